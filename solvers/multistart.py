"""Many starts, cheaply: a Latin hypercube, screened by cost, thinned so that the kept ones are apart.

Latin hypercube: McKay, Beckman & Conover, Technometrics 21 (1979) 239, doi:10.1080/00401706.1979.10489755.
"""

from __future__ import annotations

import numpy as np

from solvers.problem import FloatArray, Population, Problem

APART = 0.05  # root mean square distance, in widths of the box


def latin_hypercube(n: int, lower: FloatArray, upper: FloatArray, rng: np.random.Generator) -> FloatArray:
    """`(n, dim)` points: in each dimension exactly one in each of `n` equal slices of the box."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    slices = rng.permuted(np.tile(np.arange(n), (lower.size, 1)), axis=1).T
    unit = (slices + rng.random((n, lower.size))) / n
    return np.clip(lower + unit * (upper - lower), lower, upper)


def best_apart(population: Population, keep: int, problem: Problem, apart: float = APART) -> Population:
    """The cheapest points, up to `keep`, each at least `apart` from every cheaper one that was kept.

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
        near |= distance2 < apart**2
        near[first] = True
    return Population(ranked.x[kept], ranked.cost[kept])


def screened_starts(
    problem: Problem, n: int, keep: int, rng: np.random.Generator, *, apart: float = APART
) -> Population:
    """Evaluate a Latin hypercube of `n` points at once, and keep the best `keep` that are apart."""
    problem.require_finite_box("screened_starts")
    sample = latin_hypercube(n, problem.lower, problem.upper, rng)
    return best_apart(problem.evaluate(sample), keep, problem, apart)
