"""Global search, then local refinement of what it found: never stop at the metaheuristic."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from solvers.driver import APART, SOLVERS, best_apart, minimize
from solvers.ipopt import ipopt
from solvers.newton import newton
from solvers.problem import INTERRUPTED, FloatArray, Population, Problem, Result, choice, rows

EXPLORERS = (*(solver.__name__ for solver in SOLVERS), "screening")


@dataclass(frozen=True, eq=False)
class HybridResult(Result):
    """A `Result` that also shows how it came about.

    explored: the global stage.
    local: one result per refined start, user's starts first.
    share: fraction of the refined starts that ended at the best cost. Near 1: the optimum is easy to reach;
        a single one of many: look at the others before believing it.
    """

    explored: Result
    local: tuple[Result, ...]
    share: float


def hybrid(
    problem: Problem,
    *,
    seed: int | np.random.Generator,
    starts: ArrayLike | None = None,
    keep: int = 3,
    budget: int = 20_100,
    global_solver: str = "shtlbo",
    apart: float = APART,
    same: float = 1e-6,
    size: int | None = None,
) -> HybridResult:
    """Explore the box, refine the best few points that are apart, and return the best of all.

    starts: `(k, dim)` points of the user; they join the global stage and are all refined themselves.
    keep: how many points of the final population to refine at most, each `apart` from the others in widths
        of the box (root mean square). A class that has collapsed leaves one.
    budget: evaluations of the global stage.
    global_solver: a name from `SOLVERS`, or "screening", one Latin hypercube of `budget` points.
    same: relative difference of cost within which two local results count as the same optimum.
    size: as in `minimize`.
    """
    began, _ = perf_counter(), problem.second_order
    choice(global_solver, EXPLORERS, "global_solver", "hybrid")
    given = np.empty((0, problem.dim)) if starts is None else rows(starts, problem.dim, "starts", "hybrid")
    # a screening is a search that ends with its first population, one hypercube of the whole budget
    method, size = ("tlbo", budget) if global_solver == "screening" else (global_solver, size)
    begin = given if len(given) else None
    explored = minimize(problem, method, seed=seed, budget=budget, start=begin, size=size)
    queue = np.concatenate([given, best_apart(explored.population, keep, problem, apart).x])
    local: list[Result] = []
    interrupted = explored.status == "interrupted" or _refine(problem, queue, explored, local, same)
    stages = [explored, *local]
    ended = [stage for stage, there in zip(local, _reached([*local, explored], same), strict=False) if there]
    best, share = min(ended or stages, key=lambda stage: stage.cost), len(ended) / max(len(local), 1)
    return HybridResult(
        x=best.x,
        cost=best.cost,
        status="interrupted" if interrupted else best.status,
        message=INTERRUPTED if interrupted else _message(best, local, share),
        evaluations=sum(stage.evaluations for stage in stages),
        history=_joined(stages),
        population=_ends(local) if local else best.population,
        seconds=perf_counter() - began,
        explored=explored,
        local=tuple(local),
        share=share,
    )


def _refine(problem: Problem, queue: FloatArray, explored: Result, local: list[Result], same: float) -> bool:
    """Refine the starts into `local`, by Newton's method; return whether that was interrupted.

    IPOPT takes three times as long: it begins anew where Newton's method fails or ends above the best cost.
    """
    try:
        for x0 in queue:
            local.append(newton(problem, x0))
            if local[-1].status == "interrupted":
                return True
        for k, there in enumerate(_reached([*local, explored], same)[:-1]):
            if there and local[k].status == "converged":
                continue
            tried = [ipopt(problem, queue[k]), local[k]]
            evaluations = sum(stage.evaluations for stage in tried)
            lower = min(tried, key=lambda stage: stage.cost)
            local[k] = replace(lower, evaluations=evaluations, history=_joined(tried[::-1]))
            if tried[0].status == "interrupted":
                return True
    except KeyboardInterrupt:
        return True
    return False


def _reached(stages: list[Result], same: float) -> list[bool]:
    """Which of the results have the best cost."""
    lowest = min(stage.cost for stage in stages)
    begun = [
        stage.history[0, 1] for stage in stages if len(stage.history) and np.isfinite(stage.history[0, 1])
    ]
    tolerance = same * abs(lowest) + 1e-12 * (max(begun) - lowest) if begun else 0.0
    return [bool(np.isfinite(stage.cost) and stage.cost <= lowest + tolerance) for stage in stages]


def _message(best: Result, local: list[Result], share: float) -> str:
    if not local:
        return f"There was nothing to refine. {best.message}"
    return f"{share:.0%} of {len(local)} refined starts reached the best cost. {best.message}"


def _joined(stages: list[Result]) -> FloatArray:
    """The histories one after the other: evaluations add up, the best cost only falls."""
    table = np.concatenate([stage.history for stage in stages])
    before = np.cumsum([0, *(stage.evaluations for stage in stages[:-1])])
    table[:, 0] += np.repeat(before, [len(stage.history) for stage in stages])
    table[:, 1] = np.minimum.accumulate(table[:, 1])
    return table


def _ends(local: list[Result]) -> Population:
    """Where the local methods ended."""
    return Population(np.array([stage.x for stage in local]), np.array([stage.cost for stage in local]))
