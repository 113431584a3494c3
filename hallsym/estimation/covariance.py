"""Standard uncertainties of a fit: from the likelihood, or from what differs between runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.special import chdtri, ndtr

from hallsym.estimation.calibration import CombinationEstimate
from hallsym.estimation.goodness_of_fit import CERTAIN, GoodnessOfFit, goodness_of
from hallsym.estimation.identifiable import UNDETERMINED, Determination, linear_combinations
from hallsym.estimation.likelihood import Cost, Point
from hallsym.estimation.normal_equations import solve
from hallsym.estimation.run_scatter import RunScatter
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.quantities import combination, linear

OVERSTATED = 0.1
"""Cost per degree of freedom below which noise was overstated or there is none (a plan): it tells nothing."""
BY_RUNS = "runs as blocks"
"""Method of a covariance that comes from the scatter between runs."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of every parameter and determined combination; see `Fit` for the fields.

    `degrees_of_freedom`: (n,), infinite where the noise is as stated.
    """

    std: np.ndarray
    determined: np.ndarray
    covariance: np.ndarray
    method: str
    reason: str
    at_bound: tuple[str, ...]
    combinations: tuple[CombinationEstimate, ...]
    undetermined_by_log: tuple[str, ...]
    degrees_of_freedom: np.ndarray
    goodness: GoodnessOfFit

    @property
    def cost_per_dof(self) -> float:
        """Cost per degree of freedom."""
        return self.goodness.cost_per_degree_of_freedom


def uncertainty(cost: Cost, p: np.ndarray, found: Determination) -> Uncertainty:
    """Return the uncertainties at the optimum `p` of `cost`."""
    return uncertainty_at(cost.at(p), found)


def uncertainty_at(point: Point, found: Determination) -> Uncertainty:
    """Return the uncertainties where `point` is the optimum of its cost."""
    cost, p, model = point.cost, point.p, point.cost.summary.model
    at_bound = _at_bound(model.bounds, p, found)
    free = np.array([k for k in range(len(p)) if k not in found.held and k not in at_bound], dtype=int)
    fit = goodness_of(point, len(free))
    covariance = np.zeros((len(p), len(p)))
    known = _Estimate(covariance, "likelihood", "there was nothing to estimate")
    if len(free):
        runs, more = point.information(1.0, free), _turning_noise_of(cost, p, free)
        scores = 0.5 * point.run_gradients[:, free]
        known = _estimate(runs, more, scores, cost.weights, fit)
        covariance[np.ix_(free, free)] = known.covariance
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    determined = np.isin(np.arange(len(p)), free) & ~_loose(model.names, std, found)
    dof = np.full(len(p), np.inf)
    dof[free] = known.degrees_of_freedom(np.eye(len(free)))

    def dof_of(gradient: np.ndarray) -> float:
        return float(known.degrees_of_freedom(gradient[None, free])[0])

    combinations, lost = _combinations(cost, p, covariance, found, determined, dof_of)
    loose = [n for k, n in enumerate(model.names) if _by_log(model, k, found, determined, at_bound)]
    return Uncertainty(
        std=np.where(determined, std, np.nan),
        determined=determined,
        covariance=covariance,
        method=known.method,
        reason=known.reason,
        at_bound=tuple(model.names[k] for k in at_bound),
        combinations=combinations,
        undetermined_by_log=(*loose, *lost),
        degrees_of_freedom=dof,
        goodness=fit,
    )


def _by_log(
    model: Model, k: int, found: Determination, determined: np.ndarray, at_bound: tuple[int, ...]
) -> bool:
    """Whether another recording could determine parameter k and this one does not."""
    p = model.parameters[k]
    return not determined[k] and p.name not in found.structural and p.width > 0 and k not in at_bound


def _turning_noise_of(cost: Cost, p: np.ndarray, free: np.ndarray) -> np.ndarray | None:
    """Return `_turning_noise` of the runs of all shares of a cost, in order; None where none has any."""
    out, runs = np.zeros((len(cost.weights), len(free), len(free))), 0
    turning = False
    for part, chosen in cost.shares:
        at = slice(runs, runs + len(part.weights))
        own = np.flatnonzero(np.isin(free, chosen))
        place = np.searchsorted(chosen, free[own])
        found = _turning_noise(part, p[chosen], place)
        if found is not None:
            out[at, own[:, None], own] = found
            turning = True
        runs = at.stop
    return out if turning else None


def _turning_noise(cost: Cost, p: np.ndarray, free: np.ndarray) -> np.ndarray | None:
    """What the covariance of each run's scores has beyond its information, (r, n, n) for n `free` parameters.

    The cost weighs every residual of a run by the mean of their covariances C (`likelihood`). Where the
    noise of the reference acts along an ellipse, C goes round with the pose: scores g^T W r, g = dr/dp and W
    the inverse of the mean C, then have the covariance sum of g^T W C W g, and the estimate the sandwich of
    both (White, Econometrica 50 (1982) 1, doi:10.2307/1912526). None where readings are linear in the pose.
    """
    summary, model = cost.summary, cost.summary.model
    if not summary.places or not np.any(cost.column_variance):
        return None
    K, n = len(cost.reading_variance), len(free)
    run = model.remember("slopes of all kinds, on arrays", lambda: _slopes_of_all(model))
    at = cost.at(p)
    out = np.zeros((len(summary.runs), n, n))
    for k, (places, W) in enumerate(zip(summary.places, at.W, strict=True)):
        poses = len(summary.model.pose)
        found = run(p, at.zeros[k], places[:poses], places[poses:])
        g, j, z = (np.transpose(v.reshape(-1, K, places.shape[1]), (2, 1, 0)) for v in found)
        if z.shape[2]:  # what the run's zeros leave of a slope
            square, both = (np.einsum("ski,kl,slj->ij", z, W, v) for v in (z, g))
            g = g - z @ solve(square, both)
        g = g[:, :, free]
        C = (j * cost.column_variance) @ np.swapaxes(j, 1, 2)
        weighed = W @ g
        more = np.tensordot(weighed, (C - C.mean(axis=0)) @ weighed, axes=([0, 1], [0, 1]))
        out[k] = more * summary.counts[k] / places.shape[1]
    return out


@dataclass(frozen=True, eq=False)
class _Estimate:
    """Covariance of the free parameters, and how it came about.

    `scatter`: of the scores of the runs, where the covariance is theirs; else all directions have the `dof`.
    """

    covariance: np.ndarray
    method: str
    reason: str
    dof: float = np.inf
    scatter: RunScatter | None = None

    def degrees_of_freedom(self, gradients: np.ndarray) -> np.ndarray:
        """Return those of linear combinations (m, n) of the free parameters, (m,)."""
        if self.scatter is None:
            return np.full(len(gradients), self.dof)
        return self.scatter.degrees_of_freedom_of(gradients)


def _estimate(
    runs: np.ndarray, more: np.ndarray | None, scores: np.ndarray, weights: np.ndarray, fit: GoodnessOfFit
) -> _Estimate:
    """Covariance by the likelihood, scaled where the noise is larger, or by the scatter between runs.

    `runs`: (r, n, n) information of each run, overwritten. `more`: what the covariance of its scores by the
    noise has beyond that, None where all samples are alike. `scores`: (r, n).
    """
    runs *= weights[:, None, None]
    known = None if more is None else runs + more * weights[:, None, None]
    scatter = RunScatter.of(runs, scores * weights[:, None], known)
    naive = scatter.root @ scatter.by_noise @ scatter.root.T
    n, scale = int(np.sum(weights > 0)), 1.0
    method, dof, said = "likelihood", np.inf, ""
    if fit.significant:
        scale, method, dof = fit.cost_per_degree_of_freedom, "likelihood, scaled", fit.degrees_of_freedom
        said = f"the cost per degree of freedom is {scale:.3g} +- {fit.scatter:.2g}; "
    if n == 1:
        said += "one recording cannot show whether its noise is white, which is assumed"
        return _Estimate(scale * naive, method, said, dof)
    # noise that is correlated within a run leaves less than stated there, and more between runs
    size = fit.cost_per_degree_of_freedom if fit.contradicts else 1.0
    size = size if size > OVERSTATED else 1.0
    limit = size * float(chdtri(scatter.degrees_of_freedom, ndtr(-CERTAIN))) / scatter.degrees_of_freedom
    said += (
        f"scores of the {n} runs scatter {scatter.ratio:.2f} x what white noise predicts (limit {limit:.2f})"
    )
    if scatter.ratio <= limit:
        return _Estimate(scale * naive, method, said, dof)
    return _Estimate(scatter.covariance(scale), BY_RUNS, said, scatter=scatter)


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
    cost: Cost,
    p: np.ndarray,
    covariance: np.ndarray,
    found: Determination,
    determined: np.ndarray,
    dof_of: Callable[[np.ndarray], float],
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
            dof = dof_of(gradient)
            out.append(CombinationEstimate(named.expression, value, std, named.unit, degrees_of_freedom=dof))
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
            value, dof = float(gradient @ p), dof_of(gradient)
            out.append(CombinationEstimate(quantity.name, value, std, quantity.unit, factors, dof))
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


def _slopes_of_all(model: Model) -> Callable[..., list[np.ndarray]]:
    """`(parameters, zeros, pose, state) -> d reading / d parameter, / d column, / d zero` on arrays."""
    s = model.symbols
    reading, columns = s.full(s.reading), ca.vertcat(s.pose, s.state)
    slopes = [ca.densify(ca.jacobian(reading, of)) for of in (s.parameters, columns, s.zeros)]
    return on_arrays(ca.Function("slopes", [s.parameters, s.zeros, s.pose, s.state], slopes))


def _slopes_by_column(model: Model) -> Callable[..., list[np.ndarray]]:
    """`(parameters, pose, state) -> d reading / d column` on arrays, zeros at zero."""
    s = model.symbols
    reading = ca.substitute(s.full(s.reading), s.zeros, ca.SX.zeros(s.zeros.numel()))
    slope = ca.jacobian(reading, ca.vertcat(s.pose, s.state))
    return on_arrays(ca.Function("slope", [s.parameters, s.pose, s.state], [ca.densify(slope)]))
