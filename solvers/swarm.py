"""Particle swarms: PSO with constriction, and MPSO with an inertia that falls.

PSO: Clerc & Kennedy, IEEE TEC 6 (2002) 58, doi:10.1109/4235.985692. MPSO: Meng et al., Sensors 2014, 14,
13980, doi:10.3390/s140813980: positions and velocities follow (8) and (9), the inertia falls linearly, (10),
after Shi & Eberhart, IEEE ICEC 1998, 69, doi:10.1109/ICEC.1998.699146. Where the paper is silent:
accelerating constants of 2 and an inertia from 0.9 to 0.4 are Shi & Eberhart's.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solvers.problem import Evaluate, Population


def pso(population: Population, evaluate: Evaluate, rng: np.random.Generator) -> Iterator[Population]:
    """Every particle is pulled to its own best place and to the best of all; yields the own bests."""
    x, speed, own = population.x, np.zeros_like(population.x), population
    while True:
        r1, r2 = rng.random(x.shape), rng.random(x.shape)
        speed = 0.7298 * speed + 1.49618 * (r1 * (own.x - x) + r2 * (own.best - x))
        tried = evaluate(x + speed)
        x, speed = tried.x, tried.x - x  # a bounce off a bound turns the speed as well
        own = own.improved_by(tried)
        yield own


def inertia(generation: int, generations: int, w_max: float, w_min: float) -> float:
    """The weight (10) of a generation, counted from 0; it stays at `w_min` once the plan is over."""
    left = max(generations - generation, 0) / generations
    return left * (w_max - w_min) + w_min


def mpso(
    population: Population,
    evaluate: Evaluate,
    rng: np.random.Generator,
    *,
    generations: int = 200,
    w_max: float = 0.9,
    w_min: float = 0.4,
) -> Iterator[Population]:
    """Particle swarm whose inertia falls from `w_max` to `w_min` over `generations`; yields the own bests.

    generations: the plan of the paper is 200 with 100 particles; `minimize` sets it from its budget.
    """
    generation = 0
    x, speed, own = population.x, np.zeros_like(population.x), population
    while True:
        w = inertia(generation, generations, w_max, w_min)
        r1, r2 = rng.random(x.shape), rng.random(x.shape)
        speed = w * speed + 2.0 * r1 * (own.x - x) + 2.0 * r2 * (own.best - x)  # (8)
        tried = evaluate(x + speed)  # (9)
        x, speed = tried.x, tried.x - x  # a bounce off a bound turns the speed as well
        own = own.improved_by(tried)
        generation += 1
        yield own
