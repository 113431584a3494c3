"""What every global method must do, whichever it is: SOLVERS x problems, budget, bounds, endings."""

import ast
import doctest
import importlib
import pkgutil
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from solver_problems import GLOBAL, SPHERE

import solvers
from solvers import SOLVERS, Problem, minimize

NAMES = tuple(solver.__name__ for solver in SOLVERS)
each_solver = pytest.mark.parametrize("name", NAMES)


@each_solver
@pytest.mark.parametrize("known", GLOBAL, ids=lambda known: known.name)
def test_finds_the_global_optimum(name, known):
    """To a millionth of a typical cost: 8000 random points alone reach 8000^(-2/dim), 1e-4 at best."""
    problem = known.problem()
    result = minimize(problem, name, seed=3, size=40, budget=8000)
    sample = np.random.default_rng(0).uniform(problem.lower, problem.upper, (999, problem.dim))
    assert result.cost - known.cost <= 1e-6 * (np.median(problem.cost(sample)) - known.cost)
    assert result.cost == problem.cost(result.x[None, :])[0] == result.population.cost.min() <= result.first


@each_solver
def test_same_seed_same_bits(name):
    first, again, other = (minimize(SPHERE.problem(), name, seed=seed, budget=900) for seed in (5, 5, 6))
    assert np.array_equal(first.x, again.x)
    assert np.array_equal(first.population.x, again.population.x)
    assert not np.array_equal(first.x, other.x)


@each_solver
@pytest.mark.parametrize("budget", [2, 7, 100, 299, 301])
def test_budget_and_bounds_hold_for_every_row_evaluated(name, budget):
    seen = []
    lower, upper = np.array([-1.0, 2.0, 0.0]), np.array([0.5, 2.0, 1e-9])

    def cost(x):
        seen.append(x.copy())
        return x.sum(axis=1)  # the optimum is a corner: candidates are pushed outside

    result = minimize(Problem(cost, lower, upper), name, seed=0, budget=budget)
    rows = np.concatenate(seen)
    assert len(rows) == result.evaluations <= budget
    assert (lower <= rows).all()
    assert (rows <= upper).all()
    if result.status == "budget":
        assert result.evaluations == budget


@each_solver
def test_only_strictly_better_replaces(name):
    """On a plateau nothing is better than anything, so the first population stays."""
    plateau = Problem(lambda x: np.zeros(len(x)), [-1.0] * 3, [1.0] * 3)
    first, last = (minimize(plateau, name, seed=2, budget=budget).population.x for budget in (100, 900))
    assert np.array_equal(first, last)


@each_solver
@pytest.mark.parametrize("at", [1, 2, 6])
def test_interruption_returns_the_best_so_far(name, at):
    costs = []

    def cost(x):
        if len(costs) == at:
            raise KeyboardInterrupt
        costs.append(SPHERE.cost_of(x))
        return costs[-1]

    result = minimize(Problem(cost, SPHERE.lower, SPHERE.upper), name, seed=4, budget=5000)
    assert result.status == "interrupted"
    assert result.cost == np.concatenate(costs).min() == SPHERE.cost_of(result.x[None, :])[0]
    assert result.evaluations == sum(map(len, costs))


def test_interruption_before_anything_was_evaluated():
    def stop(x):
        raise KeyboardInterrupt

    nothing = minimize(Problem(stop, [0.0], [4.0]), seed=0)
    assert (nothing.status, nothing.cost, nothing.x[0]) == ("interrupted", np.inf, 2.0)


@each_solver
def test_nan_and_infinite_costs_count_as_worst(name):
    """Half of the box is nan, a quarter -inf: the optimum of the rest is found."""

    def cost(x):
        value = (x[:, 0] - 1.0) ** 2 + x[:, 1] ** 2
        return np.where(x[:, 0] < 0, np.nan, np.where(x[:, 1] < -0.5, -np.inf, value))

    result = minimize(Problem(cost, [-2.0, -1.0], [2.0, 1.0]), name, seed=0, size=20, budget=4000)
    assert result.x == pytest.approx([1.0, 0.0], abs=1e-2)
    assert np.isfinite(result.population.cost[np.argmin(result.population.cost)])


@each_solver
def test_no_finite_cost_is_a_failure_with_a_remedy(name):
    result = minimize(Problem(lambda x: np.full(len(x), np.nan), [0.0], [1.0]), name, seed=0, budget=500)
    assert (result.status, result.cost) == ("failed", np.inf)
    assert "check the cost" in result.message


@each_solver
def test_fixed_variables(name):
    target = Problem(lambda x: (x**2).sum(axis=1), [-1.0, 0.3, -1.0], [2.0, 0.3, 2.0])
    result = minimize(target, name, seed=0, size=20, budget=4000)
    assert result.x[1] == 0.3
    assert result.cost == pytest.approx(0.09, abs=1e-4)


def test_start_takes_part_and_is_clipped():
    result = minimize(SPHERE.problem(), seed=0, budget=100, start=[SPHERE.x, [99.0] * 5])
    assert result.cost == 0.0
    assert np.array_equal(result.population.x[1], [5.0] * 5)


def test_stops_when_collapsed_and_the_default_budget_is_the_papers():
    collapsed = minimize(SPHERE.problem(), seed=0, size=10)
    assert collapsed.status == "converged"
    assert np.ptp(collapsed.population.x, axis=0).max() <= 1e-9
    result = minimize(SPHERE.problem(), "shtlbo", seed=0)
    assert result.evaluations == 100 + 2 * 100 * 100


MISUSE = {
    "unknown solver": (
        lambda p: minimize(p, "tblo", seed=0),
        "one of tlbo, gbtlbo, shtlbo; .* 'tblo'",
    ),
    "budget": (lambda p: minimize(p, seed=0, budget=1), "Input budget of minimize must be at least 2"),
    "size": (lambda p: minimize(p, seed=0, size=1), "Input size of minimize must be at least 2"),
    "start shape": (lambda p: minimize(p, seed=0, start=[1.0, 2.0]), r"finite, of shape \(n, 5\)"),
    "start rows": (lambda p: minimize(p, seed=0, size=2, start=np.zeros((3, 5))), "at most 2 rows"),
    "infinite box": (lambda p: minimize(Problem(p.cost, [-np.inf], [1]), seed=0), "Input lower of Problem"),
    "box too wide": (
        lambda p: minimize(Problem(p.cost, [-1e308], [1e308]), seed=0),
        "Input width of Problem",
    ),
    "cost shape": (lambda p: minimize(Problem(lambda x: x, [0.0], [1.0]), seed=0), r"shape \(100,\)"),
    "crossed": (
        lambda p: Problem(p.cost, [0.0, 2.0], [1.0, 1.0]),
        r"lower\[1\] of Problem .* upper\[1\] = 1",
    ),
    "lengths": (lambda p: Problem(p.cost, [0.0], [1.0, 1.0]), "as long as lower, 1; instead received 2"),
    "nan bound": (lambda p: Problem(p.cost, [np.nan], [1.0]), "free of nan"),
    "empty": (lambda p: Problem(p.cost, [], []), "not empty"),
}


@pytest.mark.parametrize("case", MISUSE)
def test_misuse_says_what_is_wrong(case):
    call, message = MISUSE[case]
    with pytest.raises(ValueError, match=message) as caught:
        call(SPHERE.problem())
    assert str(caught.value).startswith("Input ")
    assert "; instead received " in str(caught.value)


BOX = st.tuples(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))


def test_imports_only_numpy_casadi_and_the_standard_library():
    allowed = {"numpy", "casadi", "solvers", *sys.stdlib_module_names}
    files = sorted(Path(solvers.__file__).parent.rglob("*.py"))
    assert len(files) > 5
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0
                names = [node.module]
            assert {name.split(".")[0] for name in names} <= allowed, file.name


@pytest.mark.parametrize("module", [m.name for m in pkgutil.iter_modules(solvers.__path__)])
def test_examples_in_docstrings(module):
    assert doctest.testmod(importlib.import_module(f"solvers.{module}")).failed == 0
