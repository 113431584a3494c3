"""The integer decoupler: against the model in double, its bits on this machine and on a Cortex-M0, refusals.

Independent facts: exact products of Python's integers; the model's decoded pose; 32 bits never overflow.
"""

import numpy as np
import pytest
from firmware import (
    calibration,
    height_quadratic,
    made,
    with_effect,
)
from hypothesis import given
from hypothesis import strategies as st

from hallsym.codegen import generate
from hallsym.codegen.box import box_of
from hallsym.codegen.integer_c import Line, Program, integer_program
from hallsym.codegen.lowering import lower

PRODUCT = Program(lower(calibration(), box_of(calibration())))
PRODUCT.lines.append(Line("q1", "mul", "a", "b"))
PRODUCT.outputs["x_m"] = ("q1", 0)
INT = st.integers(-(2**31) + 1, 2**31 - 1)
LINEAR = ("stage31", "four probes", "user's height_quadratic", "vertical_offset_coupling")


@given(INT, INT)
def test_a_product_is_low_by_less_than_three(a, b):
    found = int(PRODUCT.run({"a": np.array(a), "b": np.array(b)})["x_m"])
    exact = a * b / 2**32
    assert -3 < found - exact <= 0


@pytest.mark.parametrize("case", LINEAR)
def test_a_tenth_of_a_nanometre_is_added_at_most(case):
    met = made(case, arithmetic="q31").backend.errors(20_000, seed=4)
    assert max(met["x_m"], met["y_m"]) <= 0.1e-9
    assert met["rz_rad"] <= 3e-9


@pytest.mark.parametrize("z", [(-1e-3, 1e-3), (-2e-4, 3e-3)])
def test_gains_that_vary_much_take_more_newton_steps_and_stay_within_their_bound(z):
    source = generate(calibration(), arithmetic="q31", ranges={"z_m": z}).backend
    for column, error in source.errors(20_000, seed=1).items():
        assert error <= source.program.bounds[column][2] < 1e-8
    assert len(source.program.lines) > len(made("stage31", arithmetic="q31").backend.program.lines)


def test_a_users_effect_follows_into_the_integers():
    names = integer_program(lower(f := with_effect(height_quadratic, 3e5), box_of(f))).table
    assert "gain_hall_a_z_z" in names
