"""Confusable effects: those that a log cannot tell apart, those it does not exclude, and smaller findings."""

from collections.abc import Sequence
from dataclasses import dataclass

from hallsym.diagnosis.findings import EITHER
from hallsym.diagnosis.ranking import Exact, count_of, distance
from hallsym.diagnosis.record import FoundEffect, Separation, SmallerFinding
from hallsym.diagnosis.scores import by_name
from hallsym.diagnosis.selection import Selected, Selection
from hallsym.diagnosis.separate import separation
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation
from hallsym.diagnosis.verdict import Verdict

MOST = 3
"""Other effects that a group holds at most, in the order of their fit."""


@dataclass(frozen=True, eq=False)
class Confusable:
    """Groups that this log cannot tell apart, what separates each, and all names that carry evidence."""

    groups: tuple[tuple[str, ...], ...]
    separate: tuple[Separation, ...]
    ranked: tuple[str, ...]


def confusable(
    setup: Setup, found: Validation, effects: Sequence[FoundEffect], verdict: Verdict
) -> Confusable:
    """Return the effects that this log cannot tell apart: exact refits that leave the same residual.

    `ranked`: the effects by share, members of their groups, and, where they explain the gap, other effects
    that the log does not exclude in their place. An effect that does not lower the gap on the holdout runs
    has no evidence.
    """
    groups: list[tuple[str, ...]] = []
    separate = []
    for held in found.effects:
        members = _members(setup, held.selected, found.inflation)
        if members:
            groups.append((held.selected.name, *(r.score.effect.name for r, _ in members)))
            separate.append(_separation(setup, groups[-1], held.selected.exact, members, found.inflation))
    if effects and effects[0].name in EITHER and len(setup.base.model.pose) == 1:
        groups.insert(0, EITHER)  # either turns the angle round, and its zero is free
    names = [e.name for e in effects if e.share > 0] + [name for group in groups for name in group]
    if verdict == "explained":
        for held in found.effects:
            rivals = _not_excluded(setup, held.selected, found.inflation)
            names += [r.score.effect.name for r in rivals]
    return Confusable(tuple(groups), tuple(separate), tuple(dict.fromkeys(names)))


def _members(setup: Setup, selected: Selected, inflation: float) -> list[tuple[Exact, float]]:
    """Return the effects that the log cannot tell from the one selected, each with its squared distance."""
    one = selected.exact
    rivals = _not_excluded(setup, selected, inflation)
    if setup.base.model.family.pairs:  # parameters for which the log gives no reason make no rival
        rivals = [r for r in rivals if r.bic - one.bic < setup.policy.reason]
    close = [(r, distance(one.fit, r.fit)) for r in rivals]
    limit = _limit(setup, one, inflation)
    return [(r, d) for r, d in close if d < limit][:MOST]


def _not_excluded(setup: Setup, selected: Selected, inflation: float) -> list[Exact]:
    """Return the effects that the log does not exclude in the place of the one selected."""
    limit = _limit(setup, selected.exact, inflation)
    return [r for r in selected.rivals if r.fit.cost - selected.exact.fit.cost < limit]


def _limit(setup: Setup, one: Exact, inflation: float) -> float:
    """Whitened squares by which two fits must differ to be told apart."""
    return setup.policy.separated**2 * _variance(one, inflation)


def _variance(one: Exact, inflation: float) -> float:
    """Variance of a slow average of the whitened residual."""
    return max(one.fit.cost / count_of(one.fit), 1e-12) * inflation


def _separation(
    setup: Setup, names: tuple[str, ...], one: Exact, members: Sequence[tuple[Exact, float]], inflation: float
) -> Separation:
    fits = [one.fit, *(r.fit for r, _ in members)]
    advice = ways([e.score.effect.separate for e in (one, *(r for r, _ in members))])
    closest = min(d for _, d in members)
    return separation(names, fits, closest, _variance(one, inflation), advice, setup.policy)


def ways(records: Sequence[str]) -> str:
    """Return what the members of a group ask to be recorded, each way once with all that it would show.

    >>> ways(["another air gap; or a longer run", "another air gap: it follows the field"])
    'another air gap: it follows the field; or a longer run'
    """
    reasons: dict[str, dict[str, None]] = {}
    for way in (way for record in records for way in record.split("; or ")):
        what, _, reason = way.partition(": ")
        reasons.setdefault(what, {}).update({reason: None} if reason else {})
    return "; or ".join(f"{what}: {', '.join(why)}" if why else what for what, why in reasons.items())


def smaller_findings(
    setup: Setup, selection: Selection, found: Validation, below: Sequence[FoundEffect] = ()
) -> tuple[SmallerFinding, ...]:
    """Return the effects that are significant and worth less than the threshold.

    First those that were named but are too small together (`below`), then those that do not hold on the
    holdout runs, then those that score beside what was selected.
    """
    out = [SmallerFinding(e.name, e.shrinkage, e.p_value) for e in below] + list(found.dropped)
    known = {h.selected.name for h in found.effects} | {d.name for d in found.dropped}
    for score in by_name(selection.last):
        p, shrinkage = score.corrected(setup.tested), 1 - score.ratio
        # what is worth more was judged, and not selected
        small = setup.policy.smallest * setup.threshold <= shrinkage < setup.threshold
        if p < setup.policy.certain and small and score.effect.name not in known:
            out.append(SmallerFinding(score.effect.name, shrinkage, p))
    return tuple(out)
