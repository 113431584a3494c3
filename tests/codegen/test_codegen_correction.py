"""The correction of an encoder: the smallest table, what it leaves, and channels that are clipped.

Independent facts: dense samples lie within enclosed ranges; the model's own readings at a known angle; a
bound holds at angles that no proof looked at.
"""

from functools import cache
from math import pi

import casadi as ca
import numpy as np
import pytest
from calibrations import fit_of, made
from hypothesis import given
from hypothesis import strategies as st
from test_codegen_rotary import turned

from hallsym.cli.main import main
from hallsym.codegen.bounds import rounded
from hallsym.codegen.decoupler import Step, computed
from hallsym.codegen.intervals import Enclosure, enclose
from hallsym.codegen.lowering.correction import SIZES, grid, proved, sampled, smallest_correction, table_bytes
from hallsym.codegen.lowering.phase_curve import Curve
from hallsym.codegen.operations import graph
from hallsym.errors import InputError
from hallsym.model import on_arrays


@cache
def curve(case):
    fit = fit_of(case)
    return Curve(fit.model, fit.values)


SLOW = pytest.mark.slow
# -- ranges --------------------------------------------------------------------------------------------------

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
ROUNDED = {
    "sums": (X * Y - X) / (3 + X**2) + ca.fabs(X),
    "branches": ca.if_else(ca.fabs(X) <= Y, X * Y, ca.fabs(Y) - X),
    "lesser": ca.if_else(X * Y < X / 3, X * Y, X / 3) * (Y - X),
}
"""What float32 computes by the same operations, one by one."""
EXPRESSIONS = ROUNDED | {
    "rails": ca.fmin(ca.fmax(X, -0.4), 0.6) * Y + ca.fabs(X) - ca.sign(Y),
    "waves": ca.sin(3 * X) * ca.cos(X - Y) + ca.tanh(X),
    "quotient": (X - Y) / (2 + ca.sin(X)),
    "choice": ca.if_else(X < Y, X * X, ca.sqrt(4 + Y)),
    "angle": ca.atan2(Y, X) + ca.atan(X) + ca.exp(Y) / 3,
    "functions": ca.log(3 + X) + ca.asin(X / 3) - ca.acos(Y / 4) + ca.sinh(X) * ca.cosh(Y),
    "power": X**3 - 2 * Y**4 + 1 / (3 + X),
    "slope of rails": ca.jacobian(ca.fmin(ca.fmax(ca.sin(X), -0.4), 0.6) * Y, X),
}
FLOATS = st.floats(-2, 2, width=32)


@pytest.mark.parametrize("name", EXPRESSIONS)
@given(FLOATS, st.floats(0, 1), FLOATS, st.floats(0, 1), st.integers(0, 2**31))
def test_an_enclosure_holds_every_sample_and_what_rounding_makes_of_it(name, x, wide, y, high, seed):
    expression = ca.densify(EXPRESSIONS[name])
    low = np.array([[x], [y]])
    top = np.add(low, [[wide], [high]]).astype(np.float32).astype(float)  # ends, too, are numbers of float32
    ends = {c: Enclosure(low[k], top[k]) for k, c in enumerate("xy")}
    (found,) = enclose([EXPRESSIONS[name]], ends)
    share = np.random.default_rng(seed).random((2, 50))
    share[:, :4] = [[0, 0, 1, 1], [0, 1, 0, 1]]
    given = np.clip((low + (top - low) * share).astype(np.float32), low, top)
    with np.errstate(all="ignore"):
        (exact,) = on_arrays(ca.Function("f", [X, Y], [expression]))(*([row.astype(float)] for row in given))
    assert (exact[~np.isnan(exact)] >= found.low).all()
    assert (exact[~np.isnan(exact)] <= found.high).all()
    if name in ROUNDED:
        own, values = graph([EXPRESSIONS[name]]), dict(zip("xy", given.astype(np.float32), strict=True))
        single = computed(own, values, np.float32)[own.results[0]]
        less, most, error = rounded([Step("f", EXPRESSIONS[name])], ["f"], ends, {})
        known = 2.0**-52 * np.abs(exact)  # double arithmetic rounds, too
        assert (np.abs(single.astype(float) - exact) <= error + known).all()
        assert ((-less <= single) & (single <= most)).all()


# -- what a correction leaves --------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("case", ["meng angle", pytest.param("harmonics volts", marks=SLOW), "clipped"])
@pytest.mark.parametrize("form", [(64, 1, True), pytest.param((256, 3, False), marks=SLOW), (1024, 1, False)])
def test_what_a_table_leaves_is_bounded_and_nearly_met(case, form):
    table = grid(curve(case), *form)
    angle = np.random.default_rng(1).uniform(-pi, pi, 40_000)
    phase = curve(case).phase(curve(case).readings(angle))
    met = turned(phase + table.at(phase)[0] - angle).max()
    bound = proved(curve(case), table, 1.2 * met)
    assert 0.8 * bound < met <= bound


def test_the_slope_and_bend_of_a_correction_bound_what_it_does():
    phase = np.linspace(-pi, pi, 20_001)
    for found in (grid(curve("clipped"), 256, 3, False), grid(curve("meng angle"), 64, 1, True)):
        value, slope = found.at(phase)
        inside = slice(1, -1)
        seen = np.gradient(value, phase)[inside]
        assert np.abs(seen).max() <= found.slope * (1 + 1e-9)
        assert np.abs(slope).max() <= found.slope
        same = np.abs(np.diff(slope)) <= found.bend * (phase[1] - phase[0]) * (1 + 1e-9) + 1e-12
        assert same.mean() > 0.98  # all but the corners of lines


@pytest.mark.parametrize("case", ["meng angle", "harmonics volts", "ideal volts", "ellipse volts"])
@pytest.mark.parametrize("accuracy", [1e-6, 1e-3, 0.9])
def test_no_smaller_table_than_the_one_taken_would_do(case, accuracy):
    found = smallest_correction(curve(case), accuracy)
    assert found.left <= accuracy
    plain = case in ("ideal volts", "ellipse volts")  # the linear map does it all
    assert found.looked_up == (accuracy < 0.9 and not plain)
    taken = table_bytes(len(found.values), found.degree, found.integers)
    for form in ((n, degree, integers) for n in SIZES for degree in (1, 3) for integers in (True, False)):
        if found.looked_up and table_bytes(*form) < taken:
            assert sampled(curve(case), grid(curve(case), *form)) > accuracy


# -- clipped channels ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_is_said_to_be_within_reach_is():
    with pytest.raises(InputError) as said:
        made("clipped")
    reach = float(str(said.value).partition("entries; ")[2].split()[0])
    assert made("clipped", accuracy=reach).decoupler.slack <= reach * 1.001


# -- options -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_takes_an_accuracy_in_any_unit(tmp_path, capsys):
    fit_of("clipped").save(tmp_path / "calib.json")
    base = ["codegen", str(tmp_path / "calib.json"), "-o", str(tmp_path / "fw")]
    assert main([*base, "--accuracy", "angle_um=1"]) == 2
    assert main([*base, "--accuracy", "angle_mrad=one"]) == 2
    assert main(base) == 2
    assert "is within reach: give --accuracy" in capsys.readouterr().err
    assert main([*base, "--accuracy", "angle_mrad=5"]) == 0
    assert "table of 592 bytes" in capsys.readouterr().out
