"""Standard uncertainties of a fit: from the likelihood, or from what differs between runs."""

from collections.abc import Callable, Iterator, Sequence
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

TOGETHER = 16_384
"""Places of runs whose slopes are computed at once."""
OVERSTATED = 0.1
"""Cost per degree of freedom below which noise was overstated or there is none (a plan): it tells nothing."""
AT_BOUND = 1e-6
"""Part of the width of its bounds within which a parameter counts as at one of them."""
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
        runs, more = point.information(1.0, free), _turning_noise_of(point, free)
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


def _turning_noise_of(point: Point, free: np.ndarray) -> np.ndarray | None:
    """Return `_turning_noise` of the runs of all shares of a cost, in order; None where none has any."""
    cost, p = point.cost, point.p
    out, runs = np.zeros((len(cost.weights), len(free), len(free))), 0
    turning = False
    for part, chosen in cost.shares:
        at = slice(runs, runs + len(part.weights))
        own = np.flatnonzero(np.isin(free, chosen))
        place = np.searchsorted(chosen, free[own])
        found = _turning_noise(point if part is cost else part.at(p[chosen]), place)
        if found is not None:
            out[at, own[:, None], own] = found
            turning = True
        runs = at.stop
    return out if turning else None


def _turning_noise(point: Point, free: np.ndarray) -> np.ndarray | None:
    """What the covariance of each run's scores has beyond its information, (r, n, n) for n `free` parameters.

    The cost weighs every residual of a run by the mean of their covariances C (`likelihood`). Where the
    noise of the reference acts along an ellipse, C goes round with the pose: scores g^T W r, g = dr/dp and W
    the inverse of the mean C, then have the covariance sum of g^T W C W g, and the estimate the sandwich of
    both (White, Econometrica 50 (1982) 1, doi:10.2307/1912526). None where readings are linear in the pose.
    """
    cost, p, summary, model = point.cost, point.p, point.cost.summary, point.cost.summary.model
    if not summary.places or not np.any(cost.column_variance):
        return None
    K, n = len(cost.reading_variance), len(free)
    slopes = model.remember("slopes of all kinds, on arrays", lambda: _slopes_of_all(model))
    out, W, poses = np.zeros((len(summary.runs), n, n)), point.W[:, None], len(model.pose)
    for some in _alike(summary.places):
        places = np.array([summary.places[k] for k in some])  # (r, columns, s)
        r, _, s = places.shape
        columns = np.swapaxes(places, 0, 1).reshape(-1, r * s)
        found = slopes(p, np.repeat(point.zeros[some].T, s, axis=1), columns[:poses], columns[poses:])
        g, j, z = (np.transpose(v.reshape(-1, K, r, s), (2, 3, 1, 0)) for v in found)
        if z.shape[3]:  # what the zeros of a run leave of a slope
            square, both = (_products(z, W[some] @ v) for v in (z, g))
            g = g - z @ solve(square, both)[:, None]
        g = g[..., free]
        C = (j * cost.column_variance) @ np.swapaxes(j, 2, 3)
        weighed = W[some] @ g
        more = _products(weighed, (C - C.mean(axis=1, keepdims=True)) @ weighed)
        out[some] = more * (summary.counts[some] / s)[:, None, None]
    return out


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the sum of a^T b over samples and channels, (r, i, j), of a (r, s, K, i) and b (r, s, K, j)."""
    left, right = (v.reshape(len(v), -1, v.shape[-1]) for v in (a, b))
    return np.asarray(np.swapaxes(left, 1, 2) @ right)


def _alike(places: Sequence[np.ndarray]) -> Iterator[list[int]]:
    """Yield runs with one number of places (n_columns, samples), as many as are handled at once."""
    by_samples: dict[int, list[int]] = {}
    for k, own in enumerate(places):
        by_samples.setdefault(own.shape[1], []).append(k)
    for samples, runs in by_samples.items():
        most = max(1, TOGETHER // max(samples, 1))
        yield from (runs[first : first + most] for first in range(0, len(runs), most))


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
        if k not in found.held and min(p[k] - lower[k], upper[k] - p[k]) <= AT_BOUND * found.scale[k]
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


def noise_floor(point: Point) -> dict[str, float]:
    """RMSE of the decoded pose that reading and reference noise alone would leave, by pose coordinate."""
    cost, p, summary, model = point.cost, point.p, point.cost.summary, point.cost.summary.model
    gain = model.remember("gain at any pose, on arrays", lambda: on_arrays(model.noise_gain_at))
    weight = 1.0 / cost.reading_variance
    share = cost.weights * summary.counts / (cost.weights @ summary.counts)
    K, poses, m = len(model.channels), _poses(cost), max(len(model.typical), 1)
    state = np.tile(summary.mean_state.T, m)
    (flat,) = gain(p, poses, state, weight)
    D = np.transpose(flat.reshape(K, len(model.pose), m, -1), (2, 3, 1, 0))  # (m, r, n_pose, K)
    if model.typical:  # the covariance of a residual is not the same all over a run
        (flat,) = model.remember("slopes by column", lambda: _slopes_by_column(model))(p, poses, state)
        J = np.transpose(flat.reshape(len(cost.column_variance), K, m, -1), (2, 3, 1, 0))
        each = np.square(D) @ cost.reading_variance + np.square(D @ J) @ cost.column_variance
    else:
        each = np.einsum("mrik,mrik->mri", D @ point.covariance, D)
    variance = np.einsum("r,mri->i", share / m, each)
    return dict(zip(model.pose, np.sqrt(variance).tolist(), strict=True))


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
