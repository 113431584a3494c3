"""Particle swarm with constriction: Clerc & Kennedy, IEEE TEC 6 (2002) 58, doi:10.1109/4235.985692."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solvers.problem import Evaluate, Population


def pso(
    population: Population,
    evaluate: Evaluate,
    rng: np.random.Generator,
    *,
    inertia: float = 0.7298,
    pull: float = 1.49618,
) -> Iterator[Population]:
    """Every particle is pulled to its own best place and to the best of all; yields the own bests."""
    x, speed, own = population.x, np.zeros_like(population.x), population
    while True:
        r1, r2 = rng.random(x.shape), rng.random(x.shape)
        speed = inertia * speed + pull * (r1 * (own.x - x) + r2 * (own.best - x))
        tried = evaluate(x + speed)
        x, speed = tried.x, tried.x - x  # a bounce off a bound turns the speed as well
        own = own.improved_by(tried)
        yield own
