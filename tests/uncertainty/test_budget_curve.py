"""Budgets of a machine that follows a curve: Eq. (15) in a budget file, along a path of a calibration."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from twins import record, with_noise

from hallsym.errors import InputError
from hallsym.estimation import Fit, fit
from hallsym.trajectory import Curve, choose_curve, curve_cost, points_of
from hallsym.uncertainty import (
    Budget,
    Settings,
    Source,
    along_curve,
    position_budget,
    read_budget,
    uncertainty_map,
    with_curve,
)

TABLE2 = Path(__file__).parents[2] / "data" / "micromachines2019" / "table2_budget.toml"
USE = Settings(
    averaged=400, zero_averaged=500, zero_pose_std={"x_m": 2e-8, "y_m": 2e-8}, scale_std={"x_m": 2e-4}
)
TEXT = "x = r*(t - sin(t)); y = r*(1 - cos(t))"


@cache
def calibration() -> Fit:
    return fit(with_noise(record(seed=1)), "stage31", solver="direct", loss="none")


@cache
def cycloid(points: int = 11, radius: float = 1e-3) -> Curve:
    how = {"span": "t=0:2*pi", "values": {"r": radius}, "method": "bernstein", "nodes": "equidistant"}
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
    cost = curve_cost(choose_curve(points_of(1e-3 * np.column_stack([t, np.sin(t)]))).curve, 5e-7)
    assert (cost.rows, cost.enough) == ((), None)
    assert cost.total_m > cost.machine_m


def test_along_a_curve_the_uncertainty_is_that_of_a_budget_at_each_place_and_of_the_map():
    found = calibration()
    curve = cycloid(9, 5e-5)
    along = along_curve(found, curve, {"z_m": 2e-4}, USE, places=51)
    for k in (0, 17, 50):
        budgets = position_budget(found, along.position(k), USE)
        for row, column in enumerate(along.pose):
            alone, joined = budgets[column], budgets[column]
            if column in curve.coordinates:
                joined = with_curve(alone, curve, column)
            assert along.machine[row, k] == pytest.approx(alone.expanded, rel=1e-9)
            assert along.total[row, k] == pytest.approx(joined.expanded, rel=1e-9)
    spot = along.position(17)
    axes = {c: [spot[c] - 1e-6, spot[c], spot[c] + 1e-6] for c in ("x_m", "y_m", "z_m")}
    whole = uncertainty_map(found, axes, USE)
    assert along.machine[:, 17] == pytest.approx(whole.expanded[:, 1, 1, 1], rel=1e-9)


def test_the_worst_part_of_a_path_is_where_the_machine_is_worst():
    along = along_curve(calibration(), cycloid(9, 5e-5), {"z_m": 2e-4}, USE)
    assert along.worst("x_m") > 0.95 * len(along.parameter)  # farthest from the zeroing
    first, last = along.worst_part("x_m")
    assert 2e-4 < first < last == pytest.approx(8 * 5e-5, rel=1e-2)
    assert along.to_dict()["worst"]["x_m"]["at"]["x_m"] == pytest.approx(2 * np.pi * 5e-5, rel=1e-3)
    still = along_curve(calibration(), cycloid(9, 1e-9), settings=Settings())
    assert still.worst_part("x_m") is None  # alike everywhere


def test_a_level_and_correlated_sources_take_the_curve_too():
    found, curve = calibration(), cycloid(9, 5e-5)
    settings = replace(USE, level=0.95, coverage=2.0)
    along = along_curve(found, curve, None, settings, places=5)
    joined = with_curve(position_budget(found, along.position(4), settings, split=True)["x_m"], curve, "x_m")
    assert along.total[0, 4] == pytest.approx(joined.expanded, rel=1e-6)


def test_an_angle_of_a_curve_has_its_own_error():
    text = "x = r*t; y = 0*t; rz = 1e-3*sin(3*t)"
    curve = choose_curve(text, points=8, span="t=0:1", values={"r": 1e-4}, method="bernstein").curve
    along = along_curve(calibration(), curve, None, USE)
    assert along.error["rz_rad"] == pytest.approx(curve.source["max_error_rad"])
    assert 0 < along.error["rz_rad"] < 1e-6
    assert along.error["x_m"] < 1e-15


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (lambda: with_curve(Budget("p", "rad", (Source.normal("a", 1.0, "rad"),)), cycloid()), "is in rad"),
        (lambda: with_curve(with_curve(read_budget(TABLE2)[0], cycloid()), cycloid()), "already"),
        (lambda: curve_cost(replace(cycloid(), max_error_m=None), 1e-7), "does not state its error"),
        (
            lambda: along_curve(calibration(), replace(cycloid(), max_error_m=None)),
            "does not state its error",
        ),
        (lambda: along_curve(calibration(), cycloid(), {"x_m": 1e-4}), "the curve moves it"),
        (
            lambda: along_curve(calibration(), replace(cycloid(), coordinates=("x_m", "angle_rad"))),
            "moves angle_rad, which",
        ),
    ],
)
def test_what_has_no_budget_is_one_sentence(act, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        act()
    assert "\n" not in str(caught.value)
