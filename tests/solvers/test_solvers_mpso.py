"""Modified particle swarm and limits: the equations with known numbers, ranks, and what discarding costs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from solver_problems import ROSENBROCK, SPHERE

from solvers import Population, Problem, discarding, minimize, ranking
from solvers.mpso import inertia, mpso


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


def test_velocities_are_multiples_of_the_steps():
    seen = []

    def cost(x):
        seen.append(x.copy())
        return (x**2).sum(axis=1)

    start = np.array([[4.0, -3.0], [2.5, 2.0], [-4.5, 1.0]])
    minimize(
        Problem(cost, [-5.0, -5.0], [5.0, 5.0]), "mpso", seed=2, size=3, budget=60, start=start,
        steps=[0.5, 0.25],
    )  # fmt: skip
    rows = np.concatenate(seen)
    assert np.abs(rows / [0.5, 0.25] - np.rint(rows / [0.5, 0.25])).max() < 1e-9
    assert len(np.unique(rows, axis=0)) > 6


def test_the_plan_follows_the_budget():
    """The same swarm with the plan spelled out: 100 first rows, then 9 generations."""
    problem = ROSENBROCK.problem()
    given, planned, longer = (
        minimize(problem, "mpso", seed=4, budget=1000, **options)
        for options in ({}, {"generations": 9}, {"generations": 200})
    )
    assert np.array_equal(given.population.x, planned.population.x)
    assert not np.array_equal(given.population.x, longer.population.x)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"generations": 0}, "generations of mpso must be at least 1"),
        ({"w_min": 1.5}, "w_min of mpso must be between 0 and w_max = 0.9"),
        ({"steps": [0.1]}, r"steps of mpso must be positive, of shape \(5,\)"),
        ({"steps": [0.1, 0, 1, 1, 1]}, r"steps of mpso must be positive"),
    ],
)
def test_misuse_is_one_sentence(options, said):
    with pytest.raises(ValueError, match=said):
        minimize(SPHERE.problem(), "mpso", seed=1, **options)


def outside_disc(x):
    """Distance beyond a disc of radius 0.5 around (1.5, 1.5)."""
    return np.hypot(x[:, 0] - 1.5, x[:, 1] - 1.5) - 0.5


@pytest.mark.parametrize("name", ["mpso", "shtlbo"])
def test_ranking_finds_the_constrained_optimum(name):
    """Sphere outside a disc: the nearest point of the disc is (1.5 - 0.5 / sqrt 2) on the diagonal."""
    ball = Problem(lambda x: (x**2).sum(axis=1), [-4.0, -4.0], [4.0, 4.0])
    found = minimize(ranking(ball, outside_disc, 32.0), name, seed=1, budget=8000, size=40)
    corner = 1.5 - 0.5 / np.sqrt(2)
    assert np.abs(found.x - corner).max() < 1e-3
    assert found.cost == pytest.approx(2 * corner**2, rel=1e-4)


def test_discarding_blinds_where_ranking_does_not():
    """A limit that one point in 300 000 keeps: no first swarm holds one, and all discarded are equal."""

    def violation(x):
        return np.abs(x - 0.7).max(axis=1) - 0.003

    bowl = Problem(lambda x: ((x - 0.7) ** 2).sum(axis=1), [-1.0] * 3, [1.0] * 3)
    kept = {"discarding": 0, "ranking": 0}
    for seed in range(10):
        for name, problem in (
            ("discarding", discarding(bowl, violation)),
            ("ranking", ranking(bowl, violation, 10.0)),
        ):
            found = minimize(problem, "mpso", seed=seed, budget=1500, size=30)
            kept[name] += bool(np.isfinite(found.cost) and violation(found.x[None])[0] <= 0)
    assert kept["ranking"] == 10
    assert kept["discarding"] < 5


points = st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=2, max_size=20)


@given(points)
def test_ranks_are_debs(rows):
    """What keeps the limit goes first, then by cost; the rest by violation."""
    x = np.array(rows)
    ball = Problem(lambda x: (x**2).sum(axis=1), [-4.0, -4.0], [4.0, 4.0])
    cost = ranking(ball, outside_disc, 32.0).cost(x)
    plain, broken = ball.cost(x), outside_disc(x)
    for i in range(len(x)):
        for j in range(len(x)):
            if broken[i] <= 0 < broken[j]:
                assert cost[i] < cost[j]
            elif broken[i] <= 0 and broken[j] <= 0:
                assert (cost[i] < cost[j]) == (plain[i] < plain[j])
            elif broken[i] > broken[j] + 1e-9 > 1e-9:
                assert cost[i] > cost[j]


def test_a_violation_of_the_wrong_shape_is_refused():
    ball = Problem(lambda x: (x**2).sum(axis=1), [-4.0, -4.0], [4.0, 4.0])
    with pytest.raises(ValueError, match="violation of limits must be a function that returns shape"):
        minimize(discarding(ball, lambda x: x), seed=1)
    with pytest.raises(ValueError, match="worst of ranking must be finite"):
        ranking(ball, outside_disc, np.inf)


def test_limits_drop_derivatives_that_no_longer_hold():
    limited = discarding(SPHERE.problem(derivatives=True, expression=True), lambda x: x[:, 0])
    assert limited.derivatives is None
    assert limited.expression is None
