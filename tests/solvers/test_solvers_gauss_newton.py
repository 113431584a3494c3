"""Gauss-Newton: the loop alone; the caller linearises."""

from dataclasses import dataclass

import numpy as np
import pytest

from solvers import gauss_newton

HUGE = float("inf")


@dataclass(frozen=True)
class Curve:
    """Least squares of `y - exp(x t)` at x, linearised there."""

    x: float

    @property
    def residual(self) -> np.ndarray:
        return np.exp(0.7 * np.arange(4.0)) - np.exp(self.x * np.arange(4.0))

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)

    def moved(self, share: float) -> float:
        slope = np.arange(4.0) * np.exp(self.x * np.arange(4.0))
        return self.x + share * float(slope @ self.residual) / float(slope @ slope)


def test_it_ends_at_the_optimum_and_counts_no_step_that_raised_the_cost():
    asked = []

    def linearise(x: float) -> Curve:
        asked.append(x)
        return Curve(x)

    best, outcome = gauss_newton(linearise, -1.0, lambda now, gained: gained < 1e-20, most=50)
    assert outcome == "converged"
    assert best.x == pytest.approx(0.7, abs=1e-12)
    assert any(Curve(x).cost > Curve(-1.0).cost for x in asked)  # the first full step overshoots


def test_the_first_point_is_judged_before_any_step():
    gains = []
    gauss_newton(Curve, 0.7, lambda now, gained: gains.append(gained) or True, most=5)
    assert gains == [HUGE]


def test_a_budget_that_is_spent_returns_the_best_so_far():
    best, outcome = gauss_newton(Curve, 0.0, lambda now, gained: False, most=3)
    assert outcome == "budget"
    assert best.cost < Curve(0.0).cost


def test_no_step_that_lowers_the_cost_is_said():
    class Uphill(Curve):
        def moved(self, share: float) -> float:
            return self.x - share

    best, outcome = gauss_newton(Uphill, 0.5, lambda now, gained: False, most=50)
    assert (best.x, outcome) == (0.5, "stuck")
