"""Standard uncertainties of a fit: from the likelihood, or from the scatter between runs.

The scatter between runs: bias-reduced linearisation, CR2 (R. M. Bell and D. F. McCaffrey, Survey Methodology
28 (2002) 169; with the offsets of the runs as absorbed effects: J. E. Pustejovsky and E. Tipton, J. Bus.
Econ. Stat. 36 (2018) 672, doi:10.1080/07350015.2016.1247004).

Its coordinates are those in which the information of all runs together is the unit matrix: K K^T is the
covariance by the likelihood, J_g = K^T I_g K is the leverage of run g, and the J_g add up to 1. If noise
alone acts, the score t_g of a run at the optimum has the covariance J_g - J_g^2; (1 - J_g)^(-1/2) t_g has
J_g, the contribution of that run's errors to the estimate. The sum of their squares is the covariance of the
estimate, whatever acts on a run as a whole.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtri, ndtr

from hallsym.estimation.calibration import CombinationEstimate
from hallsym.estimation.factors import solve, unit_scale
from hallsym.estimation.goodness_of_fit import CERTAIN, GoodnessOfFit, goodness_of
from hallsym.estimation.identifiable import (
    ROUNDING,
    UNDETERMINED,
    Determination,
    linear_combinations,
    opened,
)
from hallsym.estimation.likelihood import Cost, Point
from hallsym.model import Model
from hallsym.model.influence import reading_slopes
from hallsym.model.model import combination, linear

TOGETHER = 128
"""Runs per block: larger blocks cost memory and save no time."""
ALONE = 1e-3
"""1 - leverage below which a run determines a direction alone: its score does not show its error there."""


@dataclass(frozen=True, eq=False)
class RunScatter:
    """Scores of r runs about n parameters.

    `root`: (n, n) K. `leverage`: (r, n, n) J. `scores`: (r, n) t. `by_noise`: (n, n) covariance by noise of
    the contributions of all runs, 1 where the noise of a run is stationary; `lost`: sum over runs of the
    trace of J times the contribution of that run, by which scores are smaller.
    """

    root: np.ndarray
    leverage: np.ndarray
    scores: np.ndarray
    by_noise: np.ndarray
    lost: float

    @staticmethod
    def of(runs: np.ndarray, scores: np.ndarray, known: np.ndarray | None = None) -> "RunScatter":
        """Change to the coordinates from those of the parameters.

        `runs`: (r, n, n) information, which becomes the leverage in its place. `scores`: (r, n). `known`:
        (r, n, n) covariance of the scores by the noise, None where it is the information.
        """
        information = runs.sum(axis=0)
        unit = unit_scale(information)
        values, axes = np.linalg.eigh(information * np.outer(unit, unit))
        K = unit[:, None] * axes / np.sqrt(np.maximum(values, ROUNDING * values[-1]))
        by_noise, lost = np.zeros_like(K), 0.0
        for some in _parts(len(runs)):
            J = runs[some] = K.T @ runs[some] @ K
            brought = J if known is None else K.T @ known[some] @ K
            by_noise += brought.sum(axis=0)
            lost += float(np.einsum("rij,rji->", J, brought))
        return RunScatter(K, runs, scores @ K, by_noise, lost)

    @cached_property
    def _powers(self) -> tuple[np.ndarray, float]:
        """Sum over runs of J^2, (n, n), and of the trace of J^3."""
        squares, cubes = np.zeros_like(self.root), 0.0
        for J in self._leverages():
            square = J @ J
            squares += square.sum(axis=0)
            cubes += float(np.einsum("rij,rji->", square, J))
        return squares, cubes

    def _leverages(self) -> Iterator[np.ndarray]:
        return (self.leverage[some] for some in _parts(len(self.leverage)))

    @cached_property
    def expected(self) -> float:
        """Sum of squares of all scores that noise alone predicts."""
        squares, _ = self._powers
        return float(np.trace(self.by_noise)) - 2.0 * self.lost + float(np.sum(squares * self.by_noise))

    @cached_property
    def ratio(self) -> float:
        """Sum of squares of all scores over its expectation by noise; 1 without scores."""
        squares = float(np.einsum("ri,ri->", self.scores, self.scores))
        return squares / self.expected if self.expected > ALONE * len(self.root) else 1.0

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Of `ratio`: 2 mean^2 / variance, for leverages as they are."""
        squares, cubes = self._powers
        variance = float(np.trace(squares)) - 2.0 * cubes + float(np.sum(squares * squares))
        mean = len(self.root) - float(np.trace(squares))
        return max(mean**2 / variance, 1.0) if variance > ALONE**2 else 1.0

    def limit(self, size: float) -> float:
        """Return the `ratio` that white noise of variance `size` certainly does not exceed."""
        return size * float(chdtri(self.degrees_of_freedom, ndtr(-CERTAIN))) / self.degrees_of_freedom

    def _adjusted(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield for some runs at a time J (r, n, n), and (1 - J)^(-1/2) without the directions that a run
        determines alone (r, n, n)."""
        for J in self._leverages():
            share, axes = np.linalg.eigh(J)
            seen = 1.0 - share > ALONE
            grow = np.where(seen, 1.0 / np.sqrt(np.where(seen, 1.0 - share, 1.0)), 0.0)
            yield J, (axes * grow[:, None, :]) @ np.swapaxes(axes, 1, 2)

    @cached_property
    def _alone(self) -> np.ndarray:
        """Leverage in the directions that a run determines alone, of all runs, (n, n)."""
        out = np.zeros_like(self.root)
        for J in self._leverages():
            share, axes = np.linalg.eigh(J)
            share = np.where(1.0 - share > ALONE, 0.0, share)
            out += np.einsum("rik,rk,rjk->ij", axes, share, axes)
        return out

    def covariance(self, least: float) -> np.ndarray:
        """Return the covariance of the parameters, (n, n).

        A direction that one run determines alone gets the variance by noise, scaled by the scatter of all
        directions together and by no less than `least`.
        """
        parts = zip(_parts(len(self.scores)), self._adjusted(), strict=True)
        grown = np.concatenate(
            [np.einsum("rij,rj->ri", adjust, self.scores[some]) for some, (_, adjust) in parts]
        )
        inner = grown.T @ grown + max(self.ratio, least) * self._alone
        return self.root @ inner @ self.root.T

    def degrees_of_freedom_of(self, gradients: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom (m,) of the variances of linear combinations (m, n) of parameters.

        Bell and McCaffrey's: of the chi-square with the mean and the variance that noise alone gives the
        estimate of that variance. Where one run determines a part alone, that part has those of `ratio`.
        """
        along = gradients @ self.root
        size = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.where(size > 0, size, 1.0)
        m, n = along.shape
        mean, variance, across = np.zeros(m), np.zeros(m), np.zeros((m, n, n))
        for J, adjust in self._adjusted():
            w = np.einsum("rij,mj->rmi", adjust, along)
            y = np.einsum("rmi,rij->rmj", w, J)
            own = np.einsum("rmi,rmi->rm", w, y)
            mean += own.sum(axis=0) - np.einsum("rmi,rmi->m", y, y)
            across += np.einsum("rmi,rmj->mij", y, y)
            variance += (own**2).sum(axis=0) - 2.0 * np.einsum("rm,rmi,rmi->m", own, y, y)
        variance += np.einsum("mij,mij->m", across, across)
        pooled = np.einsum("mi,ij,mj->m", along, self._alone, along)
        spread = variance + pooled**2 / self.degrees_of_freedom
        return np.maximum((mean + pooled) ** 2 / np.maximum(spread, 1e-300), 1.0)


def _parts(runs: int) -> Iterator[slice]:
    return (slice(start, start + TOGETHER) for start in range(0, runs, TOGETHER))


PLACES = 16_384
"""Most places whose slopes are computed at once."""
OVERSTATED = 0.1
"""Cost per degree of freedom below which noise was overstated or there is none (a plan): it is not used."""
AT_BOUND = 1e-6
"""Part of a bound, or of the width of the bounds, within which a parameter counts as at it (`pressed`)."""
BY_RUNS = "runs as blocks"
"""Method of a covariance that comes from the scatter between runs."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of every parameter and determined combination; see `Fit` for the fields.

    `degrees_of_freedom`: (n,), infinite where the noise is as stated. `fitted`: how many numbers were fitted.
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
    fitted: int

    @property
    def cost_per_dof(self) -> float:
        """Cost per degree of freedom."""
        return self.goodness.cost_per_degree_of_freedom


def uncertainty(point: Point, found: Determination) -> Uncertainty:
    """Return the uncertainties where `point` is the optimum of its cost."""
    cost, p, model = point.cost, point.p, point.cost.summary.model
    at_bound = _at_bound(model.bounds, p, found)
    axes = found.coordinates(at_bound)
    moving, fitted = axes.moving, len(axes.free)
    basis = axes.basis(len(p))
    fit = goodness_of(point, fitted)
    covariance = np.zeros((len(p), len(p)))
    known = _Estimate(covariance, "likelihood", "there was nothing to estimate")
    if fitted:
        runs, more = point.information(1.0, moving), _excess_noise_of(point, moving)
        if len(axes.dependent):
            own = basis[moving]
            runs, more = own.T @ runs @ own, None if more is None else own.T @ more @ own
        scores = 0.5 * axes.slope(point.run_gradients)
        known = _estimate(runs, more, scores, cost.weights, fit)
        covariance = basis @ known.covariance @ basis.T
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    determined = np.isin(np.arange(len(p)), moving) & ~_loose(model.names, std, found)
    dof = np.full(len(p), np.inf)
    dof[moving] = known.degrees_of_freedom(basis[moving])

    def dof_of(gradient: np.ndarray) -> float | None:
        of_it = float(known.degrees_of_freedom(axes.slope(gradient)[None])[0])
        return of_it if np.isfinite(of_it) else None

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
        fitted=fitted,
    )


def _by_log(
    model: Model, k: int, found: Determination, determined: np.ndarray, at_bound: tuple[int, ...]
) -> bool:
    """Whether another recording could determine parameter k and this one does not."""
    p = model.parameters[k]
    return not determined[k] and p.name not in found.structural and p.width > 0 and k not in at_bound


def _excess_noise_of(point: Point, free: np.ndarray) -> np.ndarray | None:
    """Return `_excess_noise` of the runs of all shares of a cost, in order; None where none has any."""
    cost, p = point.cost, point.p
    out, runs = np.zeros((len(cost.weights), len(free), len(free))), 0
    varying = False
    for part, chosen in cost.shares:
        at = slice(runs, runs + len(part.weights))
        own = np.flatnonzero(np.isin(free, chosen))
        place = np.searchsorted(chosen, free[own])
        found = _excess_noise(point if part is cost else part.at(p[chosen]), place)
        if found is not None:
            out[at, own[:, None], own] = found
            varying = True
        runs = at.stop
    return out if varying else None


def _excess_noise(point: Point, free: np.ndarray) -> np.ndarray | None:
    """Covariance of each run's scores beyond its information, (r, n, n) for n `free` parameters.

    The cost weighs every residual of a run by the mean of their covariances C (`likelihood`). Where the
    noise of the reference acts along an ellipse, C goes round with the pose: scores g^T W r, g = dr/dp and W
    the inverse of the mean C, then have the covariance sum of g^T W C W g, and the estimate the sandwich of
    both (White, Econometrica 50 (1982) 1, doi:10.2307/1912526). None where readings are linear in the pose.
    """
    cost, p, summary, model = point.cost, point.p, point.cost.summary, point.cost.summary.model
    if not summary.places or not np.any(cost.column_variance):
        return None
    K, n = len(cost.reading_variance), len(free)
    out, W, poses = np.zeros((len(summary.runs), n, n)), point.W[:, None], len(model.pose)
    for some in _of_one_size(summary.places):
        places = np.array([summary.places[k] for k in some])  # (r, columns, s)
        r, _, s = places.shape
        columns = np.swapaxes(places, 0, 1).reshape(-1, r * s)
        offsets = np.repeat(point.offsets[some].T, s, axis=1)
        found = reading_slopes(model, p, offsets, columns[:poses], columns[poses:])
        g, z, *by_columns = (v.reshape(r, s, K, v.shape[2]) for v in found)
        j = np.concatenate(by_columns, axis=3)
        if z.shape[3]:  # slopes with the offsets of a run eliminated
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


def _of_one_size(places: Sequence[np.ndarray]) -> Iterator[list[int]]:
    """Yield runs with one number of places (n_columns, samples), as many as are handled at once."""
    by_samples: dict[int, list[int]] = {}
    for k, own in enumerate(places):
        by_samples.setdefault(own.shape[1], []).append(k)
    for samples, runs in by_samples.items():
        most = max(1, PLACES // max(samples, 1))
        yield from (runs[first : first + most] for first in range(0, len(runs), most))


@dataclass(frozen=True, eq=False)
class _Estimate:
    """Covariance of the free parameters, and how it came about.

    `scatter`: of the scores of the runs, if the covariance is from them; else all directions have the `dof`.
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

    `runs`: (r, n, n) information of each run, overwritten. `more`: covariance of its scores beyond that, None
    where the noise is stationary. `scores`: (r, n).
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
    # noise that is correlated within a run has a smaller residual there, and more scatter between runs
    size = fit.cost_per_degree_of_freedom if fit.contradicts else 1.0
    size = size if size > OVERSTATED else 1.0
    limit = scatter.limit(size)
    said += (
        f"scores of the {n} runs scatter {scatter.ratio:.2f} x what white noise predicts (limit {limit:.2f})"
    )
    if scatter.ratio <= limit:
        return _Estimate(scale * naive, method, said, dof)
    return _Estimate(scatter.covariance(scale), BY_RUNS, said, scatter=scatter)


def _at_bound(bounds: tuple[np.ndarray, np.ndarray], p: np.ndarray, found: Determination) -> tuple[int, ...]:
    return tuple(k for k in pressed(bounds, p) if k not in found.not_free)


def pressed(bounds: tuple[np.ndarray, np.ndarray], p: np.ndarray) -> tuple[int, ...]:
    """Return the index of each parameter at one of its bounds.

    A distance counts beside the bound itself where that is less than the range: .9 is not at the end of a
    range from 1e-6 to 1e6.
    """
    width = bounds[1] - bounds[0]
    sizes = [np.where(end == 0, width, np.minimum(np.abs(end), width)) for end in bounds]
    ends = zip(bounds, sizes, strict=True)
    near = [np.isfinite(end) & (np.abs(p - end) <= AT_BOUND * size) for end, size in ends]
    return tuple(np.flatnonzero(near[0] | near[1]).tolist())


def _loose(names: tuple[str, ...], std: np.ndarray, found: Determination) -> np.ndarray:
    """Which parameters null directions move by more than their uncertainty, or no recording determines."""
    return np.isin(names, found.structural) | (found.slack(np.eye(len(names))) > std)


def _combinations(
    cost: Cost,
    p: np.ndarray,
    covariance: np.ndarray,
    found: Determination,
    determined: np.ndarray,
    dof_of: Callable[[np.ndarray], float | None],
) -> tuple[tuple[CombinationEstimate, ...], list[str]]:
    """Named combinations that are determined, then linear ones for the rest; and named ones lost."""
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
            out.append(CombinationEstimate(named.expression, value, std, named.unit, None, dof))
            known.append(gradient)
        else:
            lost.append(named.expression)
    stacked = np.array(known).T if known else np.zeros((len(p), 0))
    scaled = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    among = np.flatnonzero(_loose(model.names, scaled, found) & (found.scale > 0) & opened(model))
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


def _std(gradient: np.ndarray, covariance: np.ndarray) -> float:
    return float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
