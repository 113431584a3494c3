"""The integer decoupler: against the model in double, its bits on this machine and on a Cortex-M0, refusals.

Independent facts: exact products of Python's integers; the model's decoded pose; 32 bits never overflow.
"""

import numpy as np
import pytest
from firmware import (
    CASES,
    GOLDEN,
    Library,
    calibration,
    every_input,
    height_quadratic,
    instructions,
    made,
    need,
    passes,
    proved_by_eva,
    ran,
    undefined_symbols,
    with_effect,
    written,
)
from hypothesis import given
from hypothesis import strategies as st

from hallsym.cli.main import main
from hallsym.codegen import generate
from hallsym.codegen.box import box_of
from hallsym.codegen.integer_c import Line, Program, integer_program
from hallsym.codegen.lowering import lower
from hallsym.errors import InputError

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


@pytest.mark.parametrize("case", LINEAR)
def test_corners_of_the_box_do_not_overflow(case):
    source = made(case, arithmetic="q31").backend
    d, p = source.decoupler, source.program
    rng = np.random.default_rng(0)
    ends = np.array([[v * 2.0 ** p.inputs[c] for v in d.ends(c)] for c in d.inputs])
    corners = np.take_along_axis(ends, rng.integers(0, 2, (len(ends), 4096)), axis=1)
    source.step(np.trunc(corners).astype(np.int64))  # raises OverflowError beyond 32 bits


def test_models_that_are_iterated_are_refused():
    with pytest.raises(InputError, match=r"linear in the pose; .* has its C in float") as refused:
        generate(CASES["cubic"](), arithmetic="q31")
    assert str(refused.value).count(". ") == 0


def test_options_of_the_float_code_do_not_go_with_it(tmp_path, capsys):
    arguments = ["codegen", str(GOLDEN / "calib.json"), "-o", str(tmp_path / "o"), "--arithmetic", "q31"]
    assert main([*arguments, "--double"]) == 2
    assert "--double belongs to --arithmetic float" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_a_users_effect_follows_into_the_integers():
    names = integer_program(lower(f := with_effect(height_quadratic, 3e5), box_of(f))).table
    assert "gain_hall_a_z_z" in names


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("q31") / "fw"
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(out), "--arithmetic", "q31"]) == 0
    return out


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_stated_bits_on_this_machine(folder, compiler):
    passes(folder, compiler=compiler)


@pytest.mark.parametrize("case", ["four probes", pytest.param("stage15", marks=pytest.mark.slow)])
def test_other_models_compile_and_pass(tmp_path, case):
    code = generate(CASES[case](), arithmetic="q31", ranges={"z_m": (-1e-4, 2.5e-4)})
    passes(written(code, tmp_path / "fw"))


@pytest.mark.slow
def test_stated_bits_and_instructions_on_a_cortex_m0(folder):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    assert "as stated" in ran(folder, "make", "qemu")
    assert max(instructions(made("stage31", arithmetic="q31"), folder)) <= 850
    assert undefined_symbols(folder) == {"decoupler_crc"}  # no division, no 64-bit product of a library


CORES = {
    "M3": ("MACHINE=mps2-an385", "CPU=-mcpu=cortex-m3 -mthumb"),
    "M4": ("MACHINE=mps2-an386", "CPU=-mcpu=cortex-m4 -mthumb"),
    "M7": ("MACHINE=mps2-an500", "CPU=-mcpu=cortex-m7 -mthumb"),
}


@pytest.mark.slow
@pytest.mark.parametrize("core", CORES)
def test_the_same_bits_on_other_cores(folder, core):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    ran(folder, "make", "clean")
    assert ran(folder, "make", "qemu", *CORES[core]).count("as stated") == 2
    ran(folder, "make", "clean")


@pytest.mark.slow
def test_cppcheck_finds_nothing_that_is_not_listed(folder):
    need("cppcheck", "make")
    ran(folder, "make", "misra")


def test_any_integers_and_damaged_tables(folder):
    need("gcc")
    source = made("stage31", arithmetic="q31").backend
    library = Library(folder, source.decoupler, np.int32)
    rng = np.random.default_rng(0)
    inputs = rng.integers(-(2**31), 2**31, (6, 500)) >> rng.integers(0, 4, 500)
    pose, status = source.step(inputs)
    for column, expected, flags in zip(inputs.T, pose.T, status, strict=True):
        found, said = library.step(column)
        assert said == flags
        assert found.tolist() == expected.tolist()
    assert library.check() == 0
    before = library.table.copy()
    for byte in range(len(before) - 16):
        library.table[byte] ^= 1
        assert library.check() & 0x04
        library.table[:] = before
    at = 24 + 4 * [e.name for e in source.entries].index("gain_hall_b")
    library.table[at : at + 4] = 0
    assert library.check() == 0x0C  # CRC and a gain of nothing
    library.table[:] = before


def test_eva_raises_no_alarm(folder):
    proved_by_eva(folder, integers=True)


@pytest.mark.slow
def test_every_input_and_every_divisor(folder):
    every_input(folder)
