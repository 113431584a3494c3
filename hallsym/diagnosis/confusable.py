"""Confusable effects: those that a log cannot tell apart, and the recording that would separate them.

A recording is simulated from the members' own fitted models: of every pair of a group, one member generates
the readings of each possible recording, without noise; the other is fitted to these and to the log at once.
The whitened residual of that fit is how far the recording tells the two apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hallsym.diagnosis.alternatives import Alternative, alternatives
from hallsym.diagnosis.findings import EITHER
from hallsym.diagnosis.further import added, further_recordings, recording, with_readings
from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.ranking import Exact, count_of, distance
from hallsym.diagnosis.record import FoundEffect, Separation, SmallerFinding
from hallsym.diagnosis.recordings import BETWEEN, Range, Recording, range_of, recordings
from hallsym.diagnosis.refit import Refitted
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import by_name
from hallsym.diagnosis.selection import Selected, Selection
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation
from hallsym.diagnosis.verdict import Verdict
from hallsym.diagnosis.words import SHOWN
from hallsym.errors import InputError
from hallsym.log import Log
from hallsym.model import ways_text


def separation(
    names: Sequence[str],
    fits: Sequence[Refitted],
    distance: float,
    variance: float,
    advice: str,
    policy: Policy = POLICY,
) -> Separation:
    """Return the recording that would separate the members of a group.

    `fits`: the members, each fitted on the log. `distance`: whitened squared distance between what they leave
    on it. `variance`: of a slow average of the whitened residual (noise times inflation), by which squared
    distances are divided to count in sigma. `advice`: of the catalogue, for effects that cannot be simulated
    or are not separated by any of the recordings. Of the recordings that separate nearly as well as the best
    one, the plainest is proposed.
    """
    needed = policy.separated**2 * variance
    plain = Separation(
        group=tuple(names),
        recording=advice,
        distance=distance,
        needed=needed,
        factor=float((needed / max(distance, 1e-12)) ** 0.5),
        sigma_now=float((distance / variance) ** 0.5),
    )
    if not fits[0].base.timed:
        return plain  # no clock, no motion to propose
    try:
        tried, squared = simulated(fits)
        more, added = further_recordings(fits)
        tried, squared = [*tried, *more], np.concatenate([squared, added])
    except (InputError, KeyError, ValueError, np.linalg.LinAlgError):
        return plain
    sigma = np.sqrt(squared / variance)
    plain = replace(plain, tried={r.text: float(s) for r, s in zip(tried, sigma, strict=True)})
    best = int(np.argmax(sigma >= policy.mostly * sigma.max()))
    gain = float(squared[best])
    runs = max(int(np.ceil(max(needed - distance, 0.0) / gain)), 1) if gain > 0 else policy.most_runs + 1
    if runs > policy.most_runs:
        return plain
    each, text = tried[best].run.duration_s, tried[best].text
    changed = best >= len(tried) - len(more)  # of the machine: what else the catalogue advises may be simpler
    return replace(
        plain,
        recording=f"{text}; also {advice}" if changed else text,
        simulated=True,
        sigma=float(sigma[best]),
        run_s=each,
        runs=runs,
        seconds=runs * each,
    )


def simulated(fits: Sequence[Refitted]) -> tuple[list[Recording], np.ndarray]:
    """Return recordings, and the whitened squared distance that a run of each adds for the closest pair."""
    span = range_of(fits[0].base)
    tried = recordings(span)
    least = np.full(len(tried), np.inf)
    for a, b in combinations(fits, 2):
        one = _told(span, tried, a, b)
        other = _told(span, tried, b, a)
        least = np.minimum(least, np.minimum(one, other))
    return tried, least


def _told(span: Range, tried: Sequence[Recording], a: Refitted, b: Refitted) -> np.ndarray:
    """Return the squared distance of b from the readings of a, b refitted to the log and the run at once."""
    there = recording(b.base, recorded(span, tried, a.base))
    return np.array([added(M, there, b) for M in normal_equations(there).likelihood[1:]])


def recorded(span: Range, tried: Sequence[Recording], base: Base) -> Log:
    """Return the log of what `base` reads in each recording, without noise.

    The clock goes on where the log ended: a stub at its start keeps the origin of campaign time.
    """
    columns: dict[str, list[np.ndarray]] = {}
    start = span.end_s + BETWEEN
    stub = replace(tried[0].run, duration_s=span.step_s * 32)
    for number, (run, begin, warm) in enumerate(
        [(stub, span.start_s, None), *((r.run, 0.0, r.temperature) for r in tried)]
    ):
        begin = begin if number == 0 else start  # each could be the next one
        t = np.arange(max(32, round(run.duration_s / span.step_s))) * span.step_s
        here = {c: run.position(c, t) for c in (*base.model.pose, *span.vertical)}
        _append(columns, base, span, number, begin + t, here, warm(t) if warm else None)
    plain = {c: np.concatenate(v) for c, v in columns.items()}
    return with_readings(plain, base)


def _append(
    columns: dict[str, list[np.ndarray]],
    base: Base,
    span: Range,
    number: int,
    t: np.ndarray,
    here: Mapping[str, np.ndarray],
    warm: np.ndarray | None,
) -> None:
    model = base.model
    row = dict(zip(model.references, (here[c] for c in model.pose), strict=True))
    row |= {c: here[c] for c in span.vertical} | {"run": np.full(len(t), number), "t_s": t}
    if span.temperature is not None:
        row["temperature_degc"] = np.full(len(t), span.temperature) if warm is None else warm
    for c, values in row.items():
        columns.setdefault(c, []).append(values)


@dataclass(frozen=True, eq=False)
class Confusable:
    """Groups that this log cannot tell apart, what separates each, and all names that carry evidence."""

    groups: tuple[tuple[str, ...], ...]
    separate: tuple[Separation, ...]
    ranked: tuple[str, ...]
    fits: tuple[Refitted, ...] = ()
    """Models that the log does not exclude, each with everything else that was found in place."""

    def instead_of(self, name: str) -> list[str]:
        """Return what the log cannot tell from an effect: others, and sets of others that act together."""
        sides = {s.group: s.sides for s in self.separate if s.sides}
        each = (sides.get(group) or tuple((n,) for n in group) for group in self.groups)
        out = [" + ".join(side) for sets in each if (name,) in sets for side in sets if side != (name,)]
        return out[:SHOWN]


def confusable(
    setup: Setup,
    selection: Selection,
    found: Validation,
    effects: Sequence[FoundEffect],
    verdict: Verdict,
) -> Confusable:
    """Return the effects that this log cannot tell apart: exact refits that leave the same residual.

    `ranked`: the effects by share, members of their groups, and, where they explain the gap, other effects
    that the log does not exclude in their place. An effect that does not lower the gap on the holdout runs
    has no evidence.
    """
    groups: list[tuple[str, ...]] = []
    separate = []
    members = {h.selected.name: _members(setup, h.selected, found.inflation) for h in found.effects}
    known = {name: {r.score.effect.name for r, _ in rivals} for name, rivals in members.items()}
    sets, fits = [], []
    for other in alternatives(setup, selection, found, known):
        if len(other.instead_of) == len(other.names) == 1:
            one = Exact(other.scores[0], other.fit, other.fit.cost)
            members[other.instead_of[0]].append((one, other.distance))
        else:
            sets.append(other)
        fits.append(other.fit)
    for held in found.effects:
        rivals = members[held.selected.name]
        rest = {h.selected.name for h in found.effects} - {held.selected.name}
        fits += [r.fit for r, _ in rivals if rest <= set(r.fit.base.model.effects) and r.fit not in fits]
        if rivals:
            groups.append((held.selected.name, *(r.score.effect.name for r, _ in rivals)))
            separate.append(_separation(setup, groups[-1], held.selected.exact, rivals, found.inflation))
    for other in sets:
        groups.append((*other.instead_of, *other.names))
        separate.append(_from_selected(setup, found, other))
    if effects and effects[0].name in EITHER and len(setup.base.model.pose) == 1:
        groups.insert(0, EITHER)  # either turns the angle round, and its zero is free
    names = [e.name for e in effects if e.share > 0 or verdict == "partly explained"] + [
        name for group in groups for name in group
    ]
    if verdict in ("explained", "behaves like", "partly explained"):
        for held in found.effects:
            others = _not_excluded(setup, held.selected, found.inflation)
            names += [r.score.effect.name for r in others]
    return Confusable(tuple(groups), tuple(separate), tuple(dict.fromkeys(names)), tuple(fits))


def _members(setup: Setup, selected: Selected, inflation: float) -> list[tuple[Exact, float]]:
    """Return the effects that the log cannot tell from the one selected, each with its squared distance."""
    one = selected.exact
    rivals = _not_excluded(setup, selected, inflation)
    if setup.base.model.family.pairs:  # parameters for which the log gives no reason make no rival
        rivals = [r for r in rivals if r.bic - one.bic < 2 * setup.policy.as_good]
    close = [(r, distance(one.fit, r.fit)) for r in rivals]
    limit = _limit(setup, one, inflation)
    return [(r, d) for r, d in close if d < limit][:SHOWN]


def _from_selected(setup: Setup, found: Validation, other: Alternative) -> Separation:
    """Return the recording that would separate a set of effects from the selected ones."""
    mine = [h.selected.exact.score.effect for h in found.effects if h.selected.name in other.instead_of]
    group = (*other.instead_of, *other.names)
    variance = max(found.fit.cost / count_of(found.fit), 1e-12) * found.inflation
    advice = ways_text(way for e in (*mine, *(s.effect for s in other.scores)) for way in e.separate)
    said = separation(group, [found.fit, other.fit], other.distance, variance, advice, setup.policy)
    return replace(said, sides=(other.instead_of, other.names))


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
    advice = ways_text(way for e in (one, *(r for r, _ in members)) for way in e.score.effect.separate)
    closest = min(d for _, d in members)
    return separation(names, fits, closest, _variance(one, inflation), advice, setup.policy)


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
        p, shrinkage = score.p_value, 1 - score.ratio
        # what is worth more was judged, and not selected
        small = setup.policy.minor * setup.threshold <= shrinkage < setup.threshold
        if p < setup.policy.certain and small and score.effect.name not in known:
            out.append(SmallerFinding(score.effect.name, shrinkage, p))
    return tuple(out)
