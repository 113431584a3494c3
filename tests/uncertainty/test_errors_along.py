"""Errors of known causes along a coordinate: against formulas, of several families, and the command."""

import json
from math import pi

import numpy as np
import pytest

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.families import build
from hallsym.uncertainty import error_model, errors_along


def test_a_gain_of_an_encoder_makes_two_waves():
    """atan2 of unequal gains: asin((r - 1)/(r + 1)), .0858 deg for 1.003 (Meng et al., Table 1)."""
    model = build("rotary", added=("gain_mismatch",))
    (name,) = set(model.names) - set(build("rotary").names)
    found = errors_along(model, {name: 0.003}, samples=3600)
    assert found.waves == (2,)
    assert found.peak[0] == pytest.approx(np.arcsin(0.003 / 2.003), rel=2e-3)
    assert found.at[-1] == pytest.approx(2 * pi * (1 - 1 / 3600))


def test_causes_alone_and_together():
    model = build("halbach", added=("gain_mismatch", "offset_error"))
    small = {"gain_1": 1e-6, "offset_error_0": 1e-6, "a1": 0.6 * (1 + 1e-6)}
    found = error_model(model, small)
    names = [name for name, *_ in found.causes]
    assert names == ["other values", "gain_mismatch", "offset_error", "all together"]
    *alone, together = (e.error for *_, e in found.causes)
    assert sum(alone) == pytest.approx(together, abs=1e-12)  # small ones add
    assert 1 in found.expected_waves
    assert "offset_error" in found.expected_waves[1]
    assert error_model(model, small, over=("x_m", 0.0, 0.01)).expected_waves == {}


def test_where_the_others_rest():
    """An offset weighs exp(k dz) more at a wider gap."""
    model = build("halbach", added=("offset_error",))
    near, far = (errors_along(model, {"offset_error_0": 1e-5}, at={"z_m": z}).peak for z in (4.2e-3, 5.2e-3))
    assert far / near == pytest.approx(np.full(2, np.exp(2 * pi / 30)), rel=1e-3)


def test_causes_need_values():
    model = build("halbach", added=("gain_mismatch", "offset_error"))
    with pytest.raises(InputError, match="offset_error has no value"):
        error_model(model, {"gain_0": 0.01})
    with pytest.raises(InputError, match="needs a cause"):
        error_model(build("halbach"), {})


def test_command(tmp_path, capsys):
    words = ["tolerances", "--along", "x_m", "--model", "halbach", "--set", "a1_percent=98.8"]
    assert main([*words, "--json"]) == 0
    (cause,) = json.loads(capsys.readouterr().out)["causes"]
    assert cause["rms"]["z_m"] == pytest.approx(57.64e-6, abs=1e-8)
    assert cause["waves"] == {"x_m": 0, "z_m": 0}
    assert main([*words, "--plots", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "57.64" in said
    assert (tmp_path / "errors.png").stat().st_size > 10_000
