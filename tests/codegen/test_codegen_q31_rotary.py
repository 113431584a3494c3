"""The corrected angle in integers: CORDIC, tables of binary angles, wraps, and the same bits on a Cortex-M0.

Independent facts: numpy's arctangent; straight lines by numpy's interpolation; the model's own readings at a
known angle; a binary angle wraps by itself; shifted counts are angles.
"""

from math import pi

import numpy as np
import pytest
from calibrations import made
from hypothesis import given
from hypothesis import strategies as st
from test_codegen_rotary import turned

from hallsym.codegen import integer_c as turns
from hallsym.errors import InputError

# -- binary angles -------------------------------------------------------------------------------------------

LONG = 2**27


@given(st.floats(0.5, 2.0), st.floats(-pi, pi), st.integers(8, turns.STEPS))
def test_cordic_is_an_arctangent_within_its_bound(radius, angle, steps):
    x, y = (np.array([round(LONG * radius * f(angle))]) for f in (np.cos, np.sin))
    found = turns.angle_of(x, y, steps) * turns.UNIT
    assert turned(found - np.arctan2(y, x)) <= turns.angle_error(0.5 * LONG - 1, steps)


@pytest.mark.parametrize(("bits", "shift"), [(16, 0), (16, 9), (16, 15), (32, 0)])
@given(st.integers(0, 2**32 - 1), st.integers(0, 2**31))
def test_a_table_is_straight_lines_between_its_entries(bits, shift, phase, seed):
    rng = np.random.default_rng(seed)
    values = np.cumsum(rng.integers(-90, 90, 64))
    values = (values - values.mean().astype(int)) * (1 if bits == 16 else 20_000)
    table = turns.AngleTable("t", values, shift, bits)
    found = table.at(np.array([phase]))
    wanted = np.interp(phase, np.arange(65) * 2.0**26, np.append(values, values[0])) * 2.0**shift
    assert abs(found - wanted) * turns.UNIT <= table.error


def test_a_table_that_does_not_fit_is_refused():
    with pytest.raises(InputError, match="does not fit into 32 bits"):
        turns.AngleTable("t", np.array([0, 2**15, 0, -(2**15)]), 16, 16)


# -- the angle -----------------------------------------------------------------------------------------------


def test_counts_that_are_shifted_are_angles():
    """A 14-bit encoder: count << 18."""
    source = made("meng angle", arithmetic="q31").backend
    count = np.arange(2**14)
    pose, status = source.step((count << 18)[None])
    wanted = source.decoupler.exact(count[None] * (2 * pi / 2**14))
    assert not status.any()
    assert turned(pose * turns.UNIT - wanted).max() <= source.program.bounds["angle_rad"][2]


def test_a_coarser_accuracy_takes_fewer_steps_of_cordic():
    counts = [turns.steps_for(a) for a in (1e-9, 1e-6, 1e-5, 1e-3)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == turns.STEPS
    for accuracy, steps in zip((1e-6, 1e-5, 1e-3), counts[1:], strict=True):
        assert accuracy / 65 < turns.angle_error(2.0**40, steps) - steps * turns.UNIT / 2 < accuracy / 31
