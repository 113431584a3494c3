"""Modified particle swarm of Meng et al., Sensors 2014, 14, 13980, doi:10.3390/s140813980.

The inertia falls linearly over the generations, (10), after Shi & Eberhart, IEEE ICEC 1998, 69,
doi:10.1109/ICEC.1998.699146; positions and velocities follow (8) and (9). Particles that break
`|P - measured| <= dE`, (11), are a matter of the problem: see `solvers.limits`.

Where the paper is silent: accelerating constants of 2 and an inertia from 0.9 to 0.4 are Shi & Eberhart's.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from solvers.problem import Evaluate, FloatArray, Population, misuse


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
    c1: float = 2.0,
    c2: float = 2.0,
    steps: ArrayLike | None = None,
) -> Iterator[Population]:
    """Particle swarm whose inertia falls from `w_max` to `w_min` over `generations`; yields the own bests.

    generations: the plan of the paper is 200 with 100 particles; `minimize` sets it from its budget.
    steps: velocities are multiples of these, `(dim,)`, as in the paper's table 2; none unless given.
    """
    if generations < 1:
        raise misuse("generations", "mpso", "at least 1", generations)
    if not 0.0 <= w_min <= w_max:
        raise misuse("w_min", "mpso", f"between 0 and w_max = {w_max:g}", w_min)
    grid = _grid(steps, population.x.shape[1])
    x, speed, own, generation = population.x, np.zeros_like(population.x), population, 0
    while True:
        w = inertia(generation, generations, w_max, w_min)
        r1, r2 = rng.random(x.shape), rng.random(x.shape)
        speed = w * speed + c1 * r1 * (own.x - x) + c2 * r2 * (own.best - x)  # (8)
        if grid is not None:
            speed = np.rint(speed / grid) * grid
        tried = evaluate(x + speed)  # (9)
        x, speed = tried.x, tried.x - x  # a bounce off a bound turns the speed as well
        own = own.improved_by(tried)
        generation += 1
        yield own


def _grid(steps: ArrayLike | None, dim: int) -> FloatArray | None:
    if steps is None:
        return None
    grid = np.asarray(steps, dtype=float)
    if grid.shape != (dim,) or not (grid > 0).all():
        raise misuse("steps", "mpso", f"positive, of shape ({dim},)", steps)
    return grid
