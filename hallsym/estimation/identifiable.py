"""Identifiability: null directions, fixed parameters, identifiable combinations.

Parameters are scaled by the width of their bounds, so "undetermined" has one meaning for all: the standard
uncertainty of a direction is above a quarter of that width. A factor that no recording shows is no matter of
chance: where the model states a gauge for it (`Model.gauges`), that fixes it, and no parameter is lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from hallsym.estimation.likelihood import Cost
from hallsym.model import Gauge, Model
from hallsym.model.arrays import on_arrays
from hallsym.model.features import Features

UNDETERMINED = 0.25
"""Standard uncertainty over bound width above which a direction counts as not determined (flat: 0.29)."""

MOVING = 1e-6
"""Part of a direction of unit length below which a parameter does not move along it: rounding."""

SAME_DIRECTION = 1e-6
"""Sine of an angle below which two directions are one: null directions of a log are known to 1e-9."""
ROUNDING = 1e-13
"""Information below this part of the largest is rounding."""
NIL = 1e-12
"""Singular value, over the largest, of slopes of unit size below which it is rounding."""


@dataclass(frozen=True, eq=False)
class Coordinates:
    """What is fitted of n parameters: those with index `free` (m,), which `dependent` (d,) follow.

    `follow`: (d, m) slopes of the dependent parameters, by the gauges of the model.
    """

    free: np.ndarray
    dependent: np.ndarray
    follow: np.ndarray

    @staticmethod
    def without(fixed: Sequence[int], n: int) -> "Coordinates":
        """Return all of n parameters but those `fixed`; none is dependent."""
        free = np.array([k for k in range(n) if k not in fixed], dtype=int)
        return Coordinates(free, np.zeros(0, dtype=int), np.zeros((0, len(free))))

    @property
    def moving(self) -> np.ndarray:
        """Index of all parameters that are not fixed, in ascending order."""
        return np.sort(np.concatenate([self.free, self.dependent]))

    def basis(self, n: int) -> np.ndarray:
        """Return d parameters / d free ones, (n, m)."""
        out = np.zeros((n, len(self.free)))
        out[self.free, np.arange(len(self.free))] = 1.0
        out[self.dependent] = self.follow
        return out

    def slope(self, gradient: np.ndarray) -> np.ndarray:
        """Return a gradient (..., n) with respect to the free parameters, (..., m)."""
        own = gradient[..., self.free]
        return own + gradient[..., self.dependent] @ self.follow if len(self.dependent) else own

    def curvature(self, hessian: np.ndarray) -> np.ndarray:
        """Return a Hessian (n, n) with respect to the free parameters, (m, m)."""
        return self.slope(self.slope(hessian).T).T


@dataclass(frozen=True, eq=False)
class Determination:
    """Which parameters the data determine.

    `null`: (n, k) orthonormal basis of the undetermined directions, in parameters scaled by `scale`.
    `structural`: names not identifiable from any recording with this model. `fixed`: index of the k
    parameters that stay at their nominal value so that the others can be estimated. `gauge`: (g, n) rows of
    the gauges in force, whose product with the parameters is nominal, and `dependent`: index of g parameters
    that follow from the others by them.
    """

    scale: np.ndarray
    null: np.ndarray
    structural: tuple[str, ...]
    fixed: tuple[int, ...]
    gauge: np.ndarray
    dependent: tuple[int, ...]
    n_structural: int = 0
    """How many of the first columns of `null` no recording can determine."""

    @property
    def not_free(self) -> tuple[int, ...]:
        """Index of the parameters that are fixed or dependent."""
        return tuple(sorted((*self.fixed, *self.dependent)))

    def coordinates(self, at_bound: Sequence[int] = ()) -> Coordinates:
        """Return what is fitted where parameters with index in `at_bound` stay at their bounds."""
        own = Coordinates.without((*self.not_free, *at_bound), len(self.scale))
        index = list(self.dependent)
        follow = -np.linalg.solve(self.gauge[:, index], self.gauge[:, own.free])
        return Coordinates(own.free, np.array(index, dtype=int), follow)

    def gauges_of(self, model: Model) -> tuple[tuple[Gauge, str], ...]:
        """Return the gauges of a model that are in force, each with the name of its dependent parameter."""
        names = [model.names[k] for k in self.dependent]
        return tuple((gauge, n) for gauge in model.gauges for n in names if n in gauge.parameters)

    def begin(self, model: Model, p: np.ndarray) -> np.ndarray:
        """Return parameters (n,) with the fixed ones nominal and the dependent ones as the gauges say."""
        out, index, nominal = np.array(p, dtype=float), list(self.dependent), model.nominal
        out[list(self.fixed)] = np.clip(nominal, *model.bounds)[list(self.fixed)]
        out[index] -= np.linalg.solve(self.gauge[:, index], self.gauge @ (out - nominal))
        return out

    def slack(self, gradient: np.ndarray) -> np.ndarray:
        """How far quantities of gradients (..., n) can move along the null directions inside the bounds."""
        return np.asarray(0.5 * np.linalg.norm((gradient * self.scale) @ self.null, axis=-1))


def scales(model: Model) -> np.ndarray:
    """Width of each parameter's bounds; 1 where they are infinite or closed."""
    width = model.bounds[1] - model.bounds[0]
    return np.where(np.isfinite(width) & (width > 0), width, 1.0)


def determine(cost: Cost, p: np.ndarray, fixed: tuple[int, ...] | None = None) -> Determination:
    """Find the undetermined directions of a cost at `p` and choose the `fixed` parameters if not given.

    A motion no larger than the noise of its reference does not count (`information(2)`).
    """
    model = cost.summary.model
    scale, (lower, upper) = scales(model), model.bounds
    always, rest, gauge = structural_directions(cost, p)
    information = cost.information(p, 2.0) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(rest.T @ information @ rest)
    null = np.hstack([always, rest @ vectors[:, values < least_information(values)]])
    if fixed is None:
        inside = (lower <= model.nominal) & (model.nominal <= upper)
        fixed = tuple(sorted({*_hold(null, inside), *(int(k) for k in np.flatnonzero(~opened(model)))}))
    moving = np.flatnonzero(np.linalg.norm(always, axis=1) > MOVING)
    room = np.clip(np.minimum(p - lower, upper - p) / scale, 0.0, 1.0)  # a dependent parameter meets no bound
    room[list(fixed)] = 0.0
    dependent = scipy.linalg.qr(gauge * room, mode="r", pivoting=True)[1][: len(gauge)] if len(gauge) else ()
    names = tuple(model.names[k] for k in moving)
    return Determination(
        scale, null, names, fixed, gauge / scale, tuple(int(k) for k in dependent), always.shape[1]
    )


def least_information(values: np.ndarray) -> np.ndarray:
    """Return the information (...,) that a scaled direction needs to count as determined.

    `values`: (..., m) eigenvalues of the information about scaled parameters.
    """
    return np.maximum(UNDETERMINED**-2, ROUNDING * values.max(axis=-1, initial=0.0))


def structural_directions(cost: Cost, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return orthonormal bases of structurally undetermined directions, (n, k), and of the others, (n, m).

    Both in scaled parameters; fixed parameters are in neither. Along both, the gauges in force stay: their
    rows (g, n) are the third.
    """
    model = cost.summary.model
    open_ = opened(model)
    always, gauge = gauged(model, _never(cost, p, open_))
    without = np.hstack([always, gauge.T])[open_]
    rest = np.zeros((len(p), int(open_.sum()) - without.shape[1]))
    rest[open_] = np.linalg.svd(without, full_matrices=True)[0][:, without.shape[1] :]
    return always, rest, gauge


def gauged(model: Model, null: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the structural null directions (n, k) that no gauge of a model fixes, and the gauges in force.

    These are rows (g, n) of unit size in scaled parameters; a gauge is in force where a null direction, and
    none of the gauges before it, changes the mean of its parameters.
    """
    rows = np.array([np.isin(model.names, gauge.parameters) for gauge in model.gauges], dtype=float)
    rows = rows.reshape(len(model.gauges), len(model.names)) * scales(model) * opened(model)
    rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
    used: list[int] = []
    for k in range(len(rows)):
        if np.linalg.matrix_rank((rows @ null)[[*used, k]], tol=MOVING) > len(used):
            used.append(k)
    if not used:
        return null, rows[:0]
    return null @ scipy.linalg.null_space(rows[used] @ null, rcond=MOVING), rows[used]


def opened(model: Model) -> np.ndarray:
    """Return which parameters have bounds that differ, (n,)."""
    return model.bounds[0] < model.bounds[1]


def _never(cost: Cost, p: np.ndarray, open_: np.ndarray) -> np.ndarray:
    """Return a basis (n, k) of structurally undetermined directions: of a sum of costs, common to all."""
    shares = cost.shares
    if len(shares) == 1:
        return structural_null(cost, p, open_)
    rows = []
    for part, chosen in shares:
        null = structural_null(part, p[chosen], open_[chosen])
        seen = np.zeros((len(chosen), len(p)))
        seen[:, chosen] = np.eye(len(chosen)) - null @ null.T
        rows.append(seen[:, open_])
    _, sizes, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
    out = np.zeros((len(p), int(np.sum(sizes < SAME_DIRECTION))))
    out[open_] = right[sizes < SAME_DIRECTION].T
    return out


def _hold(null: np.ndarray, inside: np.ndarray) -> list[int]:
    """The parameters whose values fix every null direction best: pivoted QR of the null basis.

    Those whose nominal value lies outside their bounds come last: they would not be fixed at a value inside.
    """
    if null.shape[1] == 0:
        return []
    preferred = null.T * np.where(inside, 1.0, 1e-3)
    return [int(k) for k in scipy.linalg.qr(preferred, mode="r", pivoting=True)[1][: null.shape[1]]]


def structural_null(cost: Cost, p: np.ndarray | None = None, open_: np.ndarray | None = None) -> np.ndarray:
    """Directions that no recording can determine: the null space of d coefficients / d parameters at `p`.

    Its dimension is decided at random points inside the bounds by `structural_rank`, the smallest counts; `p`
    is the last of them by default. `open_` (n,) says which parameters are not fixed (default: all). Returns
    an orthonormal basis (n, k) in scaled parameters.
    """
    features, model = cost.summary.features, cost.summary.model
    scale = scales(model)
    open_ = np.ones(len(scale), dtype=bool) if open_ is None else open_
    if not open_.any():
        return np.zeros((len(scale), 0))
    rank, _ = structural_rank(features, tuple(open_.tolist()))
    at = _random_points(model)[-1] if p is None else p
    rows = features.slope_rows(np.asarray(at, dtype=float))
    if rows is None:
        size = np.sqrt(np.einsum("rjj->j", cost.grams))  # of each feature in this log
        slope = features.first(at, cost.summary.centre)[1][0] * np.where(size > 0, size, 1.0)[:, None, None]
        jacobian = (np.swapaxes(slope, 1, 2).reshape(-1, len(scale)) * scale)[:, open_]
    else:  # large and small poses have the same weight
        jacobian = (rows * scale)[:, open_]
        jacobian = jacobian / np.maximum(np.linalg.norm(jacobian, axis=1, keepdims=True), 1e-300)
    null = np.zeros((len(scale), int(open_.sum()) - rank))
    wide = len(jacobian) < jacobian.shape[1]  # else all right directions come without the square of the rows
    null[open_] = np.linalg.svd(jacobian, full_matrices=wide)[2][rank:].T
    return null


POINTS = 3


def _random_points(model: Model) -> np.ndarray:
    rng, scale, (lower, upper) = np.random.default_rng(0), scales(model), model.bounds
    lower = np.where(np.isfinite(lower), lower, model.nominal - scale)
    upper = np.where(np.isfinite(upper), upper, model.nominal + scale)
    return rng.uniform(lower, upper, (POINTS, len(scale)))


def structural_rank(features: Features, open_: tuple[bool, ...]) -> tuple[int, np.ndarray]:
    """Return the rank of d coefficients / d parameters, the largest at random points, with singular values.

    A tangent is asked at its own point too: at a random one a rail may cut off all of a reading, or nothing.
    """
    found = _rank_at_random(features.everywhere, open_)
    if features.point is None or found[0] == sum(open_):
        return found
    own = _rank_at(features, features.point[None], open_)
    return own if own[0] > found[0] else found


@lru_cache(maxsize=64)
def _rank_at_random(features: Features, open_: tuple[bool, ...]) -> tuple[int, np.ndarray]:
    return _rank_at(features, _random_points(features.model), open_)


def _rank_at(features: Features, at: np.ndarray, open_: tuple[bool, ...]) -> tuple[int, np.ndarray]:
    """Return the largest rank at points (m, n), and the singular values, over the largest, that show it.

    Rows, then columns are of unit size: a value that is zero comes out as rounding, decades below the others.
    """
    best, model = (-1, np.zeros(0)), features.model
    for point in at:
        rows = features.slope_rows(point)
        if rows is None:
            slope = on_arrays(features.expressions[0])(point[:, None], np.zeros(features.exponents.shape[1]))[
                1
            ]
            shape = (len(model.names), 1 + features.n_offsets, -1)
            rows = slope.reshape(shape)[:, 0].T
        jacobian = (rows * scales(model))[:, np.array(open_)]
        jacobian = jacobian / np.maximum(np.abs(jacobian).max(axis=1, keepdims=True), 1e-300)
        jacobian = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        sizes = np.linalg.svd(jacobian, compute_uv=False)
        sizes = np.pad(sizes / max(sizes.max(initial=0.0), 1e-300), (0, max(sum(open_) - len(sizes), 0)))
        best = max(best, (int(np.sum(sizes > NIL)), sizes), key=lambda one: one[0])
    return best


def linear_combinations(
    scale: np.ndarray, null: np.ndarray, known: np.ndarray, among: np.ndarray
) -> list[np.ndarray]:
    """Sparse linear combinations that are determined although their parameters are not.

    Among the parameters with index in `among`: the complement of `null` (n, k) and of the gradients `known`
    (n, m) of combinations already named, reduced to echelon form. One gradient (n,) each, with respect to
    the unscaled parameters, its largest scaled entry 1.
    """
    if len(among) == 0:
        return []
    taken = np.hstack([null[among], (known * scale[:, None])[among]])
    u, values, _ = np.linalg.svd(taken, full_matrices=True)
    rank = int(np.sum(values > 1e-3 * max(values.max(initial=0.0), 1e-300)))
    out = []
    for row in echelon(u[:, rank:].T):
        gradient = np.zeros(len(scale))
        gradient[among] = row / scale[among]
        lead = int(np.argmax(np.abs(gradient * scale)))
        out.append(gradient / gradient[lead])
    return out


def echelon(rows: np.ndarray) -> np.ndarray:
    """Return the reduced row echelon form, pivots chosen by size; entries below 1e-6 are zero."""
    rows = rows.copy()
    for i in range(len(rows)):
        j = int(np.argmax(np.abs(rows[i])))
        rows[i] /= rows[i, j]
        for k in range(len(rows)):
            if k != i:
                rows[k] -= rows[k, j] * rows[i]
    rows[np.abs(rows) < 1e-6] = 0.0
    return rows
