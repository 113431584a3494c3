"""The optimum of a model without run summaries of its own: Gauss-Newton, one pass over the log per step."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.estimation.decoding import ErrorTable, error_tables
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.likelihood import Cost, cost_of
from hallsym.estimation.linearised import exact, summarise_at
from hallsym.estimation.optimum import Search, search
from hallsym.estimation.run_statistics import summarise
from hallsym.log import Log
from hallsym.log.batches import Weigh
from hallsym.model import Model

PASSES = 40
DROP = 1e-3
"""Decrease of the cost, per unit of what a degree of freedom leaves, that is not worth another pass: it moves
no parameter by more than 0.03 standard uncertainties."""
SHORTER = 0.3
"""Factor on a step that would raise the cost."""
SETTLED = 1e-9
"""Change [m] of a run's zeros below which they are settled."""

Zeros = Mapping[int, np.ndarray]


@dataclass(frozen=True, eq=False)
class Optimum:
    """Costs of all runs and of the fitted ones, tangent at the optimum; what is determined; the search."""

    everything: Cost
    fitted: Cost
    determination: Determination
    search: Search


def cost_near(
    log: Log, model: Model, p: np.ndarray, noise: Mapping[str, float], weigh: Weigh | None = None
) -> Cost:
    """Return the likelihood of a log near `p`, the zeros of each run settled at `p`; exact at `p`."""
    if exact(model):
        return cost_of(summarise(log, model, weigh), noise)
    zeros: Zeros = {}
    for _ in range(PASSES):
        cost = cost_of(summarise_at(log, model, p, zeros, weigh, sigma=noise), noise)
        before, zeros = zeros, zeros_of(cost, p)
        if _change(before, zeros) < SETTLED:
            break
    return cost


def zeros_of(cost: Cost, p: np.ndarray) -> dict[int, np.ndarray]:
    """Return the zeros of every run at `p`."""
    return dict(zip(cost.summary.runs, cost.at(p).zeros, strict=True))


def judge(log: Log, model: Model, p: np.ndarray, noise: Mapping[str, float]) -> ErrorTable:
    """Return the errors of fixed parameters on another log; each run's zeros are estimated from that run."""
    cost = cost_near(log, model, p, noise)
    return error_tables(log, model, [(p, zeros_of(cost, p))], cost.reading_variance, sigma=noise)[0]


def _change(before: Zeros, after: Zeros) -> float:
    return max(
        (float(np.abs(z - before.get(run, 0.0)).max(initial=0.0)) for run, z in after.items()), default=0.0
    )


def optimum(
    log: Log,
    model: Model,
    noise: Mapping[str, float],
    start: np.ndarray,
    holdout: Sequence[int],
    weigh: Weigh | None,
    say: Callable[[str], None],
) -> Optimum:
    """Minimise the cost of the runs that are not held out, from `start` (n,), inside the bounds."""
    lower, upper = model.bounds
    p = np.clip(np.asarray(start, dtype=float), lower, upper)
    zeros: Zeros = zeros_of(cost_near(log, model, p, noise, weigh), p)
    best: tuple[float, np.ndarray, Zeros] | None = None
    evaluations, step, share = 0, np.zeros_like(p), 1.0
    known: Determination | None = None
    for count in range(PASSES):
        say(f"pass {count + 1} over the log")
        everything = cost_of(summarise_at(log, model, p, zeros, weigh, sigma=noise), noise)
        used = [run for run in everything.summary.runs if run not in holdout]
        fitted = cost_of(everything.summary.select(used), noise)
        value = fitted.at(p).value
        if best is not None and not value <= best[0] and share > 1e-3:
            share *= SHORTER
            p, zeros = best[1] + share * step, best[2]
            continue
        found = determine(fitted, p)
        if known is not None and known.null.shape == found.null.shape:
            found = replace(found, held=known.held)
        elif found.held:
            p[list(found.held)] = np.clip(model.nominal, lower, upper)[list(found.held)]
        known = found
        target = search(fitted, fitted, p, found, solver="direct", seed=0)
        evaluations += target.evaluations
        best, step, share = (value, p, zeros_of(everything, p)), target.p - p, 1.0
        readings = float(fitted.summary.counts.sum()) * len(model.channels)
        if value - target.cost <= DROP * max(value / readings, 1e-300):
            return Optimum(everything, fitted, found, replace(target, evaluations=evaluations))
        p, zeros = target.p, zeros_of(everything, target.p)
    said = f"{PASSES} passes over the log did not bring it to rest"
    stuck = replace(target, status="not converged", message=said, evaluations=evaluations)
    return Optimum(everything, fitted, found, stuck)
