"""A family of its own: its maker alone gives a folder that compiles, passes its self-test and is proved.

Independent facts: numpy's `where` and `abs` for what the C branches on; the bits of a million samples.
"""

import casadi as ca
import numpy as np
import pytest
from firmware import known, passes, proved_by_eva, written

import hallsym
from hallsym import Model, Parameter
from hallsym.codegen import Box, Decoupler, Entry, Margin, Step, limits
from hallsym.codegen.bounds import pose_bounds
from hallsym.codegen.box import box_of
from hallsym.codegen.lowering import lower
from hallsym.estimation.calibration import LogRecord
from hallsym.log import Noise, Sigma
from hallsym.model import Family

FOLDING = Family("folding", decoder=lambda *given: maker(*given))


def folding() -> Model:
    """Two probes beside one scale: whichever reads less is in its linear range."""

    def field(s, p):
        s["displacement"] = ca.vertcat(s["x_m"], s["x_m"])
        s["gain"] = ca.vertcat(p["g"], p["g"])
        s["reading"] = s["gain"] * s["displacement"]

    return Model(
        name="folding", family=FOLDING, pose=("x_m",), references=("x_ref_m",), state=(),
        channels=("hall_a_m", "hall_b_m"), parameters=(Parameter("g", 2.0, 0.5, 4.0, "1"),),
        steps=(("field", field),),
    )  # fmt: skip


def maker(model, p, weight, box):
    """x = a / g where |a| <= |b| and a is positive, else |b| / g - a."""
    a, b, zero, gain = (ca.SX.sym(n) for n in ("hall_a", "hall_b", "zero_x", "gain"))
    near = ca.logic_not(ca.fabs(b) < ca.fabs(a))
    x = zero + ca.if_else(near, ca.if_else(a < 0, ca.fabs(b) / gain - a, a / gain), ca.fabs(b) / gain - a)
    zeros = (Entry("zero_x", 0.0, "m", "added to x_m"),)

    def exact(inputs):
        m, n = inputs
        far = np.abs(n) / p[0] - m
        return np.where((np.abs(m) <= np.abs(n)) & (m >= 0), m / p[0], far)[None]

    ends = Box({**dict.fromkeys(model.channels, (-0.001, 0.001)), **box.ends})
    return Decoupler(
        model=model, inputs=model.channels, table=(Entry("gain", float(p[0]), "1", "gain"),),
        limits=limits(model.channels, ends), offsets=zeros, steps=(Step("x", x, "[m]"),), at_pose=(),
        margins=(Margin("hall_a_m", "gain"),), box=ends, exact=exact,
        symbols={"hall_a_m": a, "hall_b_m": b, "zero_x": zero, "gain": gain, "x_m": ca.SX.sym("x")},
    )  # fmt: skip


@pytest.fixture
def fit():
    """A calibration of the family."""
    model = folding()
    noise = Noise({c: Sigma(5e-7, "given") for c in model.channels})
    return known(model, np.array([2.5]), noise=noise, log=LogRecord(span={"x_ref_m": (-4e-4, 4e-4)}))


@pytest.mark.slow
def test_its_folder_passes_its_self_test(fit, tmp_path):
    code = hallsym.generate(fit, jacobian=True)
    assert "MAGNITUDE(hall_b) < MAGNITUDE(hall_a)" in str(code.files["decoupler.c"])
    passes(written(code, tmp_path / "fw"))
    proved_by_eva(tmp_path / "fw")


def test_it_has_bounds(fit):
    code = hallsym.generate(fit)
    assert code.bounds.least_gain == {"hall_a_m": 1.0}
    found = pose_bounds(lower(fit, box_of(fit)))
    assert found.low["x_m"] <= -1e-3
    assert found.high["x_m"] >= 1e-3 * 1.4
    assert 0 < found.error["x_m"] < 1e-9
