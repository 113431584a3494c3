"""fg-Bernstein bases, and their collocation matrices solved with high relative accuracy.

u_k(t) = C(n, k) f(t)^k g(t)^(n-k), k = 0 .. n (Micromachines 2019, 10, 597, Eq. (7)). With f, g >= 0 and f/g
increasing, every collocation matrix A[i, j] = C(n, j-1) f_i^(j-1) g_i^(n-j+1) is totally positive.

A is described by the multipliers of its Neville elimination, the pivots, and the multipliers of the
elimination of its transpose (Eq. (10)). They are products and quotients of f, g and the differences
W(t, s) = f(t) g(s) - f(s) g(t), so each has a relative error of a few n u, however ill-conditioned A is
(TNBDA). Solving applies the elimination step by step (TNSolve). QR (TNQR): the leftmost elementary factor
[[1, 0], [x, 1]] is a rotation times U = [[r, x/r], [0, 1/r]], r = sqrt(1 + x^2). U is passed through the
factors to its right until the diagonal takes it up, and its last entry through the upper factors. Steps add,
multiply and divide positive numbers: R is as accurate as the factors.

Products of a thousand factors leave the range of float64: mantissas and exponents are separate. g^n would
multiply the rounding error of g by n: g and its powers are computed in numpy's longdouble.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hallsym.errors import InputError

Array = np.ndarray
D = math.pi / 2
"""Shape of the trigonometric basis: f = sin((D + t)/2), g = sin((D - t)/2) on [-D, D]."""


@dataclass(frozen=True, eq=False)
class Basis:
    """A pair f, g on [start, stop] that spans, for every order n, n + 1 functions f^k g^(n-k).

    `difference(t, s)`: W(t, s) for s < t, to full relative accuracy. `rates`: (alpha, beta) where
    f' = alpha f + beta g and g' = -beta f - alpha g. `series`: f and g of a power series.
    """

    name: str
    start: float
    stop: float
    f: Callable[[Array], Array]
    g: Callable[[Array], Array]
    difference: Callable[[Array, Array], Array]
    rates: tuple[float, float]
    series: Callable[[Any], tuple[Any, Any]]


BERNSTEIN = Basis(
    "bernstein", 0.0, 1.0, lambda t: t, lambda t: 1 - t, lambda t, s: t - s, (1.0, 1.0), lambda t: (t, 1 - t)
)
"""Polynomials."""
TRIGONOMETRIC = Basis(
    "trigonometric", -D, D, lambda t: np.sin((D + t) / 2), lambda t: np.sin((D - t) / 2),
    lambda t, s: math.sin(D) * np.sin((t - s) / 2), (0.5 / math.tan(D), 0.5 / math.sin(D)),
    lambda t: (((D + t) / 2).sin(), ((D - t) / 2).sin()),
)  # fmt: skip
"""Even orders n = 2m span the trigonometric polynomials of degree m; odd orders do not contain constants."""
BASES = {basis.name: basis for basis in (BERNSTEIN, TRIGONOMETRIC)}


def check_increasing(t: Array, name: str) -> None:
    """Refuse parameters (points,) that repeat or are out of order; `name`: of the curve."""
    steps = np.diff(t)
    if (steps <= 0).any():
        k = int(np.argmax(steps <= 0))
        what = "repeats" if steps[k] == 0 else "is less than"
        raise InputError(
            f"Parameters of {name} must increase: number {k + 2} ({t[k + 1]:.9g}) {what} number {k + 1} "
            f"({t[k]:.9g}); sort the points and take repeated ones out."
        )


@dataclass(frozen=True, eq=False)
class Factors:
    """Bidiagonal factors of a collocation matrix (points, columns), points >= columns.

    `lower[j, i - 1]`: multiplier by which step j of the elimination takes row i - 1 from row i, 0 for i <= j.
    `upper`: the same of the transpose. Pivot i is `pivot[i] * 2**exponent[i]` with 0.5 <= pivot < 1.
    """

    lower: Array  # (columns, points - 1)
    pivot: Array  # (columns,)
    exponent: Array  # (columns,) int
    upper: Array  # (columns - 1, columns - 1)

    @property
    def points(self) -> int:
        """Number of rows."""
        return self.lower.shape[1] + 1

    @property
    def columns(self) -> int:
        """Number of control points."""
        return self.lower.shape[0]

    def solve(self, right: Array) -> Array:
        """Return c of A c = right, shapes (columns, d), or (columns,); A must be square."""
        if right.ndim > 1:
            return np.stack([self.solve(one) for one in right.T], axis=1)
        b, part = right.copy(), np.empty(self.columns - 1)
        above, below = b[:-1], b[1:]
        with np.errstate(over="ignore", invalid="ignore"):  # solve_upper refuses what is not finite
            for multipliers in self.lower[:-1]:
                np.multiply(multipliers, above, part)
                np.subtract(below, part, below)
        return solve_upper(self.pivot, self.exponent, self.upper, b)


def solve_upper(pivot: Array, exponent: Array, upper: Array, right: Array) -> Array:
    """Return c (columns,) of R c = right for R given by pivots and upper multipliers.

    Raises `InputError` if the control points leave the range of float64.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        b = np.ldexp(right / pivot, -exponent)
        part, above, below = np.empty(len(b) - 1), b[:-1], b[1:]
        for multipliers in upper[::-1]:
            np.multiply(multipliers, below, part)
            np.subtract(above, part, above)
    if not np.isfinite(b).all():
        raise InputError(
            "The control points of this curve are larger than float64 can hold; take fewer points, Chebyshev "
            "nodes or a spline."
        )
    return b


def factorise(basis: Basis, t: Array, columns: int | None = None) -> Factors:
    """Return the bidiagonal factors of the collocation matrix at parameters t (points,), TNBDA.

    `columns`: number of control points, order + 1; as many as points if not given. Parameters may include the
    ends of the interval, of up to 1000 columns: a product of more mantissas in [0.5, 1) may underflow.
    """
    check_increasing(t, "the points")
    f, rounded, points = basis.f(t), basis.g(t), len(t)
    columns = points if columns is None else columns
    if not 1 <= columns <= points:
        raise InputError(
            f"A curve needs at least as many points as control points; there are {points} points for "
            f"{columns} control points."
        )
    before, valid, weights = _tables(points, columns)
    w = basis.difference(t, t[before])
    w[:, 0] = 1.0
    g = basis.g(t.astype(np.longdouble))
    lower = np.where(valid[:, 1:], _lower(g, rounded, w, before), 0.0)
    pivot, exponent = _pivots(g[:columns], w[:-1, :columns], valid[:-1, :columns])
    ratio = f[: columns - 1] / rounded[: columns - 1]
    return Factors(lower, pivot, exponent, ratio[:, None] * weights)


@lru_cache(maxsize=16)
def _tables(points: int, columns: int) -> tuple[Array, Array, Array]:
    """Row i - k for step k = 1 .. columns, whether there is one, and (n - i + 2)/(i - 1) of Eq. (10)."""
    steps, rows = np.arange(1, columns + 1)[:, None], np.arange(points)
    weights = np.triu(np.tile(np.arange(columns - 1.0, 0, -1) / np.arange(1, columns), (columns - 1, 1)))
    return np.maximum(rows - steps, 0), rows >= steps, weights


def _lower(g: Array, rounded: Array, w: Array, before: Array) -> Array:
    """m_ij of Eq. (10), as (g_i/g_(i-1))^(n-j+1) g_(i-j)/g_(i-1) prod_k W(i, i-k)/W(i-1, i-1-k), k < j."""
    columns, points = w.shape
    out, exponent = np.ones((columns, points - 1)), np.zeros((columns, points - 1), np.int32)
    mantissa, power = np.frexp(w[:-1, 1:] / w[:-1, :-1])
    np.multiply.accumulate(mantissa, axis=0, out=out[1:])
    np.add.accumulate(power, axis=0, out=exponent[1:])
    base, power = np.frexp(g[1:] / g[:-1])
    powers = np.ones((columns, points - 1), base.dtype)
    np.multiply.accumulate(np.broadcast_to(base, (columns - 1, points - 1)), axis=0, out=powers[1:])
    exponent += power * np.arange(columns - 1, -1, -1, dtype=np.int32)[:, None]
    out, power = np.frexp(out)
    out *= powers[::-1].astype(float)
    out *= rounded[before[:, 1:]] / rounded[:-1]
    exponent += power
    with np.errstate(over="ignore"):
        return np.ldexp(out, exponent)


def _pivots(g: Array, w: Array, valid: Array) -> tuple[Array, Array]:
    """p_ii of Eq. (10): mantissas in [0.5, 1) and exponents."""
    columns = len(g)
    mantissa, power = np.frexp(np.where(valid, w, 1.0))
    mantissa, more = np.frexp(np.multiply.reduce(mantissa, axis=0))
    exponent = np.add.reduce(power, axis=0) + more
    order = np.arange(columns - 1, -1, -1, dtype=np.int32)
    ratio, two = np.frexp(order[:-1] / (columns - order[:-1]) / g[:-1])  # C(n, k)/C(n, k - 1) = (n - k + 1)/k
    choose = np.ones(columns, ratio.dtype)
    np.multiply.accumulate(ratio, out=choose[1:])
    choose, more = np.frexp(choose)
    exponent += more
    exponent[1:] += np.add.accumulate(two)
    base, two = np.frexp(g)
    mantissa, power = np.frexp((mantissa * choose * base**order).astype(float))
    return mantissa, exponent + power + two * order


# -- QR (TNQR) -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Orthogonal:
    """A = Q [R; 0]: Q as rotations of neighbouring rows in order, R by pivots and upper multipliers."""

    points: int
    rotations: list[tuple[int, float, float]]  # rows i - 1 and i (counted from 0), cosine, sine
    pivot: Array
    exponent: Array
    upper: Array

    def transposed(self, right: Array) -> Array:
        """Return Q^T right, shape (points, d)."""
        columns = right.T.tolist()
        for b in columns:
            for i, c, s in self.rotations:
                one, two = b[i - 1], b[i]
                b[i - 1] = c * one + s * two
                b[i] = c * two - s * one
        return np.array(columns).T

    def solve(self, right: Array) -> Array:
        """Return the least-squares control points (columns, d) for points (points, d)."""
        top = self.transposed(right)[: len(self.pivot)].T
        return np.stack([solve_upper(self.pivot, self.exponent, self.upper, b) for b in top], axis=1)


def orthogonalise(factors: Factors) -> Orthogonal:
    """Return Q and R of a collocation matrix with at least as many points as columns, TNQR."""
    points, columns = factors.points, factors.columns
    # rows[i][j]: multiplier of row i and step j, both counted from 1; padded so that neighbours exist
    rows = np.zeros((points + 2, columns + 3))
    rows[2 : points + 1, 1 : columns + 1] = factors.lower.T
    table: list[list[float]] = rows.tolist()
    upper: list[list[float]] = factors.upper.tolist()
    diagonal, exponent = factors.pivot.tolist(), factors.exponent.tolist()
    rotations: list[tuple[int, float, float]] = []
    for k in range(points - 1, 0, -1):
        for i in range(k + 1, min(k + columns, points) + 1):
            x = table[i][i - k]
            if x == 0.0:
                continue
            r = math.hypot(1.0, x)
            rotations.append((i - 1, 1.0 / r, x / r))
            p, q, s = _through_lower(table, i, i - k, columns, r, x / r)
            if i - 1 > columns:
                continue
            first = diagonal[i - 2]
            diagonal[i - 2] = first * p
            if i <= columns:
                ratio = diagonal[i - 1] / first * 2.0 ** (exponent[i - 1] - exponent[i - 2])
                diagonal[i - 1] *= s
                _through_upper(upper, i, columns, q / p * ratio)
    mantissa, power = np.frexp(np.array(diagonal))
    return Orthogonal(points, rotations, mantissa, np.array(exponent) + power, np.array(upper))


def _through_lower(
    table: list[list[float]], i: int, j: int, columns: int, p: float, q: float
) -> tuple[float, float, float]:
    """Pass U = [[p, q], [0, s]] on rows i - 1, i through the lower factors; returns it as it leaves them."""
    above, here, below = table[i - 1], table[i], table[i + 1]
    s = 1.0 / p
    here[j] = 0.0
    if j + 1 <= columns:
        below[j + 1] /= s
    for column in range(j + 1, min(i - 1, columns + 1) + 1):
        above[column - 1] *= p
        if column > columns:
            break
        multiplier = here[column]
        old, p = p, p + q * multiplier
        here[column] = s * multiplier / p
        s = s * old / p
        if column < columns:
            below[column + 1] /= s
    return p, q, s


def _through_upper(upper: list[list[float]], i: int, columns: int, bulge: float) -> None:
    """Take the entry `bulge` of row i - 1, column i into the upper factors (in place)."""
    one = upper[i - 2]
    for k in range(i - 2, columns - 1):
        old = one[k]
        new = old + bulge
        one[k] = new
        if k + 2 == columns or bulge == 0.0:
            break
        two = upper[i - 1]
        second = two[k + 1]
        two[k + 1] = second * old / new
        bulge = bulge * second / new
