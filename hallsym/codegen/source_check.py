"""src/decoupler_check.c: what is tested of a table when it is loaded."""

from hallsym.codegen.bounds import LEAST_GAIN, spreads
from hallsym.codegen.parts import Array
from hallsym.codegen.printer import statements
from hallsym.codegen.source import BANNER, Source, ends, function, lines, no_contraction


def _each(array: Array) -> list[str]:
    return [
        f"for (uint32_t k = 0U; k < {len(array.values)}U; k++)",
        "{",
        f"    bad += not_finite(p->{array.name}[k]);",
        "}",
    ]


def check(source: Source) -> str:
    """Return the check of a table at load time."""
    d, real = source.d, source.real
    first, last = d.table[0].name, d.zeros[0].name
    most = "FLT_MAX" if real.size == 4 else "DBL_MAX"
    empty = [
        f"({high} >= {real.constant(0.0)})" if d.box.symmetric(c) else f"({low} <= {high})"
        for c, (low, high) in ((c, ends(d, c)) for c in d.inputs)
    ]
    gains, names = spreads(d), source.names
    least = statements(gains, names, real, {})
    share = real.constant(round(1 - LEAST_GAIN, 6))
    compare = "\n    && ".join(
        f"({s.name} < ({share} * greater({names[m.rest]}, -{names[m.rest]})))"
        for s, m in zip(gains, d.margins, strict=True)
    )
    helpers = [
        function(
            f"static {real.name} {name}({real.name} a, {real.name} b)", [f"return (a {sign} b) ? a : b;"]
        )
        for name, sign in (("greater", ">"),)
    ]
    return lines(
        BANNER.rstrip(),
        '#include "decoupler.h"',
        "",
        "#include <float.h>",
        "#include <stddef.h>",
        "",
        *no_contraction(),
        f"#define FIRST offsetof(decoupler_params_t, {first})",
        f"#define COVERED offsetof(decoupler_params_t, {last})",
        "",
        function(
            "static uint32_t crc32(const uint8_t *bytes, size_t count) /* IEEE 802.3, bit by bit */",
            [
                "uint32_t crc = 0xFFFFFFFFUL;",
                "for (size_t k = 0U; k < count; k++)",
                "{",
                "    crc ^= (uint32_t)bytes[k];",
                "    for (uint32_t n = 0U; n < 8U; n++)",
                "    {",
                "        crc = ((crc & 1U) != 0U) ? ((crc >> 1U) ^ 0xEDB88320UL) : (crc >> 1U);",
                "    }",
                "}",
                "return ~crc;",
            ],
        ),
        function(
            f"static uint32_t not_finite({real.name} value)",
            [f"return ((value >= -{most}) && (value <= {most})) ? 0U : 1U;"],
        ),
        *helpers,
        function(
            "static uint32_t ranges(const decoupler_params_t *p)",
            [
                "uint32_t found = 0U;",
                *least,
                "if (!(" + "\n    && ".join(empty) + "))",
                "{",
                "    found |= DECOUPLER_BAD_LIMITS;",
                "}",
                f"if (!({compare}))",
                "{",
                "    found |= DECOUPLER_BAD_GAIN;",
                "}",
                "return found;",
            ],
        ),
        function(
            "uint32_t decoupler_check(const decoupler_params_t *p)",
            [
                "const uint8_t *bytes = (const uint8_t *)p;",
                "uint32_t found = 0U;",
                "uint32_t bad = 0U;",
                *[f"bad += not_finite(p->{e.name});" for e in d.entries],
                *[line for a in d.arrays if not a.integers for line in _each(a)],
                "if (p->version != DECOUPLER_VERSION)",
                "{",
                "    found |= DECOUPLER_BAD_VERSION;",
                "}",
                "if (p->layout != DECOUPLER_LAYOUT)",
                "{",
                "    found |= DECOUPLER_BAD_LAYOUT;",
                "}",
                "if (crc32(&bytes[FIRST], COVERED - FIRST) != p->crc)",
                "{",
                "    found |= DECOUPLER_BAD_CRC;",
                "}",
                "if (bad != 0U)",
                "{",
                "    found |= DECOUPLER_BAD_NUMBER;",
                "}",
                "else",
                "{",
                "    found |= ranges(p);",
                "}",
                "return found;",
            ],
        ),
    )
