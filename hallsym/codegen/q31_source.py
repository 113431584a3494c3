"""The C files of the integer decoupler: the interface of the float one, values as integers with fixed exponents."""

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from hallsym.codegen.bounds import LEAST_GAIN
from hallsym.codegen.entries import short, unit
from hallsym.codegen.project import MARK, template
from hallsym.codegen.q31 import UPPER, Program
from hallsym.codegen.source import BANNER, bit, ends, function, lines
from hallsym.codegen.table import VERSION

CPU = "-mcpu=cortex-m0 -mthumb"
MACHINE = "microbit"
KNOWN = 1 << 29
"""Largest known pose, in units of its last bit, that a zero may be taken at."""


@dataclass(frozen=True, eq=False)
class IntegerSource:
    """Prints the files of one integer program."""

    program: Program
    source: Mapping[str, Any]

    @cached_property
    def limits(self) -> dict[str, int]:
        """Ends of the inputs as integers, by entry."""
        d = self.program.d
        found: dict[str, int] = {}
        for c in d.inputs:
            low, high = (int(v * 2.0 ** self.program.inputs[c]) for v in d.ends(c))
            name = short(c)
            found |= (
                {f"limit_{name}": high} if d.box.symmetric(c) else {f"low_{name}": low, f"high_{name}": high}
            )
        return found

    @cached_property
    def entries(self) -> list[tuple[str, int, str]]:
        """Name, integer and meaning of every entry: coefficients, limits, zeros."""
        p = self.program
        meaning = {e.name: f"[2^-{{e}} {e.unit}] {e.meaning}" for e in (*p.d.table, *p.d.zeros)}
        rows = []
        for name, (q, e) in p.table.items():
            text = meaning.get(name, "[2^-{e}] of the reciprocal").replace("{e}", str(e))
            rows.append((name, q, text))
        zeros = [r for r in rows if r[0].startswith("zero_")]
        body = [r for r in rows if not r[0].startswith("zero_")]
        return [
            *body,
            *((n, q, "end of the range, in the unit of its input") for n, q in self.limits.items()),
            *zeros,
        ]

    @property
    def layout(self) -> int:
        """CRC-32 over names, exponents and lines."""
        p = self.program
        rows = [f"{VERSION} q31", *(f"{n} {m}" for n, _, m in self.entries), *p.c({})]
        rows += [f"{c} {e}" for c, e in p.inputs.items()] + [
            f"{c} {n} {e}" for c, (n, e) in p.outputs.items()
        ]
        return zlib.crc32("\n".join(rows).encode())

    @property
    def _covered(self) -> bytes:
        values = [q for n, q, _ in self.entries if not n.startswith("zero_")]
        return struct.pack(f"<{len(values)}i", *values)

    @property
    def binary(self) -> bytes:
        """The table as it lies in flash."""
        zeros = struct.pack(f"<{len(self.program.d.pose)}i", *[0] * len(self.program.d.pose))
        return struct.pack("<III", VERSION, self.layout, zlib.crc32(self._covered)) + self._covered + zeros

    def header(self) -> str:
        """Return the interface."""
        p, d = self.program, self.program.d
        bits = [
            f"#define {bit(c)} 0x{1 << k:08X}UL /**< {c} outside its range */" for k, c in enumerate(d.inputs)
        ]
        scales = [
            f"#define {bit(c)}_EXPONENT {e} /**< {c} = value 2^-{e} {unit(c)} */" for c, e in p.inputs.items()
        ]
        scales += [
            f"#define DECOUPLER_OUT_{short(c).upper()}_EXPONENT {e} /**< {c} = value 2^-{e} {unit(c)} */"
            for c, (_, e) in p.outputs.items()
        ]
        text = template("decoupler_q31.h")
        return (
            text.replace("@LAYOUT@", f"0x{self.layout:08X}UL")
            .replace("@VERSION@", str(VERSION))
            .replace("@BITS@", "\n".join(bits))
            .replace("@SCALES@", "\n".join(scales))
            .replace("@TABLE@", "\n".join(f"    int32_t {n}; /**< {m} */" for n, _, m in self.entries))
            .replace(
                "@IN@", "\n".join(f"    int32_t {c}; /**< [2^-{e} {unit(c)}] */" for c, e in p.inputs.items())
            )
            .replace(
                "@OUT@",
                "\n".join(f"    int32_t {c}; /**< [2^-{e} {unit(c)}] */" for c, (_, e) in p.outputs.items()),
            )
            .replace("@MODEL@", d.model.name)
        )

    def step(self) -> str:
        """Return the code of every sample."""
        p, d = self.program, self.program.d
        names = {n: f"p->{n}" for n, _, _ in self.entries}
        held = []
        used = {name for line in p.lines for name in (line.a, line.b)}
        for c in d.inputs:
            low, high = ends(d, c)
            call = f"limited(in->{c}, {low}, {high}, {bit(c)}, &status);"
            held.append(f"const int32_t {short(c)} = {call}" if short(c) in used else f"(void){call}")
        body = [
            *held,
            *p.c(names),
            *(f"out->{c} = {n};" for c, (n, _) in p.outputs.items()),
            "return status;",
        ]
        test = "\n    && ".join(f"(pose->{c} >= -{KNOWN}) && (pose->{c} <= {KNOWN})" for c in d.pose)
        zeros = [(c, f"p->zero_{short(c)}") for c in d.pose]
        return lines(
            BANNER.rstrip(),
            '#include "decoupler.h"',
            "",
            UPPER,
            function(
                "static inline int32_t limited(int32_t value, int32_t low, int32_t high, uint32_t bit, uint32_t *status)",
                [
                    "int32_t result = value;",
                    "if (value > high)",
                    "{",
                    "    result = high;",
                    "    *status += bit; /* each bit once */",
                    "}",
                    "else if (value < low)",
                    "{",
                    "    result = low;",
                    "    *status += bit; /* each bit once */",
                    "}",
                    "else",
                    "{",
                    "    /* within its range */",
                    "}",
                    "return result;",
                ],
            ),
            function(
                "uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)",
                ["uint32_t status = 0U;", *body],
            ),
            function(
                "uint32_t decoupler_zero(decoupler_params_t *p, const decoupler_in_t *in, const decoupler_out_t *pose)",
                [
                    "uint32_t status = DECOUPLER_POSE;",
                    f"if ({test})",
                    "{",
                    "    decoupler_out_t seen;",
                    "    status = decoupler_step(p, in, &seen);",
                    "    if (status == 0U)",
                    "    {",
                    *[f"        {z} += pose->{c} - seen.{c};" for c, z in zeros],
                    "    }",
                    "}",
                    "return status;",
                ],
            ),
        )

    def check(self) -> str:
        """Return the check of a table at load time."""
        p, d = self.program, self.program.d
        empty = [
            f"({ends(d, c)[1]} >= 0)" if d.box.symmetric(c) else f"({ends(d, c)[0]} <= {ends(d, c)[1]})"
            for c in d.inputs
        ]
        gains = []
        for margin in d.margins:
            e_rest, terms = p.table[margin.rest][1], ["0U"]
            for name, columns in margin.terms:
                text, e = f"size(p->{name})", p.table[name][1]
                for c in columns:
                    low, high = ends(d, c)
                    reach = f"size({high})" if d.box.symmetric(c) else f"(size({low}) + size({high}))"
                    text, e = f"(({text} * {reach}) >> 31U)", e + p.inputs[c] - 31
                terms.append(f"({text} >> {e - e_rest}U)" if e >= e_rest else f"({text} << {e_rest - e}U)")
            share = round((1 - LEAST_GAIN) * 1024)
            spread = " + ".join(terms[1:] or terms)
            gains.append(f"(({spread}) >= ((size(p->{margin.rest}) * {share}U) >> 10U))")
        first = next(n for n, _, _ in self.entries)
        text = template("decoupler_check_q31.c")
        return (
            text.replace("@FIRST@", first)
            .replace("@LAST@", f"zero_{short(d.pose[0])}")
            .replace("@LIMITS@", "\n        && ".join(empty))
            .replace("@GAINS@", "\n        || ".join(gains))
        )

    def bare(self) -> str:
        """Return the arithmetic alone, without limits and status, to count its instructions."""
        p, d = self.program, self.program.d
        signature = (
            "void decoupler_bare(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)"
        )
        names = {n: f"p->{n}" for n, _, _ in self.entries} | {short(c): f"in->{c}" for c in d.inputs}
        body = [*p.c(names), *(f"out->{c} = {n};" for c, (n, _) in p.outputs.items())]
        include = [BANNER.rstrip(), '#include "decoupler.h"', "", f"extern {signature};", ""]
        return lines(*include, UPPER, function(signature, body))

    def params(self) -> str:
        """Return the table."""
        head = [("version", f"{VERSION}UL"), ("layout", f"0x{self.layout:08X}UL")]
        head += [("crc", f"0x{zlib.crc32(self._covered):08X}UL")]
        rows = [f"    .{n} = {v}," for n, v in head] + [f"    .{n} = {q}," for n, q, _ in self.entries]
        return lines(
            BANNER.rstrip(),
            f"/* Calibration {self.source['calibration_sha256']} */",
            '#include "decoupler_params.h"',
            "",
            "const decoupler_params_t decoupler_params = {",
            *rows,
            "};",
        )

    def json(self) -> str:
        """Return the readable record."""
        p = self.program
        record = {
            "format": "hallsym decoupler parameters 1",
            "generator": MARK,
            **self.source,
            "version": VERSION,
            "layout": f"0x{self.layout:08x}",
            "crc32": f"0x{zlib.crc32(self._covered):08x}",
            "type": "q31",
            "exponents": {**p.inputs, **{c: e for c, (_, e) in p.outputs.items()}},
            "parameters": [{"name": n, "value": q, "meaning": m} for n, q, m in self.entries],
        }
        return json.dumps(record, indent=1) + "\n"
