"""Standard uncertainties of a fit: from the likelihood, or from what differs between runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hallsym.estimation.calibration import CombinationEstimate
from hallsym.estimation.identifiable import UNDETERMINED, Determination, linear_combinations
from hallsym.estimation.likelihood import TOGETHER, Cost
from hallsym.estimation.normal_equations import inverse, solve
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.quantities import combination, linear

SCATTER = 3.0
"""White noise is not believed when the scores of the runs scatter this many standard deviations too much."""
FEW_RUNS = 20
"""Fewer runs than this cannot carry a covariance of their own; the likelihood's is scaled instead."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of every parameter and determined combination; see `Fit` for the fields."""

    std: np.ndarray
    determined: np.ndarray
    covariance: np.ndarray
    method: str
    reason: str
    at_bound: tuple[str, ...]
    combinations: tuple[CombinationEstimate, ...]
    undetermined_by_log: tuple[str, ...]
    cost_per_dof: float


def uncertainty(cost: Cost, p: np.ndarray, found: Determination) -> Uncertainty:
    """Return the uncertainties at the optimum `p` of `cost`."""
    model = cost.summary.model
    point = cost.at(p)
    at_bound = _at_bound(model.bounds, p, found)
    free = np.array([k for k in range(len(p)) if k not in found.held and k not in at_bound], dtype=int)
    runs = point.information(1.0)
    dof = max(_degrees_of_freedom(cost, len(free)), 1.0)
    per_dof = point.value / dof
    covariance = np.zeros((len(p), len(p)))
    method, reason = "likelihood", "there was nothing to estimate"
    if len(free):
        own = np.ix_(np.arange(len(runs)), free, free)
        more = _turning_noise(cost, p)
        sub, method, reason = _covariance(
            runs[own],
            None if more is None else more[own],
            0.5 * point.run_gradients[:, free],
            cost.weights,
            per_dof,
        )
        covariance[np.ix_(free, free)] = sub
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    determined = np.isin(np.arange(len(p)), free) & ~_loose(model.names, std, found)
    combinations, lost = _combinations(cost, p, covariance, found, determined)
    loose = [n for k, n in enumerate(model.names) if _by_log(model, k, found, determined, at_bound)]
    return Uncertainty(
        std=np.where(determined, std, np.nan),
        determined=determined,
        covariance=covariance,
        method=method,
        reason=reason,
        at_bound=tuple(model.names[k] for k in at_bound),
        combinations=combinations,
        undetermined_by_log=(*loose, *lost),
        cost_per_dof=per_dof,
    )


def _by_log(
    model: Model, k: int, found: Determination, determined: np.ndarray, at_bound: tuple[int, ...]
) -> bool:
    """Whether another recording could determine parameter k and this one does not."""
    p = model.parameters[k]
    return not determined[k] and p.name not in found.structural and p.width > 0 and k not in at_bound


def _turning_noise(cost: Cost, p: np.ndarray) -> np.ndarray | None:
    """What the covariance of each run's scores has beyond its information, (r, n, n).

    The cost weighs every residual of a run by the mean of their covariances C (`likelihood`). Where the
    noise of the reference acts along an ellipse, C goes round with the pose: scores g^T W r, g = dr/dp and W
    the inverse of the mean C, then have the covariance sum of g^T W C W g, and the estimate the sandwich of
    both (White, Econometrica 50 (1982) 1, doi:10.2307/1912526). None where readings are linear in the pose.
    """
    summary, s = cost.summary, cost.summary.model.symbols
    if not summary.places or not np.any(cost.column_variance):
        return None
    K, n = len(cost.reading_variance), len(p)
    reading, columns = s.full(s.reading), ca.vertcat(s.pose, s.state)
    slopes = [ca.densify(ca.jacobian(reading, of)) for of in (s.parameters, columns, s.zeros)]
    run = on_arrays(ca.Function("slopes", [s.parameters, s.zeros, s.pose, s.state], slopes))
    at = cost.at(p)
    out = np.zeros((len(summary.runs), n, n))
    for k, (places, W) in enumerate(zip(summary.places, at.W, strict=True)):
        poses = len(summary.model.pose)
        found = run(p, at.zeros[k], places[:poses], places[poses:])
        g, j, z = (np.transpose(v.reshape(-1, K, places.shape[1]), (2, 1, 0)) for v in found)
        if z.shape[2]:  # what the run's zeros leave of a slope
            square, both = (np.einsum("ski,kl,slj->ij", z, W, v) for v in (z, g))
            g = g - z @ solve(square, both)
        C = (j * cost.column_variance) @ np.swapaxes(j, 1, 2)
        weighed = W @ g
        more = np.einsum("ski,skl,slj->ij", weighed, C - C.mean(axis=0), weighed)
        out[k] = more * summary.counts[k] / places.shape[1]
    return out


def _covariance(
    runs: np.ndarray, more: np.ndarray | None, scores: np.ndarray, weights: np.ndarray, per_dof: float
) -> tuple[np.ndarray, str, str]:
    """Likelihood covariance, or one from the scatter between runs when white noise does not explain it.

    `runs`: (r, n, n) information of each run. `more`: what the covariance of its scores by the noise has
    beyond that, None where all samples are alike. `scores`: (r, n).
    """
    plain = inverse(np.tensordot(weights, runs, axes=1))
    whole = np.tensordot(weights, runs if more is None else runs + more, axes=1)
    naive = plain @ whole @ plain
    scores = scores * weights[:, None]
    parts = [slice(first, first + TOGETHER) for first in range(0, len(runs), TOGETHER)]

    def leverage(part: slice) -> np.ndarray:
        """Leverage of each run on its own scores, (r, n, n)."""
        return (runs[part] * weights[part, None, None]) @ plain

    left = np.zeros_like(plain)
    for part in parts:
        known = (runs[part] if more is None else runs[part] + more[part]) * weights[part, None, None]
        share = leverage(part)
        both = share @ known
        others = share @ whole @ np.swapaxes(share, 1, 2)
        left += (known - both - np.swapaxes(both, 1, 2) + others).sum(axis=0)
    lost = len(plain) - float(np.tensordot(inverse(whole), left))
    expected = max(len(plain) - lost, 1e-9)
    scatter = float(np.einsum("ri,ij,rj->", scores, inverse(whole), scores)) / expected
    limit = 1.0 + SCATTER * np.sqrt(2.0 * lost) / expected
    n = int(np.sum(weights > 0))
    if n == 1:
        return naive, "likelihood", "one run cannot show whether its noise is white; it is taken for granted"
    told = f"scores of the {n} runs scatter {scatter:.2f} x what white noise predicts (limit {limit:.2f})"
    if scatter <= limit:
        return naive, "likelihood", told
    if n < FEW_RUNS:
        factor = max(scatter, per_dof, 1.0)
        reason = f"{told}; {n} runs are too few for a covariance of their own"
        return naive * factor, "likelihood, scaled", reason
    # jackknife-like correction (CR3) for the leverage a run has on its own residuals
    one = np.eye(len(plain))
    corrected = [np.linalg.solve(one - leverage(part), scores[part, :, None])[..., 0] for part in parts]
    root = plain @ np.concatenate(corrected).T
    return root @ root.T, "runs as blocks", told


def _degrees_of_freedom(cost: Cost, n_free: int) -> float:
    summary = cost.summary
    channels = len(summary.model.channels)
    n_zeros = len(summary.model.zeros) * int(np.sum(cost.weights > 0))
    return float(cost.weights @ summary.counts) * channels - n_free - n_zeros


def _at_bound(bounds: tuple[np.ndarray, np.ndarray], p: np.ndarray, found: Determination) -> tuple[int, ...]:
    lower, upper = bounds
    return tuple(
        k
        for k in range(len(p))
        if k not in found.held and min(p[k] - lower[k], upper[k] - p[k]) <= 1e-6 * found.scale[k]
    )


def _loose(names: tuple[str, ...], std: np.ndarray, found: Determination) -> np.ndarray:
    """Which parameters null directions move by more than their uncertainty, or no recording determines."""
    slack = np.array([found.slack(unit) for unit in np.eye(len(names))])
    return np.isin(names, found.structural) | (slack > std)


def _combinations(
    cost: Cost, p: np.ndarray, covariance: np.ndarray, found: Determination, determined: np.ndarray
) -> tuple[tuple[CombinationEstimate, ...], list[str]]:
    """Named combinations that are determined, then linear ones for what they leave; and named ones lost."""
    model = cost.summary.model
    index = {name: k for k, name in enumerate(model.names)}
    out, known, lost = [], [], []
    for named in model.combinations:
        value, gradient = combination(model, named).first(p)
        std = _std(gradient, covariance)
        if all(determined[index[n]] or model.parameters[index[n]].width == 0 for n in named.parameters):
            continue
        if std > 0 and found.slack(gradient) <= max(std, 1e-9 * abs(value)):
            out.append(CombinationEstimate(named.expression, value, std, named.unit))
            known.append(gradient)
        else:
            lost.append(named.expression)
    stacked = np.array(known).T if known else np.zeros((len(p), 0))
    scaled = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    among = np.flatnonzero(_loose(model.names, scaled, found) & (found.scale > 0) & _open(model))
    for gradient in linear_combinations(found.scale, found.null, stacked, among):
        gradient = _readable(gradient, found.scale, covariance)
        std = _std(gradient, covariance)
        if 0 < std < UNDETERMINED * np.abs(gradient * found.scale).max():
            involved = np.flatnonzero(gradient)
            quantity = linear(model, gradient, model.parameters[involved[0]].unit)
            factors = {model.names[k]: float(gradient[k]) for k in involved}
            out.append(CombinationEstimate(quantity.name, float(gradient @ p), std, quantity.unit, factors))
    return tuple(out), lost


def _readable(gradient: np.ndarray, scale: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Leave out terms that cannot move the combination by a quarter of its uncertainty; lead with 1."""
    small = 0.5 * np.abs(gradient) * scale < 0.25 * _std(gradient, covariance)
    kept = np.where(small, 0.0, gradient)
    return kept / kept[np.flatnonzero(kept)[0]] if kept.any() else gradient


def _open(model: Model) -> np.ndarray:
    return np.array([p.width > 0 for p in model.parameters])


def _std(gradient: np.ndarray, covariance: np.ndarray) -> float:
    return float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))


def noise_floor(cost: Cost, p: np.ndarray) -> dict[str, float]:
    """RMSE of the decoded pose that reading and reference noise alone would leave, by pose coordinate."""
    summary, model = cost.summary, cost.summary.model
    gain = model.remember("gain at any pose, on arrays", lambda: on_arrays(model.noise_gain_at))
    weight = 1.0 / cost.reading_variance
    share = cost.weights * summary.counts / (cost.weights @ summary.counts)
    variance, poses = np.zeros(len(model.pose)), _poses(cost)
    for pose in poses:
        (flat,) = gain(p, pose, summary.mean_state.T, weight)
        D = np.transpose(flat.reshape(len(model.channels), len(model.pose), -1), (2, 1, 0))  # (r, pose, K)
        covariance = _covariance_at(cost, p, pose) if model.typical else cost.at(p).covariance
        variance += np.einsum("r,rij,rjk,rik->i", share, D, covariance, D) / len(poses)
    return dict(zip(model.pose, np.sqrt(variance).tolist(), strict=True))


def _poses(cost: Cost) -> list[list[np.ndarray]]:
    """Poses over which noise is averaged, each coordinate (r,): typical ones, the zero pose without any.

    A coordinate that does not repeat, such as a gap on which the noise depends, is where each run was.
    """
    summary, model = cost.summary, cost.summary.model
    typical = model.typical or (tuple(np.zeros(len(model.pose))),)
    out = [[np.full(len(summary.runs), v) for v in pose] for pose in typical]
    for k, coordinate in enumerate(model.pose):
        if summary.places and coordinate not in model.period:
            for j, pose in enumerate(out):
                share = (j + 0.5) / len(out)
                pose[k] = np.array([np.quantile(place[k], share) for place in summary.places])
    return out


def _covariance_at(cost: Cost, p: np.ndarray, pose: Sequence[float | np.ndarray]) -> np.ndarray:
    """Covariance of a residual (r, K, K) at one pose of each run, where it is not the same all over a run."""
    summary, model = cost.summary, cost.summary.model
    run = model.remember("slopes by column", lambda: _slopes_by_column(model))
    (flat,) = run(p, pose, summary.mean_state.T)
    K = len(cost.reading_variance)
    J = np.transpose(flat.reshape(len(cost.column_variance), K, -1), (2, 1, 0))  # (r, K, columns)
    C = np.diag(cost.reading_variance) + (J * cost.column_variance) @ np.swapaxes(J, 1, 2)
    return np.broadcast_to(C, (len(summary.runs), K, K))


def _slopes_by_column(model: Model) -> Callable[..., list[np.ndarray]]:
    """`(parameters, pose, state) -> d reading / d column` on arrays, zeros at zero."""
    s = model.symbols
    reading = ca.substitute(s.full(s.reading), s.zeros, ca.SX.zeros(s.zeros.numel()))
    slope = ca.jacobian(reading, ca.vertcat(s.pose, s.state))
    return on_arrays(ca.Function("slope", [s.parameters, s.pose, s.state], [ca.densify(slope)]))
