"""Causes that a log cannot tell apart come as a group, with the recording that separates them."""

import numpy as np
import pytest
from test_halbach_ends import swept
from twins import simulated

import hallsym
from hallsym.families.halbach import PLANAR
from hallsym.families.halbach.effects import magnets, mechanics, transducer
from hallsym.families.halbach.further import half_turned
from hallsym.families.halbach.models import halbach
from hallsym.families.halbach.planar import halbach_planar
from hallsym.simulation import campaign_from

LC_M = 0.03 / 2 / np.pi


@pytest.mark.slow
def test_a_tilt_and_a_place_of_sensors():
    """1 rad of tilt is lc of place; at gaps where the fifth harmonic has faded nothing tells them apart."""
    model, tilts = halbach(), {"0": 12e-3, "2": -9e-3}
    wide, values = mechanics.sensor_tilt(model), {f"tiltx_{k}": t for k, t in tilts.items()}
    found = hallsym.diagnose(swept(wide, values, (6.2e-3, 7.2e-3)), model, holdout=[1])
    assert found.verdict == "explained"
    assert [set(group) for group in found.groups] == [{"sensor_tilt", "sensor_position_error"}]
    assert "smaller gap" in found.separate_by[0].recording


@pytest.mark.slow
def test_a_lost_magnet_and_a_spread_of_all():
    model = halbach()
    log = swept(magnets.lost_magnet(model, magnet=1), {"lost_1": 1.0}, (4.2e-3, 5.2e-3))
    found = hallsym.diagnose(log, model, holdout=[1])
    assert (found.verdict, found.ranked[0]) == ("explained", "lost_magnet")
    assert [set(group) for group in found.groups] == [{"lost_magnet", "remanence_spread"}]
    assert found.separate_by[0].recording
    assert found.effects[0].parameters["lost_1"].value == pytest.approx(1.0, abs=0.02)


def campaign(wide, values):
    """The bundled motions of a mover, thinned."""
    noise = dict.fromkeys(wide.channels, 1e-3) | {
        c: 1e-7 if c.endswith("_m") else 1e-6 for c in wide.references
    }
    plan = campaign_from({**PLANAR.example.campaign, "step_s": 2e-2}, "motions")
    return simulated(wide, {**PLANAR.example.values, **values}, plan, noise)


def test_the_height_of_an_array_is_a_gain_of_its_patch_until_the_mover_is_turned():
    """Of a level mover whose field has one harmonic; a turned mover brings another array over the patch."""
    height = 6e-5
    forms = {
        mechanics.array_geometry_error(halbach_planar(), array="X1", only="height"): {"dz_X1": height},
        transducer.gain_mismatch(halbach_planar(), of="X1"): {"gain_X1": np.expm1(-height / LC_M)},
    }
    pose = np.array([[3e-3, -1e-3, z, 0, 0, 4e-3] for z in (4e-3, 5e-3, 8e-3)]).T

    def apart(*models):
        read = [
            np.array(m.reading(m.vector({**PLANAR.example.values, "a5": 0.0, **values}), [], pose, []))
            for m, values in zip(models, forms.values(), strict=True)
        ]
        return np.abs(read[0] - read[1]).max() / np.abs(read[0]).max()

    assert apart(*forms) < 1e-12
    assert apart(*map(half_turned, forms)) > 0.5 * height / LC_M


@pytest.mark.slow
def test_the_height_of_an_array_and_the_gain_of_its_patch():
    """A common gain of the sensors under an array is exp(height / lc)."""
    model, height = halbach_planar(), 6e-5
    wide = mechanics.array_geometry_error(model, array="X1")
    found = hallsym.diagnose(campaign(wide, {"dz_X1": height}), model, holdout=[1])
    assert found.verdict == "explained"
    assert {"array_geometry_error", "gain_mismatch"} in [set(group) for group in found.groups]
    assert "turned half round" in found.separate_by[0].recording
