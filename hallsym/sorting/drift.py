"""The drift of the bench, from the reference sensor: a random walk seen through the reference's own noise.

The field of a magnet and the supply of the sensors drift slowly; the reference sensor reads that drift with
noise of its own (electronics, its seat in a less uniform place). Dividing by each reference reading takes the
drift out and puts that noise in. The smoother takes the drift out and leaves the noise: x_j is a random walk,
var(x_j - x_j-1) = q (t_j - t_j-1), read as y_j = x_j + noise of variance r. The ratio q / r is the one of
greatest (restricted) likelihood, so that no drift and a noiseless reference are its two limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded, solveh_banded
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from hallsym.units import Array

FALSE_REFUSALS = 0.01
"""Good values that a check of a whole record may refuse, on average: 1 in 100 records."""
LEAST = 1e-12
"""What stands for zero, over what is usual."""
ANEW, SHORTEST = 1e6, 1e-3
"""Time of a step at which the walk starts anew, and of one between equal times, over the usual time."""
SIDE, LEVEL = 3, 8
"""Values on each side that a single one must differ from, and that show a new level."""
RATIOS = -14.0, 18.0
"""Natural logarithms of noise over step variance that are tried: from a noiseless reference to no drift."""
ROUNDS = 10
"""Most passes of smoothing and refusing; three are usual."""


@dataclass(frozen=True, eq=False)
class Smooth:
    """A smoothed series: `value` (n,), standard uncertainty `std` (n,), noise and step of the walk.

    `off` (n,): distance of each value from what all others say, `expected` (n,) its standard deviation;
    `bad` (n,): refused as outliers, or missing.
    """

    value: Array
    std: Array
    noise: float
    step: float
    off: Array
    expected: Array
    bad: Array


def limit(n: int) -> float:
    """Return the standard deviations beyond which one of `n` good values lies in 1 of 100 records.

    >>> round(limit(1), 2), round(limit(12700), 2)
    (2.58, 4.94)
    """
    return float(norm.isf(FALSE_REFUSALS / (2 * max(n, 1))))


def robust_std(values: Array) -> float:
    """Return 1.4826 times the median absolute deviation, which is sigma of normal values."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def smooth(values: Array, time: Array) -> Smooth:
    """Return the random walk behind `values` (n,) at `time` (n,), rising.

    Single values far from both sides take no part; where the level changes for good, as between two sessions,
    the walk starts anew.
    """
    finite = np.isfinite(values)
    good, jumps = finite & ~_spikes(values), np.zeros(max(len(values) - 1, 0), bool)
    found = _fitted(values, time, good, jumps)
    for _ in range(ROUNDS):
        away = np.abs(found.off) / np.where(found.expected > 0, found.expected, np.inf)
        usual = np.median(away[good]) / norm.ppf(0.75) if good.any() else 0.0
        far = away > limit(int(finite.sum())) * max(float(usual), LEAST)
        now = finite & ~(far & _alone(values, found))
        new = jumps | _jumps(values, now, found)
        if not found.noise or ((now == good).all() and (new == jumps).all()) or now.sum() < 3:
            break
        good, jumps = now, new
        found = _fitted(values, time, good, jumps)
    return found


def _sides(values: Array, good: Array, size: int, reduce: Callable[..., Array]) -> tuple[Array, Array]:
    """Mean or median of the `size` good values before and from each one on, (n,) each; nan at the ends."""
    at = np.flatnonzero(good)
    windows = (
        np.lib.stride_tricks.sliding_window_view(values[at], size) if len(at) >= size else np.zeros((0, size))
    )
    level = np.r_[np.full(size, np.nan), reduce(windows, axis=1), np.full(size, np.nan)]
    place = np.searchsorted(at, np.arange(len(values)))  # good values before each
    return level[place], level[place + size]


def _alone(values: Array, found: Smooth) -> Array:
    """Values that neither side agrees with."""
    before, _ = _sides(values, ~found.bad, SIDE, np.median)
    after = _sides(values[::-1], ~found.bad[::-1], SIDE, np.median)[0][::-1]
    near = np.fmin(np.abs(values - before), np.abs(values - after))
    return np.asarray(~(near <= limit(len(values)) * found.noise))


def _jumps(values: Array, good: Array, found: Smooth) -> Array:
    """Steps (n - 1,) at which the level changes by more than noise and walk can; of near ones the largest."""
    before, after = _sides(values, good, LEVEL, np.mean)
    spread = np.sqrt(2 * found.noise**2 / LEVEL + found.step**2 * (2 * LEVEL / 3))
    size = np.nan_to_num(np.abs(after - before))[1:]
    if not len(size) or not spread:
        return np.zeros(len(size), bool)
    padded = np.pad(size, LEVEL)
    largest = np.lib.stride_tricks.sliding_window_view(padded, 2 * LEVEL + 1).max(axis=1)
    return (size == largest) & (size > limit(len(values)) * spread) & good[1:]


def _spikes(values: Array, half: int = 3) -> Array:
    """Single values far from the median of their neighbours, so that the first pass is not drawn by them."""
    filled = np.where(np.isfinite(values), values, np.nanmedian(values))
    padded = np.pad(filled, half, mode="reflect") if len(filled) > half else np.pad(filled, half, mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    away = filled - middle
    return np.abs(away) > limit(len(values)) * max(robust_std(away), LEAST)


def _fitted(values: Array, time: Array, good: Array, jumps: Array) -> Smooth:
    step = np.diff(time)
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 1.0
    step = np.where(jumps, ANEW, np.maximum(step / usual, SHORTEST))
    y, w = np.where(good, values, 0.0), good.astype(float)
    centre = float(y.sum() / max(w.sum(), 1.0))
    y = np.where(good, values - centre, 0.0)
    if good.sum() < 3 or not y.any():
        zero = np.zeros(len(values))
        return Smooth(zero + centre, zero, 0.0, 0.0, zero, zero, ~good)
    grid = np.linspace(*RATIOS, 38)
    best = grid[int(np.argmin([_score(g, y, w, step) for g in grid]))]
    ratio = float(
        np.exp(minimize_scalar(_score, (best - 1, best + 1), (best - 1, best + 1), (y, w, step), "bounded").x)
    )
    banded = _matrix(w, step, ratio)
    x = solveh_banded(banded, w * y)
    noise = float(np.sqrt(_misfit(y, w, x, step, ratio) / (w.sum() - 1)))
    spread = _inverse_diagonal(banded)  # posterior variance over the noise's
    without = np.maximum(1 - w * spread, LEAST)
    off = np.where(good, (y - x) / without, np.where(np.isfinite(values), values - centre - x, 0.0))
    expected = noise * np.where(good, 1 / np.sqrt(without), np.sqrt(1 + spread))
    return Smooth(x + centre, noise * np.sqrt(spread), noise, noise / np.sqrt(ratio), off, expected, ~good)


def _matrix(w: Array, step: Array, ratio: float) -> Array:
    """Precision of the walk given the data, times the noise's variance: upper banded form (2, n)."""
    pull = ratio / step
    banded = np.zeros((2, len(w)))
    banded[1] = w
    banded[1, :-1] += pull
    banded[1, 1:] += pull
    banded[0, 1:] = -pull
    return banded


def _misfit(y: Array, w: Array, x: Array, step: Array, ratio: float) -> float:
    return float(w @ (y - x) ** 2 + ratio * np.sum(np.diff(x) ** 2 / step))


def _score(log_ratio: float, y: Array, w: Array, step: Array) -> float:
    """-2 log of the restricted likelihood of r / q, with the noise at its best, but for a constant."""
    ratio = float(np.exp(log_ratio))
    banded = _matrix(w, step, ratio)
    x = solveh_banded(banded, w * y)
    determinant = 2 * float(np.sum(np.log(cholesky_banded(banded)[1])))
    misfit = max(_misfit(y, w, x, step, ratio), np.finfo(float).tiny)
    return float((w.sum() - 1) * np.log(misfit) + determinant - (len(y) - 1) * log_ratio)


def _inverse_diagonal(banded: Array) -> Array:
    """Diagonal of the inverse of a tridiagonal matrix, from its pivots from above and from below."""
    down = cholesky_banded(banded)[1] ** 2
    turned = np.zeros_like(banded)
    turned[1], turned[0, 1:] = banded[1, ::-1], banded[0, :0:-1]
    up = cholesky_banded(turned)[1][::-1] ** 2
    return np.asarray(1 / (down + up - banded[1]))
