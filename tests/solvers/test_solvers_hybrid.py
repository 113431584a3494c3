"""Explore, then refine: the best of both, and how many starts got there."""

import numpy as np
import pytest
from solver_problems import GLOBAL, ROSENBROCK, SPHERE, _known

from solvers import EXPLORERS, SOLVERS, Problem, hybrid, newton

# Two valleys: the broad one is shallow (cost 2 at x = -2), the narrow one deep (1 at x = 2).
TWO = _known(
    "two valleys",
    2,
    lambda x: 1 + x[1] ** 2 + (x[0] - 2) ** 2 * ((x[0] + 2) ** 2 + 1 / 16),
    [-4.0, -4.0],
    [4.0, 4.0],
    [2.0, 0.0],
    1.0,
    [0.0, 0.0],
)


@pytest.mark.parametrize("explorer", EXPLORERS)
@pytest.mark.parametrize("known", GLOBAL, ids=lambda known: known.name)
def test_refined_to_the_digits_of_the_local_method(explorer, known):
    problem = known.problem()
    result = hybrid(problem, seed=0, global_solver=explorer, budget=600)
    assert result.status == "converged", result.message
    assert result.x == pytest.approx(known.x, rel=1e-4, abs=1e-4)
    assert result.cost <= result.explored.cost
    assert result.evaluations == result.explored.evaluations + sum(part.evaluations for part in result.local)
    assert result.cost <= result.first


def test_share_counts_the_starts_that_reached_the_best():
    starts = [[2.5, 1.0], [1.8, -1.0], [-2.4, 0.0], [-2.1, 0.3]]
    problem, alone = TWO.problem(), {"seed": 0, "budget": 4, "keep": 0}
    result = hybrid(problem, starts=starts, **alone)
    assert [part.x[0] > 0 for part in result.local] == [True, True, False, False]
    assert result.share == 0.5
    assert result.x == pytest.approx([2.0, 0.0], abs=1e-6)
    assert hybrid(problem, starts=starts[:2], **alone).share == 1.0
    assert hybrid(problem, starts=starts[1:], **alone).share == pytest.approx(1 / 3)


def test_ipopt_begins_anew_where_newtons_method_ends_above_the_best():
    starts, problem = [[2.5, 1.0], [-2.4, 0.0]], TWO.problem()
    result = hybrid(problem, seed=0, budget=4, keep=0, starts=starts)
    assert result.local[0].evaluations == newton(problem, starts[0]).evaluations
    assert result.local[1].evaluations > newton(problem, starts[1]).evaluations


@pytest.mark.parametrize(("keep", "valleys"), [(1, {1.0}), (30, {-1.0, 1.0})])
def test_as_many_separated_starts_are_refined_as_are_kept(keep, valleys):
    found = hybrid(TWO.problem(), seed=0, global_solver="screening", budget=300, keep=keep)
    assert len(found.local) == keep
    assert {np.sign(part.x[0]) for part in found.local} == valleys


def test_starts_of_the_user_join_the_search_and_are_refined_first():
    problem = ROSENBROCK.problem()
    result = hybrid(problem, seed=0, starts=[[1.0, 1.0], [9.0, 9.0]], budget=200, size=20)
    assert result.explored.cost == 0.0
    assert result.local[0].x == pytest.approx([1.0, 1.0])
    assert "clipped" in result.local[1].message
    assert len(result.local) >= 3


@pytest.mark.parametrize(("cost_at", "derivatives_at"), [(1, 99), (3, 99), (99, 1), (99, 12)])
def test_interruption_at_any_stage_returns_the_best_so_far(cost_at, derivatives_at):
    inner, costs, slopes = ROSENBROCK.problem().derivatives, [], []

    def cost(x):
        costs.append(x)
        if len(costs) == cost_at:
            raise KeyboardInterrupt
        return ROSENBROCK.cost_of(x)

    def derivatives(x):
        slopes.append(x)
        if len(slopes) == derivatives_at:
            raise KeyboardInterrupt
        return inner(x)

    problem = Problem(cost, ROSENBROCK.lower, ROSENBROCK.upper, derivatives)
    result = hybrid(problem, seed=0, starts=[ROSENBROCK.start] * 2, budget=300)
    assert result.status == "interrupted"
    assert result.cost == min(part.cost for part in (result.explored, *result.local))


def test_nothing_finite_is_a_failure():
    def derivatives(x):
        return np.nan, x, np.eye(1)

    problem = Problem(lambda x: np.full(len(x), np.nan), [0.0], [1.0], derivatives)
    result = hybrid(problem, seed=0, budget=300)
    assert (result.status, result.share, result.local) == ("failed", 0.0, ())


def test_misuse():
    problem = SPHERE.problem()
    names = ", ".join(solver.__name__ for solver in SOLVERS)
    with pytest.raises(ValueError, match=f"one of {names}, screening; instead received 'de'"):
        hybrid(problem, seed=0, global_solver="de")
    with pytest.raises(ValueError, match="Input derivatives of Problem"):
        hybrid(Problem(SPHERE.cost_of, SPHERE.lower, SPHERE.upper), seed=0)
