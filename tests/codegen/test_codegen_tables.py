"""Tables with a right CRC that no calibration made: those that `decoupler_check()` accepts give numbers.

Ten thousand for each case, in one program: bits turned, or numbers put at their least and greatest value. It
is compiled to stop at a signed overflow, at a division by zero and at a conversion that overflows.
"""

import re

import numpy as np
import pytest
from calibrations import made
from firmware import PATHS, SANITIZED, calibration, need, ran, written
from test_codegen_every import EVERY

from hallsym.codegen import generate
from hallsym.errors import InputError

TABLES = 10_000

CASES = (
    "stage31", "exact_rotation", "cubic", "clipped 5 mrad", "meng volts", "three sums",
    "five sums", "stage31 q31", "meng volts q31", "meng angle q31",
)  # fmt: skip
SLOW = ("travel", "12 sums")

PROGRAM = """
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "../decoupler_check.c"
#include "decoupler_params.h"

static uint32_t state = 1U;
static uint32_t drawn(void)
{
    state ^= state << 13U;
    state ^= state >> 17U;
    state ^= state << 5U;
    return state;
}

int main(void)
{
    static const struct { VALUE least, greatest; } ends[] = {ENDS};
    static const VALUE low[INPUTS] = {LOW};
    static const VALUE high[INPUTS] = {HIGH};
    unsigned accepted[2] = {0U, 0U}, bad = 0U, lost = 0U;
    for (uint32_t n = 0U; n < TABLES; n++)
    {
        decoupler_params_t table = decoupler_params;
        uint8_t *bytes = (uint8_t *)&table;
        const uint32_t size = LENGTH - FIRST;
        const uint32_t kind = n & 1U;
        for (uint32_t k = (kind == 0U) ? (drawn() % 3U) + 1U : 0U; k > 0U; k--)
        {
            bytes[FIRST + (drawn() % size)] ^= (uint8_t)(1U << (drawn() % 8U));
        }
        for (uint32_t k = 0U; (kind == 1U) && (k < COUNT); k++)
        {
            const uint32_t to = drawn() % 8U;
            if (to < 2U)
            {
                const VALUE end = END;
                (void)memcpy(&bytes[AT], &end, sizeof(end));
            }
        }
        table.crc = decoupler_crc(&bytes[COVERED], ZEROS_CRC - COVERED);
        table.zeros_crc = decoupler_crc(&bytes[ZEROS], LENGTH - ZEROS);
        const uint32_t found = decoupler_check(&table);
        lost += ((found & ~(uint32_t)0x78U) == 0U) ? 0U : 1U;
        for (uint32_t k = 0U; (found == 0U) && (k < 24U); k++)
        {
            VALUE given[INPUTS];
            decoupler_in_t in;
            decoupler_out_t out;
            VALUE made[sizeof(out) / sizeof(VALUE)];
            for (uint32_t j = 0U; j < INPUTS; j++)
            {
                const uint32_t to = drawn() % 4U;
                given[j] = (VALUE)((to == 0U) ? FAR : (to == 1U) ? LEAST : (to == 2U) ? low[j] : high[j]);
            }
            (void)memcpy(&in, given, sizeof(in));
            (void)decoupler_step(&table, &in, &out);
            (void)memcpy(made, &out, sizeof(out));
            for (uint32_t j = 0U; j < sizeof(made) / sizeof(made[0]); j++)
            {
                bad += isfinite((double)made[j]) ? 0U : 1U;
            }
        }
        accepted[kind] += (found == 0U) ? 1U : 0U;
    }
    (void)printf("%u and %u accepted, ", accepted[0], accepted[1]);
    (void)printf("%u numbers bad, %u wrong findings\\n", bad, lost);
    return ((bad == 0U) && (lost == 0U)) ? 0 : 1;
}
"""


OF_INTEGERS = {
    "FIRST": "24U", "COUNT": "(LENGTH - 24U) / 4U", "AT": "24U + 4U * k",
    "END": "(VALUE)((to == 0U) ? 0x80000000UL : 0x7FFFFFFFUL)",
}  # fmt: skip
OF_NUMBERS = {
    "FIRST": "NUMBERS", "COUNT": "(sizeof(ends) / sizeof(ends[0]))",
    "END": "(to == 0U) ? ends[k].least : ends[k].greatest",
    "AT": "k * sizeof(ends[k].least) + ((k < ZEROS_AT) ? NUMBERS : ZEROS_LESS)",
}  # fmt: skip


@pytest.mark.parametrize("case", [*CASES, *(pytest.param(c, marks=pytest.mark.slow) for c in SLOW)])
def test_an_accepted_table_gives_numbers(case, tmp_path):
    need("gcc")
    code = EVERY[case].made()
    integers = code.backend.type == "q31"
    folder, backend = written(code, tmp_path / "fw"), code.backend
    far = "2e9" if integers else "1e30"
    low, high = (", ".join(f"{v!r}" for v in side[:, 0].tolist()) for side in backend.span)
    fields = {
        "ENDS": ", ".join(f"{{{', '.join(backend.ends_in_c(e))}}}" for e in backend.numbers),
        "TABLES": f"{TABLES}U", "INPUTS": f"{len(backend.inputs)}U", "LOW": low, "HIGH": high,
        "VALUE": backend.inputs[0].type, "FAR": far,
        "LEAST": "0" if backend.inputs[0].type == "uint32_t" else f"-{far}",
        "ZEROS_AT": f"{len(backend.numbers) - len(backend.offsets)}U",
    }  # fmt: skip
    text = PROGRAM
    for name, value in ((OF_INTEGERS if integers else OF_NUMBERS) | fields).items():
        text = re.sub(rf"\b{name}\b", value, text)
    (folder / "test" / "tables.c").write_text(text)
    sources = ("decoupler.c", "decoupler_params.c", "test/tables.c")
    ran(folder, "gcc", "-std=c99", "-O1", "-w", *SANITIZED, *PATHS, *sources, "-lm", "-o", "tables")
    said = ran(folder, "./tables").split()
    assert int(said[0]) > TABLES / 50  # of those with bits turned
    print(*said)


def test_a_table_of_another_calibration_is_accepted_within_the_ends_of_the_code(tmp_path):
    code = made("stage31")
    code.write(tmp_path / "fw")
    again = generate(calibration(), like=tmp_path / "fw")
    assert again.files["decoupler_check.c"] == code.files["decoupler_check.c"]
    ends = code.backend.accepted
    assert np.isfinite([v for pair in ends.values() for v in pair]).all()
    path = tmp_path / "fw/table/decoupler_params.json"
    greatest = f'"greatest": {ends["gain_hall_a"][1]}'
    path.write_text(path.read_text().replace(greatest, '"greatest": 0.5'))
    with pytest.raises(
        InputError, match=r"gain_hall_a, 1\.\d+, is not within .* the code in the folder accepts"
    ):
        generate(calibration(), like=tmp_path / "fw")
