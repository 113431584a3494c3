"""Modified particle swarm: the equations with known numbers."""

import numpy as np
import pytest
from solver_problems import ROSENBROCK

from solvers import Population, minimize
from solvers.swarm import inertia, mpso


def test_10_inertia_falls_linearly():
    """(10) by hand: 200 generations from 0.9 to 0.4."""
    assert inertia(0, 200, 0.9, 0.4) == 0.9
    assert inertia(100, 200, 0.9, 0.4) == pytest.approx(0.65, abs=1e-15)
    assert inertia(200, 200, 0.9, 0.4) == inertia(999, 200, 0.9, 0.4) == 0.4


class Halves:
    """A generator that deals 1/2 only."""

    def random(self, shape):
        return np.full(shape, 0.5)


def test_8_and_9_two_generations_by_hand():
    """Two particles on a line, cost x^2, r = 1/2, c = 2: x0 = 4 and 1, so the swarm's best is 1.

    First: v = (4 - 4) + (1 - 4) = -3, x = 1; the other stays.
    Second: w = (0.8 + 0.2) / 2, v = -1.5, x = -0.5.
    """

    def evaluate(x):
        return Population(x, (x**2).sum(axis=1))

    swarm = mpso(evaluate(np.array([[4.0], [1.0]])), evaluate, Halves(), generations=2, w_max=0.8, w_min=0.2)
    assert next(swarm).x.tolist() == [[1.0], [1.0]]
    assert next(swarm).x.tolist() == [[-0.5], [1.0]]


def test_the_plan_follows_the_budget():
    """The same swarm with the plan spelled out: 100 first rows, then 9 generations."""
    problem = ROSENBROCK.problem()
    given, planned, longer = (
        minimize(problem, "mpso", seed=4, budget=1000, **options)
        for options in ({}, {"generations": 9}, {"generations": 200})
    )
    assert np.array_equal(given.population.x, planned.population.x)
    assert not np.array_equal(given.population.x, longer.population.x)
