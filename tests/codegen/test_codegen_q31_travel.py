"""Machines that travel over rows longer than their arrays, in integers: sensors weighted, the same bits on a
Cortex-M0.

Independent facts: the finite field of magnetised rectangles at a known pose (test_codegen_travel.py,
test_codegen_movers.py); the same decoder in double; 32 bits never overflow, whatever the readings;
instructions counted in QEMU.
"""

from functools import cache

import numpy as np
import pytest
import test_codegen_movers as movers
import test_codegen_travel as travel
from firmware import STRICT, most_instructions, need, proved_by_eva, ran
from waves import SIX

import hallsym
from hallsym.model import on_arrays

COLUMNS, REACH, GAPS = 13, 0.05, travel.GAPS
"""A board of 130 mm, an array of 90 mm: at the ends of the travel a third of it is over no sensor."""
FIELD, TILTED, COVER = movers.FIELD, movers.TILTED, movers.COVER
TRAVEL_COVER = travel.COVER
MOST = {"travel": 15_000, "mover": 28_000}
"""Instructions of decoupler_step() on a Cortex-M0, whatever the inputs."""


@cache
def made(case="travel", double=False):
    options = {"double": True} if double else {"arithmetic": "q31"}
    if case == "mover":
        return hallsym.generate(movers.fit_of(), accuracy=5e-6, **options)
    return hallsym.generate(travel.fit_of(COLUMNS, REACH), **options)


def read(x, z):
    fit = travel.fit_of(COLUMNS, REACH)
    return on_arrays(fit.model.reading)(fit.values, [], [x, z], [])[0]


def stepped(inputs, case="travel"):
    """Pose [SI] and status at readings [V]."""
    backend = made(case).backend
    scales = [np.array([[port.scale] for port in ports]) for ports in (backend.inputs, backend.outputs)]
    pose, status = backend.step(np.clip(np.round(inputs / scales[0]).astype(np.int64), *backend.ends))
    return pose * scales[1], status


def drawn(count, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(-REACH, REACH, count), rng.uniform(*GAPS, count)


# -- place and height ----------------------------------------------------------------------------------------


def test_readings_give_place_and_gap_back_over_all_of_the_board():
    pose = np.array(drawn(3000))
    found, status = stepped(read(*pose))
    assert not status.any()
    bound = made().backend.error_bound
    assert (np.abs(found - pose).max(axis=1) <= [bound["x_m"], bound["z_m"]]).all()


def test_integers_state_hardly_more_than_what_ends_and_harmonics_leave():
    code = made()
    for column, met in code.errors.items():
        rounding = code.backend.error_bound[column] - code.decoupler.leaves[column]
        assert 0 < rounding < 1.5e-6
        assert met <= code.backend.error_bound[column]


@pytest.mark.slow
@pytest.mark.parametrize("case", ["travel", "mover"])
def test_what_integers_round_is_within_what_is_stated_of_it(case):
    """Against the same decoder in double, whose functions are polynomials."""
    code, double = made(case), made(case, double=True)
    inputs = read(*drawn(2000)) if case == "travel" else movers.inputs_of(movers.poses(2000))
    off = np.abs(stepped(inputs, case)[0] - double.backend.step(inputs)[0]).max(axis=1)
    for k, column in enumerate(code.decoupler.pose):
        rounding = code.backend.error_bound[column] - code.decoupler.leaves[column]
        functions = double.decoupler.leaves[column] - code.decoupler.leaves[column]
        assert rounding / 30 < off[k] <= rounding + functions + double.bounds.error[column]


def test_nothing_steps_as_sensors_come_and_go():
    x = np.linspace(-REACH, REACH, 9001)
    off = stepped(read(x, np.full_like(x, 5e-3)))[0] - [x, np.full_like(x, 5e-3)]
    assert np.abs(np.diff(off, axis=1)).max() < 1e-6  # in 10 um of travel, roundings of one sample among it


def test_no_array_and_an_array_off_the_board_raise_a_flag():
    silent = stepped(np.zeros((COLUMNS, 1)))[1]
    noise = stepped(np.random.default_rng(2).normal(0, 1e-3, (COLUMNS, 200)))[1]
    assert (silent & FIELD == FIELD).all()
    assert (noise & FIELD == FIELD).all()
    far = np.array([-0.12, 0.11, 0.13])
    assert (stepped(read(far, np.full(3, 5e-3)))[1] & (FIELD | TRAVEL_COVER) != 0).all()
    assert stepped(read(np.array([0.01]), np.array([1.5e-3])))[1] & FIELD


def test_whatever_the_bits_nothing_overflows():
    backend = made().backend
    rng = np.random.default_rng(3)
    low, high = backend.ends
    corners = np.where(rng.integers(0, 2, (COLUMNS, 5000)), low, high)
    anything = rng.integers(-(2**31), 2**31, (COLUMNS, 5000))
    for inputs in (corners, anything):
        assert np.abs(backend.step(inputs)[0]).max() < 2**29  # raises OverflowError beyond 32 bits


@pytest.mark.slow
def test_a_recalibration_needs_the_same_code(tmp_path):
    made().write(tmp_path / "fw")
    fit = travel.fit_of(COLUMNS, REACH)
    values = fit.model.vector({**travel.VALUES, "a1": 0.64})
    again = hallsym.generate(travel.replace(fit, values=values), arithmetic="q31", like=tmp_path / "fw")
    again.write(tmp_path / "fw", params_only=True)
    assert again.files["src/decoupler.c"] == made().files["src/decoupler.c"]
    for column, met in again.errors.items():
        assert met <= again.backend.error_bound[column]


# -- six coordinates -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_readings_of_a_mover_give_its_pose_back_and_flags_say_where_there_is_none():
    pose = movers.poses(2000)
    near = movers.LENGTH * np.random.default_rng(1).uniform(-0.25, 0.25, (2, 2000))
    found, status = stepped(movers.inputs_of(pose, near), "mover")
    assert not status.any()
    bound = made("mover").backend.error_bound
    assert (np.abs(found - pose).max(axis=1) <= [bound[c] for c in SIX]).all()
    rms = np.sqrt(((found - pose) ** 2).mean(axis=1))
    assert (rms[:3] < 6e-6).all()
    assert (rms[3:] < 2.6e-5).all()
    (a, _), (b, _) = (stepped(movers.inputs_of(pose, n * movers.LENGTH), "mover") for n in (-0.2, 0.2))
    assert (a == b).all()  # what says the period changes nothing else
    for axis, value, bit in ((2, 0.012, FIELD), (3, 0.03, TILTED), (0, 0.051, COVER)):
        moved = movers.poses(200)
        moved[axis] = value
        assert (stepped(movers.inputs_of(moved), "mover")[1] & bit == bit).all(), axis


@pytest.mark.slow
def test_no_coordinate_of_a_mover_steps_as_sensors_come_and_go():
    at = np.linspace(-movers.REACH, movers.REACH, 6001)
    for axis in (0, 1):
        pose = np.tile([[2e-3], [-1e-3], [5e-3], [3e-3], [-2e-3], [2e-3]], len(at))
        pose[axis] = at
        moved = np.abs(np.diff(stepped(movers.inputs_of(pose), "mover")[0] - pose, axis=1)).max(axis=1)
        assert (moved[:3] < 3e-6).all()  # in 10 um of travel, CORDIC's roundings among it
        assert (moved[3:] < 2e-5).all()


@pytest.mark.slow
def test_whatever_the_bits_nothing_of_a_mover_overflows():
    backend = made("mover").backend
    rng, (low, high) = np.random.default_rng(0), backend.ends
    corners = np.where(rng.integers(0, 2, (len(low), 5000)), low, high)
    assert np.abs(backend.step(corners)[0]).max() < 2**29
    assert (backend.step(backend.sample(np.arange(20_000)))[1] != 0).mean() > 0.5


# -- the C itself --------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("case", ["travel", "mover"])
def test_the_folder_passes_its_self_test_without_undefined_behaviour(case, tmp_path):
    need("gcc")
    made(case).write(tmp_path / "fw")
    out, include = str(tmp_path / "selftest"), ("-Iinclude", "-Iparams", "-Itest")
    sanitize = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
    ran(tmp_path / "fw", "gcc", *STRICT, "-pedantic", *sanitize, *include, *movers.TESTED, "-o", out)
    said = ran(tmp_path / "fw", out)
    assert "table good, 0 of" in said
    assert said.count("as stated") == 2
    assert "0 faults of a table not found, 0 zeros wrong" in said


@pytest.mark.slow
@pytest.mark.parametrize("case", ["travel", "mover"])
def test_same_bits_and_instructions_on_a_cortex_m0(case, tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    made(case).write(tmp_path / "fw")
    assert ran(tmp_path / "fw", "make", "qemu").count("as stated") == 2
    assert most_instructions(tmp_path / "fw") <= MOST[case]


@pytest.mark.slow
def test_eva_raises_no_alarm(tmp_path):
    made().write(tmp_path / "fw")
    proved_by_eva(tmp_path / "fw", integers=True)
