"""The maximum-likelihood cost of a model on run summaries, with exact derivatives.

Reading and reference are both noisy, so a residual r (one entry per channel) has covariance
C = Sigma_reading + (dr/dcolumn) Sigma_column (dr/dcolumn)^T, which depends on the parameters. With the true
pose eliminated the likelihood of independent Gaussian noise is

    F(p, d) = sum over runs of tr(C_i(p)^-1 A_i^T A_i),   A_i = R_i [-X_i; 1],   X_i = c(p) + sum_l d_il E_l(p)

with R_i the run's triangle, X_i the coefficients of its features and C_i the run's mean covariance (for which
F is unbiased, docs/theory.md). F is quadratic in a run's zeros d_i: they are eliminated exactly, and
gradient and Hessian below are those of the cost that is left.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.arrays import on_arrays
from hallsym.features import Features
from hallsym.summary import Summary


@dataclass(frozen=True, eq=False)
class Coefficients:
    """c(p) and E_l(p) of a model with their derivatives, as one CasADi call each.

    Arrays have the axes (1 + n_zeros, n_features, n_channels), c first, then one E_l per zero.
    """

    features: Features
    centre: np.ndarray

    @property
    def n_zeros(self) -> int:
        """Zeros of a run that these features carry: all of the model's, or none once projected out."""
        return len(self.features.model.zeros) if self.features.n_zero else 0

    @cached_property
    def population(self) -> Callable[[np.ndarray], np.ndarray]:
        """`(m, n) parameter vectors -> (m, n_features, n_channels)` coefficients c at zero deviation."""
        model = self.features.model
        c = self.features.coefficients(model.symbols.parameters, ca.SX.zeros(len(model.zeros)), self.centre)
        run = on_arrays(ca.Function("population", [model.symbols.parameters], [ca.densify(c)]))
        shape = (len(model.channels), self.features.size)

        def coefficients(points: np.ndarray) -> np.ndarray:
            (flat,) = run(np.ascontiguousarray(points.T))
            return np.transpose(flat.reshape(*shape, len(points)), (2, 1, 0))

        return coefficients

    @cached_property
    def _functions(self) -> tuple[ca.Function, ca.Function]:
        model, n_zeros = self.features.model, self.n_zeros
        p = model.symbols.parameters
        zeros = ca.SX.sym("zeros", len(model.zeros))
        c = self.features.coefficients(p, zeros, self.centre)
        parts = [ca.vec(ca.substitute(c, zeros, ca.SX.zeros(zeros.numel())))]
        slopes = ca.jacobian(ca.vec(c), zeros)
        parts += [slopes[:, k] for k in range(n_zeros)]
        stacked = ca.densify(ca.horzcat(*parts))  # (n_features * n_channels, 1 + n_zeros)
        flat = ca.vec(stacked)
        jacobian = ca.jacobian(flat, p)
        weights = ca.SX.sym("weights", flat.numel())
        hessian, _ = ca.hessian(ca.dot(weights, flat), p)
        first = ca.Function("coefficients", [p], [stacked, ca.densify(jacobian)])
        second = ca.Function("curvature", [p, weights], [ca.densify(hessian)])
        return first, second

    def first(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the coefficients and their slopes, the latter (1 + n_zeros, n_features, n, n_channels)."""
        model = self.features.model
        shape = (1 + self.n_zeros, len(model.channels), self.features.size)
        value, slope = (np.asarray(v) for v in self._functions[0](p))
        return (
            np.ascontiguousarray(np.swapaxes(value.T.reshape(shape), 1, 2)),
            np.ascontiguousarray(np.transpose(slope.reshape(*shape, -1), (0, 2, 3, 1))),
        )

    def curvature(self, p: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return sum of weights * d2 coefficient / dp2, shape (n, n), weights shaped as coefficients."""
        return np.asarray(self._functions[1](p, np.swapaxes(weights, 1, 2).ravel()))


@dataclass(frozen=True, eq=False)
class Cost:
    """F(p) with the zeros of every run eliminated.

    `reading_variance`: (n_channels,) variance of each channel. `column_variance`: (n_columns,) variance of
    each pose and state column. `weights`: (runs,) weight of each run (1; other values re-weight runs in
    bootstrap and cross-validation without touching a sample).
    """

    summary: Summary
    coefficients: Coefficients
    reading_variance: np.ndarray
    column_variance: np.ndarray
    weights: np.ndarray

    @cached_property
    def noise_in_features(self) -> np.ndarray:
        """Q_i = sum over columns of variance * mean outer product of feature slopes, (runs, f, f)."""
        return np.tensordot(self.summary.slopes, self.column_variance, axes=(1, 0))

    @cached_property
    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """The parts of each run's triangle that belong to features and to readings."""
        n = self.summary.features.size
        R = self.summary.triangles
        return np.ascontiguousarray(R[:, :, :n]), np.ascontiguousarray(R[:, :, n:])

    def weighted(self, weights: np.ndarray) -> "Cost":
        """Return the same cost with other run weights."""
        return replace(self, weights=np.asarray(weights, dtype=float))

    def population(self, points: np.ndarray) -> np.ndarray:
        """Return F of whole populations, (m, n) -> (m,), for a merged summary (no zeros, one run)."""
        (R_f,), (R_m,) = self.triangles
        X = self.coefficients.population(points)
        A = R_m - R_f @ X
        C = np.diag(self.reading_variance) + np.swapaxes(X, 1, 2) @ (self.noise_in_features[0] @ X)
        return np.einsum("mkk->m", np.linalg.solve(C, np.swapaxes(A, 1, 2) @ A))

    def at(self, p: np.ndarray) -> "Point":
        """Return everything the cost knows at one parameter vector."""
        return Point(self, np.asarray(p, dtype=float))


class Point:
    """The cost at one parameter vector: `value`, `zeros`, and derivatives on request.

    Shapes: r runs, m rows of a triangle, f features, K channels, n parameters, z zeros, v = n + z.
    `zeros`: (r, z), optimal for these parameters, as displacements [m]. `covariance`: (r, K, K).
    """

    def __init__(self, cost: Cost, p: np.ndarray) -> None:
        self.cost, self.p = cost, p
        self.c, self.dc = cost.coefficients.first(p)
        self.R_f, R_m = cost.triangles
        base = self.c[0]
        # a zero's own features have no slope, so X may leave the zeros out in Q X
        self.QX = cost.noise_in_features @ base  # (r, f, K)
        self.covariance = np.diag(cost.reading_variance) + base.T @ self.QX
        self.W = np.linalg.inv(self.covariance)
        self.L = np.linalg.cholesky(self.W)
        at_zero = R_m - self.R_f @ base
        self.zeros = self._eliminate(at_zero)
        self.A = at_zero - self.R_f @ np.tensordot(self.zeros, self.c[1:], axes=1)  # (r, m, K)
        self.S = np.swapaxes(self.A, 1, 2) @ self.A
        self.run_values = np.einsum("rkl,rlk->r", self.W, self.S)
        self.value = float(cost.weights @ self.run_values)

    def _eliminate(self, residual: np.ndarray) -> np.ndarray:
        """Zeros that minimise F: linear least squares in each run."""
        r, z, k = len(residual), len(self.c) - 1, self.cost.summary.features.n_zero
        if z == 0:
            return np.zeros((r, 0))
        moved = (self.R_f[:, None, :, :k] @ self.c[1:, :k]) @ self.L[:, None]  # (r, z, m, K)
        moved = moved.reshape(r, z, -1)
        target = (residual @ self.L).reshape(r, -1, 1)
        return np.linalg.solve(moved @ np.swapaxes(moved, 1, 2), moved @ target)[..., 0]

    @cached_property
    def _B(self) -> np.ndarray:
        """dX / d(p, zeros), shape (r, f, v, K)."""
        r, z, (f, n, K) = len(self.zeros), len(self.c) - 1, self.dc.shape[1:]
        B = np.empty((r, f, n + z, K))
        B[:, :, :n] = self.dc[0] + np.tensordot(self.zeros, self.dc[1:], axes=1)
        B[:, :, n:] = np.swapaxes(self.c[1:], 0, 1)
        return B

    @cached_property
    def _dA(self) -> np.ndarray:
        """dA / d(p, zeros), shape (r, m, v, K)."""
        r, f, v, K = self._B.shape
        return -(self.R_f @ self._B.reshape(r, f, v * K)).reshape(r, -1, v, K)

    @cached_property
    def _G(self) -> np.ndarray:
        """dF / dX of each run, shape (r, f, K)."""
        return -2.0 * (np.swapaxes(self.R_f, 1, 2) @ self.A @ self.W + self.QX @ (self.W @ self.S @ self.W))

    @cached_property
    def _gauss(self) -> np.ndarray:
        """Whitened dA^T dA of each run, shape (r, v, v)."""
        r, m, v, K = self._dA.shape
        slope = np.swapaxes(self._dA @ self.L[:, None], 2, 3).reshape(r, m * K, v)
        return np.swapaxes(slope, 1, 2) @ slope

    def _spread(self, middle: np.ndarray) -> np.ndarray:
        """tr(middle B_a^T Q B_b) for every pair of variables, shape (r, v, v)."""
        r, f, v, K = self._B.shape
        QB = (self.cost.noise_in_features @ self._B.reshape(r, f, v * K)).reshape(r, f, v, K)
        left = np.swapaxes(self._B, 1, 2).reshape(r, v, f * K)
        return left @ np.swapaxes(np.swapaxes(QB @ middle[:, None], 1, 2).reshape(r, v, f * K), 1, 2)

    def run_gradients(self) -> np.ndarray:
        """Gradient of each run's own F, shape (r, n): what the run-block covariance is made of."""
        n = len(self.p)
        B = np.swapaxes(self._B[:, :, :n], 1, 2).reshape(len(self._B), n, -1)
        return (B @ self._G.reshape(len(B), -1, 1))[..., 0]

    def derivatives(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Return F, its gradient (n,) and its exact Hessian (n, n), the zeros eliminated."""
        weights, n, z = self.cost.weights, len(self.p), len(self.c) - 1
        gradient = weights @ self.run_gradients()
        H = 2.0 * self._gauss + self._covariance_terms()
        if z:
            cross = np.tensordot(self._G, self.dc[1:], axes=([1, 2], [1, 3]))  # (r, z, n)
            H_pd = H[:, :n, n:] + np.swapaxes(cross, 1, 2)
            reduced = H[:, :n, :n] - H_pd @ np.linalg.solve(H[:, n:, n:], np.swapaxes(H_pd, 1, 2))
        else:
            reduced = H
        hessian = np.tensordot(weights, reduced, axes=1)
        loads = np.concatenate([np.ones((len(self.zeros), 1)), self.zeros], axis=1) * weights[:, None]
        hessian = hessian + self.cost.coefficients.curvature(
            self.p, np.tensordot(loads, self._G, axes=(0, 0))
        )
        return self.value, gradient, 0.5 * (hessian + hessian.T)

    def _covariance_terms(self) -> np.ndarray | float:
        """Second-order terms of F through C(p), shape (r, v, v)."""
        if not np.any(self.cost.column_variance):
            return 0.0
        r, f, v, K = self._B.shape
        W, S = self.W[:, None], self.S[:, None]
        half = (np.swapaxes(self._B.reshape(r, f, v * K), 1, 2) @ self.QX).reshape(r, v, K, K)
        dC = half + np.swapaxes(half, 2, 3)
        P = W @ dC @ W
        U = (np.swapaxes(self.A, 1, 2) @ self._dA.reshape(r, -1, v * K)).reshape(r, K, v, K)
        # tr(P_a U_b) = sum_kl P_a[k, l] U_b[l, k]
        flat = P.reshape(r, v, K * K)
        U_t = np.swapaxes(np.swapaxes(U, 1, 2), 2, 3).reshape(r, v, K * K)
        second = flat @ np.swapaxes(U_t, 1, 2)
        third = flat @ np.swapaxes(np.swapaxes(dC @ W @ S, 2, 3).reshape(r, v, K * K), 1, 2)
        third = third + np.swapaxes(third, 1, 2)
        fourth = self._spread(self.W @ self.S @ self.W)
        return third - 2.0 * (second + np.swapaxes(second, 1, 2)) - 2.0 * fourth

    def information(self, noise_factor: float = 1.0) -> np.ndarray:
        """Expected information of each run, shape (r, n, n), the zeros eliminated.

        The reference's own noise moves the features too; `noise_factor` times its expected share is taken
        out (1: what the true motion tells; 2: nothing for a motion no larger than its noise).
        """
        n, z = len(self.p), len(self.c) - 1
        full = self._gauss.copy()
        if noise_factor and np.any(self.cost.column_variance):
            full -= noise_factor * self.cost.summary.counts[:, None, None] * self._spread(self.W)
        if z == 0:
            return full
        return full[:, :n, :n] - full[:, :n, n:] @ np.linalg.solve(full[:, n:, n:], full[:, n:, :n])


def cost_of(summary: Summary, noise: Mapping[str, float]) -> Cost:
    """Return the likelihood of `summary` for standard deviations `noise` by column (absent: exact)."""
    model = summary.model
    return Cost(
        summary,
        Coefficients(summary.features, summary.centre),
        np.array([noise[c] ** 2 for c in model.channels]),
        np.array([noise.get(c, 0.0) ** 2 for c in (*model.references, *model.state)]),
        np.ones(len(summary.runs)),
    )
