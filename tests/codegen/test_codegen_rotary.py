"""C for encoders: corrected angle from two voltages or from a decoded angle.

Independent facts: the model's own readings at a known angle; a common gain of both plates changes no angle.
"""

from math import pi

import numpy as np
import pytest
from calibrations import ELLIPSE, fit_of, made
from hypothesis import given
from hypothesis import strategies as st

from hallsym.codegen.generation import notes_of
from hallsym.families.recording import Correction


def turned(difference):
    return np.abs(difference - 2 * pi * np.round(difference / (2 * pi)))


# -- the angle -----------------------------------------------------------------------------------------------


@given(st.floats(0.55, 1.05), st.floats(-pi, pi))
def test_a_gain_common_to_both_plates_leaves_the_angle_alone(gain, angle):
    code = made("ellipse volts")
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
    backend = made("ellipse volts", arithmetic=arithmetic).backend
    inputs = np.array([[-0.03, 0.02], [0.42, 0.02], [-0.03, 0.57], [5.0, 0.1], [0.1, -9.0]])
    inputs = backend._rounded(inputs.T / [[port.scale] for port in backend.inputs])
    pose, status = backend.step(inputs)
    assert [int(s) & 0x60000003 for s in status[:3]] == [0x60000000, 0x60000000, 0x20000000]
    assert [int(s) & 3 for s in status[3:]] == [1, 2]
    assert np.isfinite(pose).all()


def test_a_reading_that_the_fit_took_with_another_sign_is_said():
    turned = (Correction("sign", ("angle_rad",)),)
    fit = fit_of("ellipse angle").changed(corrections=turned)
    assert notes_of(fit)[-1] == "The fit took angle_rad from -angle_rad: give it so here too."
