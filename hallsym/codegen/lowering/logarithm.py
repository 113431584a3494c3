"""Logarithm without libm: an odd minimax polynomial of (s - m) / (s + m) with a proved bound.

ln(s / m) = 2 artanh t, t = (s - m) / (s + m): one division, no comparison and no bits of the number. Terms are as
many as an accuracy over the range of t takes; what they leave is bounded as in `lowering.trigonometry`.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from hallsym.codegen.lowering.trigonometry import GRID

MOST_TERMS = 16
NODES = 400


@dataclass(frozen=True)
class Artanh:
    """artanh t = t (a0 + a1 t^2 + ...) for |t| <= end, off by at most `error`."""

    coefficients: tuple[float, ...]
    end: float
    error: float


@cache
def artanh(end: float, accuracy: float) -> Artanh | None:
    """Return the shortest polynomial that is off by at most `accuracy` for |t| <= end < 1, or None."""
    for terms in range(2, MOST_TERMS + 1):
        a = _minimax(end, terms)
        error = _largest(a, end)
        if error <= accuracy:
            return Artanh(tuple(a.tolist()), end, error)
    return None


def _minimax(end: float, terms: int) -> np.ndarray:
    """Coefficients by reweighted least squares on Chebyshev nodes (Lawson), as float32 numbers one by one."""
    t = end * np.sin(np.linspace(0, np.pi / 2, NODES + 1)[1:])
    wanted, weight = np.arctanh(t), np.ones(NODES)
    a = np.zeros(0)
    kept: list[float] = []
    for first in range(terms):
        powers = t[:, None] ** (2 * np.arange(first, terms) + 1) / end ** (2 * np.arange(first, terms) + 1)
        rest = wanted - sum((c * t ** (2 * k + 1) for k, c in enumerate(kept)), start=np.zeros(NODES))
        weight = np.ones(NODES)
        for _ in range(40 if first == 0 else 10):
            a, *_ = np.linalg.lstsq(powers * np.sqrt(weight)[:, None], rest * np.sqrt(weight), rcond=None)
            weight = weight * (np.abs(powers @ a - rest) + 1e-18)
            weight /= weight.sum()
        kept.append(float(np.float32(a[0] / end ** (2 * first + 1))))
    return np.array(kept)


def _largest(a: np.ndarray, end: float) -> float:
    """Return a bound of |polynomial - artanh t| over 0 .. end (see `trigonometry.largest`)."""
    t = np.linspace(0.0, end, GRID + 1)
    e = np.polyval(a[::-1], t * t) * t - np.arctanh(t)
    k, h = np.arange(len(a)), end / GRID
    bend = float((2 * k * (2 * k + 1) * np.abs(a) * end ** np.maximum(2 * k - 1, 0)).sum())
    bend += 2 * end / (1 - end * end) ** 2
    rounding = 8 * np.finfo(float).eps * float(np.arctanh(end) + 1)
    slope = (np.abs(np.diff(e)).max() + 2 * rounding) / h + h * bend
    return float(np.abs(e).max() + rounding + h / 2 * slope)
