"""Whether a reading that piles up at an end of its range is cut off there, or turns or rests there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hallsym.log.quality.motion import gains, stretches
from hallsym.log.quality.piles import Pile
from hallsym.units import Array

_SURE = 8.0
"""Ratio of a pile that is told from a turning point by its size alone, where the reading is no linear
function of the references: a wave with a flat top has up to 1 / (2^(1/4) - 1) = 5.3."""
_CORNER, _OUTSIDE = 2.0, 3
"""Depth that a smooth turning point would have, slope times duration over 8, over the width of the pile from
which it is cut off; and samples before and after it that tell the slope. A parabola is a quarter of slope
times duration deep, a wave with a flat top, of fourth order, an eighth."""
_RUNS = 8
"""Runs, those with the most samples in a pile, in which the motion is looked at."""
_LINEAR, _STRAIGHT = 0.98, 0.9995
"""Share of a run's variation from which the reading is a linear function of the references there: where noise
is what it leaves, and where something else is."""
_BESIDE, _BENT = 0.1, 0.3
"""Share of a run's range beside a pile in which a linear function still holds if the pile is a rail, and what
it may miss there over what it misses in the pile: a reading that bends by itself begins to before."""
_FEWEST_OFF = 20
"""Samples of a run off the rails that a linear function is fitted to."""
_OVER_NOISE, _OVER_MISFIT, _FLAT = 2.0, 4.0, 0.5
"""A rail hides motion: the prediction spreads more than what the fit leaves, if that is noise and if it is
not, and the reading less than the prediction."""
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
    runs, counts = np.unique(run[pile.of(x)], return_counts=True)
    parts = [run == one for one in runs[np.argsort(-counts)[:_RUNS]].tolist()]
    found = [_beside_gains(x[p], [values[p] for values in motion], pile, free[p]) for p in parts]
    found = [row for row in found if row is not None] or [_beside_gains(x, motion, pile, free)]
    if found == [None]:
        rest = [run == one for one in np.setdiff1d(run, runs)[:_RUNS].tolist()]
        alike = [_beside_gains(x[p], [values[p] for values in motion], pile, free[p]) for p in rest]
        return False if sum(row is not None for row in alike) > len(alike) / 2 else None
    table = np.array([row for row in found if row])
    if not len(table):
        return False
    hidden, left, seen, missed, bent, white = np.average(table[:, 1:], axis=0, weights=table[:, 0])
    least = _OVER_NOISE if white > _WHITE else _OVER_MISFIT
    moves = hidden > least**2 * left and seen < _FLAT**2 * hidden
    return bool(moves and bent < _BENT * missed)


def _beside_gains(x: Array, motion: Sequence[Array], pile: Pile, free: Array) -> list[float] | None:
    """Return what a linear function of the references, fitted to the `free` samples, says of a pile.

    Samples of the pile, variances of prediction, fit and reading there, what the function misses in the pile
    and beside it, and how white that is. [] where it cannot tell, None where the reading is no such function.
    """
    on = pile.of(x)
    if np.count_nonzero(free) < _FEWEST_OFF:
        return None
    found = gains(x, motion, free)
    if found is None or found.share < _LINEAR:
        return None
    predicted, known = found.predicted(motion)
    on &= known
    if np.count_nonzero(on) < 2:
        return []
    misses = pile.sign * (predicted - x)
    white = _whiteness(misses[free])
    if white < _WHITE and found.share < _STRAIGHT:
        return None
    near = free & (pile.sign * x > pile.sign * pile.edge - _BESIDE * np.ptp(x))
    bent = float(misses[near].mean()) if near.any() else 0.0
    spreads = (float(np.var(predicted[on])), found.spread**2, float(np.var(x[on])))
    return [float(np.count_nonzero(on)), *spreads, float(misses[on].mean()), bent, white]


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
    if len(steps) < _FEWEST_OFF or wide == 0.0:
        return True
    return float(np.median(steps)) > _WHITE * np.sqrt(2.0) * wide
