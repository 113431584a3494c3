"""The generated C itself: golden copy, compilers, this machine and a Cortex-M in QEMU, proofs, MISRA.

What is missing is skipped with its name; in continuous integration everything must be there.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from firmware import (
    CASES,
    GOLDEN,
    PATHS,
    STRICT,
    TESTED,
    Library,
    calibration,
    every_input,
    instructions,
    made,
    need,
    passes,
    proved_by_eva,
    ran,
    undefined_symbols,
    written,
)
from hypothesis import given
from hypothesis import strategies as st

from hallsym.cli.main import main
from hallsym.codegen import Generated
from hallsym.codegen.cost import firmware_cost

CORTEX_M0 = ("MACHINE=microbit", "CPU=-mcpu=cortex-m0 -mthumb")


@pytest.fixture(scope="module")
def golden(tmp_path_factory) -> Path:
    """The golden folder, generated again."""
    folder = tmp_path_factory.mktemp("golden") / "decoupler"
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def compiled(golden) -> tuple[Library, Generated]:
    need("gcc")
    code = made("stage31")
    return Library(golden, code.decoupler, code.backend.real.dtype), code


def test_the_golden_copy_is_what_is_generated(golden):
    """What a user reads: code, interface and table."""
    kept = GOLDEN / "decoupler"
    names = [str(p.relative_to(kept)) for p in kept.rglob("*") if p.is_file()]
    assert {"decoupler.c", "decoupler.h", "decoupler_params.c"} == set(names)
    for name in sorted(names):
        made_, wanted = (
            re.sub(r"hallsym \d[\w.+]*", "hallsym", (f / name).read_text()) for f in (golden, kept)
        )
        assert made_ == wanted, (
            f"{name} differs from tests/golden/decoupler: review it, generate it with hallsym codegen "
            "tests/golden/calib.json, and copy it there"
        )


def test_the_whole_footprint_is_printed(golden):
    need("arm-none-eabi-gcc", "make")
    said = ran(golden, "make", "-s", "size")
    flash, stack = said.split("stack")
    sizes = {line.split(maxsplit=1)[1]: int(line.split()[0]) for line in flash.splitlines()[1:]}
    parts = ("step", "zero", "check", "crc", "params")
    ends = sum(size for name, size in sizes.items() if name.startswith("ends."))  # of the check
    assert sum(sizes[f"decoupler_{part}"] for part in parts) + ends == sizes["in all"]
    assert ends >= 8 * len(made("stage31").decoupler.entries)
    assert sizes["decoupler_params"] == len((golden / "table/decoupler_params.bin").read_bytes())
    assert all(f"decoupler_{part}" in stack for part in parts[:-1])


@pytest.mark.slow
@pytest.mark.parametrize(("compiler", "level"), [("gcc", "-O0"), ("clang", "-O3")])
def test_compilers_warn_of_nothing_and_give_the_stated_bits(golden, compiler, level):
    passes(golden, level, compiler=compiler)


@pytest.mark.slow
def test_doubles_pass_their_self_test(tmp_path):
    passes(written(made("stage31", double=True), tmp_path / "fw"))


# -- behaviour, through the compiled library ---------------------------------------------------------------

BITS = st.lists(st.integers(0, 2**32 - 1), min_size=6, max_size=6)


@given(BITS)
def test_whatever_the_bits_c_and_its_emulation_agree(compiled, bits):
    library, code = compiled
    inputs = np.array(bits, dtype=np.uint32).view(np.float32)
    pose, status = library.step(inputs)
    expected, flags = code.backend.step(inputs[:, None])
    assert status == flags[0]
    assert pose.tobytes() == expected[:, 0].tobytes()
    assert np.isfinite(pose).all()


def test_each_bit_is_its_own_input(compiled):
    library, code = compiled
    header = str(code.files["decoupler.h"])
    for k, column in enumerate(code.decoupler.inputs):
        bit = re.search(rf"#define DECOUPLER_STATUS_{column.rpartition('_')[0].upper()} (0x\w+)UL", header)
        for value in (np.nan, np.inf, -np.inf, code.decoupler.ends(column)[1] * 1.01):
            inputs = np.zeros(6, np.float32)
            inputs[k] = value
            assert library.step(inputs)[1] == int(bit[1], 16) == 1 << k
    for end in (0, 1):  # the ends themselves are inside
        ends = np.array([code.decoupler.ends(c)[end] for c in code.decoupler.inputs], np.float32)
        assert library.step(ends)[1] == 0


def test_the_zero_belongs_to_a_reset(compiled):
    library, _ = compiled
    before = library.table.copy()
    fit, rng = calibration(), np.random.default_rng(2)
    delta, state = rng.uniform(-8e-6, 8e-6, 3), rng.uniform(-2e-4, 2e-4, 3)
    known = np.array([1e-4, -5e-5, 2e-4])

    def reading(pose, state):
        return np.asarray(fit.model.reading(fit.values, delta, pose, state)).ravel()

    try:
        assert library.zero(np.concatenate([reading(known, state), state]), known) == 0
        for _ in range(20):
            pose, state = rng.uniform(-2e-4, 2e-4, 3), rng.uniform(-2e-4, 2e-4, 3)
            found, status = library.step(np.concatenate([reading(pose, state), state]))
            assert status == 0
            assert np.abs(found - pose).max() < 2e-9
        assert library.check() == 0  # the zeros have a CRC of their own
        zeroed = library.table.copy()
        assert library.zero(np.full(6, np.nan), known) == 0b111111
        assert library.zero(np.zeros(6), np.array([np.nan, 0, 0])) == 1 << 31
        assert library.zero(np.zeros(6), np.array([0, 2.0, 0])) == 1 << 31
        assert (library.table == zeroed).all()
    finally:
        library.table[:] = before


INTERRUPTED = """
#include "decoupler.h"
#include "decoupler_params.h"

static decoupler_params_t table;
static decoupler_in_t in;
static decoupler_out_t meanwhile;

uint32_t decoupler_crc(const uint8_t *bytes, uint32_t count) /* called before the zeros are stored */
{
    (void)decoupler_step(&table, &in, &meanwhile);
    return (uint32_t)bytes[0] + count;
}

int main(void)
{
    const decoupler_out_t known = {0};
    decoupler_out_t before;
    decoupler_out_t after;
    table = decoupler_params;
    table.zero_x = 5e-4F;
    (void)decoupler_step(&table, &in, &before);
    const uint32_t status = decoupler_zero(&table, &in, &known);
    (void)decoupler_step(&table, &in, &after);
    return ((status == 0U) && (before.x_m > 4.9e-4F) && (meanwhile.x_m == before.x_m) &&
            (after.x_m < 1e-9F)) ? 0 : 1;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("case", ["stage31", "exact_rotation"])
@pytest.mark.parametrize("arithmetic", ["float", "q31"])
def test_an_interrupt_while_a_zero_is_taken_sees_the_old_one(case, arithmetic, tmp_path):
    need("gcc")
    if (case, arithmetic) == ("exact_rotation", "q31"):
        pytest.skip("integers are for models that are linear in the pose")
    folder = written(made(case, arithmetic=arithmetic), tmp_path / "fw")
    of_integers = INTERRUPTED.replace("5e-4F", "1000000").replace("4.9e-4F", "900000").replace("1e-9F", "1")
    (folder / "interrupted.c").write_text(INTERRUPTED if arithmetic == "float" else of_integers)
    files = ["decoupler.c", "decoupler_params.c", "interrupted.c"]
    ran(folder, "gcc", *STRICT, *PATHS, *files, "-o", "interrupted")
    ran(folder, "./interrupted")


@pytest.mark.parametrize("case", ["exact_rotation", pytest.param("cubic", marks=pytest.mark.slow)])
def test_the_zero_of_a_non_linear_model(tmp_path, case):
    need("gcc")
    fit, code = CASES[case](), made(case)
    library = Library(written(code, tmp_path / "fw"), code.decoupler, code.backend.real.dtype)
    rng = np.random.default_rng(2)
    delta, state, known = (
        rng.uniform(-8e-6, 8e-6, 3),
        rng.uniform(-2e-4, 2e-4, 3),
        np.array([1e-4, -5e-5, 2e-4]),
    )
    # delta is seen by the non-linear field like a displacement: a zero is exact at the pose it was taken at
    inputs = np.concatenate([np.asarray(fit.model.reading(fit.values, delta, known, state)).ravel(), state])
    assert library.zero(inputs, known) == 0
    found, status = library.step(inputs)
    assert status == 0
    assert np.abs(found - known).max() < 2e-9


def test_a_damaged_table_is_found(compiled):
    library, code = compiled
    before = library.table.copy()
    floats = library.table.view(np.float32)
    first = 6
    finds = {"number": 0x08, "limits": 0x10}
    names = [e.name for e in code.decoupler.entries]
    try:
        assert library.check() == 0
        for byte in range(136):  # a CRC covers every bit
            for bit in range(8):
                library.table[byte] ^= 1 << bit
                assert library.check() & (0x40 if byte >= 120 else 0x04)
                library.table[byte] ^= 1 << bit
        for at, bits in (
            (4, 0x05),
            (8, 0x06),
            (12, 0x06),
            (16, 0x04),
        ):  # version, layout, length, calibration
            library.table[at] ^= 1
            assert library.check() == bits
            library.table[at] ^= 1
        for name, value, what in (
            ("y_hall_c", np.nan, "number"),
            ("gain_hall_a", np.inf, "number"),
            ("limit_z", -1e-4, "limits"),
            ("gain_hall_b_z", 1e4, "number"),  # it would take all of the gain
        ):
            floats[first + names.index(name)] = value
            assert library.check() & finds[what], name
            library.table[:] = before
    finally:
        library.table[:] = before


# -- Cortex-M ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_same_bits_on_a_cortex_m4f(golden):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    said = ran(golden, "make", "qemu")
    assert said.count("as stated") == 2


M3 = ("MACHINE=mps2-an385", "CPU=-mcpu=cortex-m3 -mthumb")
M7 = ("MACHINE=mps2-an500", "CPU=-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-sp-d16")


@pytest.mark.slow
@pytest.mark.parametrize("machine", [CORTEX_M0, M3, M7], ids=["M0", "M3", "M7"])
def test_same_bits_on_other_cores(golden, machine):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make")
    ran(golden, "make", "clean")
    assert ran(golden, "make", "qemu", *machine).count("as stated") == 2
    ran(golden, "make", "clean")


@pytest.mark.slow
def test_instructions_on_a_cortex_m4f_and_nothing_static_nothing_from_libraries(tmp_path):
    """The estimate of `firmware_cost` is that of the arithmetic alone."""
    typical = {}
    for case in ("stage31", "user's height_quadratic"):
        code, folder = made(case), tmp_path / case.partition("'")[0]
        typical[case], *others = instructions(code, written(code, folder))
        assert undefined_symbols(folder) == {"decoupler_crc"}  # decoupler_check.c
        assert firmware_cost(code.decoupler).table == len(code.backend.binary)
        if case == "stage31":
            assert typical[case] <= 102
            assert max(others) <= 122
    estimated = {case: firmware_cost(made(case).decoupler).instructions for case in typical}
    plain, bent = typical
    assert estimated[bent] - estimated[plain] == pytest.approx(typical[bent] - typical[plain], abs=1)
    assert 0.6 * typical[plain] < estimated[plain] < typical[plain]


# -- proofs and MISRA ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_cppcheck_finds_no_misra_violation_that_is_not_listed(golden):
    need("cppcheck", "make")
    ran(golden, "make", "misra")


LATER = [pytest.param(c, marks=pytest.mark.slow) for c in ("four probes", "exact_rotation")]


@pytest.mark.slow
@pytest.mark.parametrize("case", ["stage31", *LATER])
def test_eva_raises_no_alarm(tmp_path, case):
    folder = written(made(case, jacobian=True), tmp_path / "fw")
    proved_by_eva(folder)
    proof = folder / "proof/eva.c"
    wider = re.sub(r"(table.gain_hall_a = Frama_C_float_interval\()[^,]*", r"\g<1>0.0f", proof.read_text())
    proof.write_text(wider)
    with pytest.raises(AssertionError):  # a gain that comes to nothing
        proved_by_eva(folder)


@pytest.mark.slow
def test_every_bit_pattern_passes_the_range_test(golden):
    every_input(golden)


def test_the_header_is_also_cpp(golden, tmp_path):
    need("g++")
    user = tmp_path / "user.cpp"
    user.write_text(
        '#include "decoupler.h"\n#include "decoupler_params.h"\n'
        "int main() { decoupler_out_t q; decoupler_in_t in = {}; const auto *p = &decoupler_params; "
        "return static_cast<int>(decoupler_step(p, &in, &q) + decoupler_check(p)); }\n"
    )
    c, cpp = ("gcc", "-std=c99"), ("g++", "-std=c++11", "-Wall", "-Wextra", "-pedantic", "-Werror")
    for source in ("decoupler.c", "decoupler_check.c", "decoupler_params.c"):
        ran(golden, *c, *PATHS, "-c", source, "-o", str(tmp_path / f"{Path(source).stem}.o"))
    objects = [str(p) for p in sorted(tmp_path.glob("*.o"))]
    ran(golden, *cpp, *PATHS, str(user), *objects, "-o", str(tmp_path / "user"))
    ran(golden, str(tmp_path / "user"))  # links by extern "C"; status 0: zero is in the box


@pytest.mark.slow
def test_the_self_test_runs_every_line_and_takes_every_branch_of_a_sample(golden, tmp_path):
    need("gcc", "gcov")
    out = str(tmp_path / "selftest")
    sources = [str(golden / name) for name in TESTED]
    include = [f"-I{golden}", f"-I{golden / 'test'}"]
    ran(tmp_path, "gcc", "-std=c99", "-O0", "--coverage", *include, *sources, "-o", out)
    ran(tmp_path, out)
    said = ran(tmp_path, "gcov", "-b", "-n", *map(str, tmp_path.glob("*-decoupler.gcda")))
    own = said[said.index("decoupler.c'") :]
    assert "Lines executed:100.00%" in own
    assert "Taken at least once:100.00%" in own


@pytest.mark.slow
def test_cmake_builds_it(golden, tmp_path):
    need("cmake", "gcc")
    ran(golden, "cmake", "-S", ".", "-B", str(tmp_path), "-DDECOUPLER_SELFTEST=ON")
    ran(golden, "cmake", "--build", str(tmp_path))
    assert "0 of" in ran(tmp_path, "./decoupler_selftest")
