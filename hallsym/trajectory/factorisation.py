"""Bidiagonal factorisation of fg-Bernstein collocation matrices, and solving with it.

A[i, j] = C(n, j-1) f_i^(j-1) g_i^(n-j+1) is described by the multipliers of its Neville elimination, the
pivots, and the multipliers of the elimination of its transpose (Eq. (10)). They are products and quotients
of f, g and W, so each has a relative error of a few n u, however ill-conditioned A is (TNBDA). Solving
applies the elimination step by step (TNSolve): a step is one numpy sweep over all rows.

Products of a thousand factors leave the range of float64: mantissas and exponents are kept apart. g^n would
multiply the rounding error of g by n: g and its powers are computed in numpy's longdouble.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.basis import Basis, values

Array = np.ndarray
MOST = 1000
"""Largest number of control points: a product of more mantissas in [0.5, 1) may underflow."""


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
        right = np.asarray(right, float)
        if self.points != self.columns or len(right) != self.columns:
            raise InputError(
                f"Interpolation needs as many points as control points; there are {len(right)} points for "
                f"{self.columns} control points."
            )
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
    ends of the interval.
    """
    v = values(basis, t)
    points = len(v.t)
    columns = points if columns is None else columns
    if not 1 <= columns <= points:
        raise InputError(
            f"A curve needs at least as many points as control points; there are {points} points for "
            f"{columns} control points."
        )
    if columns > MOST:
        raise InputError(f"A curve may have at most {MOST} control points; {columns} were asked for.")
    before, valid, weights = _tables(points, columns)
    w = basis.difference(v.t, v.t[before])
    w[:, 0] = 1.0
    g = basis.g(v.t.astype(np.longdouble))
    lower = np.where(valid[:, 1:], _lower(g, v.g, w, before), 0.0)
    pivot, exponent = _pivots(g[:columns], w[:-1, :columns], valid[:-1, :columns])
    ratio = v.f[: columns - 1] / v.g[: columns - 1]
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
