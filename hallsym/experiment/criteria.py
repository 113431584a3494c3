"""What a good plan is: information functions of the information matrix M (m, m), larger is better.

Each phi is concave and phi(t M) = t phi(M) (Pukelsheim, Optimal Design of Experiments, SIAM 2006,
doi:10.1137/1.9780898719109, ch. 5 and 6), so one bound holds for all: with any slope G of phi at any M,
phi(M') <= tr(G M'). Twice the information is twice phi; uncertainties shrink with the root of it.

- D: det(M)^(1/m): the volume of the uncertainty ellipsoid.
- A: m / tr(M^-1): the mean variance of the scaled parameters.
- E: the least eigenvalue of M: the worst-determined combination.
- max-u: 1 / max over the workspace of sum_o u_o^2 / reference_o^2, u_o the standard uncertainty that the
  parameters leave in coordinate o of the decoded position.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

CRITERIA = ("D", "A", "E", "max-u")
SHARP = 24.0
"""Power that stands for a maximum where E and max-u have corners: in slopes, and in a first exchange."""


@dataclass(frozen=True, eq=False)
class Criterion:
    """`values(M)`: phi of each of (..., m, m), shape (...). `slope(M)`: G (m, m) with phi(M') <= tr(G M').

    `soft`: the same criterion with its corners rounded; None where it has none.
    """

    name: str
    values: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]
    soft: Callable[[np.ndarray], np.ndarray] | None = None


def criterion(name: str, m: int, workspace: np.ndarray) -> Criterion:
    """Return a criterion of `CRITERIA` by name.

    `workspace`: (points, n_pose, m) slopes of the decoded position with the coordinates, in references.
    """
    return {"D": _d, "A": _a, "E": _e}[name](m) if name != "max-u" else _max_u(workspace)


def _d(m: int) -> Criterion:
    def values(M: np.ndarray) -> np.ndarray:
        sign, size = np.linalg.slogdet(M)
        return np.where(sign > 0, np.exp(size / m), 0.0)

    return Criterion("D", values, lambda M: values(M) / m * np.linalg.inv(M))


def _a(m: int) -> Criterion:
    def values(M: np.ndarray) -> np.ndarray:
        return m / np.trace(np.linalg.inv(M), axis1=-2, axis2=-1)

    def slope(M: np.ndarray) -> np.ndarray:
        inverse = np.linalg.inv(M)
        return values(M) ** 2 / m * inverse @ inverse

    return Criterion("A", values, slope)


def _e(m: int) -> Criterion:
    def slope(M: np.ndarray) -> np.ndarray:
        size, vectors = np.linalg.eigh(M)
        share = (size[0] / size) ** SHARP
        return (vectors * (share / share.sum())) @ vectors.T  # tr = 1, so tr(G M') >= least eigenvalue of M'

    def soft(M: np.ndarray) -> np.ndarray:
        size = np.linalg.eigvalsh(M)
        return size[..., 0] * np.sum((size[..., :1] / size) ** SHARP, axis=-1) ** (-1 / SHARP)

    return Criterion("E", lambda M: np.linalg.eigvalsh(M)[..., 0], slope, soft)


def _max_u(workspace: np.ndarray) -> Criterion:
    points, outputs, m = workspace.shape
    flat = np.ascontiguousarray(workspace.reshape(-1, m))

    def squares(M: np.ndarray) -> np.ndarray:
        """Squared uncertainty at each point of the workspace, (..., points)."""
        by_row = np.sum((flat @ np.linalg.inv(M)) * flat, axis=-1)
        return by_row.reshape(*by_row.shape[:-1], points, outputs).sum(axis=-1)

    def slope(M: np.ndarray) -> np.ndarray:
        u2, inverse = squares(M), np.linalg.inv(M)
        share = (u2 / u2.max()) ** SHARP
        share = share / share.sum()
        loaded = flat * np.sqrt(np.repeat(share, outputs))[:, None] @ inverse
        return loaded.T @ loaded / (share @ u2) ** 2  # the slope of 1 / sum share u2, which bounds 1 / max u2

    def soft(M: np.ndarray) -> np.ndarray:
        u2 = squares(M)
        most = u2.max(axis=-1)
        return np.mean((u2 / most[..., None]) ** SHARP, axis=-1) ** (-1 / SHARP) / most

    return Criterion("max-u", lambda M: 1.0 / squares(M).max(axis=-1), slope, soft)
