"""Odd polynomials with a proved bound in place of functions: arctangent, logarithm; angles that wrap.

Coefficients are float32 numbers, so the same polynomial is computed in float and in double; it is the
shortest for an accuracy. ln(s / m) = 2 artanh t, t = (s - m) / (s + m): one division, no comparison and no
bits of the number. What a polynomial leaves is not taken on trust: `largest` bounds it from its coefficients,
on a grid and between its points.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import pi

import casadi as ca
import numpy as np

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


def largest(
    coefficients: Sequence[float],
    function: Callable[[np.ndarray], np.ndarray],
    end: float,
    bend: float,
) -> float:
    """Return a bound of |polynomial - function| over 0 .. end, of a function that grows.

    Between points h apart the error e moves by at most h/2 max |e'|; (e[k+1] - e[k]) / h is a value of e'
    within each interval, and e' moves from it by at most h max |e''|, which the coefficients and `bend`, that
    of the function, bound.
    """
    a = np.array([_single(c) for c in coefficients])
    q = np.linspace(0.0, end, GRID + 1)
    e = np.polyval(a[::-1], q * q) * q - function(q)
    k, h = np.arange(len(a)), end / GRID
    bend += float((2 * k * (2 * k + 1) * np.abs(a) * end ** np.maximum(2 * k - 1, 0)).sum())
    rounding = 8 * np.finfo(float).eps * (float(function(np.array(end))) + 1.0)
    slope = (np.abs(np.diff(e)).max() + 2 * rounding) / h + h * bend
    return float(np.abs(e).max() + rounding + h / 2 * slope)


def _single(value: float) -> float:
    return float(np.float32(value))


def wrapped(x: ca.SX) -> ca.SX:
    """Return x within -pi .. pi, for |x| <= 3 pi."""
    above, below = (x - TURN_HIGH) - TURN_LOW, (x + TURN_HIGH) + TURN_LOW
    return ca.if_else(x > PI, above, ca.if_else(x < -PI, below, x))


MOST_TERMS = 16
NODES = 400
LAWSON = 40
"""Rounds of reweighting that level the largest errors."""
FUNCTIONS = {"atan": np.arctan, "artanh": np.arctanh}


@dataclass(frozen=True)
class Odd:
    """f(t) = t (a0 + a1 t^2 + ...) for |t| <= end, off by at most `error`."""

    coefficients: tuple[float, ...]
    end: float
    error: float

    @property
    def degree(self) -> int:
        """Of the polynomial."""
        return 2 * len(self.coefficients) - 1

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """Return the polynomial."""
        x = np.asarray(t, dtype=float)
        return np.asarray(np.polyval(np.array(self.coefficients)[::-1], x * x) * x)


@cache
def shortest(function: str, end: float, accuracy: float, fewest: int = 2) -> Odd | None:
    """Return the shortest polynomial of one of `FUNCTIONS` that is off by at most `accuracy`, or None.

    `fewest`: terms that it has at least.
    """
    for terms in range(fewest, MOST_TERMS + 1):
        found = tuple(_minimax(function, end, terms))
        bend = 1.0 if function == "atan" else 2 * end / (1 - end * end) ** 2
        error = largest(found, FUNCTIONS[function], end, bend)
        if error <= accuracy:
            return Odd(found, end, error)
    return None


def _minimax(function: str, end: float, terms: int) -> list[float]:
    """Coefficients by reweighted least squares (Lawson), rounded to float32 one by one, lowest first."""
    t: np.ndarray = end * np.sin(np.linspace(0, np.pi / 2, NODES + 1)[1:])
    wanted = FUNCTIONS[function](t)
    kept: list[float] = []
    for first in range(terms):
        powers = (t[:, None] / end) ** (2 * np.arange(first, terms) + 1)
        rest = wanted - sum((c * t ** (2 * k + 1) for k, c in enumerate(kept)), start=np.zeros(NODES))
        weight, a = np.ones(NODES), np.zeros(terms - first)
        for _ in range(LAWSON):
            root = np.sqrt(weight)
            a, *_ = np.linalg.lstsq(powers * root[:, None], rest * root, rcond=None)
            weight = weight * (np.abs(powers @ a - rest) + 1e-18)
            weight /= weight.sum()
        kept.append(float(np.float32(a[0] / end ** (2 * first + 1))))
    return kept
