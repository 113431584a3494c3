"""C for encoders: corrected angle from two voltages or from a decoded angle.

Independent facts: the model's own readings at a known angle; a common gain of both plates changes no angle.
"""

from functools import cache
from math import pi

import numpy as np
import pytest
from firmware import known
from hypothesis import given
from hypothesis import strategies as st

import hallsym
from hallsym.codegen.generation import notes_of
from hallsym.estimation.calibration import LogRecord
from hallsym.families import effects
from hallsym.families.recording import Correction
from hallsym.families.rotary import FAMILY
from hallsym.families.rotary import FAMILY as ROTARY_FAMILY
from hallsym.families.rotary import models as rotary
from hallsym.log import Noise, Sigma

ROTARY = effects(ROTARY_FAMILY)
ELLIPSE = {"Vx": 0.02, "Vy": -0.03, "Ax": 1.02, "Ay": 0.99, "beta": 0.02, "zero": 2.9}
PAPER = {k: v for k, v in FAMILY.example.values.items() if k != "A"}
WAVES = {"h3c": 2e-3, "h3s": -1e-3, "h4c": 3e-3, "h8s": 1e-3}
CASES = {
    "ideal": (rotary.rotary_ideal, {"A": 1.3, "zero": -2.0}),
    "ellipse": (rotary.rotary, ELLIPSE),
    "meng": (rotary.rotary_meng, PAPER),
    "harmonics": (lambda layout: rotary.harmonics(rotary.rotary(layout)), {**ELLIPSE, **WAVES}),
    "eccentric": (
        lambda layout: ROTARY["eccentricity"](rotary.rotary(layout), direction_deg=np.degrees(0.3)),
        {**ELLIPSE, "eccentricity_both_re": 0.01, "eccentricity_both_im": -0.02, "eccentricity_chip": 0.015},
    ),
}
LAYOUTS = {"volts": rotary.two_voltages(), "angle": rotary.angle_only()}
QUICK = [("ellipse", "volts"), ("meng", "angle")]


def calibrated(model, values):
    """A calibration of an encoder at known parameters."""
    p = model.vector({k: v for k, v in values.items() if k in model.names})
    return known(
        model, p, errors=None, error_rows={}, noise_floor={},
        noise=Noise({c: Sigma(3e-4, "given") for c in (*model.channels, *model.references)}),
        log=LogRecord(span={"angle_ref_rad": (0.0, 12.0), "temperature_degc": (20.0, 30.0)}, sha256=64 * "0"),
    )  # fmt: skip


@cache
def fit_of(case, form):
    make, values = CASES[case]
    return calibrated(make(LAYOUTS[form]), values)


@cache
def made(case, form, **variant):
    return hallsym.generate(fit_of(case, form), **variant)


def turned(difference):
    return np.abs(difference - 2 * pi * np.round(difference / (2 * pi)))


# -- polynomials ---------------------------------------------------------------------------------------------


# -- the angle -----------------------------------------------------------------------------------------------


@given(st.floats(0.55, 1.05), st.floats(-pi, pi))
def test_a_gain_common_to_both_plates_leaves_the_angle_alone(gain, angle):
    code = made("ellipse", "volts")
    model = code.decoupler.model
    p = model.vector(ELLIPSE)
    reading = np.asarray(model.reading(p, [], angle, [])).ravel()
    center = np.array([ELLIPSE["Vy"], ELLIPSE["Vx"]])
    given = (center + gain * (reading - center)).astype(np.float32)[:, None]
    pose, status = code.backend.step(given)
    # the voltages are not the calibrated ones any more, and the flag says so
    assert status == (0 if abs(gain - 1.0) < 1e-3 else code.decoupler.fault_bit) or abs(gain - 1.0) < 5e-3
    assert turned(float(pose[0, 0]) - angle) < 2e-6


@pytest.mark.parametrize("arithmetic", ["float", "q31"])
def test_no_magnet_and_a_broken_wire_have_bits_of_their_own(arithmetic):
    """Field and fault without a magnet, a fault of a weak one, and bits of the readings."""
    backend = made("ellipse", "volts", arithmetic=arithmetic).backend
    inputs = np.array([[-0.03, 0.02], [0.42, 0.02], [-0.03, 0.57], [5.0, 0.1], [0.1, -9.0]])
    inputs = backend._rounded(inputs.T / [[port.scale] for port in backend.inputs])
    pose, status = backend.step(inputs)
    assert [int(s) & 0x60000003 for s in status[:3]] == [0x60000000, 0x60000000, 0x20000000]
    assert [int(s) & 3 for s in status[3:]] == [1, 2]
    assert np.isfinite(pose).all()


def test_a_reading_that_the_fit_took_with_another_sign_is_said():
    turned = (Correction("sign", ("angle_rad",)),)
    fit = calibrated(rotary.rotary(LAYOUTS["angle"]), ELLIPSE).changed(corrections=turned)
    assert notes_of(fit)[-1] == "The fit took angle_rad from -angle_rad: give it so here too."
