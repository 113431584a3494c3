"""Confusable effects: those that a log cannot tell apart, and the recording that would separate them.

A recording is simulated from the members' own fitted models: of every pair of a group, one member generates
the readings of each possible recording, without noise; the other is fitted to these and to the log at once.
The whitened residual of that fit is how far the recording tells the two apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.record import FoundEffect, Separation, SmallerFinding
from hallsym.diagnosis.recordings import (
    Range,
    Recording,
    added,
    further_recordings,
    range_of,
    recording,
    recordings,
    with_readings,
)
from hallsym.diagnosis.refit import Refitted
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import by_name
from hallsym.diagnosis.selection import Exact, Selection
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation, Verdict
from hallsym.diagnosis.words import SHOWN
from hallsym.errors import InputError
from hallsym.families.faults import WIRING
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
    model = base.model
    stub = replace(tried[0].run, duration_s=span.step_s * 32)
    each_next = ((r.run, span.end_s + span.step_s, r.temperature) for r in tried)
    rows = []
    for number, (run, begin, warm) in enumerate([(stub, span.start_s, None), *each_next]):
        t = np.arange(max(32, round(run.duration_s / span.step_s))) * span.step_s
        here = {c: run.position(c, t) for c in (*model.pose, *span.vertical)}
        row = dict(zip(model.references, (here[c] for c in model.pose), strict=True))
        row |= {c: here[c] for c in span.vertical} | {"run": np.full(len(t), number), "t_s": begin + t}
        if span.temperature is not None:
            row["temperature_degc"] = warm(t) if warm else np.full(len(t), span.temperature)
        rows.append(row)
    return with_readings({c: np.concatenate([row[c] for row in rows]) for c in rows[0]}, base)


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
            separate.append(_separation(setup, inflation, held.exact, own))
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


def _separation(setup: Setup, inflation: float, one: Exact, others: Sequence[Exact]) -> Separation:
    """Return the recording that would separate `others` from a selected effect."""
    effects = [one.score.effect, *(o.score.effect for o in others)]
    advice = ways_text(way for e in effects for way in e.separate)
    closest = min(one.fit.distance(o.fit) for o in others)
    variance, fits = one.fit.variance(inflation), [one.fit, *(o.fit for o in others)]
    return separation([e.name for e in effects], fits, closest, variance, advice, setup.policy)


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
