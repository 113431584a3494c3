"""Units that people read: small angles in urad, those that go round in degrees, as the model says."""

import math

import pytest

from hallsym.units import fitting, parameter_unit, readable, scaled, si_symbol, si_unit, split_unit, typeset


@pytest.mark.parametrize(
    ("column", "turning", "shown"),
    [
        ("x_ref_m", (), (1e6, "um", "x_ref")),
        ("rz_rad", (), (1e6, "urad", "rz")),
        ("rz_rad", {"rz_rad": 6.28}, (180 / math.pi, "deg", "rz")),
        ("angle_rad", (), (1e6, "urad", "angle")),
        ("angle_rad", None, (180 / math.pi, "deg", "angle")),
        ("v_sin_v", (), (1e3, "mV", "v_sin")),
        ("temperature_degc", (), (1.0, "degC", "temperature")),
        ("angle_count", None, (1.0, "count", "angle")),
    ],
)
def test_a_column_is_read_in_its_unit_and_an_angle_by_whether_it_goes_round(column, turning, shown):
    factor, unit, name = readable(column, turning)
    assert (unit, name) == shown[1:]
    assert factor == pytest.approx(shown[0], rel=1e-15)


def test_a_picture_stays_near_the_unit_of_the_tables():
    lengths = {15e-9: "nm", 300e-6: "um", 0.0019: "um", 0.0195: "mm", 2.0: "m", math.nan: "um"}
    assert [scaled("x_m", v)[1] for v in lengths] == [*lengths.values()]
    assert (scaled("rz_rad", 0.1), scaled("temperature_degc", 60.0)) == ((1e3, "mrad"), (1.0, "degC"))
    assert [scaled("a_rad", v, {"a_rad": 6.28})[1] for v in (1e-4, 0.1, 100.0)] == ["deg", "deg", "deg"]
    assert [scaled("v_cos_v", v)[1] for v in (1e-6, 0.1, 1.0)] == ["mV", "mV", "V"]


def test_a_budget_takes_the_smallest_unit_that_stays_below_a_thousand():
    assert [fitting("m", v)[1] for v in (1e-7, 1e-6, 2e-3, 5.0)] == ["nm", "um", "mm", "m"]
    assert fitting("rad", 1e-3, turns=True)[1] == "deg"
    assert fitting("1", 2e-6)[1] == "ppm"
    assert fitting("t", 2e-6) == (1.0, "t")


def test_words_of_units():
    assert parameter_unit("rad")[1] == "deg"
    assert parameter_unit("m") == parameter_unit("m", bare=True) == (1e3, "mm")
    assert parameter_unit("s") == (1e3, "ms")
    assert (parameter_unit("1")[1], parameter_unit("1", bare=True)[1]) == ("1", "")
    assert [typeset(u) for u in ("um", "urad", "degC", "rpm")] == ["µm", "µrad", "°C", "rpm"]
    assert [si_unit(c) for c in ("hall_a_m", "speed_rad_s", "hall_a")] == ["m", "rad_s", ""]
    assert [si_symbol(c) for c in ("col_0_v", "speed_rad_s", "hall_a")] == ["V", "rad/s", ""]


@pytest.mark.parametrize(
    ("column", "stem", "unit"),
    [("current_a", "current", "a"), ("current_a_a", "current_a", "a"), ("current_ma", "current", "ma"),
     ("hall_a", "hall_a", None), ("v_v", "v_v", None), ("hall_a_m", "hall_a", "m")],
)  # fmt: skip
def test_a_last_letter_is_a_unit_where_the_quantity_has_it(column, stem, unit):
    found, stated = split_unit(column)
    assert (found, stated.name if stated else None) == (stem, unit)
