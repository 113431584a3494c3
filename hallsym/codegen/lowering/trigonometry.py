"""Arctangent and sine without libm: odd minimax polynomials with a proved bound, and angles that wrap.

Coefficients are float32 numbers, so the same polynomial is computed in float and in double; they were found
by Remez' exchange and rounded one by one. What a polynomial leaves is not taken on trust: `largest` bounds it
from its coefficients, on a grid and between its points.
"""

from collections.abc import Callable, Sequence
from functools import cache
from math import pi

import casadi as ca
import numpy as np

ARCTANGENT = (
    0.999999344, -0.333298594, 0.199465662, -0.139086291, 0.0964219719, -0.055912327, 0.0218629576,
    -0.00405456731,
)  # fmt: skip
"""atan q = q (a0 + a1 q^2 + ...) for 0 <= q <= 1, degree 15: off by 6.7e-8 rad, half of what float32 rounds
an angle near pi by (1.2e-7 rad); degree 13 would leave 2.5e-7 rad."""
SINE = (1.0, -0.166666478, 0.00833289977, -0.000198008973, 2.59048852e-06)
"""sin t = t (a0 + a1 t^2 + ...) for |t| <= pi / 2, degree 9: off by 3.4e-8."""
TURN_HIGH = float(np.float32(2 * pi))
TURN_LOW = 2 * pi - TURN_HIGH
"""2 pi in two parts: x - TURN_HIGH is exact in float32 for pi <= x <= 4 pi (Sterbenz): one rounding."""
HALF_PI, PI = pi / 2, pi
GRID = 1 << 18


def odd(coefficients: Sequence[float], x: ca.SX, square: ca.SX) -> ca.SX:
    """Return x (a0 + a1 x^2 + ...) by Horner's rule; `square` = x^2."""
    total: ca.SX = ca.SX(_single(coefficients[-1]))
    for a in reversed(coefficients[:-1]):
        total = total * square + _single(a)
    return x * total


@cache
def arctangent_error() -> float:
    """Return the bound of |polynomial - atan q| [rad] over 0 <= q <= 1."""
    return largest(ARCTANGENT, np.arctan, 1.0)


@cache
def sine_error() -> float:
    """Return the bound of |polynomial - sin t| over |t| <= pi / 2."""
    return largest(SINE, np.sin, pi / 2)


def largest(coefficients: Sequence[float], function: Callable[[np.ndarray], np.ndarray], end: float) -> float:
    """Return a bound of |polynomial - function| over 0 .. end, the function atan or sin.

    Between points h apart the error e moves by at most h/2 max |e'|; (e[k+1] - e[k]) / h is a value of e'
    within each interval, and e' moves from it by at most h max |e''|, which the coefficients bound.
    """
    a = np.array([_single(c) for c in coefficients])
    q = np.linspace(0.0, end, GRID + 1)
    e = np.polyval(a[::-1], q * q) * q - function(q)
    k, h = np.arange(len(a)), end / GRID
    bend = (
        float((2 * k * (2 * k + 1) * np.abs(a) * end ** np.maximum(2 * k - 1, 0)).sum()) + 1.0
    )  # |f''| <= 1
    rounding = 8 * np.finfo(float).eps * float(np.abs(function(q)).max())
    slope = (np.abs(np.diff(e)).max() + 2 * rounding) / h + h * bend
    return float(np.abs(e).max() + rounding + h / 2 * slope)


def _single(value: float) -> float:
    return float(np.float32(value))


def wrapped(x: ca.SX) -> ca.SX:
    """Return x within -pi .. pi, for |x| <= 3 pi."""
    above, below = (x - TURN_HIGH) - TURN_LOW, (x + TURN_HIGH) + TURN_LOW
    return ca.if_else(x > PI, above, ca.if_else(x < -PI, below, x))
