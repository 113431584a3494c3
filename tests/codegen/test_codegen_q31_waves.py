"""Magnet arrays in integers: place and height of one, six coordinates of four, the same bits on a Cortex-M0.

Independent facts: numpy's logarithm; the field's own equations at known poses (tests/waves.py); 32 bits never
overflow, whatever the readings; the bits of 100000 samples; instructions counted in QEMU.
"""

from functools import cache

import numpy as np
import pytest
from firmware import STRICT, most_instructions, need, proved_by_eva, ran
from hypothesis import given
from hypothesis import strategies as st
from test_codegen_arrays import CASES as MOVERS
from test_codegen_arrays import QUICK, fit_of, poses
from test_codegen_arrays import read as read_mover
from test_codegen_waves import CASES, moved, read, turned
from waves import LENGTH, SIX, calibrated, sums

import hallsym
from hallsym.codegen import binary_logarithm
from hallsym.errors import InputError

MOST = {"three sums": 1100, QUICK: 6700, "24 sums": 11500}
"""Instructions of decoupler_step() on a Cortex-M0, whatever the inputs."""


@cache
def made(case="three sums", accuracy=None):
    if case in MOVERS:
        return hallsym.generate(fit_of(case), arithmetic="q31", accuracy=MOVERS[case][1])
    count, values = CASES[case]
    return hallsym.generate(calibrated(sums(count), values), arithmetic="q31", accuracy=accuracy)


def as_integers(backend, readings):
    units = np.array([[port.scale] for port in backend.inputs])
    return np.round(readings / units).astype(np.int64)


def in_si(backend, pose):
    return pose * np.array([[port.scale] for port in backend.outputs])


# -- the logarithm -------------------------------------------------------------------------------------------


@given(st.floats(0, 30.9), st.floats(-np.pi, np.pi), st.sampled_from([3, 5, 8, 12]))
def test_the_logarithm_of_a_vector_is_within_its_bound(bits, angle, degree):
    x, y = (np.array([round(2.0**bits * f(angle))]) for f in (np.cos, np.sin))
    length = float(np.hypot(x, y)[0])
    if length < 1:
        return
    found = binary_logarithm.logarithm_of(x, y, degree, 56) * 2.0**-26
    off = abs(float(found[0]) - np.log(length * 2.0**-28))
    assert off <= binary_logarithm.logarithm_error(2.0**-28, 2.0**3, degree)


def test_the_bound_of_the_logarithm_is_hardly_more_than_what_is_met():
    rng = np.random.default_rng(2)
    angle, bits = rng.uniform(-np.pi, np.pi, 100_000), rng.uniform(26, 30, 100_000)
    x, y = (np.round(2.0**bits * f(angle)).astype(np.int64) for f in (np.cos, np.sin))
    for degree in (4, 7):
        found = binary_logarithm.logarithm_of(x, y, degree, 56) * 2.0**-26
        off = np.abs(found - np.log(np.hypot(x, y) * 2.0**-28)).max()
        bound = binary_logarithm.logarithm_error(0.25, 4.0, degree)
        assert 0.5 * bound < off <= bound


def test_a_finer_logarithm_takes_a_higher_degree():
    degrees = [binary_logarithm.degree_for(a) for a in (1e-3, 1e-5, 1e-7)]
    assert degrees == sorted(degrees)
    assert binary_logarithm.left_by(degrees[1]) / 2 <= 1e-5 < binary_logarithm.left_by(degrees[1] - 1) / 2


# -- place and height ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_readings_of_the_field_give_place_and_height_back(case):
    backend, (x, z) = made(case).backend, moved()
    pose, status = backend.step(as_integers(backend, read(case, x, z)))
    found = in_si(backend, pose)
    assert not status.any()
    wavelength = CASES[case][1].get("wavelength", LENGTH)
    for off, column in ((turned(found[0] - x, wavelength), "x_m"), (np.abs(found[1] - z), "z_m")):
        # half a bit of readings of 2^-29 V in a field of a quarter of a volt is below 1e-10 m
        assert off.max() <= backend.error_bound[column] + 1e-10
        assert backend.error_bound[column] < 6.5e-7


@pytest.mark.parametrize("accuracy", [1e-7, 2e-8])
def test_an_accuracy_that_is_asked_for_is_nearly_all_of_the_bound(accuracy):
    code = made(accuracy=accuracy)
    rounding = 6e-8  # by intervals, of vectors of some 27 bits: as in float
    assert max(code.backend.error_bound.values()) <= 1.3 * accuracy + rounding
    assert max(code.errors.values()) <= max(code.backend.error_bound.values())


def test_a_wide_range_of_heights_costs_rounding_and_stays_within_its_bound():
    """The field grows 6.6 times: its fifth power leaves fewer bits."""
    backend = hallsym.generate(calibrated(gaps=(0.003, 0.012)), arithmetic="q31").backend
    for column, met in backend.errors(20_000).items():
        assert met <= backend.error_bound[column] < 2e-6


def test_heights_beyond_the_box_raise_the_flag_and_those_within_do_not():
    backend, (x, _) = made().backend, moved(count=200)
    low, high = backend.ends
    for gap, raised in ((0.0041, 0), (0.0099, 0), (0.0025, 1), (0.012, 1), (0.05, 1)):
        given = np.clip(as_integers(backend, read("three sums", x, np.full_like(x, gap))), low, high)
        _, status = backend.step(given)
        assert ((status & 0x40000000) != 0).mean() == raised, gap


@pytest.mark.parametrize("case", [pytest.param("three sums", marks=pytest.mark.slow), QUICK])
def test_whatever_the_bits_nothing_overflows(case):
    backend = made(case).backend
    pose, status = backend.step(backend.sample(np.arange(30_000)))  # raises OverflowError beyond 32 bits
    rng = np.random.default_rng(0)
    low, high = backend.ends
    corners = np.where(rng.integers(0, 2, (len(low), 5000)), low, high)
    assert np.abs(backend.step(corners)[0]).max() < 2**29
    assert np.abs(pose).max() < 2**29
    assert (status != 0).mean() > 0.5


def test_a_recalibration_needs_the_same_code(tmp_path):
    made().write(tmp_path / "fw")
    values = {**CASES["three sums"][1], "g0": 4.3, "o2": 5e-3, "phase": 0.9}
    again = hallsym.generate(calibrated(values=values), arithmetic="q31", like=tmp_path / "fw")
    again.write(tmp_path / "fw", params_only=True)
    assert again.files["src/decoupler.c"] == made().files["src/decoupler.c"]
    assert again.files["params/decoupler_params.c"] != made().files["params/decoupler_params.c"]
    for column, met in again.errors.items():
        assert met <= again.backend.error_bound[column] < 1e-6


def test_what_integers_cannot_do_is_refused_in_one_sentence():
    for option in ({"fma": True}, {"double": True}, {"jacobian": True}):
        with pytest.raises(InputError, match="belongs to --arithmetic float"):
            hallsym.generate(calibrated(), arithmetic="q31", **option)
    with pytest.raises(InputError, match="--correction belongs to"):
        hallsym.generate(calibrated(), arithmetic="q31", correction="table")


# -- six coordinates -----------------------------------------------------------------------------------------

LATER = [pytest.param(c, marks=pytest.mark.slow) for c in MOVERS if c != QUICK]


@pytest.mark.parametrize("case", [QUICK, *LATER])
def test_readings_of_a_mover_give_its_pose_back(case):
    backend, pose = made(case).backend, poses(case, 2000)
    inputs = read_mover(case, pose)
    if case == "many periods":
        off = LENGTH * np.random.default_rng(1).uniform(-0.25, 0.25, (2, pose.shape[1]))
        inputs = np.vstack([inputs, pose[:2] + off])
    given = np.clip(as_integers(backend, inputs), *backend.ends)
    found, status = backend.step(given)
    assert not status.any()
    off = np.abs(in_si(backend, found) - pose).max(axis=1)
    assert (off <= np.array([backend.error_bound[c] for c in SIX])).all()
    for column, met in made(case).errors.items():
        assert met <= backend.error_bound[column]


def test_a_far_mover_a_tilted_one_and_no_mover_raise_a_flag():
    backend, pose = made(QUICK).backend, poses(QUICK, 100)
    for change, bit in (({2: 0.013}, 0x40000000), ({3: 0.02}, 0x20000000), ({2: 0.5}, 0x40000000)):
        moved_pose = pose.copy()
        for k, value in change.items():
            moved_pose[k] = value
        given = np.clip(as_integers(backend, read_mover(QUICK, moved_pose)), *backend.ends)
        assert (backend.step(given)[1] & bit == bit).all()


# -- the C itself --------------------------------------------------------------------------------------------

TESTED = (
    "src/decoupler.c", "src/decoupler_check.c", "params/decoupler_params.c", "test/selftest.c",
    "test/faults.c", "test/main.c",
)  # fmt: skip
BUILT = ["three sums", QUICK, pytest.param("five sums", marks=pytest.mark.slow), *LATER]


@pytest.mark.parametrize("case", BUILT)
def test_the_folder_passes_its_self_test_without_undefined_behaviour(case, tmp_path):
    need("gcc")
    made(case).write(tmp_path / "fw")
    out, include = str(tmp_path / "selftest"), ("-Iinclude", "-Iparams", "-Itest")
    sanitize = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
    ran(tmp_path / "fw", "gcc", *STRICT, "-pedantic", *sanitize, *include, *TESTED, "-o", out)
    said = ran(tmp_path / "fw", out)
    assert "table good, 0 of" in said
    assert said.count("as stated") == 2
    assert "0 faults of a table not found, 0 zeros wrong" in said


COUNTED = ["three sums", *(pytest.param(c, marks=pytest.mark.slow) for c in (QUICK, "24 sums"))]


@pytest.mark.parametrize("case", COUNTED)
def test_same_bits_and_instructions_on_a_cortex_m0(case, tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    made(case).write(tmp_path / "fw")
    assert ran(tmp_path / "fw", "make", "qemu").count("as stated") == 2
    assert most_instructions(tmp_path / "fw") <= MOST[case]
    symbols = ran(tmp_path / "fw", "arm-none-eabi-nm", "build/decoupler.o").splitlines()
    kinds = {line.split()[-1]: line.split()[-2] for line in symbols}
    assert kinds.pop("decoupler_crc") == "U"  # src/decoupler_check.c
    assert set(kinds.values()) <= {"T", "t", "r"}  # nothing in RAM, nothing undefined: no 64-bit division


@pytest.mark.slow
@pytest.mark.parametrize("case", ["three sums", QUICK])
def test_eva_raises_no_alarm_and_cppcheck_lists_nothing(case, tmp_path):
    need("cppcheck", "make")
    made(case).write(tmp_path / "fw")
    ran(tmp_path / "fw", "make", "misra")
    proved_by_eva(tmp_path / "fw", integers=True)
