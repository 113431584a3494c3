"""The published tables hold the article's digits, and those digits agree with the model they belong to.

The literals here stand in the units of Sensors 2016, 16(6), 872 and were typed apart from the files.
Equivalence: a rigid stage ties b/a and c/a to where the probes are (signs and units of a, b, c, H).
"""

import math

import pytest

from hallsym.errors import InputError
from hallsym.families.published import bounds, table, values

VERTICAL = [f"{letter}_{sensor}" for sensor in "ABC" for letter in "abc"]
LENGTHS = ["H1x", "H2x", "H3y", "H3x", "H1y", "H2y"]
GAINS = ["eta_A", "eta_B", "eta_C"]
ANGLES = ["theta_A", "theta_B", "theta_C"]


def records(name: str, *columns: str) -> list[tuple]:
    return list(zip(*(table(name)[column] for column in columns), strict=True))


# The article's digits.


def test_table_1_is_the_design():
    design = values("table1_designed")
    assert [design[name] for name in LENGTHS] == [0.1975, 0.1975, 0.36, 0.1975, 0.4, 0.42]
    assert {design[name] for name in GAINS} == {1.0}
    assert {design[name] for name in ANGLES} == {0.0}
    assert len(design) == 12


def test_tables_3_and_5_are_the_bounds():
    limits = bounds()
    assert [limits[name] for name in LENGTHS] == [
        (0.1475, 0.2475),
        (0.1475, 0.2475),
        (0.26, 0.46),
        (0.1475, 0.2475),
        (0.3, 0.5),
        (0.32, 0.52),
    ]
    assert [limits[name] for name in GAINS] == [(0.78, 0.98), (0.65, 0.85), (0.72, 0.92)]
    assert {limits[name] for name in ANGLES} == {(-math.radians(8), math.radians(8))}
    assert {name for name in VERTICAL if limits[name] == (0, 5000)} == {"c_A", "c_C"}
    assert {limits[name] for name in VERTICAL if name not in ("c_A", "c_C")} == {(-5000, 0)}
    assert len(limits) == 21


def test_table_7_is_the_estimate():
    estimate = values("table7_estimates")
    assert [estimate[name] for name in LENGTHS] == [0.1944, 0.2173, 0.3293, 0.1979, 0.3381, 0.3555]
    assert [estimate[name] for name in VERTICAL] == [
        *(-188.1873, -69.7432, 14.8664),
        *(-156.5783, -56.7511, -55.0764),
        *(-178.1902, -63.4133, 12.7241),
    ]
    assert [estimate[name] for name in GAINS] == [0.8671, 0.7049, 0.8632]
    assert [estimate[name] for name in ANGLES] == [math.radians(deg) for deg in (0.0145, 0.4143, -0.0561)]
    assert len(estimate) == 21


def test_table_a1_has_every_run_once():
    runs = records("tableA1_zero_deviations", "setting", "axis")
    assert sorted(runs) == sorted((setting, axis) for setting in range(1, 20) for axis in ("x", "y", "rz"))
    assert [axis for _, axis in runs] == ["y", "x", "rz"] * 19
    assert [setting for setting, _ in runs[::3]] == [
        1,
        *(n for pair in range(2, 20, 2) for n in (pair + 1, pair)),
    ]


def test_table_a1_sums():
    """Sums of the printed columns, in um with two decimals: one wrong digit or sign anywhere shows."""
    columns = [table("tableA1_zero_deviations")[f"delta_{sensor}_m"] for sensor in "abc"]
    assert [round(math.fsum(column) * 1e6, 2) for column in columns] == [27.34, 35.67, 8.10]
    rms = [math.sqrt(math.fsum(delta**2 for delta in column) / 57) * 1e6 for column in columns]
    assert [round(value, 3) for value in rms] == [1.078, 1.006, 1.428]


# What the digits say together.


@pytest.mark.parametrize(
    ("sensor", "x0", "y0"), [("A", 0.115, -0.03), ("B", 0.134, -0.01), ("C", 0.126, -0.03)]
)
def test_a_rigid_stage_ties_the_vertical_coefficients(sensor, x0, y0):
    """b/a = y - y0 and c/a = -(x - x0): the three sensors find one point (x0, y0), in metres."""
    p = values("table7_estimates")
    x, y = {"A": (p["H1x"], p["H1y"]), "B": (-p["H2x"], p["H2y"]), "C": (p["H3x"], p["H3y"])}[sensor]
    a, b, c = (p[f"{letter}_{sensor}"] for letter in "abc")
    assert x + c / a == pytest.approx(x0, abs=0.0005)
    assert y - b / a == pytest.approx(y0, abs=0.005)


# The loader and its files.


@pytest.mark.parametrize("name", ["table1_designed", "table7_estimates"])
def test_printed_and_value_are_the_same_number(name):
    for parameter, value, printed in records(name, "parameter", "value", "printed"):
        number, _, unit = printed.partition(" ")
        assert value == (math.radians(float(number)) if unit == "deg" else float(number)), parameter


def test_unknown_table_names_the_nearest_one():
    with pytest.raises(InputError, match="did you mean 'table7_estimates'") as error:
        table("table7_estimate")
    assert "data/<publication>/<table>.csv" in str(error.value)
