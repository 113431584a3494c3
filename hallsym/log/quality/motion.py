"""What samples of one column say by themselves and beside others: noise, codes of a converter, gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from hallsym.units import Array

_ROUGH = 0.5
"""Spread of sixth over that of fourth differences, each for unit white noise, from which a column is noisy: 1
for white noise, 0.75 for noise that is correlated over many samples, below 0.05 for motion."""
_OF_A_CODE = 0.6
"""Standard deviation of noise, in codes of the converter, from which it is more than rounding (0.29)."""
_ARITHMETIC = 1e-13
"""Differences over the largest value that are due to rounding of floating-point numbers alone."""
_EQUAL, _SMALLEST = 0.01, 0.005
"""Share of equal neighbours from which the steps themselves show the codes, and the quantile of the others
that is one code: the codes of a converter may lie unevenly."""
_FEWEST = 16
_COARSE = 0.8
"""Share of distinct values below which a column shows the codes of its converter."""


def stretches(mask: Array, shortest: int = 2) -> list[tuple[int, int]]:
    """Return (start, stop) of the stretches of at least `shortest` True in a boolean array."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(np.int8)))
    return [
        (a, b) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True) if b - a >= shortest
    ]


def code(ordered: Array) -> float:
    """Return the step between codes of sorted values (n,); 0 where nearly all of them differ."""
    step = np.diff(ordered)
    step = step[step > 0]
    return float(step.min()) if len(step) and len(step) < _COARSE * len(ordered) else 0.0


def is_noisy(x: Array) -> bool:
    """Say whether samples (n,) carry noise beyond their rounding, so that no two recordings are alike."""
    return noise_in_codes(x) > 0.0


def noise_in_codes(x: Array) -> float:
    """Return the noise of samples (n,), one sigma, in codes of their converter; 0 if it is only rounding."""
    if len(x) < _FEWEST:
        return 0.0
    fourth = np.diff(x, 4)
    spread = _spread(fourth, 4)
    if not _spread(np.diff(fourth, 2), 6) > _ROUGH * spread:
        return 0.0
    steps = np.abs(np.diff(x))
    if np.mean(steps == 0) > _EQUAL:
        step = float(np.quantile(steps[steps > 0], _SMALLEST)) if steps.any() else np.inf
    else:  # differences of codes are whole numbers of codes too, whatever the motion; less is arithmetic
        whole = np.abs(fourth)
        step = float(np.min(whole[whole > _ARITHMETIC * np.abs(x).max()], initial=np.inf))
    codes = spread / step
    return codes if codes > _OF_A_CODE else 0.0


def _spread(difference: Array, order: int) -> float:
    """Standard deviation of white noise with such differences; a few outliers do not count."""
    return float(np.median(np.abs(difference))) / (0.67449 * np.sqrt(comb(2 * order, order)))


@dataclass(frozen=True)
class Follows:
    """A column as a linear function of others: `predicted` (n,) and `spread` of what is left, one sigma.

    `share` of the variation that the function explains among the samples it was fitted to.
    """

    predicted: Array
    spread: float
    share: float


def follows(x: Array, others: Sequence[Array], good: Array) -> Follows | None:
    """Fit column x (n,) by others (n,) and a constant over the `good` samples; None if these are too few."""
    moving = [
        other for other in others if (span := np.ptp(other[good], axis=0) if good.any() else 0) and span > 0
    ]
    if not moving or np.count_nonzero(good) < 4 * (len(moving) + 1):
        return None
    table = np.array(
        [(other - other[good].mean()) / other[good].std() for other in moving] + [np.ones(len(x))]
    )
    middle = x[good].mean()
    coefficients, *_ = np.linalg.lstsq(table[:, good].T, x[good] - middle, rcond=None)
    predicted = coefficients @ table + middle
    rest = x[good] - predicted[good]
    variance = float(np.var(x[good]))
    share = 1.0 - float(np.mean(rest**2)) / variance if variance > 0 else 0.0
    spread = float(np.sqrt(np.sum(rest**2) / (len(rest) - len(table))))
    return Follows(predicted, spread, share)
