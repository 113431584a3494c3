"""The loop around every global method, and local refinement of its result.

The loop keeps budget, bounds, best so far, history, status and interruption. A global method is never the end
(`hybrid`): the best few separated points are refined.

Starts come from a Latin hypercube (McKay, Beckman & Conover, Technometrics 21 (1979) 239,
doi:10.1080/00401706.1979.10489755), of which separated points are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from solvers.ipopt import ipopt
from solvers.newton import newton
from solvers.problem import (
    INTERRUPTED,
    FloatArray,
    Population,
    Problem,
    Result,
    Solver,
    Status,
    choice,
    misuse,
    rows,
)
from solvers.tlbo import gbtlbo, shtlbo, tlbo

SOLVERS: tuple[Solver, ...] = (tlbo, gbtlbo, shtlbo)
EXPLORERS = (*(solver.__name__ for solver in SOLVERS), "screening")
COLLAPSED = 1e-10
"""Widths of the box within which a whole population counts as one point."""
SEPARATION = 0.05
"""Root mean square distance of two starts, in widths of the box."""
SAME = 1e-6
"""Relative difference of cost within which two local results are the same optimum."""


def latin_hypercube(n: int, lower: FloatArray, upper: FloatArray, rng: np.random.Generator) -> FloatArray:
    """`(n, dim)` points: in each dimension exactly one in each of `n` equal slices of the box."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    slices = rng.permuted(np.tile(np.arange(n), (lower.size, 1)), axis=1).T
    unit = (slices + rng.random((n, lower.size))) / n
    return np.clip(lower + unit * (upper - lower), lower, upper)


def best_separated(
    population: Population, keep: int, problem: Problem, separation: float = SEPARATION
) -> Population:
    """The cheapest points, up to `keep`, each at least `separation` from every cheaper one that was kept.

    Distance is the root mean square over the variables that are not fixed, in widths of the box. Points of
    infinite cost are left out; so fewer than `keep` may come back, from a class that has collapsed just one.
    """
    movable = problem.width > 0.0
    ranked = population.cheapest(len(population))
    unit = ranked.x[:, movable] / problem.width[movable]
    near = np.isinf(ranked.cost)
    kept: list[int] = []
    while len(kept) < keep and not near.all():
        first = int(np.argmin(near))
        kept.append(first)
        distance2 = np.square(unit - unit[first]).sum(axis=1) / max(1, unit.shape[1])
        near |= distance2 < separation**2
        near[first] = True
    return Population(ranked.x[kept], ranked.cost[kept])


def screened_starts(
    problem: Problem, n: int, keep: int, rng: np.random.Generator, *, separation: float = SEPARATION
) -> Population:
    """Evaluate a Latin hypercube of `n` points at once, and keep the best `keep` separated ones."""
    problem.require_finite_box("screened_starts")
    sample = latin_hypercube(n, problem.lower, problem.upper, rng)
    return best_separated(problem.evaluate(sample), keep, problem, separation)


def reflect(x: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Reflect points outside back into the box; points inside stay as they are, to the bit.

    The bounds act as mirrors, so a candidate any number of widths away still lands inside in one step.
    Clipping instead piles candidates up on the faces of the box, where differences between them vanish.
    """
    outside = (x < lower) | (x > upper)
    if not outside.any():
        return x
    low, high = (np.broadcast_to(bound, x.shape)[outside] for bound in (lower, upper))
    width = high - low
    with np.errstate(invalid="ignore"):  # a fixed variable (width 0) or an infinite candidate: clip below
        folded = low + width - np.abs(np.mod(x[outside] - low, 2.0 * width) - width)
    inside = x.copy()
    inside[outside] = np.clip(np.where(np.isfinite(folded), folded, x[outside]), low, high)
    return inside


@dataclass(frozen=True, eq=False)
class SearchResult(Result):
    """A `Result` with the points and costs of the last generation."""

    population: Population


def minimize(
    problem: Problem,
    solver: str | Solver = "shtlbo",
    *,
    seed: int | np.random.Generator,
    budget: int = 20_100,
    size: int | None = None,
    start: ArrayLike | None = None,
) -> SearchResult:
    """Search the whole box with a population; the same seed gives the same result, to the bit.

    solver: a name from `SOLVERS`, or a generator function of the same form (see `Solver`).
    budget: rows of `problem.cost` that may be evaluated, met exactly: the last generation is cut short.
        The default is the paper's: a class of 100, then 100 generations of two phases.
    size: rows of the population, 100 by default.
    start: `(k, dim)` points to begin with, clipped into the box; a Latin hypercube fills up the rest.

    A search that is interrupted (Ctrl-C) returns its best point so far.

    >>> bowl = Problem(lambda x: (x**2).sum(axis=1), [-1.0, -1.0], [1.0, 2.0])
    >>> minimize(bowl, seed=1, budget=3000).cost < 1e-6
    True
    """
    began = perf_counter()
    if isinstance(solver, str):
        names = tuple(known.__name__ for known in SOLVERS)
        solver = SOLVERS[names.index(choice(solver, names, "solver", "minimize"))]
    if budget < 2:
        raise misuse("budget", "minimize", "at least 2", budget)
    size = min(100 if size is None else size, budget)
    if size < 2:
        raise misuse("size", "minimize", "at least 2", size)
    problem.require_finite_box("minimize")
    rng = np.random.default_rng(seed)
    run = _Run(problem, budget, _first(problem, size, start, rng))
    status: Status
    try:
        status, message = run.search(solver, rng)
    except KeyboardInterrupt:
        status, message = "interrupted", INTERRUPTED
    if status != "interrupted" and np.isinf(run.cost):
        status, message = "failed", "No finite cost was found: check the cost at a point you know is good."
    return SearchResult(
        x=run.x,
        cost=run.cost,
        status=status,
        message=message,
        evaluations=run.evaluations,
        first=run.first,
        population=run.population,
        seconds=perf_counter() - began,
    )


class _Run:
    """State of one search."""

    def __init__(self, problem: Problem, budget: int, first: FloatArray) -> None:
        self.problem, self.budget = problem, budget
        self.x, self.cost, self.evaluations = (problem.lower + problem.upper) / 2.0, np.inf, 0
        self.first = np.inf
        self.population = Population(first, np.full(len(first), np.inf))

    def search(self, method: Solver, rng: np.random.Generator) -> tuple[Status, str]:
        """Evaluate the first population, then one generation after the other until there is an ending."""
        self.population = self.evaluate(self.population.x)
        self.first = self.cost
        generations = method(self.population, self.evaluate, rng)
        while (ending := self.ending()) is None:
            self.population = next(generations)
        return ending

    def evaluate(self, candidates: FloatArray) -> Population:
        """Into the box, then the cost; rows beyond the budget are not evaluated and cost +inf."""
        x = reflect(candidates, self.problem.lower, self.problem.upper)
        affordable = min(len(x), self.budget - self.evaluations)
        if affordable == 0:
            return Population(x, np.full(len(x), np.inf))
        paid = self.problem.evaluate(x[:affordable])
        self.evaluations += affordable
        best = int(np.argmin(paid.cost))
        if paid.cost[best] < self.cost:
            self.x, self.cost = x[best].copy(), float(paid.cost[best])
        return Population(x, np.concatenate([paid.cost, np.full(len(x) - affordable, np.inf)]))

    def ending(self) -> tuple[Status, str] | None:
        """Why to stop now, if there is a reason."""
        if (np.ptp(self.population.x, axis=0) <= COLLAPSED * self.problem.width).all():
            return "converged", "The population has collapsed to one point: refine it, or try another seed."
        if self.evaluations >= self.budget:
            return "budget", f"{self.budget} evaluations are spent: refine the best points, or raise budget."
        return None


def _first(problem: Problem, size: int, start: ArrayLike | None, rng: np.random.Generator) -> FloatArray:
    """The first population: the given points, then a Latin hypercube."""
    first = latin_hypercube(size, problem.lower, problem.upper, rng)
    if start is not None:
        given = rows(start, problem.dim, "start", "minimize")
        if len(given) > size:
            raise misuse("start", "minimize", f"at most {size} rows, the size of the population", len(given))
        first[: len(given)] = np.clip(given, problem.lower, problem.upper)
    return first


# -- refinement ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class HybridResult(Result):
    """A `Result` with its global and local stages.

    explored: the global stage.
    local: one result per refined start, user's starts first.
    share: fraction of the refined starts that ended at the best cost. Near 1: the optimum is easy to reach;
        a single one of many: look at the others before believing it.
    """

    explored: SearchResult
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
    size: int | None = None,
) -> HybridResult:
    """Explore the box, refine the best few separated points, and return the best of all.

    starts: `(k, dim)` points of the user; they join the global stage and are all refined themselves.
    keep: how many points of the final population to refine at most, `SEPARATION` from the others in widths
        of the box (root mean square). A class that has collapsed leaves one.
    budget: evaluations of the global stage.
    global_solver: a name from `SOLVERS`, or "screening", one Latin hypercube of `budget` points.
    size: as in `minimize`.
    """
    began, _ = perf_counter(), problem.second_order
    choice(global_solver, EXPLORERS, "global_solver", "hybrid")
    given = np.empty((0, problem.dim)) if starts is None else rows(starts, problem.dim, "starts", "hybrid")
    # a screening is a search that ends with its first population, one hypercube of the whole budget
    method, size = ("tlbo", budget) if global_solver == "screening" else (global_solver, size)
    begin = given if len(given) else None
    explored = minimize(problem, method, seed=seed, budget=budget, start=begin, size=size)
    queue = np.concatenate([given, best_separated(explored.population, keep, problem).x])
    local: list[Result] = []
    interrupted = explored.status == "interrupted" or _refine(problem, queue, explored, local)
    stages = [explored, *local]
    ended = [stage for stage, there in zip(local, _reached([*local, explored]), strict=False) if there]
    best, share = min(ended or stages, key=lambda stage: stage.cost), len(ended) / max(len(local), 1)
    return HybridResult(
        x=best.x,
        cost=best.cost,
        status="interrupted" if interrupted else best.status,
        message=INTERRUPTED if interrupted else _message(best, local, share),
        evaluations=sum(stage.evaluations for stage in stages),
        first=explored.first,
        seconds=perf_counter() - began,
        explored=explored,
        local=tuple(local),
        share=share,
    )


def _refine(problem: Problem, queue: FloatArray, explored: SearchResult, local: list[Result]) -> bool:
    """Refine the starts into `local`, by Newton's method; return whether that was interrupted.

    IPOPT takes three times as long: it begins anew where Newton's method fails or ends above the best cost.
    """
    try:
        for x0 in queue:
            local.append(newton(problem, x0))
            if local[-1].status == "interrupted":
                return True
        for k, there in enumerate(_reached([*local, explored])[:-1]):
            if there and local[k].status == "converged":
                continue
            tried = [ipopt(problem, queue[k]), local[k]]
            evaluations = sum(stage.evaluations for stage in tried)
            lower = min(tried, key=lambda stage: stage.cost)
            local[k] = replace(lower, evaluations=evaluations)
            if tried[0].status == "interrupted":
                return True
    except KeyboardInterrupt:
        return True
    return False


def _reached(stages: list[Result]) -> list[bool]:
    """Which of the results have the best cost."""
    lowest = min(stage.cost for stage in stages)
    begun = [stage.first for stage in stages if np.isfinite(stage.first)]
    tolerance = SAME * abs(lowest) + 1e-12 * (max(begun) - lowest) if begun else 0.0
    return [bool(np.isfinite(stage.cost) and stage.cost <= lowest + tolerance) for stage in stages]


def _message(best: Result, local: list[Result], share: float) -> str:
    if not local:
        return f"There was nothing to refine. {best.message}"
    return f"{share:.0%} of {len(local)} refined starts reached the best cost. {best.message}"
