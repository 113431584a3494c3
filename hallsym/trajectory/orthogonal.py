"""QR of a collocation matrix from its bidiagonal factors (TNQR), and least squares with it.

The leftmost elementary factor [[1, 0], [x, 1]] is a rotation times U = [[r, x/r], [0, 1/r]], r = sqrt(1 +
x^2). U is passed through the factors to its right until the diagonal takes it up, and its last entry through
the upper factors. Steps add, multiply and divide positive numbers: R is as accurate as the factors.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np

from hallsym.errors import InputError
from hallsym.trajectory.factorisation import Factors, solve_upper

Array = np.ndarray


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
        columns = np.asarray(right, float).T.tolist()
        for b in columns:
            for i, c, s in self.rotations:
                one, two = b[i - 1], b[i]
                b[i - 1] = c * one + s * two
                b[i] = c * two - s * one
        return np.array(columns).T

    def leverage(self) -> Array:
        """Return the diagonal of A (A^T A)^-1 A^T, shape (points,): the pull of each point on its own fit."""
        q = np.zeros((self.points, len(self.pivot)))
        np.fill_diagonal(q, 1.0)
        for i, c, s in reversed(self.rotations):
            one = q[i - 1].copy()
            q[i - 1] = c * one - s * q[i]
            q[i] = s * one + c * q[i]
        return np.sum(q * q, axis=1)

    def solve(self, right: Array) -> Array:
        """Return the least-squares control points (columns, d) for points (points, d)."""
        right = np.asarray(right, float)
        if right.ndim != 2 or len(right) != self.points:
            raise InputError(f"Least squares of {self.points} points got data of shape {right.shape}.")
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
            r = hypot(1.0, x)
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
