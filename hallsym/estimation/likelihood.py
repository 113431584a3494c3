"""The maximum-likelihood cost of a model on run statistics, with exact derivatives.

Reading and reference are both noisy, so a residual r (one entry per channel) has the covariance
C = Sigma_reading + (dr/dcolumn) Sigma_column (dr/dcolumn)^T, which depends on the parameters. With the true
pose eliminated the likelihood of independent Gaussian noise is

    F(p, d) = sum over runs of tr(C_i(p)^-1 A_i^T A_i)
    A_i = R_i [-X_i; 1],   X_i = c(p) + sum_l d_il E_l(p)

with R_i the run's triangle, X_i the coefficients of its features and C_i the run's mean covariance (for which
F is unbiased, docs/theory.md). F is quadratic in a run's offsets d_i: they are eliminated exactly, and
gradient and Hessian below are those of the cost that is left.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import casadi as ca
import numpy as np

from hallsym.estimation.factors import RunStatistics, eliminate, exact, joined, solve, summarise, summarise_at
from hallsym.log import Log
from hallsym.log.batches import Weigh
from hallsym.model import Model
from hallsym.model.features import Tangent
from hallsym.model.model import Combination, Signals, Step


@dataclass(frozen=True, eq=False)
class Cost:
    """F(p) with the offsets of every run eliminated.

    `reading_variance`: (n_channels,) variance of each channel. `column_variance`: (n_columns,) variance of
    each pose and state column. `weights`: (runs,) weight of each run (1; other values re-weight runs in
    cross-validation without touching a sample).
    """

    summary: RunStatistics
    reading_variance: np.ndarray
    column_variance: np.ndarray
    weights: np.ndarray
    anchor: "Point | None" = None
    """A point whose derivatives by run are shared by every re-weighting (`anchored`)."""
    planned: bool = False
    """The logged columns hold the motion itself, without noise: a campaign that is not recorded yet."""
    parts: tuple["Cost", ...] = ()
    """The costs of several logs of one device, of which this one is the sum; its variances are means then."""
    chosen: tuple[np.ndarray, ...] = ()
    """Which of the parameters each of the `parts` has, (n,) each."""

    @property
    def shares(self) -> "tuple[tuple[Cost, np.ndarray], ...]":
        """The costs that this one is the sum of, and which of its parameters each has: itself, and all."""
        if not self.parts:
            return ((self, np.arange(len(self.summary.model.names))),)
        return tuple(zip(self.parts, self.chosen, strict=True))

    @cached_property
    def noise_in_features(self) -> np.ndarray:
        """Q_i = sum over columns of variance * mean outer product of feature slopes, (runs, f, f)."""
        if self.parts:
            return np.concatenate([part.noise_in_features for part in self.parts])
        return self.summary.noise_in_features(self.column_variance)

    @cached_property
    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """The parts of each run's triangle that belong to features and to readings."""
        n = self.summary.features.size
        R = self.summary.triangles
        return R[:, :, :n], R[:, :, n:]

    @cached_property
    def grams(self) -> np.ndarray:
        """R_f^T R_f of each run, (runs, f, f): enough digits for second derivatives, not for the cost."""
        R_f = self.triangles[0]
        return np.swapaxes(R_f, 1, 2) @ R_f

    def weighted(self, weights: np.ndarray) -> "Cost":
        """Return the same cost with other run weights; nothing that belongs to the runs is computed again."""
        other = replace(self, weights=np.asarray(weights, dtype=float))
        for name in ("noise_in_features", "triangles", "grams"):
            other.__dict__[name] = getattr(self, name)
        return other

    def without(self, holdout: Collection[int]) -> "Cost":
        """Return the cost of the runs that are not in `holdout`; itself where there are none."""
        used = [run for run in self.summary.runs if run not in holdout]
        if len(used) == len(self.summary.runs):
            return self
        weights = self.weights[[run not in holdout for run in self.summary.runs]]
        return replace(self, summary=self.summary.select(used), weights=weights)

    def anchored(self, p: np.ndarray) -> "Cost":
        """Return a cost whose re-weightings share what has been computed at `p`: for many refits from `p`."""
        point = self.at(p)
        point.kept = [part.derivatives() for part in point.parts]
        return replace(self.weighted(self.weights), anchor=point).weighted(self.weights)

    def population(self, points: np.ndarray) -> np.ndarray:
        """Return F of whole populations, (m, n) -> (m,), for a merged summary (no offsets, one run)."""
        if self.parts:
            return np.sum([part.population(points[:, chosen]) for part, chosen in self.shares], axis=0)
        (R_f,), (R_m,) = self.triangles
        X = self.summary.features.population(points, self.summary.centre)
        A = R_m - R_f @ X
        C = np.diag(self.reading_variance) + np.swapaxes(X, 1, 2) @ (self.noise_in_features[0] @ X)
        return np.einsum("mkk->m", np.linalg.solve(C, np.swapaxes(A, 1, 2) @ A))

    def at(self, p: np.ndarray) -> "Point":
        """Return everything the cost knows at one parameter vector; the last one asked for is kept."""
        if self.anchor is not None and np.array_equal(p, self.anchor.p):
            return self.anchor.reweighted(self)
        known: Point | None = self.__dict__.get("_last")
        if known is None or not np.array_equal(p, known.p):
            # a point with this cost would make a cycle, and leave its arrays to the garbage collector
            own = replace(self) if self.parts else self.weighted(self.weights)
            self.__dict__["_last"] = known = Point(own, np.array(p, dtype=float))
        return known

    def information(self, p: np.ndarray, noise_factor: float = 1.0) -> np.ndarray:
        """Return the expected information of all runs on the parameters, (n, n); see `Point.information`."""
        return self.at(p).total_information(noise_factor)


class Point:
    """The cost at one parameter vector: `value`, `offsets`, and derivatives on request.

    Shapes: r runs, n parameters, z offsets, K channels. `offsets`: (r, z), optimal for these parameters, as
    displacements [m]. `covariance`, `W`: (r, K, K) of a residual, and its inverse. `run_values`: (r,).

    Derivatives are computed for `TOGETHER` runs at a time and summed, so that memory does not grow with them.
    """

    def __init__(self, cost: Cost, p: np.ndarray) -> None:
        self.cost, self.p = cost, p
        self.parts: list[_Runs] = []
        first = 0
        for log, (share, chosen) in enumerate(cost.shares):
            features, own, runs = share.summary.features, p[chosen], len(share.weights)
            tangent = features.tangent(own)
            known = features.first(own, share.summary.centre) if tangent is None else (tangent,)
            size = known[-1].size
            together = int(np.clip(TOGETHER * SLOPES // max(size, 1), 1, TOGETHER))
            for start in range(0, max(runs, 1), together):
                at = slice(start, min(start + together, runs))
                which = share, at, log, slice(first + at.start, first + at.stop)
                self.parts.append(
                    _Polynomials(*which, *known) if tangent is None else _Tangents(*which, tangent)
                )
            first += runs
        self.kept: list[Derivatives] | None = None  # of every run, for re-weightings
        self.offsets = self._joined("offsets")
        self.run_values = self._joined("values")
        self.value = float(cost.weights @ self.run_values)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of a residual in each run, (r, K, K)."""
        return self._joined("covariance")

    @property
    def squares(self) -> np.ndarray:
        """Sum of the products of a run's residuals, channel by channel, (r, K, K)."""
        return self._joined("squares")

    @property
    def feature_products(self) -> np.ndarray:
        """Sum of the products of each feature with each channel's residual, (r, f, K)."""
        return self._joined("feature_products")

    @property
    def W(self) -> np.ndarray:
        """Inverse of `covariance`."""
        return self._joined("W")

    def _joined(self, name: str) -> np.ndarray:
        parts = [getattr(part, name) for part in self.parts]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def reweighted(self, cost: Cost) -> "Point":
        """Return this point for the same runs with other weights."""
        other = copy(self)
        other.cost, other.value = cost, float(cost.weights @ self.run_values)
        return other

    def _of_parts(self) -> "Iterator[tuple[_Runs, np.ndarray]]":
        """Yield the runs that are handled together, and which parameters they have."""
        chosen = [which for _, which in self.cost.shares]
        return ((part, chosen[part.log]) for part in self.parts)

    def derivatives(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Return F, its gradient (n,) and its exact Hessian (n, n), the offsets eliminated."""
        n = len(self.p)
        gradient, hessian = np.zeros(n), np.zeros((n, n))
        bend: dict[int, np.ndarray] = {}
        for k, (part, chosen) in enumerate(self._of_parts()):
            weights = self.cost.weights[part.here]
            if not self.kept:
                part, weights = part.counted(weights), weights[weights != 0]
            gradients, hessians = self.kept[k] if self.kept else part.derivatives()
            gradient[chosen] += weights @ gradients
            hessian[np.ix_(chosen, chosen)] += np.einsum("r,rij->ij", weights, hessians)
            if isinstance(part, _Polynomials):
                own = np.tensordot(part.loads * weights[:, None], part.G, axes=(0, 0))
                bend[part.log] = bend.get(part.log, 0.0) + own
        for log, load in bend.items():
            share, chosen = self.cost.shares[log]
            at = self.p[chosen], share.summary.centre
            hessian[np.ix_(chosen, chosen)] += share.summary.features.curvature(*at, load)
        return self.value, gradient, 0.5 * (hessian + hessian.T)

    @cached_property
    def run_gradients(self) -> np.ndarray:
        """Gradient of each run's own F, shape (r, n): what the run-block covariance is made of."""
        out = np.zeros((len(self.run_values), len(self.p)))
        for part, chosen in self._of_parts():
            out[part.here, chosen] = part.gradients
        return out

    def information(self, noise_factor: float = 1.0, free: np.ndarray | None = None) -> np.ndarray:
        """Expected information of each run, (r, n, n), the offsets eliminated; of the parameters `free`.

        The reference's own noise moves the features too; `noise_factor` times its expected share is taken
        out (1: the information of the true motion; 2: none for a motion no larger than its noise).
        """
        k = np.arange(len(self.p)) if free is None else free
        out = np.zeros((len(self.run_values), len(k), len(k)))
        for part, chosen in self._of_parts():
            own = np.flatnonzero(np.isin(chosen, k))
            at = np.searchsorted(k, chosen[own])
            out[part.here, at[:, None], at] = part.information(noise_factor)[:, own[:, None], own]
        return out

    def total_information(self, noise_factor: float = 1.0) -> np.ndarray:
        """Expected information of all runs by their weights, (n, n)."""
        total = np.zeros((len(self.p),) * 2)
        for part, chosen in self._of_parts():
            own = np.tensordot(self.cost.weights[part.here], part.information(noise_factor), axes=1)
            total[np.ix_(chosen, chosen)] += own
        return total

    def zero_covariance(self, covariance: np.ndarray) -> np.ndarray:
        """Covariance of each run's zero displacements [m^2], (r, z, z); `covariance`: of the parameters."""
        each = [part.zero_covariance(covariance[np.ix_(chosen, chosen)]) for part, chosen in self._of_parts()]
        return np.concatenate(each)


TOGETHER, SLOPES = 128, 20_000
"""Runs whose derivatives are computed at once, and numbers of each: 40 kB each for Model (31), fewer runs
where slopes are more."""
Derivatives = tuple[np.ndarray, np.ndarray]
"""Gradients (r, n) and Hessians (r, n, n) of runs, the latter without the curvature of c(p)."""


class _Runs(ABC):
    """The cost of some runs of one log at one parameter vector: the runs `at` of its `cost`.

    Shapes: r runs, m rows of a triangle, f features, K channels, n parameters, z offsets, v = z + n.
    """

    def __init__(self, cost: Cost, at: slice, log: int, here: slice) -> None:
        """`log`: number of the log, `here`: the runs among those of all logs."""
        self.cost, self.log, self.here = cost, log, here
        self.at: slice | np.ndarray = at
        self.R_f, R_m = (part[at] for part in cost.triangles)
        self.Q = cost.noise_in_features[at]
        # features of an offset have no slope, so X may leave the offsets out in Q X
        self.QX = self._read(self.Q)  # (r, f, K)
        self.covariance = np.diag(cost.reading_variance) + self._read(np.swapaxes(self.QX, 1, 2))
        self.W = np.linalg.inv(self.covariance)
        self.A, moved = R_m - self._read(self.R_f), self._read_offsets()
        r, self.z = moved.shape[:2]
        self.offsets = np.zeros((r, self.z))
        if self.z:  # those that minimise F: linear least squares in each run
            L = np.linalg.cholesky(self.W)
            along = (moved @ L[:, None]).reshape(r, self.z, -1)
            target = (self.A @ L).reshape(r, -1, 1)
            self.offsets = solve(along @ np.swapaxes(along, 1, 2), along @ target)[..., 0]
            self.A -= (self.offsets[:, None] @ moved.reshape(r, self.z, -1)).reshape(self.A.shape)
        self.squares = np.swapaxes(self.A, 1, 2) @ self.A
        self.values = np.einsum("rkl,rlk->r", self.W, self.squares)

    @property
    @abstractmethod
    def gradients(self) -> np.ndarray:
        """Gradient of each run's F with its offsets eliminated, (r, n)."""

    @abstractmethod
    def _read(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (r, m, f) times the coefficients at offsets of 0, (r, m, K)."""

    @abstractmethod
    def _read_offsets(self) -> np.ndarray:
        """Return the triangles times the coefficients of each offset, (r, z, m, K)."""

    @abstractmethod
    def _quadratic(self, fit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Sum over channels k, l of B_k^T (fit_kl R_f^T R_f - noise_kl Q) B_l, (r, v, v); B: slopes of X."""

    @abstractmethod
    def _by_channel(self, left: np.ndarray) -> np.ndarray:
        """Return left (r, i, f) times the slopes of each channel, (r, K, i, v)."""

    def counted(self, weights: np.ndarray) -> "_Runs":
        """Return those of the runs whose weight is not 0: a draw of runs leaves a third of them out."""
        used = np.flatnonzero(weights)
        if len(used) == len(self.offsets):
            return self
        other = copy(self)
        for name in ("G", "_WSW", "gradients"):
            other.__dict__.pop(name, None)
        for name in ("R_f", "Q", "QX", "covariance", "W", "offsets", "A", "squares", "values"):
            setattr(other, name, getattr(self, name)[used])
        other.at = np.arange(len(self.cost.weights))[self.at][used]
        return other

    @cached_property
    def _WSW(self) -> np.ndarray:
        return self.W @ self.squares @ self.W

    @property
    def feature_products(self) -> np.ndarray:
        """Sum of the products of each feature with each channel's residual, (r, f, K)."""
        return np.swapaxes(self.R_f, 1, 2) @ self.A

    def derivatives(self) -> Derivatives:
        """Gradient and Hessian of each run's F with its offsets eliminated, without the curvature of c."""
        return self.gradients, eliminate(self._hessian(), self.z)[0]

    def _hessian(self) -> np.ndarray:
        """Second derivatives of each run's F by offsets and parameters, (r, v, v), for coefficients linear in
        both."""
        H = 2.0 * self._quadratic(self.W, self._WSW)
        if not self._noisy:
            return H
        r, K = self.W.shape[:2]
        AR = np.swapaxes(self.A, 1, 2) @ self.R_f  # -A^T dA = AR B
        both = self._by_channel(np.concatenate([np.swapaxes(self.QX, 1, 2), -AR], axis=1))
        half, U, v = both[:, :, :K], both[:, :, K:], both.shape[-1]
        dC = half + np.swapaxes(half, 1, 2)
        inner = ((self.squares @ self.W) @ dC.reshape(r, K, K * v)).reshape(dC.shape) - 2.0 * U
        terms = np.swapaxes(_between(self.W, dC).reshape(r, K * K, v), 1, 2) @ inner.reshape(r, K * K, v)
        return H + terms + np.swapaxes(terms, 1, 2)

    @property
    def _noisy(self) -> bool:
        """Whether logged columns have noise, so that the covariance depends on the parameters."""
        return bool(np.any(self.cost.column_variance))

    def information(self, noise_factor: float) -> np.ndarray:
        """Expected information of each run about the parameters, (r, n, n)."""
        return eliminate(self._full_information(noise_factor), self.z)[0]

    def _full_information(self, noise_factor: float) -> np.ndarray:
        counts = self.cost.summary.counts[self.at, None, None]
        return self._quadratic(self.W, (noise_factor - self.cost.planned) * counts * self.W)

    def zero_covariance(self, covariance: np.ndarray) -> np.ndarray:
        """Covariance of each run's zero displacements [m^2], (r, z, z); `covariance`: of the parameters."""
        full, z = self._full_information(1.0), self.z
        follow = eliminate(full, z)[1]
        return np.linalg.inv(full[:, :z, :z]) + follow @ covariance @ np.swapaxes(follow, 1, 2)


class _Polynomials(_Runs):
    """Runs of a polynomial reading: coefficients and their slopes as `Features.first` returns them."""

    def __init__(self, cost: Cost, at: slice, log: int, here: slice, c: np.ndarray, dc: np.ndarray) -> None:
        self.c, self.dc = c, dc
        super().__init__(cost, at, log, here)

    def _read(self, rows: np.ndarray) -> np.ndarray:
        return rows @ self.c[0]

    def _read_offsets(self) -> np.ndarray:
        k = self.cost.summary.features.n_zero
        return self.R_f[:, None, :, :k] @ self.c[1:, :k]

    @property
    def loads(self) -> np.ndarray:
        """Factors of c and of each E_l, (r, 1 + z)."""
        return np.concatenate([np.ones((len(self.offsets), 1)), self.offsets], axis=1)

    @property
    def _slopes(self) -> np.ndarray:
        """dX / d(offsets, p), shape (r, K, f, v)."""
        by_channel = np.ascontiguousarray(np.transpose(self.dc, (0, 3, 1, 2)))
        B = np.empty((len(self.offsets), *by_channel.shape[1:3], self.z + self.dc.shape[2]))
        B[..., : self.z] = np.transpose(self.c[1:], (2, 1, 0))
        B[..., self.z :] = by_channel[0] + np.tensordot(self.offsets, by_channel[1:], axes=1)
        return B

    @cached_property
    def G(self) -> np.ndarray:
        """dF / dX of each run, shape (r, f, K)."""
        return -2.0 * (self.feature_products @ self.W + self.QX @ self._WSW)

    @cached_property
    def gradients(self) -> np.ndarray:
        slopes = np.transpose(self.dc, (0, 1, 3, 2)).reshape(len(self.dc), -1, self.dc.shape[2])
        return np.einsum("rl,lrn->rn", self.loads, self.G.reshape(len(self.G), -1) @ slopes)

    def _hessian(self) -> np.ndarray:
        H, z = super()._hessian(), self.z
        if z:
            cross = np.tensordot(self.G, self.dc[1:], axes=([1, 2], [1, 3]))  # (r, z, n)
            H[:, :z, z:] += cross
            H[:, z:, :z] += np.swapaxes(cross, 1, 2)
        return H

    def _quadratic(self, fit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        B = self._slopes
        r, K, f, v = B.shape
        middle = fit @ (self.cost.grams[self.at, None] @ B).reshape(r, K, f * v)
        if self._noisy:
            middle -= noise @ (self.Q[:, None] @ B).reshape(r, K, f * v)
        return np.swapaxes(B.reshape(r, K * f, v), 1, 2) @ middle.reshape(r, K * f, v)

    def _by_channel(self, left: np.ndarray) -> np.ndarray:
        return left[:, None] @ self._slopes


class _Tangents(_Runs):
    """Runs of a tangent. A feature moves one channel, so that products with coefficients are sums.

    `parts`: neighbouring features of neighbouring channels, and these channels. `first`: where features of
    another column begin among those that have one, `columns`: these columns.
    """

    def __init__(self, cost: Cost, at: slice, log: int, here: slice, tangent: Tangent) -> None:
        self.tangent = tangent
        m, channel = len(tangent.column), tangent.channel
        cuts = sorted({0, m, *(np.flatnonzero(np.diff(channel) != 1) + 1).tolist(), len(channel)})
        self.parts = [(slice(a, b), slice(channel[a], channel[a] + b - a)) for a, b in pairwise(cuts)]
        self.first = np.flatnonzero(np.diff(tangent.column, prepend=-1))
        self.columns = tangent.column[self.first]
        self.size = cost.summary.features.n_offsets + len(cost.summary.model.names)
        super().__init__(cost, at, log, here)

    def _read(self, rows: np.ndarray) -> np.ndarray:
        out = np.zeros((*rows.shape[:-1], len(self.cost.reading_variance)))
        for features, channels in self.parts:
            out[..., channels] += rows[..., features] * self.tangent.value[features]
        return out

    def _read_offsets(self) -> np.ndarray:
        features, (r, m, _) = self.cost.summary.features, self.R_f.shape
        out, k = np.zeros((r, features.n_offsets, m, len(self.cost.reading_variance))), features.n_zero
        out[:, self.tangent.column[:k], :, self.tangent.channel[:k]] = np.moveaxis(self.R_f[..., :k], 2, 0)
        return out

    def _by_column(self, rows: np.ndarray, axis: int) -> np.ndarray:
        """Return the sums of what belongs to each offset and parameter along an axis of m features."""
        out = np.zeros((*rows.shape[:axis], self.size, *rows.shape[axis + 1 :]))
        out[(slice(None),) * axis + (self.columns,)] = np.add.reduceat(rows, self.first, axis=axis)
        return out

    @cached_property
    def gradients(self) -> np.ndarray:
        AW, slopes = self.A @ self.W, np.empty(self.R_f.shape[::2])
        for features, channels in self.parts:
            QX, WSW = self.QX[:, features], self._WSW[..., channels]
            own = np.einsum("rmi,rmi->ri", self.R_f[..., features], AW[..., channels])
            slopes[:, features] = own + np.einsum("rik,rki->ri", QX, WSW)
        return -2.0 * self._by_column(slopes[:, : len(self.tangent.column)], 1)[:, self.z :]

    def _quadratic(self, fit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        m = len(self.tangent.column)
        products = self._between_channels(fit, self.cost.grams[self.at, :m, :m])
        if self._noisy:
            products -= self._between_channels(noise, self.Q[:, :m, :m])
        return self._by_column(products, 2)

    def _between_channels(self, weights: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Return products (r, m, m) of features times the weights (r, K, K) of their channels, (r, v, m), the
        first features summed by column."""
        m = len(self.tangent.column)
        spread, weighted = weights.take(self.tangent.channel[:m], axis=2), np.empty(products.shape)
        for features, channels in self.parts:
            if features.stop <= m:
                np.multiply(products[:, features], spread[:, channels], out=weighted[:, features])
        return self._by_column(weighted, 1)

    def _by_channel(self, left: np.ndarray) -> np.ndarray:
        m, out = len(self.tangent.column), np.zeros((len(left), self.W.shape[1], left.shape[1], self.size))
        out[:, self.tangent.channel[:m], :, self.tangent.column] = np.moveaxis(left[..., :m], 2, 0)
        return out


def _between(W: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return W X W for each of v matrices X (r, K, K, v); W symmetric, (r, K, K)."""
    r, K, _, v = X.shape
    first = (W @ X.reshape(r, K, K * v)).reshape(r, K, K, v)
    return np.swapaxes(np.swapaxes(first, 2, 3) @ W[:, None], 2, 3)


def cost_of(summary: RunStatistics, noise: Mapping[str, float]) -> Cost:
    """Return the likelihood of `summary` for standard deviations `noise` by column (absent: exact)."""
    model = summary.model
    return Cost(
        summary,
        np.array([noise[c] ** 2 for c in model.channels]),
        np.array([noise.get(c, 0.0) ** 2 for c in (*model.references, *model.state)]),
        np.ones(len(summary.runs)),
    )


# -- several logs of one device ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Sharing:
    """Which parameters several logs share.

    `model`: of one log, n parameters. `joint`: the same model with the parameters of all logs; one that a log
    has of its own is named `gain[log]`, and its readings are those of the last log. `chosen`: per log the
    index (n,) of its parameters among those.
    """

    model: Model
    own: tuple[str, ...]
    logs: tuple[str, ...]
    joint: Model
    chosen: tuple[np.ndarray, ...]

    @staticmethod
    def of(model: Model, own: Collection[str], logs: Sequence[str]) -> "Sharing":
        """Return how `logs` share the parameters of `model`; each has those named `own` for itself."""
        parameters, chosen = [], [np.zeros(len(model.names), dtype=int) for _ in logs]
        for k, parameter in enumerate(model.parameters):
            for g, log in enumerate(logs):
                if parameter.name in own or g == 0:
                    name = own_name(parameter.name, log) if parameter.name in own else parameter.name
                    parameters.append(replace(parameter, name=name))
                chosen[g][k] = len(parameters) - 1
        several = replace(
            model,
            parameters=tuple(parameters),
            steps=tuple((link, _with_own(step, own, logs[-1])) for link, step in model.steps),
            combinations=tuple(c for one in model.combinations for c in _by_log(one, own, logs)),
            gauges=tuple(
                replace(one, parameters=tuple(own_name(n, log) if n in own else n for n in one.parameters))
                for one in model.gauges
                for log in (logs if set(one.parameters) & set(own) else logs[:1])
            ),
            period=dict(model.period)
            | {own_name(n, log): model.period[n] for n in own if n in model.period for log in logs},
        )
        return Sharing(model, tuple(own), tuple(logs), several if own else model, tuple(chosen))

    def of_log(self, log: int, p: np.ndarray) -> np.ndarray:
        """Return the parameters (n,) of one log out of all."""
        return p[self.chosen[log]]


def own_name(parameter: str, log: str) -> str:
    """Return the name of a parameter of one log among those of all.

    >>> own_name("eta_A", "night2")
    'eta_A[night2]'
    """
    return f"{parameter}[{log}]"


def _with_own(step: Step, own: Collection[str], log: str) -> Step:
    """Return a step that reads the parameters which one log has of its own."""

    def read(signals: Signals, p: Mapping[str, ca.SX]) -> None:
        step(signals, {**p, **{name: p[own_name(name, log)] for name in own}})

    return read


def _by_log(one: Combination, own: Collection[str], logs: Sequence[str]) -> list[Combination]:
    """Return a combination once for each log where a log's own parameter is part of it."""
    if not set(one.parameters) & set(own):
        return [one]
    named = [{n: own_name(n, log) if n in own else n for n in one.parameters} for log in logs]

    def value(p: Mapping[str, ca.SX], here: Mapping[str, str]) -> ca.SX:
        return one.value({**p, **{name: p[its] for name, its in here.items()}})

    return [
        replace(
            one,
            expression=own_name(one.expression, log),
            parameters=tuple(here.values()),
            value=partial(value, here=here),
        )
        for log, here in zip(logs, named, strict=True)
    ]


def joint_cost(sharing: Sharing, costs: Sequence[Cost], numbers: Sequence[dict[int, int]]) -> Cost:
    """Return the sum of the costs of the logs; `numbers`: of each log, run -> number among all.

    Its variances are means over the samples; each log has its own.
    """
    counts = np.array([cost.weights @ cost.summary.counts for cost in costs])
    share = counts / max(counts.sum(), 1e-300)
    summary = joined([numbered(cost.summary, known) for cost, known in zip(costs, numbers, strict=True)])
    features = replace(summary.features, model=sharing.joint)
    return Cost(
        replace(summary, features=features),
        share @ [cost.reading_variance for cost in costs],
        share @ [cost.column_variance for cost in costs],
        np.concatenate([cost.weights for cost in costs]),
        parts=tuple(costs),
        chosen=sharing.chosen,
    )


def numbered(summary: RunStatistics, numbers: dict[int, int]) -> RunStatistics:
    """Return run statistics whose runs have other numbers."""
    return replace(summary, runs=tuple(numbers[run] for run in summary.runs))


def run_numbers(runs: Sequence[Sequence[int]]) -> tuple[dict[int, int], ...]:
    """Return for each log run -> number among all logs: its own where no other log has it.

    Else the number of the log, from 1, stands before that of the run.

    >>> run_numbers([[0, 7], [7, 12]])
    ({0: 100, 7: 107}, {7: 207, 12: 212})
    """
    every = [run for own in runs for run in own]
    if len(set(every)) == len(every):
        return tuple({run: run for run in own} for own in runs)
    step = 10 ** len(str(max(map(abs, every))))
    return tuple({run: step * (g + 1) + run for run in own} for g, own in enumerate(runs))


# -- the cost near a point -----------------------------------------------------------------------------------

SETTLED = 1e-9
"""Change [m] of a run's offsets below which they are settled."""
MOST = 40
"""Rounds of settling the offsets of the runs, at most."""


Offsets = Mapping[int, np.ndarray]


def cost_near(
    log: Log,
    model: Model,
    p: np.ndarray,
    noise: Mapping[str, float],
    weigh: Weigh | None = None,
    rounds: int = MOST,
) -> Cost:
    """Return the likelihood of a log near `p`, the offsets of each run settled at `p`; exact at `p`.

    `rounds`: of settling, at most.
    """
    if exact(model):
        return cost_of(summarise(log, model, weigh), noise)
    offsets: Offsets = {}
    for _ in range(rounds):
        cost = cost_of(summarise_at(log, model, p, offsets, noise, weigh), noise)
        before, offsets = offsets, offsets_of(cost, p)
        if all(np.abs(z - before.get(run, 0.0)).max(initial=0.0) < SETTLED for run, z in offsets.items()):
            break
    return cost


def offsets_of(cost: Cost, p: np.ndarray) -> dict[int, np.ndarray]:
    """Return the offsets of every run at `p`."""
    return dict(zip(cost.summary.runs, cost.at(p).offsets, strict=True))


def deviations_of(point: Point) -> dict[int, np.ndarray]:
    """Return the zero deviations of every run at a point in reading space, as a calibration keeps them."""
    summary = point.cost.summary
    read = point.offsets * summary.model.zero_scale(point.p, summary.first_state)
    return dict(zip(summary.runs, read, strict=True))
