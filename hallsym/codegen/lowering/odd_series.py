"""Odd minimax polynomials of as few terms as an accuracy takes, with a proved bound: arctangent and
logarithm.

ln(s / m) = 2 artanh t, t = (s - m) / (s + m): one division, no comparison and no bits of the number. What a
polynomial leaves is bounded as in `lowering.trigonometry`, on a grid and between its points.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from hallsym.codegen.lowering.trigonometry import GRID

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
        found = Odd(tuple(_minimax(function, end, terms)), end, 0.0)
        error = _largest(function, found)
        if error <= accuracy:
            return Odd(found.coefficients, end, error)
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


def _largest(function: str, found: Odd) -> float:
    """Return a bound of |polynomial - function| over 0 .. end (see `trigonometry.largest`)."""
    f, a, end = FUNCTIONS[function], np.array(found.coefficients), found.end
    t = np.linspace(0.0, end, GRID + 1)
    e = found.at(t) - f(t)
    k, h = np.arange(len(a)), end / GRID
    bend = float((2 * k * (2 * k + 1) * np.abs(a) * end ** np.maximum(2 * k - 1, 0)).sum())
    bend += 1.0 if function == "atan" else 2 * end / (1 - end * end) ** 2  # of the function itself
    rounding = 8 * np.finfo(float).eps * float(f(end) + 1)
    slope = (np.abs(np.diff(e)).max() + 2 * rounding) / h + h * bend
    return float(np.abs(e).max() + rounding + h / 2 * slope)
