"""Readings that are cut off at the ends of their range: both rails together, with or without noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.limits import is_reading, is_reference
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.motion import follows, stretches
from hallsym.log.quality.piles import SAME, Pile, piles
from hallsym.log.quality.sample import WHOLE_ROWS, Whole
from hallsym.log.quality.scan import Scan
from hallsym.units import Array, si_unit

REFUSE = 0.05
"""Share of the samples on the rails from which a log is refused. A sine cut off for 5 %
of the time lacks 0.3 % of its stroke, which matters to nothing; beyond it a calibration extrapolates."""
_SURE = 8.0
"""Ratio of a pile that is told from a turning point by its size alone, where the reading is no linear
function of the references: a wave with a flat top has up to 1 / (2^(1/4) - 1) = 5.3."""
_CORNER, _OUTSIDE = 2.0, 3
"""Depth that a smooth turning point would have, slope times duration over 8, over the width of the pile from
which it is cut off; and samples before and after it that tell the slope. A parabola is a quarter of slope
times duration deep, a wave with a flat top, of fourth order, an eighth."""
_RUNS = 8
"""Runs, those with the most samples in a pile, in which the motion is looked at."""
_LINEAR = 0.98
"""Share of a run's variation from which the reading is a linear function of the references there."""
_ENDS = 0.1
"""Share of a run's range at either end that takes no part in the fit of that function."""
_FEWEST_OFF = 20
"""Samples of a run off the rails that a linear function is fitted to."""
_OVER_NOISE, _FLAT = 2.0, 0.5
"""A rail hides motion: the prediction spreads more than what the fit leaves, the reading less than it."""
_NOISE_ONLY = 0.5
"""Mean square of a reference's steps over twice its variance from which its motion in a run is noise: 1."""
_GOES_ON = 0.5
"""Motion of the reference on a rail over that elsewhere, median steps: 0 at a turning point or a rest."""


@dataclass(frozen=True)
class Rails:
    """The rails of a reading: samples that are not between `low` and `high` lie on them (-inf, inf: none).

    `at` holds the level of each rail, `count` the samples on them; `worst` the run with the largest share.
    """

    low: float
    high: float
    at: tuple[float, ...]
    count: int
    worst: tuple[int, float]


def saturated(log: Log, seen: Scan) -> Iterator[Finding]:
    """Readings with samples on a rail."""
    for name in filter(is_reading, seen.traces):
        trace = seen.traces[name]
        if trace.nonfinite or not trace.low < trace.high:
            continue
        if max(trace.at_low, trace.at_high) >= SAME or piles(seen.sample.whole.data[name]):
            rails = _rails(log, name)
            if rails:
                yield _finding(log, name, rails, min(seen.rows, WHOLE_ROWS))


def _finding(log: Log, name: str, rails: Rails, rows: int) -> Finding:
    share, unit = rails.count / rows, si_unit(name)
    where = " and ".join(f"{level:.4g}" for level in rails.at)
    refuse = share > REFUSE
    return Finding(
        f"{the(log, name)} is saturated: {rails.count} samples ({share:.1%}) lie on its"
        f" rail{'s' if len(rails.at) > 1 else ''} at {where} {unit}, most in run {rails.worst[0]}"
        f" ({rails.worst[1]:.0%})",
        refuse, Drop(between=((name, rails.low, rails.high),)), remedy="lower the gain or the travel",
    )  # fmt: skip


def _rails(log: Log, name: str) -> Rails | None:
    """Look at whole columns: both ends, then whether the reading is cut off there or rests or turns there."""
    references = [column for column in log.columns if is_reference(column)]
    whole = Whole.of(log, (name, *references))
    x = whole.data[name]
    found = piles(x)
    free = ~np.any([pile.of(x) for pile in found], axis=0) if found else np.empty(0, bool)
    motion = [whole.data[column] for column in references]
    found = [pile for pile in found if not motion or _cut_off(x, motion, whole.run, pile, free)]
    if not found:
        return None
    on = np.any([pile.of(x) for pile in found], axis=0)
    return Rails(
        max((pile.edge for pile in found if pile.sign < 0), default=-np.inf),
        min((pile.edge for pile in found if pile.sign > 0), default=np.inf),
        tuple(sorted(float(np.median(x[pile.of(x)])) for pile in found)),
        int(np.count_nonzero(on)),
        _worst(whole.run, on),
    )


def _worst(run: Array, on: Array) -> tuple[int, float]:
    runs, inverse, counts = np.unique(run, return_inverse=True, return_counts=True)
    shares = np.bincount(inverse, weights=on) / counts
    worst = int(np.argmax(shares))
    return int(runs[worst]), float(shares[worst])


def _cut_off(x: Array, motion: Sequence[Array], run: Array, pile: Pile, free: Array) -> bool:
    """Say whether the references move on while the reading stays in a pile at its end."""
    if not free.any():
        return False
    within = pile.of(x)
    runs, counts = np.unique(run[within], return_counts=True)
    spread, left, flat, count, linear = 0.0, 0.0, 0.0, 0, False
    for one in runs[np.argsort(-counts)[:_RUNS]].tolist():
        here = run == one
        on, off = within[here], free[here]
        if np.count_nonzero(on) < 2 or np.count_nonzero(off) < _FEWEST_OFF:
            continue
        found = follows(x[here], [values[here] for values in motion], off & _middle(x[here]))
        if found is None or found.share < _LINEAR:
            continue
        linear = True
        n = int(np.count_nonzero(on))
        spread += n * float(np.var(found.predicted[on]))
        left += n * found.spread**2
        flat += n * float(np.var(x[here][on]))
        count += n
    if linear:
        return spread > _OVER_NOISE**2 * left and flat < _FLAT**2 * spread
    if pile.ratio < _SURE:
        return False
    goes_on = any(_goes_on(values, run, within) for values in _related(x, motion, free))
    return goes_on and _has_corners(x, run, within)


def _middle(x: Array) -> Array:
    """Return the samples of a run that are not near the ends of its range, where another rail may be."""
    low, high = x.min(), x.max()
    return np.asarray((x > low + _ENDS * (high - low)) & (x < high - _ENDS * (high - low)))


def _related(x: Array, motion: Sequence[Array], free: Array) -> list[Array]:
    """Return the references that a reading follows, or all of them where none stands out."""
    strength = []
    for values in motion:
        spread = x[free].std() * values[free].std()
        strength.append(
            abs(np.mean((x[free] - x[free].mean()) * (values[free] - values[free].mean())))
            / (spread or np.inf)
        )
    least = max(0.3, 0.9 * max(strength, default=0.0))
    return [values for values, s in zip(motion, strength, strict=True) if s >= least] or list(motion)


def _goes_on(motion: Array, run: Array, pile: Array) -> bool:
    """Say whether a reference moves on through the samples of a pile as it does elsewhere in their runs."""
    there = []
    for one in np.unique(run[pile]).tolist():
        here = run == one
        if np.var(np.diff(motion[here])) > _NOISE_ONLY * 2 * np.var(motion[here]):
            continue
        step = np.abs(motion[here][2:] - motion[here][:-2])
        if (usual := float(np.median(step)) if len(step) else 0.0) > 0:
            there.append(step[pile[here][1:-1]] / usual)
    steps = np.concatenate(there) if there else np.empty(0)
    return len(steps) > 0 and bool(np.median(steps) >= _GOES_ON)


def _has_corners(x: Array, run: Array, pile: Array) -> bool:
    """Say whether a reading comes to a pile, and leaves it, faster than a smooth turning point would."""
    low, high = np.quantile(x[pile], [0.025, 0.975])
    middle, depths, weights = np.median(x[pile]), [], []
    for one in np.unique(run[pile]).tolist():
        here = run == one
        values = x[here]
        for a, b in stretches(pile[here], shortest=1):
            outside = [i for i in (a - _OUTSIDE, b + _OUTSIDE - 1) if 0 <= i < len(values)]
            slopes = [abs(values[i] - middle) / _OUTSIDE for i in outside]
            if slopes:
                depths.append(float(np.mean(slopes)) * (b - a) / 8)
                weights.append(b - a)
    return len(depths) > 0 and bool(np.average(depths, weights=weights) > _CORNER * (high - low))
