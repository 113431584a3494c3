"""Interval arithmetic on arrays: every result encloses all that its inputs can give, rounding included."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
SLACK = 2.0**-50
"""Relative widening of library functions: numpy's err by a few units in the last place."""


@dataclass(frozen=True, eq=False)
class Interval:
    """Arrays `low` and `high` of one shape."""

    low: Array
    high: Array

    @classmethod
    def of(cls, value: Array | float) -> Interval:
        """Return the interval that is one float64 number, or one per element."""
        value = np.asarray(value, float)
        return cls(value, value)

    @property
    def most(self) -> Array:
        """Largest magnitude."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    @property
    def least(self) -> Array:
        """Smallest magnitude."""
        return np.maximum(np.maximum(self.low, -self.high), 0.0)

    def __add__(self, other: Interval) -> Interval:
        """Enclose the sum."""
        return _out(self.low + other.low, self.high + other.high)

    def __sub__(self, other: Interval) -> Interval:
        """Enclose the difference."""
        return _out(self.low - other.high, self.high - other.low)

    def __neg__(self) -> Interval:
        """Return the negative."""
        return Interval(-self.high, -self.low)

    def __mul__(self, other: Interval) -> Interval:
        """Enclose the product."""
        with np.errstate(invalid="ignore", over="ignore"):
            a, b = self.low * other.low, self.low * other.high
            c, d = self.high * other.low, self.high * other.high
        return _out(
            np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d))
        )

    def __truediv__(self, other: Interval) -> Interval:
        """Enclose the quotient; everything where the divisor may be 0."""
        holds_zero = (other.low <= 0) & (other.high >= 0)
        one = np.where(holds_zero, 1.0, other.low), np.where(holds_zero, 1.0, other.high)
        with np.errstate(over="ignore"):  # an infinite bound of the inverse of a subnormal number is right
            inverse = _out(1 / one[1], 1 / one[0])
        low = np.where(holds_zero, -np.inf, inverse.low)
        return self * Interval(low, np.where(holds_zero, np.inf, inverse.high))

    def scaled(self, factor: float) -> Interval:
        """Return the product with a number."""
        low, high = (self.low, self.high) if factor >= 0 else (self.high, self.low)
        return _out(low * factor, high * factor)


def _out(low: Array, high: Array) -> Interval:
    """Round outwards; nan (inf - inf, 0 inf) is everything."""
    low, high = np.nextafter(low, -np.inf), np.nextafter(high, np.inf)
    if np.isnan(low).any() or np.isnan(high).any():
        unknown = np.isnan(low) | np.isnan(high)
        return Interval(np.where(unknown, -np.inf, low), np.where(unknown, np.inf, high))
    return Interval(low, high)


def rising(
    function: Callable[[Array], Array], x: Interval, low: float = -np.inf, high: float = np.inf
) -> Interval:
    """Return the range of a function that increases, defined on [low, high]; everything where x leaves it."""
    inside = (x.low >= low) & (x.high <= high)
    with np.errstate(all="ignore"):
        a = function(np.where(inside, x.low, max(low, 0.5)))
        b = function(np.where(inside, x.high, max(low, 0.5)))
    return Interval(
        np.where(inside, a - SLACK * np.abs(a) - 1e-300, -np.inf),
        np.where(inside, b + SLACK * np.abs(b) + 1e-300, np.inf),
    )


def sine(x: Interval, shift: float = 0.0) -> Interval:
    """Return the range of sin(x + shift), shift 0 or pi/2 (the cosine)."""
    function = np.sin if shift == 0.0 else np.cos
    with np.errstate(invalid="ignore"):
        a, b = function(x.low), function(x.high)
        slack = 4 * SLACK * (1.0 + x.most)
        low, high = np.minimum(a, b) - SLACK, np.maximum(a, b) + SLACK
        turn = 2 * np.pi
        first, last = (x.low + shift - slack) / turn, (x.high + shift + slack) / turn
        high = np.where(np.floor(last - 0.25) >= np.ceil(first - 0.25), 1.0, high)
        low = np.where(np.floor(last + 0.25) >= np.ceil(first + 0.25), -1.0, low)
        known = np.isfinite(x.low) & np.isfinite(x.high)
    return Interval(np.where(known, np.maximum(low, -1.0), -1.0), np.where(known, np.minimum(high, 1.0), 1.0))


def hyperbolic_cosine(x: Interval) -> Interval:
    """Return the range of cosh."""
    with np.errstate(over="ignore"):
        low, high = np.cosh(x.least), np.cosh(x.most)
    return Interval(np.maximum(low * (1 - SLACK), 1.0), high * (1 + SLACK))
