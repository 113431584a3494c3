"""`--jacobian`: slopes of the pose by readings and by state, against the model's own readings.

At a pose the readings are f(pose, state), so d pose / d reading is the inverse of f's slope by the pose, and
d pose / d state is minus that times f's slope by the state.
"""

import ctypes
import json
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from firmware import CASES, GOLDEN, Library, calibration, made, need, passes, ran, written

import hallsym
from hallsym.cli.main import main
from hallsym.errors import InputError

BOTH = "reading,state"


@cache
def implied(case):
    """The slopes of the pose [pose, reading and state] by the implicit function theorem."""
    fit = CASES[case]()
    model = fit.model
    pose, state = ca.SX.sym("pose", len(model.pose)), ca.SX.sym("state", len(model.state))
    reading = model.reading(fit.values, np.zeros(len(model.zeros)), pose, state)
    inverse = ca.inv(ca.jacobian(reading, pose))
    slopes = ca.horzcat(inverse, -inverse @ ca.jacobian(reading, state))
    return ca.Function("implied", [pose, state], [reading, slopes])


def slopes_of(library, inputs, shape):
    out = np.zeros(shape, library.dtype)
    call = library.library.decoupler_jacobian
    call.restype = ctypes.c_uint32
    inputs = np.asarray(inputs, library.dtype)
    given = (library.table, inputs, out)
    return call(*(a.ctypes.data_as(ctypes.c_void_p) for a in given)), out


@pytest.mark.parametrize("case", ["stage31", "vertical_offset_coupling", "exact_rotation"])
def test_they_are_those_of_the_model(tmp_path, case):
    need("gcc")
    code = made(case, double=True, jacobian=BOTH)
    code.write(tmp_path / "fw")
    library = Library(tmp_path / "fw", code.decoupler, np.float64)
    rng = np.random.default_rng(5)
    for _ in range(20):
        pose, state = rng.uniform(-1e-4, 1e-4, 3), rng.uniform(-1e-4, 1e-4, 3)
        reading, expected = (np.asarray(part) for part in implied(case)(pose, state))
        status, found = slopes_of(library, np.concatenate([reading.ravel(), state]), (3, 6))
        assert status == 0
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_by_state_alone_they_are_the_last_columns(tmp_path):
    need("gcc")
    inputs = np.array([2e-5, -1e-5, 3e-5, 1e-4, -1e-4, 5e-5])
    found = {}
    for kinds, width in ((BOTH, 6), ("state", 3)):
        code = made("stage31", jacobian=kinds)
        code.write(tmp_path / kinds)
        library = Library(tmp_path / kinds, code.decoupler, np.float32)
        found[kinds] = slopes_of(library, inputs, (3, width))[1]
    assert found["state"] == pytest.approx(found[BOTH][:, 3:], rel=1e-5)
    header = str(made("stage31", jacobian="state").files["include/decoupler.h"])
    assert "Slopes of the pose by the state." in header
    assert "float x_rx; /**< [m/rad] d x_m / d rx_rad */" in header
    assert "x_hall_a" not in header.split("} decoupler_jacobian_t")[0].rpartition("typedef struct")[2]


LATER = [pytest.param(c, marks=pytest.mark.slow) for c in CASES if c != "stage31"]


@pytest.mark.parametrize("case", ["stage31", *LATER])
def test_the_self_test_holds_them(tmp_path, case):
    code = made(case, jacobian=BOTH)
    passes(written(code, tmp_path / "fw"))
    bounds = [b for b in str(code.files["test/selftest_vectors.h"]).splitlines() if "slope_bounds" in b]
    assert bounds[0].count(",") + 1 == 3 * len(code.decoupler.inputs)


@pytest.mark.slow
def test_a_wrong_slope_is_noticed(tmp_path):
    need("gcc", "make")
    code = made("stage31", jacobian=BOTH)
    for name in ("x_rx", "rz_z", "y_hall_c"):
        folder = tmp_path / name
        code.write(folder)
        source = folder / "src/decoupler.c"
        text = source.read_text()
        assert f"slopes->{name} = " in text
        source.write_text(text.replace(f"slopes->{name} = ", f"slopes->{name} = 1.00001f * "))
        with pytest.raises(AssertionError, match=r"85 vectors failed"):
            ran(folder, "make", "check")


def test_a_recalibration_remembers_which(tmp_path):
    folder = tmp_path / "fw"
    command = ["codegen", str(GOLDEN / "calib.json"), "-o", str(folder)]
    assert main([*command, "--jacobian", BOTH]) == 0
    vectors = (folder / "test/selftest_vectors.h").read_text()
    assert main([*command, "--params-only"]) == 0
    assert (folder / "test/selftest_vectors.h").read_text() == vectors
    table = json.loads((folder / "params/decoupler_params.json").read_text())
    assert table["options"] == {"jacobian": BOTH}


def test_what_does_not_exist_is_refused_in_one_sentence():
    fit = calibration()
    with pytest.raises(InputError, match="takes reading, state or both") as refused:
        hallsym.generate(fit, jacobian="readings")
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="--jacobian belongs to --arithmetic float"):
        hallsym.generate(fit, jacobian="state", arithmetic="q31")


def test_the_option_swallows_no_other_argument(tmp_path, capsys):
    calib, folder = str(GOLDEN / "calib.json"), tmp_path / "fw"
    with pytest.raises(SystemExit) as stopped:
        main(["codegen", "-o", str(folder), "--jacobian", calib])
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert said.count("\n") == 1
    assert "takes reading, state or reading,state; instead received" in said
    assert "--jacobian=reading where another argument follows" in said
    for k, given in enumerate((["--jacobian=reading", calib], [calib, "--jacobian"])):
        assert main(["codegen", "-o", f"{folder}{k}", *given]) == 0
        header = Path(f"{folder}{k}/include/decoupler.h").read_text()
        assert "Slopes of the pose by the readings." in header
