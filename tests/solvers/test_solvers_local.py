"""IPOPT and Newton: the same contract for both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nist import sets
from solver_problems import LOCAL, ROSENBROCK, SPHERE

from solvers import Problem, ipopt, newton

METHODS = (ipopt, newton)
each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)


@each_method
@pytest.mark.parametrize("known", LOCAL, ids=lambda known: known.name)
def test_known_optima(method, known):
    """IPOPT's tolerance 1e-8 bounds the slope in units of cost and slope at the start (HS3: slope 1e-5)."""
    problem = known.problem()
    result = method(problem, known.start, tolerance=1e-12)
    assert result.status == "converged", result.message
    assert result.cost == pytest.approx(known.cost, rel=1e-10, abs=1e-7)
    assert result.x == pytest.approx(known.x, rel=1e-6, abs=2e-3 if known.name == "hs3" else 1e-5)
    assert (problem.lower <= result.x).all()
    assert (result.x <= problem.upper).all()
    again = method(problem, result.x, tolerance=1e-12)
    assert again.status == "converged", again.message
    assert again.cost <= result.cost


@each_method
@given(st.lists(st.floats(-9.0, 9.0), min_size=2, max_size=2), st.integers(1, 6))
def test_never_worse_than_the_clipped_start(method, x0, iterations):
    problem = ROSENBROCK.problem()
    result = method(problem, x0, max_iterations=iterations)
    clipped = np.clip(x0, problem.lower, problem.upper)
    assert result.cost <= problem.second_order(clipped)[0]
    assert result.cost == problem.second_order(result.x)[0]


@each_method
def test_a_start_outside_is_clipped(method):
    result = method(SPHERE.problem(), [99.0] * 5)
    assert result.status == "converged"
    assert result.first == SPHERE.cost_of(np.full((1, 5), 5.0))[0]
    assert "clipped" in result.message
    assert "clipped" not in method(SPHERE.problem(), [4.0] * 5).message


@each_method
@pytest.mark.parametrize("fixed", [[0], [1], [0, 3, 4], [0, 1, 2, 3, 4]])
def test_fixed_variables(method, fixed):
    lower, upper = np.array(SPHERE.lower), np.array(SPHERE.upper)
    lower[fixed] = upper[fixed] = 0.125
    full = SPHERE.problem()
    result = method(Problem(full.cost, lower, upper, full.derivatives), [4.0] * 5)
    optimum = np.array(SPHERE.x)
    optimum[fixed] = 0.125
    assert result.status == "converged", result.message
    assert (result.x[fixed] == 0.125).all()
    assert result.x == pytest.approx(optimum, abs=1e-6)


@each_method
@pytest.mark.parametrize("factor", [1e-24, 1e-12, 1.0, 1e12])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e3])
def test_units_do_not_matter(method, factor, unit):
    """A cost of square metres at the micrometre is not taken for solved; nor do units of variables matter."""
    inner = ROSENBROCK.problem().second_order

    def derivatives(x):
        f, gradient, hessian = inner(x / unit)
        return factor * (f + 1.0), factor * gradient / unit, factor * hessian / unit**2

    box = unit * np.array([[-2.0, -2.0], [2.0, 2.0]])
    result = method(Problem(lambda x: x[:, 0], *box, derivatives=derivatives), unit * np.array([-1.2, 1.0]))
    assert result.status == "converged", result.message
    assert result.x / unit == pytest.approx([1.0, 1.0], abs=1e-4)


@each_method
def test_out_of_iterations(method):
    result = method(ROSENBROCK.problem(), ROSENBROCK.start, max_iterations=3)
    assert result.status == "budget"
    assert "max_iterations" in result.message


def counted(known, fail_at=None, error=None):
    """Derivatives that count their calls, and at one of them misbehave."""
    inner, calls = known.problem().second_order, []

    def derivatives(x):
        calls.append(x.copy())
        if len(calls) == fail_at:
            if error is None:
                return np.nan, np.full(len(x), np.nan), np.full((len(x), len(x)), np.nan)
            raise error
        return inner(x)

    return Problem(known.cost_of, known.lower, known.upper, derivatives), calls


@each_method
@pytest.mark.parametrize("at", [1, 2, 5])
def test_interruption_returns_the_best_so_far(method, at):
    problem, calls = counted(ROSENBROCK, at, KeyboardInterrupt())
    result = method(problem, ROSENBROCK.start)
    assert result.status == "interrupted"
    assert len(calls) == at
    finished = [ROSENBROCK.cost_of(x[None, :])[0] for x in calls[:-1]]
    assert result.cost == pytest.approx(min(finished, default=np.inf), rel=1e-12)


@each_method
@pytest.mark.parametrize("at", [1, 4])
def test_an_error_in_the_derivatives_comes_out(method, at):
    problem, calls = counted(ROSENBROCK, at, ZeroDivisionError("mine"))
    with pytest.raises(ZeroDivisionError, match="mine"):
        method(problem, ROSENBROCK.start)
    assert len(calls) == at


@each_method
def test_nan_at_the_start_is_a_failure_and_later_an_obstacle(method):
    problem, _ = counted(ROSENBROCK, 1)
    assert method(problem, ROSENBROCK.start).status == "failed"
    assert method(problem, ROSENBROCK.start).status == "converged"
    problem, _ = counted(ROSENBROCK, 4)
    assert method(problem, ROSENBROCK.start).cost < ROSENBROCK.cost_of(np.array([ROSENBROCK.start]))[0]


@each_method
def test_nothing_is_printed_even_by_bad_derivatives(method, capfd):
    for at in (1, 3):
        method(counted(ROSENBROCK, at)[0], ROSENBROCK.start)
    assert capfd.readouterr() == ("", "")


@each_method
def test_each_point_costs_one_call_of_the_derivatives(method):
    problem, calls = counted(ROSENBROCK)
    result = method(problem, ROSENBROCK.start)
    repeats = len(calls) - len({x.tobytes() for x in calls})
    assert repeats <= 1  # IPOPT's last point, evaluated again without the relaxed bounds
    assert result.evaluations == pytest.approx(len(calls), abs=2)


@each_method
def test_derivatives_of_another_cost_are_found_out(method):
    """The gradient has the wrong sign: no step can improve."""

    def wrong(x):
        return float(x @ x), -2.0 * x, 2.0 * np.eye(2)

    result = method(Problem(lambda x: x[:, 0], [-5.0] * 2, [5.0] * 2, wrong), [2.0, 1.0])
    assert result.status == "failed"
    assert result.x.tolist() == [2.0, 1.0]


@each_method
def test_misuse(method):
    bare = Problem(lambda x: x[:, 0], [0.0], [1.0])
    with pytest.raises(ValueError, match="Input derivatives of Problem must be given"):
        method(bare, [0.5])
    for x0 in ([0.5, 0.5], [np.nan], [[0.5]]):
        with pytest.raises(
            ValueError, match=rf"Input x0 of {method.__name__} must be finite, of shape \(1,\)"
        ):
            method(Problem(lambda x: x[:, 0], [0.0], [1.0], lambda x: (x[0], x, np.eye(1))), x0)


@pytest.mark.parametrize("name", ["BoxBOD", "Eckerle4"])
def test_a_flat_stretch_that_satisfies_ipopt_is_found_out(name):
    """From NIST's first start IPOPT is satisfied where the squares are 8 and 480 times the certified ones."""
    known = sets()[name]
    result = ipopt(known.problem(known.starts[0]), np.ones(len(known.values)), max_iterations=3000)
    assert "Solve_Succeeded" in result.message
    assert result.status == "converged"
    assert result.cost == pytest.approx(known.rss, rel=1e-8)


def test_a_saddle_is_no_optimum():
    """Where the slope of one variable is nil by symmetry, no method moves it."""

    def derivatives(x):
        f = x[0] ** 2 - x[1] ** 2 + x[1] ** 4
        return f, np.array([2 * x[0], -2 * x[1] + 4 * x[1] ** 3]), np.diag([2.0, 12 * x[1] ** 2 - 2.0])

    for method in METHODS:
        result = method(Problem(lambda x: x[:, 0], [-2.0] * 2, [2.0] * 2, derivatives), [1.0, 0.0])
        assert result.status == "failed" or result.cost == pytest.approx(-0.25), method
        assert result.status == "converged" or "saddle" in result.message


def test_newton_is_quadratic():
    """Digits double: once within .1 of the optimum, 5 more steps reach rounding."""

    def derivatives(x):
        return float((np.exp(x) - 2.0 * x).sum()), np.exp(x) - 2.0, np.diag(np.exp(x))

    problem = Problem(lambda x: x[:, 0], [-9.0] * 2, [9.0] * 2, derivatives)
    result = newton(problem, [np.log(2.0) + 0.1, np.log(2.0) - 0.1])
    assert result.x == pytest.approx([np.log(2.0)] * 2, abs=1e-9)
    assert result.evaluations <= 5


@pytest.mark.parametrize("start", [[0.1, 0.2], [-0.1, 3.0], [1e-9, -1e-9]])
def test_newton_leaves_negative_curvature(start):
    """x^4/4 - x^2/2 in each variable: a maximum at 0, minima of -1/4 at +-1."""

    def derivatives(x):
        return float((x**4 / 4 - x**2 / 2).sum()), x**3 - x, np.diag(3 * x**2 - 1)

    problem = Problem(lambda x: x[:, 0], [-5.0] * 2, [5.0] * 2, derivatives)
    result = newton(problem, start, tolerance=1e-14)
    assert result.status == "converged"
    assert np.abs(result.x) == pytest.approx([1.0, 1.0], abs=1e-6)


def test_ipopt_options_reach_ipopt():
    result = ipopt(ROSENBROCK.problem(), ROSENBROCK.start, max_wall_time=1e-9)
    assert "Maximum_WallTime_Exceeded" in result.message
    with pytest.raises(RuntimeError, match="no_such_option"):
        ipopt(ROSENBROCK.problem(), ROSENBROCK.start, no_such_option=1)
