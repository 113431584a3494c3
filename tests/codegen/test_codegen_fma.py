"""`--fma`: fused multiply-add. Exact by rational numbers; the same bits with and without the instruction."""

import re
from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import waves
from firmware import CASES, GOLDEN, STRICT, Library, made, need, proved_by_eva, ran
from hypothesis import assume, given
from hypothesis import strategies as st

import hallsym
from hallsym.cli.main import main
from hallsym.codegen import enclose, firmware_cost, fused_multiply_add
from hallsym.codegen.intervals import Enclosure
from hallsym.codegen.operations import graph

TESTED = (
    "src/decoupler.c", "src/decoupler_check.c", "params/decoupler_params.c", "test/selftest.c",
    "test/faults.c", "test/main.c",
)  # fmt: skip
PATHS = ("-Iinclude", "-Iparams", "-Itest")
M0 = ("MACHINE=microbit", "CPU=-mcpu=cortex-m0 -mthumb")
M3 = ("MACHINE=mps2-an385", "CPU=-mcpu=cortex-m3 -mthumb")
M7 = ("MACHINE=mps2-an500", "CPU=-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-sp-d16")
BARE = 60
"""Most instructions of the arithmetic alone on a Cortex-M4F; without fused multiply-add they are 67."""
STEP = (96, 116)
"""Most instructions of a step, in range and at worst."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The folder of stage31."""
    path = tmp_path_factory.mktemp("fma") / "decoupler"
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(path), "--fma"]) == 0
    return path


@pytest.fixture(scope="module")
def compiled(folder):
    need("gcc")
    return Library(folder, made("stage31", fma=True).decoupler, np.float32), made("stage31", fma=True)


# -- the operation -------------------------------------------------------------------------------------------

NUMBERS = {
    np.float32: st.floats(
        width=32, allow_nan=False, allow_infinity=False, min_value=-(2.0**50), max_value=2.0**50
    ),
    np.float64: st.floats(allow_nan=False, allow_infinity=False, min_value=-1e140, max_value=1e140),
}


def nearest(exact, found, real):
    """Whether no number of a type is nearer to a rational one, and of two as near the even one is taken."""
    error = abs(Fraction(float(found)) - exact)
    sides = [np.nextafter(found, real(end)) for end in (-np.inf, np.inf)]
    others = [abs(Fraction(float(side)) - exact) for side in sides]
    bits = np.array(found).view(np.uint32 if real is np.float32 else np.uint64)
    return error < min(others) or (error == min(others) and int(bits) % 2 == 0)


@pytest.mark.parametrize("real", NUMBERS, ids=["float", "double"])
@given(st.data())
def test_a_product_and_a_sum_round_once(real, data):
    a, b, c = (real(data.draw(NUMBERS[real])) for _ in range(3))
    if data.draw(st.booleans()):  # where much cancels
        with np.errstate(all="ignore"):
            c = real(-a * b)
    assume(np.isfinite(c))
    found = fused_multiply_add(*(np.array([x]) for x in (a, b, c)))[0]
    assert found.dtype == real
    assert nearest(Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c)), found, real)


def test_where_rounding_twice_is_wrong():
    """1 + 2^-24 lies half-way between two floats; what decides is lost in double."""
    a, b, c = (np.float32([x]) for x in (1 + 2**-12, 1 - 2**-12, 2.0**-24 + 2.0**-24))
    assert fused_multiply_add(a, b, c)[0] == np.float32(1 + 2**-24)
    a, b, c = (np.float32([x]) for x in (2.0**-30, 2.0**-30, 1 + 2.0**-23))
    half = np.float32([2.0**-24])
    assert fused_multiply_add(half, np.float32([1 + 2**-23]), np.float32([1.0]))[0] == 1 + 2.0**-23
    assert fused_multiply_add(half, np.float32([1.0]), np.float32([1.0]))[0] == 1.0
    assert fused_multiply_add(a, b, c)[0] == c[0]


def test_signs_of_zero_are_those_of_product_and_sum():
    zero, one = np.zeros(1), np.ones(1)
    for real in NUMBERS:
        a, b = zero.astype(real), one.astype(real)
        assert not np.signbit(fused_multiply_add(a, b, a))[0]
        assert np.signbit(fused_multiply_add(-a, b, -a))[0]
        assert not np.signbit(fused_multiply_add(b, b, -b))[0]


# -- arithmetic and bounds -----------------------------------------------------------------------------------


COMPARED = ("stage31", "four probes")
"""Cases that are compared in every run: three probes and four."""


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=() if c in COMPARED else pytest.mark.slow) for c in CASES]
)
def test_never_more_operations_and_never_a_larger_bound(case):
    fused, plain = made(case, fma=True), made(case)
    assert firmware_cost(fused.decoupler, fused=True).operations < firmware_cost(plain.decoupler).operations
    for column, bound in fused.bounds.error.items():
        assert bound <= plain.bounds.error[column]
        assert fused.errors[column] <= bound


def test_a_product_that_is_used_twice_is_computed_once():
    x, y = hallsym.build("stage31").symbols.state[0], hallsym.build("stage31").symbols.state[1]
    once = [o.op for o in graph([x * y + 1], fused=True).operations if o.op in ("mul", "fma")]
    assert once == ["fma"]
    product = x * y
    both = [o.op for o in graph([product + x, product - y], fused=True).operations]
    assert both.count("mul") == 1
    assert not {"fma", "fms", "fnma"} & set(both)


@given(st.lists(st.floats(-8, 8, width=32), min_size=6, max_size=6), st.integers(0, 2))
def test_the_bound_of_one_operation_holds(ends, form):
    a, b, c = (ca.SX.sym(n) for n in "abc")
    expression = (a * b + c, a * b - c, c - a * b)[form]
    pairs = [sorted(ends[k : k + 2]) for k in (0, 2, 4)]
    given_ends = {n: Enclosure(*pair) for n, pair in zip("abc", pairs, strict=True)}
    (found,) = enclose([expression], given_ends, 24, fused=True)
    for share in (0.0, 0.37, 1.0):
        u, v, w = (np.float32([low + (high - low) * share]) for low, high in pairs)
        got = fused_multiply_add(*((u, v, w), (u, v, -w), (-u, v, w))[form])[0]
        exact = float((u.astype(float) * v + w, u.astype(float) * v - w, w - u.astype(float) * v)[form][0])
        assert found.low - 1e-12 <= exact <= found.high + 1e-12
        assert abs(float(got) - exact) <= found.error + 1e-15


# -- C -------------------------------------------------------------------------------------------------------


def instruction(compiler):
    """The option that makes a compiler use the instruction, where this machine has it."""
    info = Path("/proc/cpuinfo")
    return ["-mfma"] if info.exists() and re.search(r"\bfma\b", info.read_text()) else []


@pytest.mark.parametrize("compiler", ["gcc", pytest.param("clang", marks=pytest.mark.slow)])
def test_the_same_bits_with_and_without_the_instruction(folder, tmp_path, compiler):
    need(compiler)
    for options in {(), tuple(instruction(compiler))}:
        out = str(tmp_path / "selftest")
        ran(folder, compiler, *STRICT, "-Wshadow", "-pedantic", *options, *PATHS, *TESTED, "-o", out)
        said = ran(folder, out)
        assert "table good, 0 of" in said
        assert said.count("as stated") == 2
        assert "0 faults of a table not found, 0 zeros wrong" in said


LATER = [pytest.param(m, marks=pytest.mark.slow) for m in (M0, M3, M7)]


@pytest.mark.parametrize("machine", [(), *LATER], ids=["M4F", "M0", "M3", "M7"])
def test_the_same_bits_on_a_cortex_m(folder, machine):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    ran(folder, "make", "clean")
    said = ran(folder, "make", "qemu", *machine)
    assert "0 of" in said
    assert said.count("as stated") == 2
    ran(folder, "make", "clean")


def test_instructions_on_a_cortex_m4f(folder):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    said = ran(folder, "make", "count")
    bare = int(re.search(r"decoupler_bare, \d+ bytes, instructions per call: (\d+)", said)[1])
    step = re.search(r"decoupler_step, (\d+) bytes, instructions per call: (.*)", said)
    counts = [int(n) for n in step[2].split()]
    assert bare <= BARE
    assert counts[0] <= STEP[0]
    assert max(counts) <= STEP[1]
    assert int(step[1]) <= 400
    assert abs(firmware_cost(made("stage31").decoupler, fused=True).instructions / bare - 1) < 0.1
    kinds = {line.split()[-2] for line in ran(folder, "arm-none-eabi-nm", "build/decoupler.o").splitlines()}
    assert kinds == {"T", "U"}  # U: decoupler_crc alone
    assert "fma" not in ran(folder, "arm-none-eabi-nm", "-u", "build/decoupler.o")


def test_compiled_without_a_library(folder):
    need("arm-none-eabi-gcc")
    for core in ("cortex-m0", "cortex-m3", "cortex-m4 -mfloat-abi=soft"):
        options = ["-ffreestanding", *f"-mcpu={core}".split(), "-mthumb"]
        ran(folder, "arm-none-eabi-gcc", *STRICT, *options, *PATHS, "-c", "src/decoupler.c", "-o", "free.o")
        undefined = ran(folder, "arm-none-eabi-nm", "-u", "free.o")
        assert not re.search(r"\bfmaf?\b", undefined)


def test_proofs_and_misra(folder):
    need("cppcheck", "make", "gappa")
    ran(folder, "make", "misra")
    ran(folder, "gappa", "proof/rounding.g")
    assert "rnd(" in (folder / "proof/rounding.g").read_text()
    proved_by_eva(folder)


LONG = [
    pytest.param(c, marks=pytest.mark.slow) for c in CASES if c not in ("stage31", "cubic", "four probes")
]


@pytest.mark.parametrize("case", ["four probes", *LONG])
def test_gappa_confirms_the_bound(tmp_path, case):
    need("gappa")
    code = made(case, fma=True)
    code.write(tmp_path / "fw")
    ran(tmp_path / "fw", "gappa", "proof/rounding.g")


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_model_with_slopes(tmp_path, case):
    need("gcc", "make")
    made(case, fma=True, jacobian=True).write(tmp_path / "fw")
    assert "0 of" in ran(tmp_path / "fw", "make", "check")


@pytest.mark.slow
@pytest.mark.parametrize("axes", [1, 6])
def test_magnet_arrays(tmp_path, axes):
    need("gcc", "make")
    tilted = {"count": 3, "gaps": (0.0065, 0.0085), "tilt": 0.003, "travel": 0.0135}
    fit = waves.calibrated() if axes == 1 else waves.calibrated_planar(**tilted)
    code = hallsym.generate(fit, fma=True, accuracy=None if axes == 1 else 5e-6)
    code.write(tmp_path / "fw")
    assert ran(tmp_path / "fw", "make", "check").count("as stated") == 2
    for column, bound in code.backend.error_bound.items():
        assert code.errors[column] <= bound
    assert firmware_cost(code.decoupler, fused=True).operations < firmware_cost(code.decoupler).operations


@pytest.mark.slow
def test_doubles_where_core_or_host_has_them(tmp_path):
    need("gcc", "make", "arm-none-eabi-gcc", "qemu-system-arm")
    code = made("stage31", fma=True, double=True)
    code.write(tmp_path / "fw")
    for target in ("check", "qemu"):  # a host's library, and a Cortex-M7 with doubles
        assert ran(tmp_path / "fw", "make", target).count("as stated") == 2
    with pytest.raises(AssertionError, match="generate without --fma"):
        ran(tmp_path / "fw", "make", "qemu", "-B", "CPU=-mcpu=cortex-m4 -mthumb -mfloat-abi=soft")


@given(st.lists(st.integers(0, 2**32 - 1), min_size=6, max_size=6))
def test_whatever_the_bits_c_and_its_emulation_agree(compiled, bits):
    library, code = compiled
    inputs = np.array(bits, dtype=np.uint32).view(np.float32)
    pose, status = library.step(inputs)
    expected, flags = code.backend.step(inputs[:, None])
    assert (status, pose.tobytes()) == (flags[0], expected[:, 0].tobytes())


# -- options -------------------------------------------------------------------------------------------------


def test_a_recalibration_remembers_it(folder, capsys):
    before = (folder / "src/decoupler.c").read_bytes()
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(folder), "--params-only"]) == 0
    assert "wrote" in capsys.readouterr().out
    assert (folder / "src/decoupler.c").read_bytes() == before
    assert '"fma": true' in (folder / "params/decoupler_params.json").read_text()


def test_code_without_it_reads_another_table(folder, tmp_path, capsys):
    plain = tmp_path / "plain"
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(plain)]) == 0
    capsys.readouterr()
    command = ["codegen", str(GOLDEN / "calib.json"), "-o", str(plain), "--params-only", "--fma"]
    assert main(command) != 0
    assert "reads another table" in capsys.readouterr().err


def test_integers_have_none(capsys, tmp_path):
    command = ["codegen", str(GOLDEN / "calib.json"), "-o", str(tmp_path / "fw"), "--fma"]
    assert main([*command, "--arithmetic", "q31"]) != 0
    assert "--fma belongs to --arithmetic float" in capsys.readouterr().err
