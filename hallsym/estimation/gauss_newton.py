"""The optimum of a model without run statistics of its own: Gauss-Newton, one pass over the log per step."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import numpy as np

import solvers
from hallsym.estimation.decoding import ErrorTable, error_tables, zero_shifts
from hallsym.estimation.goodness_of_fit import GoodnessOfFit, goodness_of
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.likelihood import Cost, Point, cost_of
from hallsym.estimation.linearised import exact, summarise_at
from hallsym.estimation.optimum import Search, Solution, search
from hallsym.estimation.run_statistics import summarise
from hallsym.log import Log
from hallsym.log.batches import Weigh
from hallsym.log.phase import rehomed
from hallsym.model import Model

PASSES = 40
DROP = 1e-3
"""Decrease of the cost, per unit of what a degree of freedom leaves, that is not worth another pass: it moves
no parameter by more than 0.03 standard uncertainties."""
REMEDY = (
    "start the effect from other numbers (--effect NAME:number=VALUE; 'hallsym diagnose' finds some) "
    "or leave it out"
)
"""What helps where passes over the log do not converge."""
SETTLED = 1e-9
"""Change [m] of a run's zeros below which they are settled."""

Zeros = Mapping[int, np.ndarray]
Shifts = Mapping[str, Mapping[int, float]]


def cost_near(
    log: Log, model: Model, p: np.ndarray, noise: Mapping[str, float], weigh: Weigh | None = None
) -> Cost:
    """Return the likelihood of a log near `p`, the zeros of each run settled at `p`; exact at `p`."""
    if exact(model):
        return cost_of(summarise(log, model, weigh), noise)
    zeros: Zeros = {}
    for _ in range(PASSES):
        cost = cost_of(summarise_at(log, model, p, zeros, noise, weigh), noise)
        before, zeros = zeros, zeros_of(cost, p)
        if all(np.abs(z - before.get(run, 0.0)).max(initial=0.0) < SETTLED for run, z in zeros.items()):
            break
    return cost


def zeros_of(cost: Cost, p: np.ndarray) -> dict[int, np.ndarray]:
    """Return the zeros of every run at `p`."""
    return dict(zip(cost.summary.runs, cost.at(p).zeros, strict=True))


def deviations_of(point: Point) -> dict[int, np.ndarray]:
    """Return the zero deviations of every run at a point in reading space, as a calibration keeps them."""
    summary = point.cost.summary
    read = point.zeros * summary.model.zero_scale(point.p, summary.first_state)
    return dict(zip(summary.runs, read, strict=True))


@dataclass(frozen=True, eq=False)
class Judged:
    """Fixed parameters on another log: errors, zeros beside the calibration's, how well they fit it.

    `point`: of its cost. `log`: what was decoded, with the zeros of its references that were asked for.
    """

    table: ErrorTable
    shifts: Shifts
    goodness: GoodnessOfFit
    point: Point
    log: Log


def judged(
    log: Log, model: Model, p: np.ndarray, noise: Mapping[str, float], *, own_zero: bool = False
) -> Judged:
    """Return what fixed parameters make of another log; each run's zeros are estimated from that run.

    `own_zero`: so is the zero of a reference that repeats, which the calibration has one of.
    """
    cost = cost_near(log, model, p, noise)
    shifts = zero_shifts(log, model, p, zeros_of(cost, p), cost.reading_variance, noise)
    if own_zero and shifts:
        log = rehomed(log, shifts, model)
        cost = cost_near(log, model, p, noise)
    (table,) = error_tables(log, model, [(p, zeros_of(cost, p))], cost.reading_variance, sigma=noise)
    point = cost.at(p)
    return Judged(table, shifts, goodness_of(point, 0), point, log)


@dataclass(frozen=True, eq=False)
class _Pass:
    """The cost of all runs, and of the fitted ones, linearised at `p`.

    `before`: what the last pass found determined, None in the first.
    """

    everything: Cost
    fitted: Cost
    p: np.ndarray
    before: Determination | None

    @cached_property
    def cost(self) -> float:
        return self.fitted.at(self.p).value

    @cached_property
    def _found(self) -> tuple[Determination, np.ndarray]:
        """What is determined here, and where the search begins.

        What is held stays at its value while the rank does not change, else it goes to its nominal value.
        """
        found, before, model = determine(self.fitted, self.p), self.before, self.fitted.summary.model
        if before is not None and before.null.shape == found.null.shape:
            return replace(found, held=before.held), self.p
        p, held = self.p.copy(), list(found.held)
        p[held] = np.clip(model.nominal, *model.bounds)[held]
        return found, p

    @property
    def determination(self) -> Determination:
        return self._found[0]

    @cached_property
    def target(self) -> Search:
        """The optimum of the linearised cost inside the bounds."""
        found, begin = self._found
        return search(self.fitted, self.fitted, begin, found, solver="direct", seed=0)

    def moved(self, share: float) -> tuple[np.ndarray, Zeros]:
        if share == 1.0:
            return self.target.p, zeros_of(self.everything, self.target.p)
        begin = self._found[1]
        return begin + share * (self.target.p - begin), zeros_of(self.everything, begin)


def optimum(
    log: Log,
    model: Model,
    noise: Mapping[str, float],
    start: np.ndarray,
    holdout: Sequence[int],
    weigh: Weigh | None,
    say: Callable[[str], None],
) -> Solution:
    """Minimise the cost of the runs that are not held out, from `start` (n,), inside the bounds."""
    number, evaluations, before = count(1), 0, None

    def linearise(at: tuple[np.ndarray, Zeros]) -> _Pass:
        say(f"pass {next(number)} over the log")
        p, zeros = at
        everything = cost_of(summarise_at(log, model, p, zeros, noise, weigh), noise)
        return _Pass(everything, everything.without(holdout), p, before)

    def converged(now: _Pass, gained: float) -> bool:
        nonlocal evaluations, before
        evaluations, before = evaluations + now.target.evaluations, now.determination
        readings = float(now.fitted.summary.counts.sum()) * len(model.channels)
        return now.cost - now.target.cost <= DROP * max(now.cost / readings, 1e-300)

    first = np.clip(np.asarray(start, dtype=float), *model.bounds)
    zeros = zeros_of(cost_near(log, model, first, noise, weigh), first) if model.zeros else {}
    best, outcome = solvers.gauss_newton(linearise, (first, zeros), converged, PASSES)
    found = replace(best.target, evaluations=evaluations)
    if outcome != "converged":
        passes = next(number) - 1
        said = {
            "budget": "the cost still falls",
            "stuck": "no step along the tangent lowers the cost any more",
        }[outcome] + f" after {passes} passes over the log"
        # the minimum of the tangent is no optimum then: the best point that was passed is the result
        found = replace(found, p=best.p, cost=best.cost, status="not converged", message=f"{said}; {REMEDY}")
    return Solution(best.everything, best.fitted, best.determination, found)
