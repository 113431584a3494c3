"""The C files of the integer decoupler: the interface of the float one, values as integers with fixed exponents."""

import json
import struct
import textwrap
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from hallsym.codegen import turns
from hallsym.codegen.bounds import LEAST_GAIN
from hallsym.codegen.entries import short, unit
from hallsym.codegen.parts import flag_bit
from hallsym.codegen.project import MARK, template
from hallsym.codegen.q31_program import UPPER, Program
from hallsym.codegen.source import BANNER, bit, ends, function, lines, numbers
from hallsym.codegen.table import VERSION
from hallsym.codegen.turns import MASK

CPU = "-mcpu=cortex-m0 -mthumb"
MACHINE = "microbit"
KNOWN = 1 << 29
"""Largest known pose, in units of its last bit, that a zero may be taken at."""


@dataclass(frozen=True, eq=False)
class IntegerSource:
    """Prints the files of one integer program."""

    program: Program
    source: Mapping[str, Any]

    @property
    def limited(self) -> list[str]:
        """Inputs that have a range: all but binary angles, of which every bit pattern is one."""
        return [c for c in self.program.d.inputs if c not in self.program.angles]

    @cached_property
    def limits(self) -> dict[str, int]:
        """Ends of the inputs as integers, by entry."""
        d = self.program.d
        found: dict[str, int] = {}
        for c in self.limited:
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
            rows.append((name, q, p.unsigned.get(name, text)))
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
        rows += [f"angle {line.i}" for line in p.lines if line.operation == "angle"]
        rows += [f"{a.name}[{len(a.values)}] {a.bits} {a.shift}" for a in p.arrays.values()]
        return zlib.crc32("\n".join(rows).encode())

    @property
    def _covered(self) -> bytes:
        values = [q for n, q, _ in self.entries if not n.startswith("zero_")]
        arrays = [
            struct.pack(f"<{len(a.values)}{'h' if a.bits == 16 else 'i'}", *a.values.tolist())
            for a in self.program.arrays.values()
        ]
        return b"".join([struct.pack(f"<{len(values)}I", *(v & MASK for v in values)), *arrays])

    @property
    def binary(self) -> bytes:
        """The table as it lies in flash."""
        zeros = struct.pack(f"<{len(self.program.d.pose)}i", *[0] * len(self.program.d.pose))
        return struct.pack("<III", VERSION, self.layout, zlib.crc32(self._covered)) + self._covered + zeros

    def header(self) -> str:
        """Return the interface."""
        p, d = self.program, self.program.d
        bits = [
            f"#define {bit(c)} 0x{1 << k:08X}UL /**< {c} outside its range */"
            for k, c in enumerate(d.inputs)
            if c in self.limited
        ]
        bits += [
            f"#define DECOUPLER_{f.name} 0x{flag_bit(k):08X}UL /**< {f.meaning} */"
            for k, f in enumerate(d.flags)
        ]
        scales = [
            f"#define {bit(c)}_EXPONENT {e} /**< {c} = value 2^-{e} {unit(c)} */"
            for c, e in p.inputs.items()
            if c not in p.angles
        ]
        scales += [
            f"#define DECOUPLER_OUT_{short(c).upper()}_EXPONENT {e} /**< {c} = value 2^-{e} {unit(c)} */"
            for c, (_, e) in p.outputs.items()
            if c not in p.angles
        ]
        if p.angles:
            scales.append(f"#define DECOUPLER_RAD_PER_BAM {turns.UNIT!r} /**< binary angles: 2^-32 turn */")
        text = template("decoupler_q31.h")
        return (
            text.replace("@LAYOUT@", f"0x{self.layout:08X}UL")
            .replace("@VERSION@", str(VERSION))
            .replace("@BITS@", "\n".join(bits))
            .replace("@SCALES@", "\n".join(scales))
            .replace("@ANGLES@", self._said())
            .replace("@KNOWN@", "" if p.angles else KNOWN_BIT)
            .replace("@TABLE@", "\n".join(self._members()))
            .replace("@IN@", "\n".join(self._member(c) for c in p.inputs))
            .replace("@OUT@", "\n".join(self._member(c) for c in p.outputs))
            .replace("@MODEL@", d.model.name)
        )

    def _member(self, column: str) -> str:
        p = self.program
        return f"    {p.kind(column)} {p.member(column)}; /**< [{p.scale(column)}] */"

    def _said(self) -> str:
        wrapped = [f" * {line}" for text in self.program.said for line in textwrap.wrap(text, 110)]
        return (ANGLES if self.program.angles else "") + "".join(f"{line}\n" for line in wrapped)

    def _members(self) -> list[str]:
        """The entries, with rows of them before the zeros."""
        p = self.program
        rows = [
            f"    {'uint32_t' if n in p.unsigned else 'int32_t'} {n}; /**< {m} */" for n, _, m in self.entries
        ]
        arrays = [
            f"    int{a.bits}_t {a.name}[{len(a.values)}]; /**< [2^{a.shift - 32} turn] at as many phases of a turn */"
            for a in p.arrays.values()
        ]
        last = len(rows) - len(p.d.pose)
        return [*rows[:last], *arrays, *rows[last:]]

    @property
    def _helpers(self) -> list[str]:
        """Functions that the lines call."""
        p = self.program
        used = {line.operation for line in p.lines}
        called = [UPPER] if "mul" in used else []
        called += [turns.angle_of_c(line.i) for line in p.lines if line.operation == "angle"]
        return called + [a.c() for a in p.arrays.values()]

    def step(self) -> str:
        """Return the code of every sample."""
        p, d = self.program, self.program.d
        names = {n: f"p->{n}" for n, _, _ in self.entries}
        held = []
        used = {name for line in p.lines for name in (line.a, line.b)}
        for c in d.inputs:
            if c in p.angles:
                held.append(f"const uint32_t {short(c)} = in->{p.member(c)};")
                continue
            low, high = ends(d, c)
            call = f"limited(in->{c}, {low}, {high}, {bit(c)}, &status);"
            held.append(f"const int32_t {short(c)} = {call}" if short(c) in used else f"(void){call}")
        body = [
            *held,
            *p.c(names),
            *(f"out->{p.member(c)} = {n};" for c, (n, _) in p.outputs.items()),
            *(line for flag in d.flags for line in self._flag(flag.name)),
            "return status;" if self._can_fail else "return 0U;",
        ]
        test = "\n    && ".join(f"(pose->{c} >= -{KNOWN}) && (pose->{c} <= {KNOWN})" for c in d.pose)
        zeros = [(p.member(c), f"p->zero_{short(c)}") for c in d.pose]
        take = [
            "decoupler_out_t seen;",
            "status = decoupler_step(p, in, &seen);",
            "if (status == 0U)",
            "{",
            *[f"    {z} += pose->{c} - seen.{c};" for c, z in zeros],
            "}",
        ]
        if p.angles:
            take = [take[0], take[1].replace("status", "const uint32_t status", 1), *take[2:]]
        else:
            take = [
                "uint32_t status = DECOUPLER_POSE;",
                f"if ({test})",
                "{",
                *(f"    {t}" for t in take),
                "}",
            ]
        return lines(
            BANNER.rstrip(),
            '#include "decoupler.h"',
            "",
            *self._helpers,
            *([_LIMITED] if self.limited else []),
            function(
                "uint32_t decoupler_step(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)",
                [*(["uint32_t status = 0U;"] if self._can_fail else []), *body],
            ),
            function(
                "uint32_t decoupler_zero(decoupler_params_t *p, const decoupler_in_t *in, const decoupler_out_t *pose)",
                [*take, "return status;"],
            ),
        )

    @property
    def _can_fail(self) -> bool:
        return bool(self.limited or self.program.d.flags)

    def _flag(self, name: str) -> list[str]:
        seen, least = self.program.flags[name]
        return [f"if ({seen} < p->{least})", "{", f"    status |= DECOUPLER_{name};", "}"]

    def check(self) -> str:
        """Return the check of a table at load time."""
        p, d = self.program, self.program.d
        empty = [
            f"({ends(d, c)[1]} >= 0)" if d.box.symmetric(c) else f"({ends(d, c)[0]} <= {ends(d, c)[1]})"
            for c in self.limited
        ]
        gains = []
        for margin in d.margins if not p.angles else ():
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
            .replace("@SIZE@", _SIZE if gains else "")
            .replace("@LIMITS@", _found("!(" + "\n        && ".join(empty) + ")", "LIMITS") if empty else "")
            .replace("@GAINS@", _found("\n        || ".join(gains), "GAIN") if gains else "")
        )

    def bare(self) -> str:
        """Return the arithmetic alone, without limits and status, to count its instructions."""
        p, d = self.program, self.program.d
        signature = (
            "void decoupler_bare(const decoupler_params_t *p, const decoupler_in_t *in, decoupler_out_t *out)"
        )
        names = {n: f"p->{n}" for n, _, _ in self.entries} | {
            short(c): f"in->{p.member(c)}" for c in d.inputs
        }
        body = [*p.c(names), *(f"out->{p.member(c)} = {n};" for c, (n, _) in p.outputs.items())]
        body += [f"(void){n};" for n, _ in p.flags.values()]
        include = [BANNER.rstrip(), '#include "decoupler.h"', "", f"extern {signature};", ""]
        return lines(*include, *self._helpers, function(signature, body))

    def params(self) -> str:
        """Return the table."""
        head = [("version", f"{VERSION}UL"), ("layout", f"0x{self.layout:08X}UL")]
        head += [("crc", f"0x{zlib.crc32(self._covered):08X}UL")]
        rows = [f"    .{n} = {v}," for n, v in head]
        values = [f"    .{n} = {q}{'U' if n in self.program.unsigned else ''}," for n, q, _ in self.entries]
        last = len(values) - len(self.program.d.pose)
        rows += values[:last]
        for a in self.program.arrays.values():
            rows += [f"    .{a.name} = {{", *numbers(", ".join(map(str, a.values.tolist()))), "    },"]
        rows += values[last:]
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
        record: dict[str, Any] = {
            "format": "hallsym decoupler parameters 1",
            "generator": MARK,
            **self.source,
            "version": VERSION,
            "layout": f"0x{self.layout:08x}",
            "crc32": f"0x{zlib.crc32(self._covered):08x}",
            "type": "q31",
            "exponents": p.exponents,
            "parameters": [{"name": n, "value": q, "meaning": m} for n, q, m in self.entries],
        }
        if p.arrays:
            record["arrays"] = [
                {"name": a.name, "values": a.values.tolist(), "unit_turn": 2.0 ** (a.shift - 32)}
                for a in p.arrays.values()
            ]
        return json.dumps(record, indent=1) + "\n"


ANGLES = """ *
 * A binary angle counts 2^-32 of a turn, unsigned: it wraps by itself, and every bit pattern is an angle. Counts of
 * an encoder with 2^b per turn are shifted left by 32 - b.
"""
KNOWN_BIT = "#define DECOUPLER_POSE 0x80000000UL /**< decoupler_zero(): known pose beyond 2^29 */\n"
_LIMITED = """\
static inline int32_t limited(int32_t value, int32_t low, int32_t high, uint32_t bit, uint32_t *status)
{
    int32_t result = value;
    if (value > high)
    {
        result = high;
        *status += bit; /* each bit once */
    }
    else if (value < low)
    {
        result = low;
        *status += bit; /* each bit once */
    }
    else
    {
        /* within its range */
    }
    return result;
}
"""
_SIZE = """\
static uint64_t size(int32_t value)
{
    const int64_t wide = (int64_t)value;
    const int64_t positive = (wide < 0) ? -wide : wide;
    return (uint64_t)positive;
}

"""


def _found(condition: str, what: str) -> str:
    return f"    if ({condition})\n    {{\n        found |= DECOUPLER_BAD_{what};\n    }}\n"
