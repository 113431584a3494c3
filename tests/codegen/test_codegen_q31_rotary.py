"""The corrected angle in integers: CORDIC, tables of binary angles, wraps, and the same bits on a Cortex-M0.

Independent facts: numpy's arctangent; straight lines by numpy's interpolation; the model's own readings at a
known angle; a binary angle wraps by itself; shifted counts are angles.
"""

from functools import cache
from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_codegen_correction import fit_of
from test_codegen_rotary import turned

from hallsym.codegen import generate
from hallsym.codegen import integer_c as turns
from hallsym.errors import InputError

CASES = [("meng angle", None), ("meng volts", None), ("ellipse volts", None), ("clipped", 5e-3)]


@cache
def made(case, accuracy=None):
    return generate(fit_of(case), arithmetic="q31", accuracy=accuracy)


# -- binary angles -------------------------------------------------------------------------------------------

LONG = 2**27


@given(st.floats(0.5, 2.0), st.floats(-pi, pi), st.integers(8, turns.STEPS))
def test_cordic_is_an_arctangent_within_its_bound(radius, angle, steps):
    x, y = (np.array([round(LONG * radius * f(angle))]) for f in (np.cos, np.sin))
    found = turns.angle_of(x, y, steps) * turns.UNIT
    assert turned(found - np.arctan2(y, x)) <= turns.angle_error(0.5 * LONG - 1, steps)


def test_a_table_that_does_not_fit_is_refused():
    with pytest.raises(InputError, match="does not fit into 32 bits"):
        turns.AngleTable("t", np.array([0, 2**15, 0, -(2**15)]), 16, 16)


# -- the angle -----------------------------------------------------------------------------------------------


def test_counts_that_are_shifted_are_angles():
    """A 14-bit encoder: count << 18."""
    source = made("meng angle").backend
    count = np.arange(2**14)
    pose, status = source.step((count << 18)[None])
    wanted = source.decoupler.exact(count[None] * (2 * pi / 2**14))
    assert not status.any()
    assert turned(pose * turns.UNIT - wanted).max() <= source.program.bounds["angle_rad"][2]
