"""The integer decoupler: against the model in double, its bits on this machine and on a Cortex-M0, refusals.

Independent facts: exact products of Python's integers; the model's decoded pose; 32 bits never overflow.
"""

import re

import numpy as np
import pytest
from firmware import CASES, GOLDEN, calibration, height_quadratic, need, ran, with_effect
from hypothesis import given
from hypothesis import strategies as st

from hallsym.cli import main
from hallsym.codegen import generate_q31
from hallsym.codegen.box import box_of
from hallsym.codegen.families import decoupler
from hallsym.codegen.q31 import Line, Program, program
from hallsym.errors import InputError

INT = st.integers(-(2**31) + 1, 2**31 - 1)
LINEAR = ("stage31", "four probes", "user's height_quadratic", "vertical_offset_coupling")


@given(INT, INT)
def test_a_product_is_low_by_at_most_two(a, b):
    p = Program(decoupler(calibration(), box_of(calibration())))
    p.lines.append(Line("q1", "mul", "a", "b"))
    p.outputs["x_m"] = ("q1", 0)
    found = int(p.run({"a": np.array(a), "b": np.array(b)})["x_m"])
    exact = a * b / 2**32
    assert -3 < found - exact <= 0


@pytest.mark.parametrize("case", LINEAR)
def test_a_tenth_of_a_nanometre_is_added_at_most(case):
    made = generate_q31(CASES[case]())
    met = made.source.errors(100_000, seed=4)
    assert max(met["x_m"], met["y_m"]) <= 0.1e-9
    assert met["rz_rad"] <= 3e-9


@pytest.mark.parametrize("case", LINEAR)
def test_corners_of_the_box_do_not_overflow(case):
    made = generate_q31(CASES[case]())
    d, p = made.source.program.d, made.source.program
    rng = np.random.default_rng(0)
    ends = np.array([[v * 2.0 ** p.inputs[c] for v in d.ends(c)] for c in d.inputs])
    corners = np.take_along_axis(ends, rng.integers(0, 2, (len(ends), 4096)), axis=1)
    made.source.emulate(np.trunc(corners).astype(np.int64))  # raises OverflowError beyond 32 bits


def test_models_that_are_iterated_are_refused():
    with pytest.raises(InputError, match="linear in the pose"):
        generate_q31(CASES["cubic"]())


def test_options_of_the_float_code_do_not_go_with_it(tmp_path, capsys):
    arguments = ["codegen", str(GOLDEN / "calib.json"), "-o", str(tmp_path / "o"), "--arithmetic", "q31"]
    assert main([*arguments, "--double"]) == 2
    assert "--double belongs to --arithmetic float" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_a_users_effect_follows_into_the_integers():
    names = program(decoupler(f := with_effect(height_quadratic, 3e5), box_of(f))).table
    assert "gain_hall_a_z_z" in names


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("q31") / "fw"
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(out), "--arithmetic", "q31"]) == 0
    return out


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_stated_bits_on_this_machine(folder, compiler):
    need(compiler, "make")
    ran(folder, "make", "clean")
    said = ran(folder, "make", "check", f"CC={compiler}")
    assert "table good, bits of 100000 samples as stated" in said
    assert "zero works" in said


@pytest.mark.parametrize("case", ["four probes", "user's height_quadratic"])
def test_other_models_compile_and_pass(tmp_path, case):
    need("gcc", "make")
    generate_q31(CASES[case](), ranges={"z_m": (-1e-4, 2.5e-4)}).write(tmp_path / "fw")
    assert "as stated" in ran(tmp_path / "fw", "make", "check")


def test_stated_bits_and_instructions_on_a_cortex_m0(folder):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    assert "as stated" in ran(folder, "make", "qemu")
    said = ran(folder, "make", "count")
    counts = re.search(r"decoupler_step, \d+ bytes, instructions per call: (.*)", said)
    assert max(map(int, counts[1].split())) <= 850
    symbols = ran(folder, "arm-none-eabi-nm", "build/decoupler.o")
    assert " U " not in symbols  # no division, no 64-bit product of a library


def test_cppcheck_finds_nothing_that_is_not_listed(folder):
    need("cppcheck", "make")
    ran(folder, "make", "misra")
