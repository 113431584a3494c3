"""Fit a model with effects, exact and non-linear, by Gauss-Newton steps on passes over the log."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import numpy as np

from hallsym.diagnosis.normal_equations import Columns, NormalEquations, normal_equations
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.scores import bic
from hallsym.estimation.covariance import RunScatter, pressed
from hallsym.estimation.factors import SINGULAR, pseudo_inverse, unit_scale
from hallsym.estimation.identifiable import gauged, scales
from hallsym.estimation.optimum import DROP, PASSES
from hallsym.model import Model, Variant
from solvers import bounded_step, gauss_newton

FEWEST = 30
"""Fewest values of an octave of frequency in which noise has a variance of its own, known to a quarter."""


@dataclass(frozen=True, eq=False)
class Refitted:
    """A model fitted on some runs: its parameters, its tangents there, and its residual.

    `cost`: whitened squares over the fitted runs.
    """

    base: Base
    tangents: NormalEquations
    fitted: np.ndarray
    cost: float

    @cached_property
    def decoded(self) -> np.ndarray:
        """Products of the tangents mapped to the pose, rotation as length: (units, c, c).

        Computed on first use, since intermediate steps and rejected fits do not need them.
        """
        return normal_equations(self.base).decoded.border

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

    def unseen(self) -> tuple[int, ...]:
        """Index of the free parameters on which no fitted sample depends, see `seen`."""
        return tuple(np.array(self.base.free, dtype=int)[~seen(self.base, self.products)].tolist())

    def covariance(self) -> np.ndarray:
        """Covariance of all parameters, as of a fit; 0 where fixed, unseen or at a bound.

        Each parameter collects the noise at the frequencies of its own column: the covariance is a sandwich
        (White, Econometrica 50 (1982) 1, doi:10.2307/1912526) of the products of the columns by octave of
        frequency and of the variance of the residual there, of which the parameters have taken their part.
        Errors of the model go with the motion of a unit, and not with a frequency: where units certainly
        scatter more than by white noise, no uncertainty is smaller than their scatter says.
        """
        moving = np.flatnonzero(~np.isin(self.base.free, (*self.at_bound(), *self.unseen())))
        free = np.array(self.base.free, dtype=int)[moving]
        octaves, values = self._by_octave()
        known = octaves[:, moving[:, None], moving]
        M = known.sum(axis=0)
        inverse = pseudo_inverse(M)
        left = values - np.einsum("ij,oji->o", inverse, known)
        power = octaves[:, -1, -1] / np.maximum(left, 0.5 * values)
        found = inverse @ np.tensordot(power, known, 1) @ inverse
        units, size = self.tangents.likelihood[self.fitted], self.variance(1.0)
        scatter = RunScatter.of(units[:, moving[:, None], moving], units[:, moving, -1])
        if scatter.ratio > scatter.limit(size):
            more = np.diag(scatter.covariance(size)) / np.maximum(np.diag(found), 1e-300)
            found *= np.sqrt(np.outer(more.clip(1.0), more.clip(1.0)))
        full = np.zeros((len(self.base.p),) * 2)
        full[np.ix_(free, free)] = found
        along, rows = self._gauge(M, free)
        within = np.eye(len(full)) - along @ rows
        return np.asarray(within @ full @ within.T)

    def _by_octave(self) -> tuple[np.ndarray, np.ndarray]:
        """Return products (octaves, p, p) of free parameters and residual, and how many values are in each.

        By frequency, the slowest octave last. Of the fitted runs, the offsets of each eliminated; a run that
        is long is taken in parts.
        """
        base, work, t = self.base, Columns(self.base), self.tangents
        fitted = {run for unit in self.fitted for run in t.runs[unit]}
        follow = dict(zip(t.order, t.follow, strict=True))
        octaves = int(np.log2(base.log.rows)) + 2  # of the longest run that may be, and the mean
        sums, counts = np.zeros((octaves, work.n + 1, work.n + 1)), np.zeros(octaves)
        for batch, weights in work.weighed():
            columns = np.tensordot(base.whiten, work.columns(batch, weights)[0], axes=(1, 1))
            for run, at in batch.parts():
                if run not in fitted:
                    continue
                part = columns[:, work.z :, at] + follow[run].T @ columns[:, : work.z, at]
                n = part.shape[2]
                waves = np.fft.rfft(part) / np.sqrt(n)
                each = np.full(n // 2 + 1, 2.0)  # a frequency and its negative
                each[n // 2] = 1.0 + (n % 2)
                each[0] = 1.0
                octave = np.log2(n / np.maximum(np.arange(n // 2 + 1), 0.5)).astype(int)
                for o in np.unique(octave):
                    own = waves[:, :, octave == o] * np.sqrt(each[octave == o])
                    flat = own.swapaxes(0, 1).reshape(work.n + 1, -1)
                    sums[o] += (flat @ flat.conj().T).real
                    counts[o] += len(part) * each[octave == o].sum()
        while len(counts) > 1 and counts[-1] < FEWEST:
            sums[-2] += sums[-1]
            counts[-2] += counts[-1]
            sums, counts = sums[:-1], counts[:-1]
        seen = counts > 0
        return sums[seen], counts[seen]

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
    not reach the cost `beside` it in the passes that are left.
    """
    left = count(PASSES, -1)

    def linearised(at: Base) -> Refitted:
        t = normal_equations(at, decoded=False)
        units = t.units(runs)
        return Refitted(at, t, units, float(t.likelihood[units, -1, -1].sum()))

    def converged(now: Refitted, gained: float) -> bool:
        return gained <= 1e-5 * now.cost or next(left) * gained < now.cost - beside

    return gauss_newton(linearised, base, converged, PASSES)[0]


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
