"""Natural logarithms of the length of a vector of integers: the same in numpy as in C, and their error.

Shifts bring the larger coordinate to 2^30 .. 2^31, and then the sum of squares; what is left of it, 1 to 2,
has a polynomial, whose error is bounded on a grid and between its points. No division, no libm, any range.
"""

from functools import cache
from math import log

import numpy as np

FRACTION = 26
"""The result is in units of 2^-26."""
COEFFICIENT = 30
"""Exponent of the coefficients of the polynomial."""
HALF_LOG_2 = round(log(2) / 2 * 2**FRACTION)
MIDDLE = 1.5
"""The polynomial is in the distance from here."""
DEGREES = range(2, 15)
GRID = 1 << 16
LOW = 3
"""A product is low by less than so many units of its last bit."""
LEAST_SQUARE = 2.0**28 - 2 * LOW
"""Least sum of squares, of a vector that is not zero."""


def upper(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the upper 32 bits of a product, low by at most 2: three 16-bit products, as `upper` of the C."""
    ah, al, bh, bl = a >> 16, a & 0xFFFF, b >> 16, b & 0xFFFF
    return np.asarray(ah * bh + ((ah * bl) >> 16) + ((al * bh) >> 16))


@cache
def polynomial(degree: int) -> tuple[int, ...]:
    """Return the coefficients of ln(1.5 + x), |x| <= 1/2, in units of 2^-30, lowest first (Chebyshev)."""
    nodes = np.polynomial.chebyshev.chebpts1(degree + 1)
    found = np.polynomial.chebyshev.chebfit(nodes, np.log(MIDDLE + nodes / 2), degree)
    powers = np.polynomial.chebyshev.cheb2poly(found) * 2.0 ** np.arange(degree + 1)
    return tuple(round(float(c) * 2**COEFFICIENT) for c in powers)


@cache
def left_by(degree: int) -> float:
    """Return the bound of |polynomial - ln|: h^2 / 8 times a bend is what a grid of width h can miss."""
    a = np.array(polynomial(degree)) * 2.0**-COEFFICIENT
    x, k, h = np.linspace(-0.5, 0.5, GRID + 1), np.arange(degree + 1), 1 / GRID
    most = float(np.abs(np.polyval(a[::-1], x) - np.log(MIDDLE + x)).max())
    bend = float((k * (k - 1) * np.abs(a) * 0.5 ** np.maximum(k - 2, 0)).sum()) + 1.0
    return most + h * h / 8 * bend + 8 * float(np.finfo(float).eps)


def degree_for(accuracy: float) -> int:
    """Return the least degree whose polynomial leaves at most an accuracy of ln of the length."""
    return next((n for n in DEGREES if left_by(n) / 2 <= accuracy), DEGREES[-1])


def logarithm_of(x: np.ndarray, y: np.ndarray, degree: int, twice: int = 0) -> np.ndarray:
    """Return ln(hypot(x, y) 2^(-twice / 2)) in 2^-26, as `logarithm_of` of the C; |x|, |y| < 2^31."""
    across, up = np.abs(np.asarray(x, dtype=np.int64)), np.abs(np.asarray(y, dtype=np.int64))
    wide = spare_bits(across | up | 1)
    square = upper(across << wide, across << wide) + upper(up << wide, up << wide)
    high = spare_bits(square)
    way = (((square << high) & 0x3FFFFFFF) - 0x20000000) * 4
    first, *others = reversed(polynomial(degree))
    result = np.full(way.shape, first, dtype=np.int64)
    for c in others:
        result = upper(result, way) + c
    return np.asarray((result >> 5) + (62 - high - 2 * wide - twice) * HALF_LOG_2)


def spare_bits(value: np.ndarray) -> np.ndarray:
    """Return by how many bits a number can be shifted and stay below 2^31, 31 for 0."""
    rest, count = np.asarray(value), np.zeros(np.shape(value), dtype=np.int64)
    for bits in (16, 8, 4, 2, 1):
        low = rest < 2 ** (31 - bits)
        rest, count = np.where(low, rest << bits, rest), np.where(low, count + bits, count)
    return count


def logarithm_error(least: float, most: float, degree: int) -> float:
    """Return the bound of |logarithm_of 2^-26 - ln length| of vectors of a length from `least` to `most`.

    Lengths with `twice` taken off; at least some bits long as integers.
    """
    steps = 2 * max(abs(log(least)), abs(log(most))) / log(2) + 1
    off = abs(HALF_LOG_2 - log(2) / 2 * 2**FRACTION) * 2.0**-FRACTION
    horner = 2 * LOW * 2.0**-COEFFICIENT
    squared = 2 * LOW / LEAST_SQUARE
    return (left_by(degree) + horner + squared * (1 + squared)) / 2 + steps * off + 2.0**-FRACTION
