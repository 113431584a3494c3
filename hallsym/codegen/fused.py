"""Fused multiply-add on arrays: a b + c rounded once, to the bit what the instruction gives.

Sums are rounded to odd first (an inexact one ends in a 1), which makes a second rounding right: Boldo and
Melquiond, "Emulation of a FMA and Correctly Rounded Sums", IEEE Trans. Computers 57 (2008), 462.
"""

from fractions import Fraction

import numpy as np

SPLIT = 2.0**27 + 1
"""Veltkamp: takes the upper half of a double."""
SMALL = 2.0**-900
"""Magnitude of a product below which its rounding error may not be a double."""


def fused_multiply_add(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return a b + c, rounded once, in the type of its arguments: float32 or double.

    Arguments broadcast. Doubles are finite, and below 2^990 with their product.
    """
    a, b, c = (np.asarray(x) for x in (a, b, c))
    if np.result_type(a, b, c) == np.float32:
        product = a.astype(float) * b.astype(float)  # exact: 48 bits
        return _to_odd(*_sum(product, c.astype(float))).astype(np.float32)
    a, b, c = np.broadcast_arrays(a.astype(float), b.astype(float), c.astype(float))
    with np.errstate(all="ignore"):
        product = a * b
        none = (a == 0) | (b == 0)
        out = np.where(none, product + c, _of_doubles(a, b, c))
    tiny = (np.abs(product) < SMALL) & ~none
    if tiny.any():
        out[tiny] = [_exact(*row) for row in zip(a[tiny], b[tiny], c[tiny], strict=True)]
    return out


def _sum(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum and its rounding error, exact (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _to_odd(total: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return total + rest rounded to odd: of the doubles on either side of it the one that ends in a 1."""
    bits = np.array(total, ndmin=1).view(np.int64)
    even = (rest != 0) & np.isfinite(rest) & ((bits & 1) == 0)
    away = np.where((rest > 0) == (total > 0), 1, -1)
    return np.reshape(np.where(even, bits + away, bits).view(float), np.shape(total))


def _of_doubles(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    high, low = _product(a, b)
    small, rest = _sum(c, low)
    large, part = _sum(high, small)
    return large + _to_odd(*_sum(part, rest))


def _product(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the product and its rounding error, exact (Dekker)."""
    product = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    rest = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
    return product, rest


def _halves(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    scaled = SPLIT * a
    high = scaled - (scaled - a)
    return high, a - high


def _exact(a: float, b: float, c: float) -> float:
    """By rational numbers; an exact zero has the sign that the sum of product and c has."""
    total = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
    return float(total) if total else float(a * b + c)
