"""Fit a model with effects, exact and non-linear, by Gauss-Newton steps on passes over the log."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import numpy as np

from hallsym.diagnosis.normal_equations import Columns, NormalEquations, normal_equations
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.scores import bic
from hallsym.estimation.covariance import Octaves, White, estimated, pressed
from hallsym.estimation.factors import SINGULAR, unit_scale
from hallsym.estimation.identifiable import gauged, scales
from hallsym.estimation.optimum import DROP, PASSES
from hallsym.log.batches import Batch
from hallsym.model import Model, Variant
from solvers import bounded_step, gauss_newton


@dataclass(frozen=True, eq=False)
class Refitted:
    """A model fitted on some runs: its parameters, its tangents there, and its residual.

    `cost`: whitened squares over the fitted runs. `mapped`: the products `decoded` where they are known.
    """

    base: Base
    tangents: NormalEquations
    fitted: np.ndarray
    cost: float
    mapped: np.ndarray | None = None

    @classmethod
    def of(cls, base: Base, tangents: NormalEquations, runs: Sequence[int]) -> "Refitted":
        """Return the fit at which the tangents were taken."""
        units = tangents.units(runs)
        return cls(base, tangents, units, float(tangents.likelihood[units, -1, -1].sum()))

    @cached_property
    def decoded(self) -> np.ndarray:
        """Products of the tangents mapped to the pose, rotation as length: (units, c, c).

        Computed on first use, since intermediate steps and rejected fits do not need them.
        """
        return normal_equations(self.base).decoded.border if self.mapped is None else self.mapped

    @property
    def output(self) -> np.ndarray:
        """Sum of squared decoded errors of each unit, rotation as length."""
        return self.decoded[:, -1, -1]

    def gap(self, units: np.ndarray) -> float:
        """Return the gap metric over some units."""
        return float(np.sqrt(self.output[units].sum() / max(self.tangents.count[units].sum(), 1.0)))

    @property
    def metric(self) -> float:
        """Gap metric over the fitted runs."""
        return self.gap(self.fitted)

    @property
    def readings(self) -> float:
        """Number of readings that were fitted."""
        return float(self.tangents.count[self.fitted].sum()) * len(self.base.model.channels)

    def bic(self, size: int, inflation: float = 1.0) -> float:
        """Return the BIC of `size` parameters, with `inflation` times the variance of slow averages."""
        return float(bic(self.cost, self.readings / inflation, size, self.readings))

    def variance(self, inflation: float) -> float:
        """Return the variance of such a slow average of the whitened residual."""
        return max(self.cost / self.readings, 1e-12) * inflation

    def distance(self, other: "Refitted") -> float:
        """Return the whitened squared distance of two residuals: the separation of the models by this log."""
        known = frozenset(run for unit in self.fitted for run in self.tangents.runs[unit])
        return sum(
            float((((one.residual - two.residual) * one.used) ** 2).sum())
            for one, two in zip(pieces(self.base, known), pieces(other.base, known), strict=True)
        )

    def at_bound(self) -> tuple[int, ...]:
        """Index of the free parameters that ended at one of their bounds."""
        return tuple(k for k in pressed(self.base.model.bounds, self.base.p) if k in self.base.free)

    @property
    def products(self) -> np.ndarray:
        """Products of free parameters and residual over the fitted runs."""
        return self.tangents.likelihood[self.fitted].sum(axis=0)

    def moved(self, share: float) -> Base:
        """Return the base at `share` of the way to the minimum inside the bounds; the offsets follow."""
        base, p = self.base, self.base.p.copy()
        free = list(base.free)
        lower, upper = base.model.bounds
        step = share * inside_bounds(base, self.products)
        p[free] = np.clip(p[free] + step, np.minimum(lower, base.p)[free], np.maximum(upper, base.p)[free])
        if not len(base.model.offsets):
            return replace(base, p=p)
        v = np.concatenate([-(p[free] - base.p[free]), [1.0]])
        # the residual is r = v-combination of the columns: offsets take -follow of it
        follow = zip(self.tangents.order, self.tangents.follow, strict=True)
        return replace(base, p=p, offsets={run: base.offsets.get(run, 0.0) - f @ v for run, f in follow})

    def stepped(self) -> "Refitted":
        """Return the fit at the minimum of its tangents without another pass; they hold `decoded` too."""
        base, t, free = self.moved(1.0), self.tangents, list(self.base.free)
        to_end = np.eye(len(free) + 1)
        to_end[-1, :-1] = (self.base.p - base.p)[free]
        likelihood, mapped = (to_end @ M.border @ to_end.T for M in (t.whitened, t.decoded))
        t = replace(t, whitened=t.whitened._replace(border=likelihood), follow=t.follow @ to_end.T)
        return Refitted(base, t, self.fitted, float(likelihood[self.fitted, -1, -1].sum()), mapped)

    def unseen(self) -> tuple[int, ...]:
        """Index of the free parameters on which no fitted sample depends, see `seen`."""
        return tuple(np.array(self.base.free, dtype=int)[~seen(self.base, self.products)].tolist())

    def uncertainty(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariance (n, n) of all parameters, as of a fit, and the degrees of freedom (n,) of it.

        0 where fixed, unseen or at a bound, with infinite ones.
        """
        moving = np.flatnonzero(~np.isin(self.base.free, (*self.at_bound(), *self.unseen())))
        units = self.tangents.likelihood[self.fitted]
        free = np.array(self.base.free, dtype=int)[moving]
        octaves = Octaves.of(self._pieces(), offsets=len(self.base.model.offsets))
        known = None if octaves.white else octaves.reduced(np.eye(len(self.base.free))[:, moving])
        size, runs = self.variance(1.0), {run for unit in self.fitted for run in self.tangents.runs[unit]}
        left = self.readings - len(free) - len(runs) * len(self.base.model.offsets)
        white = White(size, size, max(left, 1.0))
        found = estimated(units[:, moving[:, None], moving], units[:, moving, -1], white, known)
        full, dof = np.zeros((len(self.base.p),) * 2), np.full(len(self.base.p), np.inf)
        full[np.ix_(free, free)] = found.covariance
        along, rows = self._gauge(units[:, moving[:, None], moving].sum(axis=0), free)
        within = np.eye(len(full)) - along @ rows
        dof[free] = found.dof(within[np.ix_(free, free)])
        return np.asarray(within @ full @ within.T), dof

    def _pieces(self) -> Iterator[tuple[Batch, np.ndarray]]:
        """Yield the fitted runs in pieces, with the whitened columns of each, see `Columns.dense`."""
        work, fitted = Columns(self.base), {run for unit in self.fitted for run in self.tangents.runs[unit]}
        for batch, weights in work.weighed():
            used = np.repeat(np.isin(batch.runs, [*fitted]), np.diff(batch.edges))
            if used.any():
                columns = work.dense(work.rows(batch, weights)[:, used])
                yield batch.of_runs(fitted), work.whiten @ columns

    def values(self) -> np.ndarray:
        """Return the parameters (n,) within the gauges of the model, as a fit gives them."""
        free = np.array(self.base.free, dtype=int)
        along, rows = self._gauge(self.products[:-1, :-1], free)
        return np.asarray(self.base.p - along @ (rows @ (self.base.p - self.base.model.nominal)))

    def _gauge(self, M: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gauges in force, rows (g, n), and the steps (n, g) that change one and no reading.

        `M`: products of the columns of the parameters `free`.
        """
        unit, scale = unit_scale(M), scales(self.base.model)
        sizes, vectors = np.linalg.eigh(M * np.outer(unit, unit))
        null = np.zeros((len(scale), int(np.sum(sizes < SINGULAR * sizes.max(initial=0.0)))))
        null[free] = unit[:, None] * vectors[:, : null.shape[1]]
        rows = gauged(self.base.model, null / scale[:, None])[1] / scale
        return null @ np.linalg.pinv(rows @ null), rows


def with_model(base: Base, model: Model) -> Base:
    """Return `base` with an extended model, new parameters at their nominal values."""
    p = model.vector(dict(zip(base.model.names, base.p.tolist(), strict=True)))
    fixed = {base.model.names[k] for k in range(len(base.p)) if k not in base.free}
    free = tuple(k for k, q in enumerate(model.parameters) if q.name not in fixed and q.width > 0)
    return replace(base, model=model, p=p, free=free)


def with_effects(base: Base, variants: Iterable[Variant], values: Mapping[str, float]) -> Base:
    """Return `base` with effects added, at `values` of those parameters that have one."""
    for variant in variants:
        base = with_model(base, variant.make(base.model))
    p = [values.get(name, nominal) for name, nominal in zip(base.model.names, base.p, strict=True)]
    return replace(base, p=np.array(p))


def refit(base: Base, runs: Sequence[int], beside: float = np.inf) -> Refitted:
    """Minimise the whitened residual of `runs` from `base`; every run's offsets follow its own samples.

    It ends where a step lowers the cost by less than 1e-5 of it, or where steps as good as the last one do
    not reach the cost `beside` it in the passes that are left. Of a long log the last step needs no pass once
    it is within the uncertainty of its part: over that the model is as linear as its covariance supposes.
    """
    left, long = count(PASSES, -1), base.part is not base

    def converged(now: Refitted, gained: float) -> bool:
        if not long:
            return gained <= 1e-5 * now.cost or next(left) * gained < now.cost - beside
        more = base.log.rows / base.part.log.rows
        most = base.policy.separated**2 * more * len(base.free) * now.variance(1.0)
        return now.cost - now.stepped().cost <= most

    def linearised(at: Base) -> Refitted:
        return Refitted.of(at, normal_equations(at, decoded=long), runs)

    found = gauss_newton(linearised, base, converged, PASSES)[0]
    return found.stepped() if long else found


def seen(base: Base, M: np.ndarray) -> np.ndarray:
    """Return which of the free parameters affect the log, from the products M of their columns.

    One that does not change the cost within its bounds stays fixed: a wave that is 0 at every sample has a
    column of rounding errors, which would be scaled up to explain noise.
    """
    free = np.array(base.free, dtype=int)
    lower, upper = base.model.bounds
    width = np.minimum((upper - lower)[free], 1e150)
    return np.maximum(np.diag(M)[: len(free)], 0.0) * width**2 >= DROP


def inside_bounds(base: Base, M: np.ndarray) -> np.ndarray:
    """Return the step to the minimum inside the bounds; a parameter that would leave them stops there."""
    free = list(base.free)
    lower, upper = (np.where(seen(base, M), (b - base.p)[free], 0.0) for b in base.model.bounds)
    return bounded_step(-M[:-1, -1], M[:-1, :-1], np.minimum(lower, 0.0), np.maximum(upper, 0.0))[0]
