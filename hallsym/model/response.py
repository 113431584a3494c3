"""What a model's readings answer to a motion: slopes with the pose, how the state moves them, their ranges.

Of a reading that is nearly linear in the pose. One whose noise is averaged over poses (`Model.typical`) has
no slope that holds everywhere, and none is given.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.model.arrays import on_arrays
from hallsym.model.model import Model

CORNERS = 256
"""Random corners of the bounds at which slopes are taken; a slope depends on four or five parameters, so each
of their corners is among them, and a product of monotonous factors has its extremes there."""
SEED = 0


@dataclass(frozen=True, eq=False)
class Response:
    """Slopes that a model can have inside the bounds of its parameters, at the zero pose and state.

    `lower`, `upper`: (n_pose, n_channels) of d reading / d pose. `state_lower`, `state_upper`: (n_state,
    n_channels) of the relative change of a channel's slopes with each state column.
    """

    lower: np.ndarray
    upper: np.ndarray
    state_lower: np.ndarray
    state_upper: np.ndarray


def response_of(model: Model) -> Response | None:
    """Return the slopes that a model can have; None where they depend on the pose, or bounds are open."""
    if model.typical or model.computed or not np.all(np.isfinite(model.bounds)):
        return None
    found: Response | None = model.remember("response", lambda: _response(model))
    return found


def relative(slopes: np.ndarray, change: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Return the relative change of slopes with each state column, (..., n_state, n_channels).

    `slopes`: (..., n_pose, n_channels). `change`: (..., n_pose, n_state, n_channels), their change. `weight`:
    of each entry of `change`, 1 over its variance; by default all poses count by the square of their slope.
    """
    weight = np.ones_like(change) if weight is None else weight
    along = weight * slopes[..., :, None, :]
    size = (along * slopes[..., :, None, :]).sum(axis=-3)
    return np.asarray((along * change).sum(axis=-3) / np.where(size > 0, size, np.inf))


def _response(model: Model) -> Response | None:
    s = model.symbols
    reading = ca.substitute(s.full(s.reading), s.zeros, ca.SX.zeros(s.zeros.numel()))
    slope = ca.jacobian(reading, s.pose)
    turned = ca.jacobian(ca.vec(slope), s.state)
    at_rest = ca.substitute(
        [ca.densify(slope), ca.densify(turned)],
        [s.pose, s.state],
        [ca.SX.zeros(s.pose.numel()), ca.SX.zeros(s.state.numel())],
    )
    rng, (lower, upper) = np.random.default_rng(SEED), model.bounds
    points = np.where(rng.integers(0, 2, (CORNERS, len(lower))) > 0, upper, lower).T
    inside = np.clip(model.nominal, lower, upper)[:, None]
    values = on_arrays(ca.Function("response", [s.parameters], at_rest))(np.hstack([points, inside]))
    j, n, k = len(model.pose), len(model.state), len(model.channels)
    slopes = np.moveaxis(values[0].reshape(j, k, points.shape[1] + 1), -1, 0)
    change = np.moveaxis(values[1].reshape(n, j, k, points.shape[1] + 1), (3, 1, 0), (0, 1, 2))
    if not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(change))):
        return None
    state = relative(slopes, change)
    return Response(slopes.min(axis=0), slopes.max(axis=0), state.min(axis=0), state.max(axis=0))
