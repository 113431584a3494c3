"""The generated C of a stage: golden copy, zeros, interrupts, damaged tables, C++, slopes of the pose.

At a pose the readings are f(pose, state), so d pose / d reading is the inverse of f's slope by the pose. What
holds for C of every kind is in `test_codegen_every`. What is missing is skipped with its name; in continuous
integration everything must be there.
"""

import re
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from calibrations import fit_of, made
from firmware import (
    GOLDEN,
    PATHS,
    STAGES,
    STRICT,
    Library,
    instructions,
    need,
    passes,
    proved_by_eva,
    ran,
    written,
)

from hallsym.cli.main import main
from hallsym.codegen import Generated
from hallsym.codegen.cost import firmware_cost


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
    return Library(golden, code), code


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


# -- behaviour, through the compiled library ---------------------------------------------------------------


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


def test_every_bit_of_a_table_that_is_turned_is_found(compiled):
    """The self-test turns words, and puts numbers beyond their ends with the CRC put right."""
    library, _ = compiled
    assert library.check() == 0
    for byte in range(136):
        for bit in range(8):
            library.table[byte] ^= 1 << bit
            assert library.check() & (0x40 if byte >= 120 else 0x04)
            library.table[byte] ^= 1 << bit
    assert library.check() == 0


@pytest.mark.slow
def test_the_estimate_of_a_cost_follows_what_is_counted(tmp_path):
    """It is that of the arithmetic alone."""
    cases = ("stage31", "user's height_quadratic")
    plain, bent = (instructions(made(c), written(made(c), tmp_path / c[:7]))[0] for c in cases)
    costs = [firmware_cost(made(case).decoupler) for case in cases]
    assert [c.table for c in costs] == [len(made(case).backend.binary) for case in cases]
    low, high = (cost.instructions for cost in costs)
    assert high - low == pytest.approx(bent - plain, abs=1)
    assert 0.6 * plain < low < plain


@pytest.mark.slow
@pytest.mark.parametrize("case", ["stage31", "four probes", "exact_rotation"])
def test_eva_proves_slopes_too_and_notices_a_gain_that_comes_to_nothing(tmp_path, case):
    folder = written(made(case, jacobian=True), tmp_path / "fw")
    proved_by_eva(folder)
    proof = folder / "proof/eva.c"
    wider = re.sub(r"(table.gain_hall_a = Frama_C_float_interval\()[^,]*", r"\g<1>0.0f", proof.read_text())
    proof.write_text(wider)
    with pytest.raises(AssertionError):
        proved_by_eva(folder)


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


# -- slopes


@cache
def implied(case):
    """The slopes of the pose by the readings by the implicit function theorem."""
    fit = fit_of(case)
    model = fit.model
    pose, state = ca.SX.sym("pose", len(model.pose)), ca.SX.sym("state", len(model.state))
    reading = model.reading(fit.values, np.zeros(len(model.offsets)), pose, state)
    slopes = ca.inv(ca.jacobian(reading, pose))
    return ca.Function("implied", [pose, state], [reading, slopes])


def slopes_of(library, inputs, shape):
    out = np.zeros(shape, library.dtype)
    return library.call("decoupler_jacobian", library.table, np.asarray(inputs, library.dtype), out), out


@pytest.mark.slow
@pytest.mark.parametrize("case", ["stage31", "vertical_offset_coupling", "exact_rotation"])
def test_they_are_those_of_the_model(tmp_path, case):
    need("gcc")
    code = made(case, jacobian=True)
    library = Library(written(code, tmp_path / "fw"), code)
    (listed,) = re.findall(r"slope_bounds\[9\] = \{(.*)\}", str(code.files["test/selftest_vectors.h"]))
    bound = np.array([float(v) for v in listed.split(", ")]).reshape(3, 3)
    rng = np.random.default_rng(5)
    for _ in range(20):
        pose, state = rng.uniform(-1e-4, 1e-4, 3), rng.uniform(-1e-4, 1e-4, 3)
        reading, expected = (np.asarray(part) for part in implied(case)(pose, state))
        status, found = slopes_of(library, np.concatenate([reading.ravel(), state]), (3, 3))
        assert status == 0
        assert (np.abs(found - expected) <= bound).all()


LATER = [pytest.param(c, marks=pytest.mark.slow) for c in STAGES if c != "stage31"]


@pytest.mark.parametrize("case", ["stage31", *LATER])
def test_the_self_test_holds_them(tmp_path, case):
    code = made(case, jacobian=True)
    passes(written(code, tmp_path / "fw"))
    bounds = [b for b in str(code.files["test/selftest_vectors.h"]).splitlines() if "slope_bounds" in b]
    assert bounds[0].count(",") + 1 == 3 * len(code.decoupler.model.channels)


@pytest.mark.slow
def test_a_wrong_slope_is_noticed(tmp_path):
    need("gcc", "make")
    code = made("stage31", jacobian=True)
    for name in ("x_hall_a", "rz_hall_b", "y_hall_c"):
        folder = tmp_path / name
        code.write(folder)
        source = folder / "decoupler.c"
        text = source.read_text()
        assert f"slopes->{name} = " in text
        source.write_text(text.replace(f"slopes->{name} = ", f"slopes->{name} = 1.00001f * "))
        with pytest.raises(AssertionError, match=r"85 vectors failed"):
            ran(folder, "make", "check")
