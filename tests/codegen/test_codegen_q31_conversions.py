"""Conversions of the header of integers: macros, in initializers and at run time, against exact arithmetic.

Independent facts: Python's fractions round to the nearest; a power of two scales a double exactly.
"""

import json
from fractions import Fraction
from math import floor, pi

import numpy as np
import pytest
from calibrations import fit_of, made
from firmware import need, ran

from hallsym.codegen import generate

WARNINGS = (
    "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Wcast-qual",
    "-Wundef", "-Werror",
)  # fmt: skip
UNDEFINED = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
MOST = 2147483520
EXTREMES = [(0, 1.0), (1, 1e30), (-1, 1e300), (1, -1e30), (-5, -0.5), (2147483647, 1e-30), (-3, 1e-12)]
PROGRAM = """
#include <stdio.h>
#include "decoupler.h"
static const int32_t made[] = {INITIALIZERS};
int main(void)
{
    static const double values[] = {VALUES};
    static const float floats[] = {FLOATS};
    static const int32_t counts[] = {COUNTS};
    printf("[");
    for (unsigned k = 0U; k < sizeof(made) / sizeof(made[0]); k++) { printf("%ld,", (long)made[k]); }
    for (unsigned k = 0U; k < sizeof(values) / sizeof(values[0]); k++)
    {
        printf("%ld,", (long)DECOUPLER_Z_FROM_SI(values[k]));
    }
    for (unsigned k = 0U; k < sizeof(floats) / sizeof(floats[0]); k++)
    {
        printf("%ld,", (long)DECOUPLER_OUT_RZ_FROM_SI(floats[k]));
    }
    for (unsigned k = 0U; k < sizeof(counts) / sizeof(counts[0]); k++)
    {
        printf("%ld,", (long)DECOUPLER_HALL_A_FROM_COUNTS(counts[k], -3.7e-9));
    }
    const double none = (values[0] - values[0]) / (values[0] - values[0]);
    const float no_float = (float)none;
    printf("%d]\\n", (DECOUPLER_Z_FROM_SI(none) == MOST) && (DECOUPLER_Z_FROM_SI(no_float) == MOST));
    return 0;
}
"""


def nearest(value):
    """The nearest integer of an exact value, halves away from zero, saturated."""
    size = floor(abs(value) + Fraction(1, 2))
    return min(size, MOST) * (1 if value >= 0 else -1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("conversions") / "fw"
    made("stage31", arithmetic="q31").write(out)
    return out


def sources(folder):
    """A program that converts; the integers that it shall print."""
    scale = {c: 2**e for c, e in made("stage31", arithmetic="q31").backend.exponents.items()}
    rng = np.random.default_rng(0)
    exact = rng.integers(-MOST, MOST, 200)
    halves = rng.integers(-(2**24), 2**24, 50) + 0.5
    below = 0.49999999999999994  # whose half more rounds to 1
    ends = [0.0, -0.0, below, -below, 0.5, -0.5, 1.5, MOST, MOST + 1e3, -3e9, 1e30]
    values = np.concatenate([exact, exact + rng.uniform(-0.5, 0.5, 200), halves, ends]) / scale["z_m"]
    units = np.concatenate([exact, exact / 2**20, halves / 4, [8388609, 16777217, -8388609, MOST, 3e9, -3e9]])
    floats = (units / scale["rz_rad"]).astype(np.float32)
    counts = np.concatenate([rng.integers(-(2**23), 2**23, 200), [0, 1, -1, 2**31 - 1, -(2**31) + 1]])
    given = ("1e-4", "-1e-4f", "0", "1e300", "-1e300")
    initial = [f"DECOUPLER_HALL_B_FROM_SI({v})" for v in given]
    initial.append("DECOUPLER_RX_FROM_COUNTS(2048 - 4095, 2.44140625e-7)")
    initial += [f"DECOUPLER_RX_FROM_COUNTS({n}, {unit})" for n, unit in EXTREMES]
    text = PROGRAM
    for name, rows in (
        ("INITIALIZERS", initial),
        ("VALUES", [repr(float(v)) for v in values]),
        ("FLOATS", [f"{float(v)!r}F" for v in floats]),
        ("COUNTS", [str(v) for v in counts]),
    ):
        text = text.replace(f"{{{name}}}", f"{{{', '.join(rows)}}}")
    text = text.replace("MOST", f"(int32_t){MOST}")
    b = scale["hall_b_m"]
    wanted = [nearest(Fraction(1e-4) * b), nearest(Fraction(float(np.float32(-1e-4))) * b), 0, MOST, -MOST]
    wanted.append(nearest(Fraction(2.44140625e-7) * -2047 * scale["rx_rad"]))
    wanted += [nearest(n * Fraction(unit) * scale["rx_rad"]) for n, unit in EXTREMES]
    wanted += [nearest(Fraction(float(v)) * scale["z_m"]) for v in values]
    wanted += [nearest(Fraction(float(v)) * scale["rz_rad"]) for v in floats]
    wanted += [nearest(int(n) * Fraction(-3.7e-9) * scale["hall_a_m"]) for n in counts]
    return text, [*wanted, 1]


@pytest.mark.parametrize(
    "compiler",
    [("gcc", "-std=c99"), ("clang", "-std=c99"), ("g++", "-std=c++11", "-xc++")],
    ids=lambda c: c[0],
)
def test_conversions_round_to_the_nearest_and_saturate(folder, compiler):
    need(compiler[0])
    text, wanted = sources(folder)
    (folder / "conversions.c").write_text(text)
    ran(folder, *compiler, *WARNINGS, *UNDEFINED, "-I.", "conversions.c", "-o", "conversions")
    assert json.loads(ran(folder, "./conversions")) == wanted


def test_a_round_trip_is_exact(folder):
    need("gcc")
    columns = ("HALL_A", "HALL_B", "HALL_C", "Z", "RX", "RY", "OUT_X", "OUT_Y", "OUT_RZ")
    tests = "\n".join(
        f"bad += (DECOUPLER_{c}_FROM_SI(DECOUPLER_{c}_TO_SI((int32_t)q)) == q) ? 0 : 1;" for c in columns
    )
    (folder / "trip.c").write_text(
        '#include "decoupler.h"\nint main(void)\n{\n int bad = 0;\n'
        f" for (int64_t q = -{MOST}; q <= {MOST}; q += 9973)\n {{\n{tests}\n }}\n return bad;\n}}\n"
    )
    ran(folder, "gcc", "-std=c99", "-O2", *WARNINGS, *UNDEFINED, "-I.", "trip.c", "-o", "trip")
    ran(folder, "./trip")


def test_angles_are_converted_round_and_round(tmp_path):
    need("gcc")
    generate(fit_of("meng angle"), arithmetic="q31").write(tmp_path / "fw")
    angles = [0.0, 1.0, -1.0, pi, -pi, 3 * pi, 100.0, -1e6, 1e10, -1e300, 2 * pi - 1e-10]
    rows = ", ".join(f"DECOUPLER_BAM_FROM_SI({a!r})" for a in angles)
    (tmp_path / "fw/angles.c").write_text(
        '#include <stdio.h>\n#include "decoupler.h"\n'
        f"static const uint32_t made[] = {{{rows}, DECOUPLER_BAM_FROM_COUNTS(16383, 14),"
        " DECOUPLER_BAM_FROM_COUNTS(5, 32)};\n"
        'int main(void)\n{\n printf("[");\n for (unsigned k = 0U; k < sizeof(made) / sizeof(made[0]); k++)'
        ' { printf("%lu,", (unsigned long)made[k]); }\n unsigned bad = 0U;\n'
        " for (int64_t q = 0; q < 4294967296; q += 9973)\n {\n"
        " const double si = DECOUPLER_BAM_TO_SI((uint32_t)q);\n"
        " bad += (DECOUPLER_BAM_FROM_SI(si) == (uint32_t)q) ? 0U : 1U; }\n"
        ' printf("%u]\\n", bad);\n return 0;\n}\n'
    )
    ran(tmp_path / "fw", "gcc", "-std=c99", *WARNINGS, *UNDEFINED, "-I.", "angles.c", "-o", "angles")
    *found, first, second, bad = json.loads(ran(tmp_path / "fw", "./angles"))
    for angle, value in zip(angles, found, strict=True):
        turns = angle / (2 * pi) if abs(angle) < 1e9 else 0.0
        off = (value / 2**32 - turns) % 1
        assert min(off, 1 - off) < 2**-32 * max(1.0, abs(turns))
    assert (first, second, bad) == (16383 << 18, 5, 0)
