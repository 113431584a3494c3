"""Confusable effects: those that a log cannot tell apart, and the recording that would separate them."""

from collections.abc import Sequence
from dataclasses import dataclass

from hallsym.diagnosis.record import FoundEffect, Separation, SmallerFinding
from hallsym.diagnosis.refit import Refitted
from hallsym.diagnosis.scores import by_name
from hallsym.diagnosis.selection import Exact, Selection
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation, Verdict
from hallsym.diagnosis.words import SHOWN
from hallsym.families.faults import WIRING
from hallsym.model import ways_text


@dataclass(frozen=True, eq=False)
class Confusable:
    """Groups that this log cannot tell apart, what separates each, and all names that carry evidence."""

    groups: tuple[tuple[str, ...], ...]
    separate: tuple[Separation, ...]
    ranked: tuple[str, ...]
    fits: tuple[Refitted, ...] = ()
    """Models that the log does not exclude, each with everything else that was found in place."""

    def instead_of(self, name: str) -> list[str]:
        """Return what the log cannot tell from an effect."""
        return [other for group in self.groups if name in group for other in group if other != name][:SHOWN]


def confusable(
    setup: Setup, found: Validation, effects: Sequence[FoundEffect], verdict: Verdict
) -> Confusable:
    """Return the effects that this log cannot tell apart: exact refits that leave the same residual.

    `ranked`: the effects by share, members of their groups, and, where they explain the gap, other effects
    that the log does not exclude in their place. An effect that does not lower the gap on the holdout runs
    has no evidence.
    """
    inflation = found.inflation
    separate, fits = list[Separation](), list[Refitted]()
    for held in found.effects:
        own, rest = _alike(setup, held.exact, inflation), {h.name for h in found.effects} - {held.name}
        fits += [a.fit for a in own if rest <= set(a.fit.base.model.effects) and a.fit not in fits]
        if own:
            separate.append(_separation(inflation, held.exact, own))
    groups = [s.group for s in separate]
    if effects and effects[0].name in WIRING and len(setup.base.model.pose) == 1:
        groups.insert(0, WIRING)  # either turns the angle round, and its zero is free
    names = [e.name for e in effects if e.share > 0] + [name for group in groups for name in group]
    if verdict == "explained":
        for held in found.effects:
            names += [r.name for r in _not_excluded(setup, held.exact, inflation)]
    return Confusable(tuple(groups), tuple(separate), tuple(dict.fromkeys(names)), tuple(fits))


def _alike(setup: Setup, one: Exact, inflation: float) -> list[Exact]:
    """Return the effects that the log cannot tell from the one selected."""
    rivals = _not_excluded(setup, one, inflation)
    if setup.base.model.family.pairs:  # parameters for which the log gives no reason make no rival
        rivals = [r for r in rivals if r.bic - one.bic < 2 * setup.policy.as_good]
    limit = setup.policy.separated**2 * one.fit.variance(inflation)
    return [r for r in rivals if one.fit.distance(r.fit) < limit][:SHOWN]


def _not_excluded(setup: Setup, one: Exact, inflation: float) -> list[Exact]:
    """Return the effects that the log does not exclude in the place of the one selected."""
    limit = setup.policy.separated**2 * one.fit.variance(inflation)
    return [r for r in one.rivals if r.fit.cost - one.fit.cost < limit]


def _separation(inflation: float, one: Exact, others: Sequence[Exact]) -> Separation:
    """Return what would separate `others` from a selected effect; slow averages are known to `inflation`."""
    effects = [one.score.effect, *(o.score.effect for o in others)]
    closest = min(one.fit.distance(o.fit) for o in others)
    return Separation(
        group=tuple(e.name for e in effects),
        recording=ways_text(way for e in effects for way in e.separate),
        sigma_now=float((closest / one.fit.variance(inflation)) ** 0.5),
    )


def smaller_findings(
    setup: Setup, selection: Selection, found: Validation, below: Sequence[FoundEffect] = ()
) -> tuple[SmallerFinding, ...]:
    """Return the effects that are significant and worth less than the threshold.

    First those that were named but are too small together (`below`), then those that score beside what was
    selected.
    """
    out = [SmallerFinding(e.name, e.shrinkage, e.p_value) for e in below]
    known = {h.name for h in found.effects}
    for score in by_name(selection.last):
        p, shrinkage = score.p_value, 1 - score.ratio
        # what is worth more was judged, and not selected
        small = setup.policy.minor * setup.threshold <= shrinkage < setup.threshold
        if p < setup.policy.certain and small and score.effect.name not in known:
            out.append(SmallerFinding(score.effect.name, shrinkage, p))
    return tuple(out)
