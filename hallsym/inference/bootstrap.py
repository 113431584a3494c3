"""Bootstrap with runs as blocks: what the fit would have been, had other runs of the same kind been recorded.

Whatever correlates samples within a run (drift, hum, filtered noise, a model that does not quite fit) is
carried along, because whole runs are drawn: Davison & Hinkley, Bootstrap Methods and their Application, 1997,
doi:10.1017/CBO9780511802843, ch. 2 and 3.8. A draw is a vector of run weights, so no sample is read again,
and all refits start together: one Newton step from the optimum for every draw, as one stack of linear
systems. Draws are then refitted, those first whose step is least to be trusted, until that changes nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from hallsym.errors import InputError
from hallsym.estimation.calibration import coverage_factor
from hallsym.estimation.factors import unit_scale
from hallsym.estimation.identifiable import least_information, scales
from hallsym.estimation.likelihood import Cost
from hallsym.estimation.optimum import refit
from hallsym.model.model import Quantity

CHECKED = 10
"""Draws that are refitted at a time, to see how far off their one Newton step was."""
ENOUGH = 0.01
"""Error of one Newton step that is accepted, in standard uncertainties."""
CHORDS = 4
"""Steps with the first Hessian, before Newton's method with exact ones."""


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Refits to runs drawn with replacement.

    `p`: (n,) optimum of the log itself. `values`: (m, n) optimum of each draw that determines the
    parameters; `singular` draws did not. `weights`: (m, runs) what was drawn, from how many `runs`.
    """

    p: np.ndarray
    values: np.ndarray
    weights: np.ndarray
    singular: int
    runs: int

    @property
    def std(self) -> np.ndarray:
        """Standard uncertainty of each parameter, (n,), as `std_of` takes it."""
        return _middle(self.values)

    def std_of(self, quantity: Quantity) -> float:
        """Return the standard uncertainty of a quantity: the width of the middle 95 % of the draws over 3.92.

        Their standard deviation would be that of the few draws that hardly determine the quantity.
        """
        return float(_middle(quantity.values(self.values)))

    def interval(self, quantity: Quantity) -> tuple[float, float]:
        """Return the interval to believe: the estimate +- its standard uncertainty times Student's t.

        As many degrees of freedom as runs less one. Percentiles as they are and studentised draws cover less
        when few runs tell most of a parameter, because a sample of few runs does not show their tails.
        """
        value, _ = quantity.first(self.p)
        half = float(coverage_factor(self.runs - 1)) * self.std_of(quantity)
        return max(value - half, quantity.lower), min(value + half, quantity.upper)


def _middle(values: np.ndarray) -> np.ndarray:
    """Standard deviation of a normal distribution with the same middle 95 %, along the first axis."""
    low, high = np.quantile(values, [0.025, 0.975], axis=0)
    return np.asarray((high - low) / (2.0 * scipy.special.ndtri(0.975)))


def bootstrap(cost: Cost, p: np.ndarray, held: Sequence[int], *, replicates: int, seed: int) -> Bootstrap:
    """Refit `cost` to `replicates` draws of its runs around its optimum `p` (n,).

    `held`: index of the parameters that stay as in `p`. Raises `InputError` where hardly a draw determines
    the parameters.
    """
    used = np.flatnonzero(cost.weights > 0)
    rng = np.random.default_rng(seed)
    weights = np.zeros((replicates, len(cost.weights)))
    weights[:, used] = rng.multinomial(len(used), np.full(len(used), 1.0 / len(used)), size=replicates)
    weights *= cost.weights
    p = np.asarray(p, dtype=float)
    steps = _Steps(cost.anchored(p), p, held)
    weights = weights[steps.determines(weights)]
    if len(weights) < 2:
        raise InputError(
            f"Only {len(weights)} of {replicates} draws of the {len(used)} runs determine the parameters, "
            "too few for a bootstrap: record more runs of each kind."
        )
    return Bootstrap(p, steps.refits(weights), weights, replicates - len(weights), len(used))


class _Steps:
    """Gradients and Hessians of every run at the optimum, in units of what the log determines."""

    def __init__(self, cost: Cost, p: np.ndarray, held: Sequence[int]) -> None:
        self.cost, self.p, self.held, point = cost, p, held, cost.at(p)
        self.free = np.array([k for k in range(len(p)) if k not in held], dtype=int)
        model = cost.summary.model
        self.lower, self.upper = (bound[self.free] for bound in model.bounds)
        hessians = point.run_hessians[:, self.free][:, :, self.free]
        self.unit = unit_scale(np.abs(np.tensordot(cost.weights, hessians, axes=1)))
        self.gradients = point.run_gradients[:, self.free] * self.unit
        self.hessians = hessians * np.outer(self.unit, self.unit)
        width = scales(model)[self.free]
        self.information = point.information(2.0, self.free) * np.outer(width, width)

    def determines(self, weights: np.ndarray) -> np.ndarray:
        """Which draws determine all free parameters, as `determine` judges it; (m,) booleans."""
        if len(self.free) == 0:
            return np.ones(len(weights), dtype=bool)
        values = np.linalg.eigvalsh(np.tensordot(weights, self.information, axes=1))
        curved = np.linalg.eigvalsh(np.tensordot(weights, self.hessians, axes=1))[:, 0] > 0
        return np.asarray((values[:, 0] >= least_information(values)) & curved)

    def refits(self, weights: np.ndarray) -> np.ndarray:
        """Return the optimum of every draw (m, n): one Newton step for all, then those that need more.

        A draw whose step leaves the box is refitted.
        """
        hessians = np.tensordot(weights, self.hessians, axes=1)
        steps = -np.linalg.solve(hessians, (weights @ self.gradients)[..., None])[..., 0]
        values = np.tile(self.p, (len(weights), 1))
        values[:, self.free] += steps * self.unit
        outside = ~self.inside(values)
        for k in np.flatnonzero(outside):
            values[k] = refit(self.cost.weighted(weights[k]), self.p, self.held)
        moved = (values - self.p)[:, self.free]
        if moved.size == 0:
            return values
        std = np.sqrt(np.mean(moved**2, axis=0))
        size = np.where(std > 0, std, np.inf)
        order = np.argsort(-(np.abs(moved / size).max(axis=1) ** 2) / np.linalg.eigvalsh(hessians)[:, 0])
        order = order[~outside[order]]
        for first in range(0, len(order), CHECKED):
            batch = order[first : first + CHECKED]
            best = np.array([self.improved(values[k], weights[k], size) for k in batch])
            error = float(np.max(np.abs((best - values[batch])[:, self.free] / size)))
            values[batch] = best
            if error <= 0.5 * ENOUGH:
                break
        return values

    def inside(self, values: np.ndarray) -> np.ndarray:
        """Whether the free parameters of `values` (..., n) lie within their bounds."""
        free = values[..., self.free]
        return np.asarray(((self.lower <= free) & (free <= self.upper)).all(axis=-1))

    def improved(self, value: np.ndarray, weights: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Go on to the optimum of one draw: the gradient where it is, the Hessian of where it came from."""
        hessian, value = np.tensordot(weights, self.hessians, axes=1), value.copy()
        for _ in range(CHORDS):
            gradient = weights @ self.cost.at(value).run_gradients[:, self.free]
            step = -np.linalg.solve(hessian, gradient * self.unit) * self.unit
            value[self.free] += step
            if not self.inside(value):
                break
            if np.max(np.abs(step / size)) <= ENOUGH:
                return value
        return refit(self.cost.weighted(weights), self.p, self.held)
