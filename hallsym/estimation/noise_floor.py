"""Noise floor: what noise, or a residual, adds to the error of the decoded pose."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import casadi as ca
import numpy as np

from hallsym.estimation.likelihood import Cost, Point
from hallsym.log import Noise
from hallsym.model import Model
from hallsym.model.arrays import on_arrays


def uncertain(point: Point, noise: Noise, length_scale_m: float | None) -> float:
    """Return the factor within which the noise floor is known, as the pose metric weighs coordinates.

    Each column counts by what it adds to the error: one that adds nothing may have any noise.
    """
    known = {c: s.uncertain for c, s in noise.sigmas.items()}
    model = point.cost.summary.model
    if all(factor == 1.0 for factor in known.values()):
        return 1.0
    weights = model.family.pose_metric.weights(model.pose, length_scale_m)
    low, high = (
        float(np.linalg.norm(weights * list(noise_floor(point, factors).values()))) for factors in ({}, known)
    )
    return high / low if low > 0 else max(known.values())


def noise_floor(point: Point, factors: Mapping[str, float] = MappingProxyType({})) -> dict[str, float]:
    """RMSE of the decoded pose that reading and reference noise alone would leave, by pose coordinate.

    `factors`: by which the noise of a column is larger than the fit took it for.
    """
    cost, p, model = point.cost, point.p, point.cost.summary.model
    if factors:
        columns = (*model.references, *model.state)
        own, other = (
            np.array([factors.get(c, 1.0) for c in names]) ** 2 for names in (model.channels, columns)
        )
        cost = replace(
            cost, reading_variance=own * cost.reading_variance, column_variance=other * cost.column_variance
        )
    D, share, poses, state = _gains(point)
    K, m = len(model.channels), len(D)
    if model.typical:  # the covariance of a residual is not the same all over a run
        (flat,) = model.remember("slopes by column", lambda: _slopes_by_column(model))(p, poses, state)
        J = np.transpose(flat.reshape(len(cost.column_variance), K, m, -1), (2, 3, 1, 0))
        each = np.square(D) @ cost.reading_variance + np.square(D @ J) @ cost.column_variance
    else:
        covariance = cost.at(p).covariance if factors else point.covariance
        each = _decoded(D, covariance)
    variance = np.einsum("r,mri->i", share / m, each)
    return dict(zip(model.pose, np.sqrt(variance).tolist(), strict=True))


def residual_over_floor(point: Point) -> float:
    """Return the decoded residual over what noise makes of it, as the pose metric weighs coordinates.

    Its squares are over the number of samples: below 1 by the degrees of freedom that a fit takes.
    """
    cost, model = point.cost, point.cost.summary.model
    D, share, _, _ = _gains(point)
    left = point.squares / np.maximum(cost.summary.counts, 1.0)[:, None, None]
    weights = model.family.pose_metric.weights(model.pose, None)
    real, noise = (
        float(np.einsum("r,mri,i->", share, _decoded(D, S), weights**2)) for S in (left, point.covariance)
    )
    return float(np.sqrt(real / noise)) if noise > 0 else 1.0


def _decoded(D: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance of decoded coordinates, (m, r, n_pose), of readings with a covariance (r, K, K)."""
    return np.asarray(np.einsum("mrik,mrik->mri", D @ covariance, D))


def _gains(point: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return d pose / d reading (m, r, n_pose, K) at m poses of r runs, the runs' shares, poses and state."""
    cost, summary, model = point.cost, point.cost.summary, point.cost.summary.model
    gain = model.remember("gain at any pose, on arrays", lambda: on_arrays(model.noise_gain_at))
    share = cost.weights * summary.counts / (cost.weights @ summary.counts)
    K, poses, m = len(model.channels), _poses(cost), max(len(model.typical), 1)
    state = np.tile(summary.mean_state.T, m)
    (flat,) = gain(point.p, poses, state, 1.0 / cost.reading_variance)
    D = np.transpose(flat.reshape(K, len(model.pose), m, -1), (2, 3, 1, 0))
    return D, share, poses, state


def _poses(cost: Cost) -> np.ndarray:
    """Poses over which noise is averaged, (n_pose, m * runs): m typical ones, the zero pose without any.

    A coordinate that does not repeat, such as a gap on which the noise depends, is where each run was.
    """
    summary, model = cost.summary, cost.summary.model
    typical = np.array(model.typical or (np.zeros(len(model.pose)),))
    out = np.repeat(typical.T[:, :, None], len(summary.runs), axis=2)
    for k, coordinate in enumerate(model.pose):
        if summary.places and coordinate not in model.period:
            shares = (np.arange(len(typical)) + 0.5) / len(typical)
            out[k] = np.transpose([np.quantile(place[k], shares) for place in summary.places])
    return out.reshape(len(model.pose), -1)


def _slopes_by_column(model: Model) -> Callable[..., list[np.ndarray]]:
    """`(parameters, pose, state) -> d reading / d column` on arrays, zeros at zero."""
    s = model.symbols
    reading = ca.substitute(s.full(s.reading), s.zeros, ca.SX.zeros(s.zeros.numel()))
    slope = ca.jacobian(reading, ca.vertcat(s.pose, s.state))
    return on_arrays(ca.Function("slope", [s.parameters, s.pose, s.state], [ca.densify(slope)]))
