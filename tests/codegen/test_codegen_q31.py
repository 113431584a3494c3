"""The integer decoupler: against the model in double, its bits on this machine and on a Cortex-M0, refusals.

Independent facts: exact products of Python's integers; the model's decoded pose; 32 bits never overflow.
"""

import re

import numpy as np
import pytest
from firmware import (
    CASES,
    GOLDEN,
    Library,
    calibration,
    height_quadratic,
    made,
    need,
    proved_by_eva,
    ran,
    with_effect,
)
from hypothesis import given
from hypothesis import strategies as st

from hallsym.cli.main import main
from hallsym.codegen import Line, Program, box_of, generate, integer_program, lower
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
    with pytest.raises(InputError, match="linear in the pose"):
        generate(CASES["cubic"](), arithmetic="q31")


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
    need(compiler, "make")
    ran(folder, "make", "clean")
    said = ran(folder, "make", "check", f"CC={compiler}")
    assert "table good, 0 of" in said
    assert said.count("as stated") == 2
    assert "0 faults of a table not found, 0 zeros wrong" in said


@pytest.mark.parametrize("case", ["four probes", pytest.param("stage15", marks=pytest.mark.slow)])
def test_other_models_compile_and_pass(tmp_path, case):
    need("gcc", "make")
    generate(CASES[case](), arithmetic="q31", ranges={"z_m": (-1e-4, 2.5e-4)}).write(tmp_path / "fw")
    assert "as stated" in ran(tmp_path / "fw", "make", "check")


def test_stated_bits_and_instructions_on_a_cortex_m0(folder):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    assert "as stated" in ran(folder, "make", "qemu")
    said = ran(folder, "make", "count")
    counts = re.search(r"decoupler_step, \d+ bytes, instructions per call: (.*)", said)
    assert max(map(int, counts[1].split())) <= 850
    symbols = ran(folder, "arm-none-eabi-nm", "build/decoupler.o")
    foreign = [line.split()[-1] for line in symbols.splitlines() if " U " in line]
    assert foreign == ["decoupler_crc"]  # no division, no 64-bit product of a library


CORES = {
    "M0": (),
    "M3": ("MACHINE=mps2-an385", "CPU=-mcpu=cortex-m3 -mthumb"),
    "M4": ("MACHINE=mps2-an386", "CPU=-mcpu=cortex-m4 -mthumb"),
    "M7": ("MACHINE=mps2-an500", "CPU=-mcpu=cortex-m7 -mthumb"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", ["stage31", "encoder"])
def test_a_million_inputs_behave_and_give_the_same_bits_on_every_core(case, tmp_path):
    need("gcc", "make", "arm-none-eabi-gcc", "qemu-system-arm")
    made_of = made("stage31", arithmetic="q31") if case == "stage31" else encoder()
    made_of.write(tmp_path / "fw")
    main_c = tmp_path / "fw/million.c"
    main_c.write_text(
        '#include <stdio.h>\n#include "selftest.h"\n'
        'int main(void) { printf("%lx\\n", (unsigned long)decoupler_hash(1000000U)); return 0; }\n'
    )
    sources = ["src/decoupler.c", "src/decoupler_check.c", "params/decoupler_params.c", "test/selftest.c"]
    ran(
        tmp_path / "fw", "gcc", "-std=c99", "-O2", "-fsanitize=undefined",
        "-fsanitize-undefined-trap-on-error", "-Iinclude", "-Iparams", "-Itest", *sources, "million.c",
        "-o", "million",
    )  # fmt: skip
    assert int(ran(tmp_path / "fw", "./million"), 16) == made_of.backend.hash(1_000_000)
    for core, machine in CORES.items():
        ran(tmp_path / "fw", "make", "clean")
        assert ran(tmp_path / "fw", "make", "qemu", *machine).count("as stated") == 2, core


def encoder():
    from test_codegen_correction import fit_of

    return generate(fit_of("meng volts"), arithmetic="q31")


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
    assert library.check() == 0x24  # CRC and a gain of nothing
    library.table[:] = before


def test_eva_raises_no_alarm(folder):
    proved_by_eva(folder, integers=True)


@pytest.mark.slow
def test_every_input_and_every_divisor(folder):
    need("gcc")
    ran(
        folder, "gcc", "-std=c99", "-O3", "-fsanitize=signed-integer-overflow",
        "-fsanitize-undefined-trap-on-error", "-Iinclude", "-Iparams", "proof/exhaustive.c",
        "src/decoupler_check.c", "params/decoupler_params.c", "-o", "exhaustive",
    )  # fmt: skip
    assert "exhaustive: 0 of" in ran(folder, "./exhaustive")
