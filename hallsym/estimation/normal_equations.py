"""Normal equations: the offsets of each run eliminated, and unknowns of any unit.

The unknowns of one run are its own offsets (zero deviations, a few) and the parameters that all runs share.
A run's offsets appear in no other run, so they are eliminated from its equations before the runs are summed.
Every function takes one matrix (v, v) or a stack of them (..., v, v).
"""

import numpy as np

SINGULAR = 1e-11
"""Singular values below this part of the largest are rounding, for matrices of unit diagonal."""


def unit_scale(matrix: np.ndarray) -> np.ndarray:
    """Return 1 / sqrt(diagonal), (..., v): the units in which the diagonal is 1; 1 where it is 0."""
    diagonal = np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 0.0)
    return 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite matrix, such as the covariance of an information matrix.

    The matrix is brought to unit diagonal first, so the units of the unknowns cost no digits.
    """
    outer = _outer(unit_scale(matrix))
    return np.linalg.inv(matrix * outer) * outer


def pseudo_inverse(matrix: np.ndarray, singular: float = SINGULAR) -> np.ndarray:
    """Return the pseudo-inverse of a matrix of products whose columns differ in unit."""
    outer = _outer(unit_scale(matrix))
    return np.linalg.pinv(matrix * outer, rcond=singular, hermitian=True) * outer


def solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve symmetric equations (..., v, v) x = right (..., v, k); least norm where they are singular."""
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return pseudo_inverse(matrix) @ right


def eliminate(matrix: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Eliminate the first `count` unknowns of each run: its offsets.

    `matrix`: (..., v, v) information, Hessian or products of columns. Returns what is left for the others,
    (..., v - count, v - count), and how the offsets follow them, (..., count, v - count): at the minimum
    `offsets = follow @ others`.
    """
    if count == 0:
        return matrix, np.zeros((*matrix.shape[:-2], 0, matrix.shape[-1]))
    across = matrix[..., :count, count:]
    follow = -solve(matrix[..., :count, :count], across)
    return matrix[..., count:, count:] + np.swapaxes(across, -1, -2) @ follow, follow


def _outer(scale: np.ndarray) -> np.ndarray:
    return scale[..., :, None] * scale[..., None, :]
