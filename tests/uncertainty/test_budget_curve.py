"""Budgets of a machine that follows a curve: Eq. (15) of the article on its Table 2."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from hallsym.errors import InputError
from hallsym.trajectory import Curve, choose_curve
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


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (lambda: with_curve(Budget("p", "rad", (Source.normal("a", 1.0, "rad"),)), cycloid()), "is in rad"),
        (lambda: with_curve(with_curve(read_budget(TABLE2)[0], cycloid()), cycloid()), "already"),
        (lambda: with_curve(read_budget(TABLE2)[0], replace(cycloid(), max_error_m=None)), "does not state"),
    ],
)
def test_what_has_no_budget_is_one_sentence(act, sentence):
    with pytest.raises(InputError, match=sentence):
        act()
