"""Budget and settings files: units in keys, one sentence for what cannot be."""

from math import sqrt

import pytest

from hallsym.errors import InputError
from hallsym.families import build
from hallsym.uncertainty import Settings, read_budget, read_settings


def written(tmp_path, text: str):
    path = tmp_path / "budget.toml"
    path.write_text(text, encoding="utf-8")
    return path


def source(tmp_path, text: str):
    return read_budget(written(tmp_path, f'[[source]]\nname = "a"\n{text}'))[0].sources[0]


@pytest.mark.parametrize(
    ("text", "std", "distribution"),
    [
        ("std_nm = 12", 12e-9, "normal"),
        ("std_um = 0.012", 12e-9, "normal"),
        ("expanded_nm = 24\ncoverage_factor = 2", 12e-9, "normal"),
        ("half_width_nm = 6", 6e-9 / sqrt(3), "rectangular"),
        ("full_width_nm = 12", 12e-9 / sqrt(12), "rectangular"),
        ("resolution_nm = 12", 12e-9 / sqrt(12), "rectangular"),
        ('half_width_nm = 6\ndistribution = "triangular"', 6e-9 / sqrt(6), "triangular"),
        ('half_width_nm = 6\ndistribution = "arcsine"', 6e-9 / sqrt(2), "arcsine"),
        ("readings_nm = [1, 3, 2]", 1e-9 / sqrt(3), "student"),
        ("std_ppm = 3", 3e-6, "normal"),
        ("std = 3", 3.0, "normal"),
        ("std_k = 3", 3.0, "normal"),
        ('std_nm = 3\ndistribution = "student"\ndegrees_of_freedom = 4', 3e-9, "student"),
    ],
)
def test_sizes(tmp_path, text, std, distribution):
    found = source(tmp_path, text)
    assert found.std == pytest.approx(std, rel=1e-12)
    assert found.distribution == distribution


def test_a_sensitivity_states_both_units(tmp_path):
    text = (
        '[[source]]\nname = "tilt"\nstd_urad = 2\nsensitivity_nm_per_urad = 350\n'
        '[[source]]\nname = "scale"\nstd_ppm = 3\nsensitivity_nm_per_ppm = 100\n'
        '[[source]]\nname = "noise"\nstd_nm = 4\nsensitivity = -2\n'
    )
    found, shown = read_budget(written(tmp_path, text))
    assert (found.unit, shown) == ("m", "nm")
    assert found.contributions == pytest.approx([700e-9, 300e-9, -8e-9], rel=1e-12)
    assert found.sources[0].sensitivity == pytest.approx(0.35)  # m per rad


def test_level_unit_and_correlation(tmp_path):
    text = (
        'quantity = "z"\nunit = "um"\nlevel = 0.99\n'
        '[[source]]\nname = "a"\nstd_nm = 3\n[[source]]\nname = "b"\nstd_nm = 4\n'
        '[[correlation]]\nbetween = ["a", "b"]\ncoefficient = 1\n'
    )
    found, shown = read_budget(written(tmp_path, text))
    assert (found.quantity, shown, found.level) == ("z", "um", 0.99)
    assert found.std == pytest.approx(7e-9)
    assert found.factor == pytest.approx(2.575829, abs=1e-6)


A = '[[source]]\nname = "a"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "at least one \\[\\[source\\]\\]"),
        ("[[source]]\nstd_nm = 3", "needs a 'name'"),
        (A, "one of std, expanded"),
        (A + "std_nm = 3\nhalf_width_nm = 3", "it has 2 sizes"),
        (A + "std_nn = 3", "Unit 'nn' of source 'a'"),
        (A + 'half_width_nm = 3\ndistribution = "rectangle"', "did you mean 'rectangular'"),
        (A + 'std_nm = 3\ndistribution = "rectangular"', "one of normal, student"),
        (A + 'std_nm = 3\ndistribution = "student"', "needs 'degrees_of_freedom'"),
        (A + "expanded_nm = 3", "needs its 'coverage_factor'"),
        (A + "std_nm = 3\nsensitivity_nm_urad = 3", "sensitivity_RESULT_per_INPUT"),
        (A + "std_nm = 3\nsensitivity_nm_per_urad = 3", "must be per unit of the source"),
        (A + 'std_nm = 3\n[[source]]\nname = "b"\nstd_urad = 3', "must all act on one result"),
        ("level = 0.9\ncoverage_factor = 2\n" + A + "std_nm = 3", "not both"),
        ("level = 95\n" + A + "std_nm = 3", "between 0 and 1"),
        ('unit = "urad"\n' + A + "std_nm = 3", "unit of the result"),
        (A + 'std_nm = 3\n[[correlation]]\nbetween = ["a", "c"]\ncoefficient = 0.1', "no source"),
    ],
)
def test_a_budget_that_cannot_be(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_budget(written(tmp_path, text))


# -- settings --------------------------------------------------------------------------------------------

FULL = """
coverage_factor = 3
[reading]
averaged = 4
adc_step_um = 2
[zeroing]
averaged = 500
x_nm = 50
rz_urad = 0.2
[zeroing.at]
z_um = -100
[state]
z_nm = 100
[reference]
x_scale_ppm = 5
"""


def settings(tmp_path, text: str) -> Settings:
    return read_settings(written(tmp_path, text), build("stage31"))


def test_settings_in_si(tmp_path):
    found = settings(tmp_path, FULL)
    assert (found.averaged, found.zero_averaged, found.coverage, found.level) == (4, 500, 3, None)
    assert found.adc_step == pytest.approx(2e-6)
    assert found.zero_pose_std == pytest.approx({"x_m": 50e-9, "rz_rad": 0.2e-6})
    assert found.zero_at == pytest.approx({"z_m": -1e-4})
    assert found.state_std == pytest.approx({"z_m": 1e-7})
    assert found.scale_std == pytest.approx({"x_m": 5e-6})
    assert settings(tmp_path, "[reading]\nadc_step_nm = 30").adc_step == pytest.approx(30e-9)
    assert settings(tmp_path, "").zero_averaged == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[readings]\naveraged = 4", "did you mean 'reading'"),
        ("[reading]\naveraged = 0", "whole number, 1 or more"),
        ("[reading]\navereged = 2", "did you mean 'averaged'"),
        ("[reading]\nadc_bits = 16", "Unknown key 'adc_bits'"),
        ("[reading]\nadc_step_urad = 1", "in the unit of a reading"),
        ("[zeroing]\nx_urad = 1", "must end with a unit of 'x'"),
        ("[reference]\nx_ppm = 1", "did you mean 'x_scale_ppm'"),
        ("level = 0.95\ncoverage_factor = 2", "not both"),
    ],
)
def test_settings_that_cannot_be(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        settings(tmp_path, text)
