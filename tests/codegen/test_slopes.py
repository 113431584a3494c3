"""`--jacobian`: slopes of the pose by the readings, against the model's own readings.

At a pose the readings are f(pose, state), so d pose / d reading is the inverse of f's slope by the pose.
"""

import ctypes
from functools import cache

import casadi as ca
import numpy as np
import pytest
from firmware import CASES, Library, made, need, passes, ran, written


@cache
def implied(case):
    """The slopes of the pose by the readings by the implicit function theorem."""
    fit = CASES[case]()
    model = fit.model
    pose, state = ca.SX.sym("pose", len(model.pose)), ca.SX.sym("state", len(model.state))
    reading = model.reading(fit.values, np.zeros(len(model.offsets)), pose, state)
    slopes = ca.inv(ca.jacobian(reading, pose))
    return ca.Function("implied", [pose, state], [reading, slopes])


def slopes_of(library, inputs, shape):
    out = np.zeros(shape, library.dtype)
    call = library.library.decoupler_jacobian
    call.restype = ctypes.c_uint32
    inputs = np.asarray(inputs, library.dtype)
    given = (library.table, inputs, out)
    return call(*(a.ctypes.data_as(ctypes.c_void_p) for a in given)), out


@pytest.mark.slow
@pytest.mark.parametrize("case", ["stage31", "vertical_offset_coupling", "exact_rotation"])
def test_they_are_those_of_the_model(tmp_path, case):
    need("gcc")
    code = made(case, double=True, jacobian=True)
    code.write(tmp_path / "fw")
    library = Library(tmp_path / "fw", code)
    rng = np.random.default_rng(5)
    for _ in range(20):
        pose, state = rng.uniform(-1e-4, 1e-4, 3), rng.uniform(-1e-4, 1e-4, 3)
        reading, expected = (np.asarray(part) for part in implied(case)(pose, state))
        status, found = slopes_of(library, np.concatenate([reading.ravel(), state]), (3, 3))
        assert status == 0
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-8)


LATER = [pytest.param(c, marks=pytest.mark.slow) for c in CASES if c != "stage31"]


@pytest.mark.parametrize("case", ["stage31", *LATER])
def test_the_self_test_holds_them(tmp_path, case):
    code = made(case, jacobian=True)
    passes(written(code, tmp_path / "fw"))
    bounds = [b for b in str(code.files["test/selftest_vectors.h"]).splitlines() if "slope_bounds" in b]
    assert bounds[0].count(",") + 1 == 3 * len(code.decoupler.model.channels)


@pytest.mark.slow
def test_a_wrong_slope_is_noticed(tmp_path):
    need("gcc", "make")
    code = made("stage31", jacobian=True)
    for name in ("x_hall_a", "rz_hall_b", "y_hall_c"):
        folder = tmp_path / name
        code.write(folder)
        source = folder / "decoupler.c"
        text = source.read_text()
        assert f"slopes->{name} = " in text
        source.write_text(text.replace(f"slopes->{name} = ", f"slopes->{name} = 1.00001f * "))
        with pytest.raises(AssertionError, match=r"85 vectors failed"):
            ran(folder, "make", "check")
