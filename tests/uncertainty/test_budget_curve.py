"""Budgets of a machine that follows a curve: Eq. (15) of the article on its Table 2."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hallsym.errors import InputError
from hallsym.trajectory import Curve, choose_curve, curve_cost, points_of
from hallsym.uncertainty import Budget, Source, read_budget, with_curve

TABLE2 = Path(__file__).parents[2] / "data" / "micromachines2019" / "table2_budget.toml"
TEXT = "x = r*(t - sin(t)); y = r*(1 - cos(t))"


@cache
def cycloid(points: int = 11, radius: float = 1e-3) -> Curve:
    how = {"span": "t=0:2*pi", "values": {"r": radius}, "method": "bernstein"}
    return choose_curve(TEXT, points=points, **how).curve


def test_table_2_with_the_curve():
    budget, _ = read_budget(TABLE2)
    assert 1e9 * budget.expanded == pytest.approx(500.94, abs=0.005)
    fifty = replace(cycloid(), max_error_m=50e-9)
    assert 1e9 * (with_curve(budget, fifty).expanded - budget.expanded) == pytest.approx(9.9, abs=0.05)
    joined = with_curve(budget, cycloid(11))
    assert 1e9 * joined.expanded == pytest.approx(512.2, abs=0.05)  # .0533 um, Table 3
    assert joined.sources[-1].name == "curve"


def test_how_many_control_points_are_worth_having():
    budget, _ = read_budget(TABLE2)
    cost = curve_cost(cycloid(11), budget.expanded)
    assert cost.growth_m == pytest.approx(11.2e-9, abs=0.1e-9)
    assert cost.enough is not None
    assert cost.enough.control_points == 12
    gains = [row.gain_m for row in cost.rows[1:]]
    assert gains == sorted(gains, reverse=True)
    assert [row.control_points for row in cost.rows] == list(range(6, 14))
    assert cost.allowed_m == pytest.approx(50.3e-9, abs=0.1e-9)
    assert cost.to_dict()["enough_control_points"] == 12


def test_least_squares_counts_its_control_points():
    how = {"span": "t=0:2*pi", "values": {"r": 1e-3}, "method": "bernstein-ls"}
    cost = curve_cost(choose_curve(TEXT, 5e-8, **how).curve, 500.94e-9)
    assert cost.enough is not None
    assert cost.enough.control_points == cost.curve.control_points == 11


def test_of_a_curve_through_points_other_numbers_of_points_are_not_known():
    t = np.linspace(0, 2, 40)
    points = points_of(1e-3 * np.column_stack([t, np.sin(t)]))
    cost = curve_cost(choose_curve(points, method="bernstein-ls", control=4).curve, 5e-7)
    assert (cost.rows, cost.enough) == ((), None)
    assert cost.total_m > cost.machine_m


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (lambda: with_curve(Budget("p", "rad", (Source.normal("a", 1.0, "rad"),)), cycloid()), "is in rad"),
        (lambda: with_curve(with_curve(read_budget(TABLE2)[0], cycloid()), cycloid()), "already"),
        (lambda: curve_cost(replace(cycloid(), max_error_m=None), 1e-7), "does not state its error"),
    ],
)
def test_what_has_no_budget_is_one_sentence(act, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        act()
    assert "\n" not in str(caught.value)
