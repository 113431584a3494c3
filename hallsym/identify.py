"""What the data determine: null directions, held parameters, determined combinations.

Parameters are scaled by the width of their bounds, so "undetermined" has one meaning for all: the data move
the standard uncertainty of a direction no further down than a quarter of that width.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from hallsym.cost import Coefficients, Cost
from hallsym.model import Model

UNDETERMINED = 0.25
"""Standard uncertainty over bound width above which a direction counts as not determined (flat: 0.29)."""


@dataclass(frozen=True, eq=False)
class Determination:
    """Which parameters the data determine.

    `null`: (n, k) orthonormal basis of the undetermined directions, in parameters scaled by `scale`.
    `structural`: names no recording can determine with this model. `held`: index of the k parameters that
    stay at their nominal value so that the others can be estimated.
    """

    scale: np.ndarray
    null: np.ndarray
    structural: tuple[str, ...]
    held: tuple[int, ...]

    def slack(self, gradient: np.ndarray) -> float:
        """How far a quantity with this gradient can move along the null directions inside the bounds."""
        return 0.5 * float(np.linalg.norm((np.asarray(gradient) * self.scale) @ self.null))


def scales(model: Model) -> np.ndarray:
    """Width of each parameter's bounds; 1 where they are infinite or closed."""
    width = model.bounds[1] - model.bounds[0]
    return np.where(np.isfinite(width) & (width > 0), width, 1.0)


def determine(cost: Cost, p: np.ndarray) -> Determination:
    """Find the undetermined directions of `cost` at `p` and choose what to hold.

    A motion no larger than the noise of its reference does not count (`information(2)`).
    """
    model = cost.summary.model
    scale, lower, upper = scales(model), *model.bounds
    fixed = [int(k) for k in np.flatnonzero(lower == upper)]
    information = np.tensordot(cost.weights, cost.at(p).information(2.0), axes=1)
    information = information * np.outer(scale, scale)
    free = [k for k in range(len(p)) if k not in fixed]
    values, vectors = np.linalg.eigh(information[np.ix_(free, free)])
    weak = values < UNDETERMINED**-2
    null = np.zeros((len(p), int(weak.sum())))
    null[free] = vectors[:, weak]
    inside = (lower <= model.nominal) & (model.nominal <= upper)
    held = _hold(null, inside)
    structural = structural_null(cost.coefficients, feature_scale(cost))
    moving = np.flatnonzero(np.linalg.norm(structural, axis=1) > 1e-6)
    return Determination(scale, null, tuple(model.names[k] for k in moving), tuple(sorted({*held, *fixed})))


def _hold(null: np.ndarray, inside: np.ndarray) -> list[int]:
    """The parameters whose values fix every null direction best: pivoted QR of the null basis.

    Those whose nominal value lies outside their bounds come last: they would not be held at nominal.
    """
    if null.shape[1] == 0:
        return []
    preferred = null.T * np.where(inside, 1.0, 1e-3)
    return [int(k) for k in qr(preferred, mode="r", pivoting=True)[1][: null.shape[1]]]


def feature_scale(cost: Cost) -> np.ndarray:
    """Size of each feature in this log, shape (n_features,): the norm of its column over all runs."""
    size = np.sqrt(np.einsum("rjj->j", cost.grams))
    return np.where(size > 0, size, 1.0)


def structural_null(
    coefficients: Coefficients, feature_scale: np.ndarray, points: int = 3, seed: int = 0
) -> np.ndarray:
    """Directions that no recording can determine: the null space of d coefficients / d parameters.

    Decided at random points inside the bounds and kept only if every point agrees on the dimension of the
    smallest. Returns (n, k) in scaled parameters, at the last such point.
    """
    model = coefficients.features.model
    rng, scale, (lower, upper) = np.random.default_rng(seed), scales(model), model.bounds
    lower = np.where(np.isfinite(lower), lower, model.nominal - scale)
    upper = np.where(np.isfinite(upper), upper, model.nominal + scale)
    best: np.ndarray | None = None
    for _ in range(points):
        _, slope = coefficients.first(rng.uniform(lower, upper))
        jacobian = slope[0] * feature_scale[:, None, None]
        jacobian = np.swapaxes(jacobian, 1, 2).reshape(-1, jacobian.shape[1]) * scale
        _, values, vectors = np.linalg.svd(jacobian)
        rank = int(np.sum(values > 1e-9 * values[0]))
        null = vectors[rank:].T
        if best is None or null.shape[1] < best.shape[1]:
            best = null
    assert best is not None
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
    for row in _echelon(u[:, rank:].T):
        gradient = np.zeros(len(scale))
        gradient[among] = row / scale[among]
        lead = int(np.argmax(np.abs(gradient * scale)))
        out.append(gradient / gradient[lead])
    return out


def _echelon(rows: np.ndarray) -> np.ndarray:
    """Reduced row echelon form with full pivoting on columns; entries below 1e-6 are zero."""
    rows = rows.copy()
    for i in range(len(rows)):
        j = int(np.argmax(np.abs(rows[i])))
        rows[i] /= rows[i, j]
        for k in range(len(rows)):
            if k != i:
                rows[k] -= rows[k, j] * rows[i]
    rows[np.abs(rows) < 1e-6] = 0.0
    return rows
