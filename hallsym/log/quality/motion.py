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
_OF_A_CODE = 2.0
"""Standard deviation of noise, in codes of the converter, from which it is more than rounding: that has 0.29,
and up to 1.4 in these differences where it alternates."""
_ARITHMETIC = 1e-13
"""Differences over the largest value that are due to rounding of floating-point numbers alone."""
_EQUAL, _SMALLEST = 0.01, 0.005
"""Share of equal neighbours from which the steps themselves show the codes, and the quantile of the others
that is one code: the codes of a converter may lie unevenly."""
_MORE = 3.0
"""Equal neighbours over those by chance from which it is no noise: an axis that goes from rest to rest."""
_FEWEST = 16
_FAR = 10.0
"""Leverage of a sample over that of the usual one up to which a linear function is believed there."""
LINEAR = 0.5
"""Share of a column's variation that a linear function of others must explain to be believed."""
OVER_NOISE = 2.0
"""Spread of what a linear function predicts over what it leaves, noise and rounding, from which the column
should have moved. A column that rests between two codes hides 0.5 of one, and rounding leaves 0.29."""
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
    if codes <= _OF_A_CODE:
        return 0.0
    return codes if np.mean(steps == 0) < _MORE * equal_by_chance(codes) + _EQUAL else 0.0


def equal_by_chance(codes: float) -> float:
    """Return how often noise of so many codes, one sigma, repeats a code: 1 / (2 sqrt(pi) codes)."""
    return min(0.5, 1.0 / (2.0 * np.sqrt(np.pi) * codes))


def _spread(difference: Array, order: int) -> float:
    """Standard deviation of white noise with such differences; a few outliers do not count."""
    return float(np.median(np.abs(difference))) / (0.67449 * np.sqrt(comb(2 * order, order)))


@dataclass(frozen=True, eq=False)
class Gains:
    """A column as a linear function of others, over the samples it was fitted to.

    `share` of its variation that the function explains; `spread` of what is left, one sigma.
    """

    share: float
    spread: float
    _moving: Array
    _centre: Array
    _scale: Array
    _coefficients: Array
    _inverse: Array

    @property
    def believed(self) -> bool:
        """Whether the function explains enough of the column to say what it should have been elsewhere."""
        return self.share > LINEAR

    def moves(self, others: Sequence[Array]) -> bool:
        """Say whether the column should have moved while the others took these values, (n,) each."""
        predicted, known = self.predicted(others)
        return bool(known.any() and np.std(predicted[known]) > OVER_NOISE * self.spread)

    def predicted(self, others: Sequence[Array]) -> tuple[Array, Array]:
        """Return the column (n,) by the others, and where the fitted samples support it, (n,) of bool.

        Their leverage says so: that of the fitted samples is 1 on average.
        """
        table = _table(others, self._moving, self._centre, self._scale)
        leverage = np.sum(table * (self._inverse @ table), axis=0) / len(table)
        return self._coefficients @ table, leverage < _FAR


def gains(x: Array, others: Sequence[Array], good: Array) -> Gains | None:
    """Fit column x (n,) by others (n,) and a constant over the `good` samples; None if these are too few."""
    values = np.array([other[good] for other in others])
    scale = values.std(axis=1) if values.size else np.zeros(0)
    moving = np.flatnonzero(scale > 0)
    count = int(np.count_nonzero(good))
    if not len(moving) or count < 4 * (len(moving) + 1):
        return None
    centre = values.mean(axis=1)
    table = _table(list(values), moving, centre, scale)
    inverse = np.linalg.pinv(table @ table.T / count, hermitian=True)
    coefficients = inverse @ (table @ x[good]) / count
    rest = x[good] - coefficients @ table
    variance = float(np.var(x[good]))
    share = 1.0 - float(np.mean(rest**2)) / variance if variance > 0 else 0.0
    spread = float(np.sqrt(np.sum(rest**2) / (count - len(table))))
    return Gains(share, spread, moving, centre, scale, coefficients, inverse)


def _table(others: Sequence[Array], moving: Array, centre: Array, scale: Array) -> Array:
    rows = [(others[k] - centre[k]) / scale[k] for k in moving.tolist()]
    return np.array([*rows, np.ones(len(others[0]))])
