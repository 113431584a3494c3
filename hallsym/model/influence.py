"""Sensitivity of the decoded pose to all of its inputs: parameters, readings, state and offsets.

The reading determines the pose implicitly, m = f(p, offsets, pose, state); by the implicit function theorem
d pose / d m = D = (J^T W J)^-1 J^T W with J = df/dpose, and d pose / d u = -D df/du for every other input u.
J and df/du are CasADi's exact Jacobians of the model's reading.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from hallsym.model.arrays import Columns, estimator, jacobian, on_arrays
from hallsym.model.model import Model


@dataclass(frozen=True, eq=False)
class Influence:
    """Slopes of the decoded pose at s samples, in SI per SI.

    `parameters`: (s, n_pose, n). `readings`: (s, n_pose, n_channels). `state`: (s, n_pose, n_state).
    `offsets`: (s, n_pose, n_offsets), per displacement as `Point.offsets` has them.
    """

    parameters: np.ndarray
    readings: np.ndarray
    state: np.ndarray
    offsets: np.ndarray


def influence(
    model: Model,
    p: np.ndarray,
    offsets: Columns,
    pose: Columns,
    state: Columns,
    weight: np.ndarray | None = None,
) -> Influence:
    """Return the slopes of the decoded pose at given poses and states.

    `p`: (n,). `offsets`, `pose`, `state`: one scalar or (s,) array per offset, coordinate and state column.
    `weight`: 1/variance per channel, which matters only with more channels than coordinates (default 1).
    """
    by_p, by_zero, J, by_state = reading_slopes(model, p, offsets, pose, state)
    D = estimator(J, weight)
    return Influence(parameters=-D @ by_p, readings=D, state=-D @ by_state, offsets=-D @ by_zero)


def reading_slopes(
    model: Model, p: np.ndarray, offsets: Columns, pose: Columns, state: Columns
) -> list[np.ndarray]:
    """Return d reading / d parameters, offsets, pose and state, each (s, n_channels, size)."""
    flat = _slopes(model)(p, offsets, pose, state)[0]
    sizes = (len(model.names), len(model.offsets), len(model.pose), len(model.state))
    slopes = np.moveaxis(flat.reshape(sum(sizes), len(model.channels), -1), (0, 1), (2, 1))
    return np.split(slopes, np.cumsum(sizes)[:-1], axis=2)


@lru_cache(maxsize=64)
def _slopes(model: Model) -> Callable[..., list[np.ndarray]]:
    """`(p, offsets, pose, state) -> d reading / d (p, offsets, pose, state)`, flattened column by column."""
    s = model.symbols
    inputs = [s.parameters, s.offsets, s.pose, s.state]
    slopes = jacobian(s.full(s.reading), ca.vertcat(*inputs))
    return on_arrays(ca.Function("slopes", inputs, [ca.cse(ca.densify(slopes))]))
