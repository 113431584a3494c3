"""Readings that are cut off at the ends of their range: both rails together, with or without noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.log.columns import is_reading, is_reference
from hallsym.log.core import Drop, Log
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.scan import OVER_NOISE, WHOLE_ROWS, Scan, Whole, code, gains, stretches
from hallsym.units import Array, si_symbol

TURN = 2.6
"""Samples within a window at the end of the range over those of the fullest window beside it, of a pile. A
sine that turns there has 1 / (sqrt(2) - 1) = 2.4, a triangle 1."""
SAME = 8
"""Samples exactly at the end of the range that are a pile where no three of the others are equal but for
rounding."""
_ROUNDING = 1e-9
"""Distance over the range up to which values are equal but for rounding: a wave that comes back to the same
phase again and again has one exact value at its ends only, where it is flat. Of 100,000 samples at random,
three are as close once in 2,000 logs."""
_CHANCE = 2.0
"""Standard deviations of a count that are left to chance."""
_WINDOWS = 2
"""Windows beside it, of which the fullest counts."""
_BESIDE = 4
"""Samples that the fullest must hold: values that repeat with each period are no piles."""
_WIDTHS = 2.0 ** np.arange(-13, -3.9, 0.5)
"""Widths of the windows over the range: noise on a rail is not wider than a sixteenth, nor codes narrower."""
_BEYOND = 0.002
"""Share of the samples that may lie beyond a rail: glitches of the logger."""
_LEVELS = 10
"""Codes that a range must have: fewer say nothing about a pile."""


@dataclass(frozen=True)
class Pile:
    """The pile at one end, `sign` +1 (high) or -1: samples from `edge` on; `ratio` to those beside it."""

    sign: float
    edge: float
    ratio: float

    def of(self, x: Array) -> Array:
        """Return which samples (n,) belong to it."""
        return np.asarray(self.sign * x >= self.sign * self.edge)


def piles(ordered: Array) -> list[Pile]:
    """Return the piles at the ends of samples (n,) by size."""
    step = code(ordered)
    if not ordered[-1] - ordered[0] > _LEVELS * step:
        return []
    ends = (-1.0, _highest(-ordered[::-1], step)), (1.0, _highest(ordered, step))
    return [Pile(sign, sign * found[0], found[1]) for sign, found in ends if found is not None]


def _highest(ordered: Array, step: float) -> tuple[float, float] | None:
    """Return edge and ratio of the pile at the end of ascending samples; windows are wider than `step`."""
    n, span = len(ordered), float(ordered[-1] - ordered[0])
    first = int(np.searchsorted(ordered, ordered[-1]))
    if n - first >= SAME and _alone(ordered[:first]):
        return float(ordered[-1]), np.inf
    end = ordered[-1 - int(_BEYOND * n)]
    widths = span * _WIDTHS
    bounds = end - np.outer(widths, np.arange(_WINDOWS + 2))
    counts = -np.diff(np.searchsorted(ordered, bounds.ravel(), side="right").reshape(bounds.shape), axis=1)
    top, fullest = counts[:, 0], counts[:, 1:].max(axis=1)
    sure = top > TURN * fullest + _CHANCE * np.sqrt(top + TURN**2 * fullest)
    good = sure & (fullest >= _BESIDE) & (widths > 1.5 * step)
    if not good.any():
        return None
    ratio = np.where(good, top / np.maximum(fullest, 1), 0.0)
    best = int(np.argmax(ratio))
    return float(np.nextafter(bounds[best, 1], np.inf)), float(ratio[best])


def _alone(ordered: Array) -> bool:
    """Say whether no three of ascending samples are equal but for rounding, but at their lower end."""
    above = ordered[int(np.searchsorted(ordered, ordered[0], side="right")) :] if len(ordered) else ordered
    near = _ROUNDING * float(ordered[-1] - ordered[0]) if len(ordered) else 0.0
    return not bool((above[2:] - above[:-2] <= near).any())


_SURE = 8.0
"""Ratio of a pile that is told from a turning point by its size alone, where the reading is no linear
function of the references: a wave with a flat top has up to 1 / (2^(1/4) - 1) = 5.3."""
_CORNER, _OUTSIDE = 2.0, 3
"""Depth that a smooth turning point would have, slope times duration over 8, over the width of the pile from
which it is cut off; and samples before and after it that tell the slope. A parabola is a quarter of slope
times duration deep, a wave with a flat top, of fourth order, an eighth."""
_LINEAR, _STRAIGHT = 0.98, 0.9995
"""Share of a run's variation from which the reading is a linear function of the references there: where noise
is what it leaves, and where something else is."""
_NEAR, _BENT = 0.1, 0.3
"""Share of a run's range beside a pile in which a linear function still holds if the pile is a rail, and what
it may miss there over what it misses in the pile: a reading that bends by itself begins to before."""
_FLAT = 0.5
"""Spread of a reading on a rail over that of its prediction, at most: a rail hides motion."""
_WHITE = 0.5
"""Whiteness from which what a linear function leaves is noise, and from which a reference only has noise."""
_GOES_ON = 0.5
"""Motion of the reference on a rail over that elsewhere, median steps: 0 at a turning point or a rest."""


def is_cut_off(x: Array, motion: Sequence[Array], run: Array, pile: Pile, free: Array) -> bool:
    """Say whether references (n,) move on while a reading x (n,) stays in a pile; `free`: samples in none."""
    if not free.any():
        return False
    within = pile.of(x)
    linear = _linear(x, motion, run, pile, free)
    if linear is not None:
        return linear
    open_runs = np.isin(run, np.unique(run[free]))  # a run that never leaves the pile says nothing
    told = np.count_nonzero(within & open_runs)
    if not told or pile.ratio * told < _SURE * np.count_nonzero(within):
        return False
    goes_on = any(_goes_on(values, run, within) for values in _related(x, motion, free))
    return goes_on and _has_corners(x, run, within) and _is_flat(x, run, within)


def _linear(x: Array, motion: Sequence[Array], run: Array, pile: Pile, free: Array) -> bool | None:
    """Judge the runs in which the reading is a linear function of the references; None if there is none."""
    runs = np.unique(run[pile.of(x)])
    parts = [run == one for one in runs.tolist()]
    found = [_beside_gains(x[p], [values[p] for values in motion], pile, free[p]) for p in parts]
    found = [row for row in found if row is not None] or [_beside_gains(x, motion, pile, free)]
    if found == [None]:
        rest = [run == one for one in np.setdiff1d(run, runs).tolist()]
        alike = [_beside_gains(x[p], [values[p] for values in motion], pile, free[p]) for p in rest]
        return False if sum(row is not None for row in alike) > len(alike) / 2 else None
    table = np.array([row for row in found if row])
    if not len(table):
        return False
    hidden, left, seen, missed, bent = np.average(table[:, 1:], axis=0, weights=table[:, 0])
    moves = hidden > OVER_NOISE**2 * left and seen < _FLAT**2 * hidden
    return bool(moves and bent < _BENT * missed)


def _beside_gains(x: Array, motion: Sequence[Array], pile: Pile, free: Array) -> list[float] | None:
    """Return what a linear function of the references, fitted to the `free` samples, says of a pile.

    Samples of the pile, variances of prediction, fit and reading there, what the function misses in the pile
    and beside it. [] where it cannot tell, None where the reading is no such function.
    """
    on = pile.of(x)
    found = gains(x, motion, free)
    if found is None or found.share < _LINEAR:
        return None
    predicted, known = found.predicted(motion)
    on &= known
    if np.count_nonzero(on) < 2:
        return []
    misses = pile.sign * (predicted - x)
    if _whiteness(misses[free]) < _WHITE and found.share < _STRAIGHT:
        return None
    near = free & (pile.sign * x > pile.sign * pile.edge - _NEAR * np.ptp(x))
    bent = float(misses[near].mean()) if near.any() else 0.0
    spreads = (float(np.var(predicted[on])), found.spread**2, float(np.var(x[on])))
    return [float(np.count_nonzero(on)), *spreads, float(misses[on].mean()), bent]


def _whiteness(rest: Array) -> float:
    """Return half the mean square of the steps over the variance: 1 for white noise, near 0 for misfit."""
    variance = float(np.var(rest))
    return float(np.var(np.diff(rest))) / (2 * variance) if variance > 0 else 0.0


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
        if _whiteness(motion[here]) > _WHITE:
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


def _is_flat(x: Array, run: Array, pile: Array) -> bool:
    """Say whether what a reading does in a pile is noise, or nothing; True if it is too short."""
    steps = np.abs(np.diff(x))[pile[1:] & pile[:-1] & (run[1:] == run[:-1])]
    wide = float(np.median(np.abs(x[pile] - np.median(x[pile]))))
    if not len(steps) or wide == 0.0:
        return True
    return float(np.median(steps)) > _WHITE * np.sqrt(2.0) * wide


REFUSE = 0.05
"""Share of the samples on the rails from which a log is refused. A sine cut off for 5 % of the
time lacks 0.3 % of its stroke, which matters to nothing; beyond it a calibration extrapolates."""


def saturated(log: Log, seen: Scan) -> Iterator[Finding]:
    """Readings with samples on a rail; what is left out are those not between the edges of its piles."""
    for name in filter(is_reading, seen.traces):
        trace = seen.traces[name]
        if trace.nonfinite or not trace.low < trace.high:
            continue
        if max(trace.at_low, trace.at_high) < SAME and not piles(seen.sample.whole.ordered(name)):
            continue
        whole = _samples(log, seen, name)
        found, x = _rails(whole, name), whole.data[name]
        if not found:
            continue
        on = np.any([pile.of(x) for pile in found], axis=0)
        low = max((pile.edge for pile in found if pile.sign < 0), default=-np.inf)
        high = min((pile.edge for pile in found if pile.sign > 0), default=np.inf)
        where = " and ".join(f"{v:.4g}" for v in sorted(float(np.median(x[pile.of(x)])) for pile in found))
        runs, inverse, counts = np.unique(whole.run, return_inverse=True, return_counts=True)
        shares, share = np.bincount(inverse, weights=on) / counts, float(np.mean(on))
        worst = int(np.argmax(shares))
        yield Finding(
            f"{the(log, name)} is saturated: {round(share * seen.rows)} samples ({share:.1%}) lie on its"
            f" rail{'s' if len(found) > 1 else ''} at {where} {si_symbol(name)}, most in run {runs[worst]}"
            f" ({shares[worst]:.0%})",
            share > REFUSE, Drop(between=((name, low, high),)), remedy="lower the gain or the travel",
        )  # fmt: skip


def _samples(log: Log, seen: Scan, name: str) -> Whole:
    """Return a reading beside the references: whole, or thinned where the log is long."""
    references = [column for column in seen.traces if is_reference(column)]
    if seen.rows > WHOLE_ROWS:
        thinned = seen.sample.whole
        return Whole(thinned.run, {c: thinned.data[c] for c in (name, *references)})
    return Whole.of(log, (name, *references))


def _rails(whole: Whole, name: str) -> list[Pile]:
    """Return the piles at both ends in which the reading is cut off, and does not rest or turn."""
    x, found = whole.data[name], piles(whole.ordered(name))
    free = ~np.any([pile.of(x) for pile in found], axis=0) if found else np.empty(0, bool)
    motion = [values for column, values in whole.data.items() if is_reference(column)]
    return [pile for pile in found if not motion or is_cut_off(x, motion, whole.run, pile, free)]
