"""The one regression on products: what features explain of groups of samples that they were not fitted on.

Lack of fit, the curves of a localisation and gains that differ from run to run all ask it.
"""

from dataclasses import dataclass

import numpy as np

FOLDS = 11
"""Groups of runs left out in turn; a prime, so that they do not fall in step with settings that recur."""
NIL = 1e-9
"""Relative squares below which a column is rounding: the model absorbs it, or it never moves."""
RIDGE = 1e-3
"""Pull of coefficients towards 0, over the squares of their column: what no group determines stays 0."""


@dataclass(frozen=True, eq=False)
class Regression:
    """Coefficients of n features: `all` (n,), and `left_out` (U, n) without each group.

    `squares`: (U,) decrease of each group's squares by the coefficients that the other groups give.
    """

    all: np.ndarray
    left_out: np.ndarray
    squares: np.ndarray


def regression(
    gram: np.ndarray, cross: np.ndarray, penalty: np.ndarray, rest: np.ndarray | None = None
) -> Regression:
    """Solve penalised least squares from the products of U groups.

    `gram`: (U, n, n) of the features, `cross`: (U, n) of features and target, `penalty`: (n, n).
    `rest`: `others(gram)`, where it is known.
    """
    total, targets = gram.sum(axis=0), cross.sum(axis=0)
    d = lengths(total + penalty)
    scale = np.outer(d, d)

    def solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.solve((A + penalty) / scale, (b / d)[..., None])[..., 0] / d)

    left = solved(others(gram) if rest is None else rest, others(cross))
    squares = (left * (2 * cross - np.einsum("uij,uj->ui", gram, left))).sum(axis=1)
    return Regression(solved(total, targets), left, squares)


def lengths(gram: np.ndarray) -> np.ndarray:
    """Return the lengths (n,) of columns, to scale them by; what never moves has no coefficient."""
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))  # differences of sums may round below 0
    return np.maximum(length, NIL * max(length.max(initial=0.0), 1e-140))


def ridge(gram: np.ndarray) -> np.ndarray:
    """Return a penalty (n, n) of `RIDGE` times the squares that all groups but one have, on average."""
    return np.diag(RIDGE * (1 - 1 / len(gram)) * lengths(gram.sum(axis=0)) ** 2)


def others(parts: np.ndarray) -> np.ndarray:
    """Sum of all parts but one, for each; a difference to the total would leave rounding where nothing is."""
    if len(parts) < 2:
        return parts[:0]
    out = np.empty_like(parts)
    out[-2] = parts[-1]
    for k in range(len(parts) - 3, -1, -1):
        out[k] = out[k + 1] + parts[k + 1]
    before = parts[0].copy()
    for k in range(1, len(parts) - 1):
        out[k] += before
        before += parts[k]
    out[-1] = before
    return out
