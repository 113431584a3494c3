"""The decoupler in 32-bit integers, for a controller without a floating-point unit."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor
from typing import Any, ClassVar
from zlib import crc32

import numpy as np

from hallsym.codegen.backend import (
    COUNT,
    REFERENCE,
    VERSION,
    Backend,
    Stored,
    bit,
    ends,
    mix,
    of_params,
)
from hallsym.codegen.binary_angle import MASK, UNIT
from hallsym.codegen.bounds import LEAST_GAIN, Bounds
from hallsym.codegen.decoupler import flag_bit
from hallsym.codegen.entries import short, unit
from hallsym.codegen.fixed_point import Program, Reciprocal, helpers
from hallsym.codegen.templates import filled, lines_of

KNOWN = 1 << 29
"""Largest known pose, in units of its last bit, that a zero may be taken at."""
MOST = 2**31 - 1
SHIFTS = "misra-c2012-10.1:src/decoupler.c"
"""Deviation: numbers with a sign are shifted right."""
ANGLES = """\
 *
 * A binary angle counts 2^-32 of a turn, unsigned: it wraps by itself, and every bit pattern is an angle. Counts of
 * an encoder with 2^b per turn are shifted left by 32 - b."""
KNOWN_BIT = "#define DECOUPLER_POSE 0x80000000UL /**< decoupler_zero(): known pose beyond 2^29 */"
HELPERS = "q31/fragments/"


@dataclass(frozen=True, eq=False)
class IntegerBackend(Backend):
    """Prints and runs an integer program: the same bits as C, in 64-bit integers."""

    program: Program

    tree: ClassVar[str] = "q31"
    hashed: ClassVar[tuple[int, int]] = (4096, 100_000)
    batch: ClassVar[int] = 1 << 62
    outside: ClassVar[str] = "outside its range"
    type: ClassVar[str] = "q31"

    # -- the arithmetic ------------------------------------------------------------------------------------

    @cached_property
    def bounds(self) -> Bounds:
        """Of the program, table and approximations included."""
        p = self.program
        low, high, error = ({c: v[k] for c, v in p.bounds.items()} for k in range(3))
        return Bounds(low, high, error, {})

    @property
    def error_bound(self) -> Mapping[str, float]:
        """Everything is counted."""
        return self.bounds.error

    @property
    def reads_angle(self) -> bool:
        """Whether an input is a binary angle, of which every bit pattern is one."""
        return bool(self.program.angles & set(self.decoupler.inputs))

    @property
    def limited(self) -> Sequence[str]:
        """Inputs that have a range: all but binary angles."""
        return [c for c in self.decoupler.inputs if c not in self.program.angles]

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Integers towards zero."""
        p, d = self.program, self.decoupler
        found = [(0, MASK) if c in p.angles else [int(v / p.unit(c)) for v in d.ends(c)] for c in d.inputs]
        return np.array(found)[:, :1], np.array(found)[:, 1:]

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Binary angles wrap."""
        return super().hold(inputs.astype(np.int64) & MASK if self.reads_angle else inputs.astype(np.int64))

    def run(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Line by line; raises `OverflowError` beyond 32 bits."""
        p, d = self.program, self.decoupler
        found = p.run({short(c): row for c, row in zip(d.inputs, held, strict=True)})
        flags = np.zeros(held.shape[1], dtype=np.int64)
        for k, flag in enumerate(d.flags):
            flags |= np.where(found[flag.name] < p.table[p.flags[flag.name][1]][0], flag_bit(k), 0)
        return np.array([found[c] for c in d.pose]), flags

    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Any integers, three quarters of them shifted towards the box."""
        n, count = np.asarray(numbers, dtype=np.uint32), len(self.decoupler.inputs)
        raw = mix(n * np.uint32(count) + np.arange(1, count + 1, dtype=np.uint32)[:, None])
        return np.asarray(raw.view(np.int32) >> ((mix(n) & np.uint32(3)).astype(np.int32)))

    def words(self, pose: np.ndarray) -> np.ndarray:
        """The bits themselves."""
        return (pose & MASK).astype(np.uint32)

    def rounded(self, inputs: np.ndarray) -> np.ndarray:
        """To nearest."""
        return np.round(inputs).astype(np.int64)

    def si(self, values: np.ndarray, columns: Sequence[str]) -> np.ndarray:
        """By the exponent of each."""
        return values * np.array([[self.program.unit(c)] for c in columns])

    def chosen(self) -> np.ndarray:
        """Return corners and points of the box, and inputs that are out of range."""
        d, (low, high) = self.decoupler, self.ends
        rng = np.random.default_rng(1)
        share = np.hstack([rng.choice([0.0, 1.0], (len(low), 8)), rng.random((len(low), COUNT - 8))])
        given = [self.rounded(low + (high - low) * share)]
        for k in range(0 if self.reads_angle else len(low)):
            beyond = np.repeat(given[0][:, 9 + k : 10 + k], 4, axis=1)
            beyond[k] = (-MOST - 1, low[k, 0] - 1, high[k, 0] + 1, MOST)
            given.append(beyond)
        if d.listed:
            listed = self.rounded(np.array(d.listed) / [self.program.unit(c) for c in d.inputs]).T
            given.append(listed & MASK if self.reads_angle else listed)
        return np.hstack(given)

    # -- the table -----------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> list[Stored]:
        """Coefficients of the program, limits, zeros."""
        p, d = self.program, self.decoupler
        meaning = {e.name: f"[2^-{{e}} {e.unit}] {e.meaning}" for e in (*d.table, *d.zeros)}
        rows = []
        for name, (q, e) in p.table.items():
            note = meaning.get(name, "[2^-{e}] of the reciprocal").replace("{e}", str(e))
            note = p.unsigned.get(name, note)
            rows.append(Stored(name, np.array(q, "<u4" if name in p.unsigned else "<i4"), note))
        limits = []
        for c in self.limited:
            low, high = (int(v * 2.0 ** p.inputs[c]) for v in d.ends(c))
            name, symmetric = short(c), d.box.symmetric(c)
            ends_of = {f"limit_{name}": high} if symmetric else {f"low_{name}": low, f"high_{name}": high}
            limits += [
                Stored(n, np.array(q, "<i4"), "end of the range, in the unit of its input")
                for n, q in ends_of.items()
            ]
        return [r for r in rows if not _is_zero(r)] + limits + [r for r in rows if _is_zero(r)]

    @property
    def coefficients(self) -> Sequence[Stored]:
        """Coefficients and limits."""
        return [e for e in self.entries if not _is_zero(e)]

    @property
    def zeros(self) -> Sequence[Stored]:
        """One of each pose coordinate."""
        return [e for e in self.entries if _is_zero(e)]

    @cached_property
    def rows(self) -> Sequence[Stored]:
        """Tables of binary angles."""
        return [
            Stored(
                a.name, a.values.astype(f"<i{a.bits // 8}"),
                f"[2^{a.shift - 32} turn] at as many phases of a turn",
            )
            for a in self.program.arrays.values()
        ]  # fmt: skip

    @cached_property
    def layout(self) -> int:
        """Of names, exponents and lines."""
        p = self.program
        rows = [f"{VERSION} q31", *(f"{e.name} {e.note}" for e in self.entries), *p.c({})]
        rows += [f"{c} {e}" for c, e in p.inputs.items()]
        rows += [f"{c} {n} {e}" for c, (n, e) in p.outputs.items()]
        rows += [f"angle {line.i}" for line in p.lines if line.operation == "angle"]
        rows += [f"{a.name}[{len(a.values)}] {a.bits} {a.shift}" for a in p.arrays.values()]
        return crc32("\n".join(rows).encode())

    def json_of_table(self) -> dict[str, Any]:
        """Integers, and the exponents of inputs and outputs."""
        p = self.program
        record: dict[str, Any] = {
            "exponents": p.exponents,
            "parameters": [{"name": e.name, "value": int(e.values), "meaning": e.note} for e in self.entries],
        }
        if p.arrays:
            record["arrays"] = [
                {"name": a.name, "values": a.values.tolist(), "unit_turn": 2.0 ** (a.shift - 32)}
                for a in p.arrays.values()
            ]
        return record

    # -- C -------------------------------------------------------------------------------------------------

    def literal(self, value: Any) -> str:
        """Its digits."""
        return str(value)

    def member(self, column: str) -> str:
        """`angle_bam` of a binary angle."""
        return self.program.member(column)

    def c_type(self, column: str) -> str:
        """Binary angles have no sign."""
        return self.program.kind(column)

    def note(self, column: str) -> str:
        """The value of the last bit."""
        return f"[{self.program.scale(column)}]"

    def any_value(self, column: str) -> str:
        """Any bits."""
        return f"{'(uint32_t)' if column in self.program.angles else ''}nondet_int32()"

    def outer(self, column: str) -> tuple[str, str] | None:
        """Its bounds; none of an angle, which may be any."""
        if self.program.angles:
            return None
        (low, high, error), e = self.program.bounds[column], self.program.outputs[column][1]
        return str(floor((low - error) * 2.0**e)), str(ceil((high + error) * 2.0**e))

    @property
    def _names(self) -> dict[str, str]:
        return {e.name: f"p->{e.name}" for e in self.entries}

    def summary(self) -> dict[str, Any]:
        """Exponents of inputs and outputs."""
        return {"exponents": self.program.exponents}

    def files(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, str | bytes]:
        """Where an angle is read, the trial is of every angle through all of the code."""
        made = super().files(errors, notes)
        if self.reads_angle:
            made["proof/exhaustive.c"] = self._every_angle()
        return made

    def fields(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, Any]:
        """Fields of header, step, check, self-test, proofs and report."""
        common = {
            "all_nan": "", "shifts": [SHIFTS] if self.program.shifts else [],
            "cpu": "-mcpu=cortex-m0 -mthumb", "machine": "microbit",
            "that_the_model_gives": "[SI] of the model", "nan_included": "", "nondet": "int32_t nondet_int32",
        }  # fmt: skip
        parts = (self._header(), self._step(), self._check(), self._selftest(), self._count())
        for part in (*parts, self._trial(), self._eva(), self._report(errors, notes)):
            common |= part
        return common

    def _header(self) -> dict[str, Any]:
        p = self.program
        prefix = {**dict.fromkeys(p.inputs, ""), **dict.fromkeys(p.outputs, "OUT_")}
        scales = [
            f"#define DECOUPLER_{prefix[c]}{short(c).upper()}_EXPONENT {e} /**< {c} = value 2^-{e} {unit(c)} */"
            for c, e in p.exponents.items()
        ]
        if p.angles:
            scales.append(f"#define DECOUPLER_RAD_PER_BAM {UNIT!r} /**< binary angles: 2^-32 turn */")
        said = [f" * {line}" for text in p.said for line in textwrap.wrap(text, 110)]
        return {
            "scales": scales,
            "said": [ANGLES, *said] if p.angles else said,
            "known_bit": [] if p.angles else [KNOWN_BIT],
        }

    def _step(self) -> dict[str, Any]:
        p, d = self.program, self.decoupler
        used = {name for line in p.lines for name in (line.a, line.b)}
        held = []
        for c in d.inputs:
            low, high = ends(d, c)
            call = f"limited(in->{c}, {low}, {high}, {bit(c)}, &status);"
            if c in p.angles:
                held.append(f"const uint32_t {short(c)} = in->{p.member(c)};")
            else:
                held.append(f"const int32_t {short(c)} = {call}" if short(c) in used else f"(void){call}")
        given = {short(c): f"in->{p.member(c)}" for c in d.inputs}
        results = [f"out->{p.member(c)} = {n};" for c, (n, _) in p.outputs.items()]
        flags = [
            line
            for name, (seen, least) in p.flags.items()
            for line in (f"if ({seen} < p->{least})", "{", f"    status |= DECOUPLER_{name};", "}")
        ]
        can_fail = bool(self.limited or d.flags)
        return {
            "helpers": helpers(p),
            "limited": lines_of(f"{HELPERS}limited.c", {}) if self.limited else [],
            "status": ["uint32_t status = 0U;"] if can_fail else [],
            "held": held,
            "body": [*p.c(self._names), *results],
            "flags": flags,
            "returned": "status" if can_fail else "0U",
            "take_zero": self._take_zero(),
            "bare_includes": [],
            "bare_helpers": helpers(p),
            "bare_body": [*p.c(self._names | given), *results, *(f"(void){n};" for n, _ in p.flags.values())],
        }

    def _take_zero(self) -> list[str]:
        p, d = self.program, self.decoupler
        known = "\n    && ".join(f"(pose->{c} >= -{KNOWN}) && (pose->{c} <= {KNOWN})" for c in d.pose)
        zeros = [f"    p->zero_{short(c)} += pose->{p.member(c)} - seen.{p.member(c)};" for c in d.pose]
        take = ["status = decoupler_step(p, in, &seen);", "if (status == 0U)", "{", *zeros, "}"]
        if p.angles:
            return ["decoupler_out_t seen;", f"const uint32_t {take[0]}", *take[1:]]
        inside = [f"    {line}" for line in ("decoupler_out_t seen;", *take)]
        return ["uint32_t status = DECOUPLER_POSE;", f"if ({known})", "{", *inside, "}"]

    def _check(self) -> dict[str, Any]:
        p, d = self.program, self.decoupler
        filled_ = [
            f"({high} >= 0)" if d.box.symmetric(c) else f"({low} <= {high})"
            for c in self.limited
            for low, high in [ends(d, c)]
        ]
        gains = []
        for margin in d.margins if not p.angles else ():
            e_rest, terms = p.table[margin.rest][1], []
            for name, columns in margin.terms:
                text, e = f"size(p->{name})", p.table[name][1]
                for c in columns:
                    low, high = ends(d, c)
                    reach = f"size({high})" if d.box.symmetric(c) else f"(size({low}) + size({high}))"
                    text, e = f"(({text} * {reach}) >> 31U)", e + p.inputs[c] - 31
                terms.append(f"({text} >> {e - e_rest}U)" if e >= e_rest else f"({text} << {e_rest - e}U)")
            share = round((1 - LEAST_GAIN) * 1024)
            spread = " + ".join(terms or ["0U"])
            gains.append(f"(({spread}) >= ((size(p->{margin.rest}) * {share}U) >> 10U))")
        return {
            "size": lines_of(f"{HELPERS}size.c", {}) if gains else [],
            "check_limits": _found("!(" + "\n    && ".join(filled_) + ")", "LIMITS") if filled_ else [],
            "check_gains": _found("\n    || ".join(gains), "GAIN") if gains else [],
        }

    # -- self-test -----------------------------------------------------------------------------------------

    def _selftest(self) -> dict[str, Any]:
        p, d, found = self.program, self.decoupler, self.vectors
        binary = [c in p.angles for c in d.inputs]
        width = len(d.pose) + 1
        rows = [
            f"{{{{{', '.join(map(_integer, found.inputs[:, k], binary))}}}, "
            f"{{{', '.join(f'{v:.12e}' for v in found.pose[:, k])}}}, 0x{int(found.status[k]):X}UL}},"
            for k in range(found.inputs.shape[1])
        ]
        rest = [1000] * len(d.inputs)
        if d.rest and not self.reads_angle:
            rest = [round(v / p.unit(c)) for c, v in zip(d.inputs, d.rest, strict=True)]
        known = {p.member(c): _integer(4096, c in p.angles) for c in d.pose}
        return {
            "sample": [
                f"in->{p.member(c)} = {'(uint32_t)' if c in p.angles else ''}input(n, {k}U);"
                for k, c in enumerate(d.inputs, 1)
            ],
            "words": [
                f"total += mix((uint32_t)out.{p.member(c)} ^ mix((n * {width}U) + {k}U));"
                for k, c in enumerate(d.pose, 1)
            ],
            "compare": [
                f"failed |= differs((double)out.{p.member(c)} * {p.unit(c)!r}, wanted->pose[{k}], "
                f"decoupler_bounds[{k}], &result.worst);"
                for k, c in enumerate(d.pose)
            ],
            "vector_includes": [],
            "slope_bounds": [],
            "bounds": ", ".join(f"{error + REFERENCE:.3e}" for error in self.bounds.error.values()),
            "rows": rows,
            "rest": [
                f"in.{p.member(c)} = {_integer(v, c in p.angles)};"
                for c, v in zip(d.inputs, rest, strict=True)
            ],
            "at_known": [f"pose.{c} = {v};" for c, v in known.items()],
            "back": " && ".join(f"(out.{c} == {v})" for c, v in known.items()),
        }

    def _count(self) -> dict[str, Any]:
        """Inputs in range, all above, all below, above and below in turn."""
        p, d = self.program, self.decoupler
        most = [2.0**29 if self.reads_angle else max(map(abs, d.ends(c))) / p.unit(c) for c in d.inputs]
        rows = [[max(min(int(share * v), MOST), -MOST) for v in most] for share in (0.7, 3.0, -3.0)]
        rows.append([v if k % 2 else -v for k, v in enumerate(rows[1])])
        listed = [", ".join(f"{v % 2**32}U" if self.reads_angle else str(v) for v in row) for row in rows]
        return {
            "count_includes": [],
            "calls": len(rows),
            "called_with": [f"{{{row}}}," for row in listed],
            "count_slopes": [],
            "call_slopes": [],
        }

    # -- proofs and report ---------------------------------------------------------------------------------

    def _trial(self) -> dict[str, Any]:
        """Every bit pattern of every input through the range test, every divisor through its reciprocal."""
        p, text = self.program, self.program.c(self._of_params)
        reciprocals, calls = [], []
        for r in p.reciprocals:
            low, high, least, most = _integers(r)
            b, result = r.b.text, r.r.text
            reciprocals += lines_of(f"{HELPERS}reciprocal.c", {
                "b": b, "lines": text[r.first : r.last], "r": result, "b_unit": repr(r.b.unit),
                "r_unit": repr(r.r.unit), "error": repr(float(r.r.error)), "least": least, "most": most,
            })  # fmt: skip
            calls.append(f"for (int32_t b = {low}; b <= {high}; b++) {{ bad += wrong_{b}(b); divisors++; }}")
        read = "every angle, through all of the code" if self.reads_angle else "range test, all bit patterns"
        tried = "range test, all bit patterns, and reciprocals, all divisors"
        return {
            "reciprocals": reciprocals,
            "range_tests": [
                f"bad += all_limited({low}, {high});"
                for c in self.limited
                for low, high in [of_params(*ends(self.decoupler, c))]
            ],
            "divisor_tests": calls,
            "tried": read if p.angles else tried,
            "as_proved": "" if p.angles else ", reciprocals as proved",
            "outputs_proved": "" if p.angles else ", outputs within the stated bounds",
        }

    @property
    def _of_params(self) -> dict[str, str]:
        return {e.name: f"decoupler_params.{e.name}" for e in self.entries}

    def _every_angle(self) -> str:
        """Every angle through decoupler_step(): the correction is no larger than an entry of the table."""
        p = self.program
        (read,), (pose,) = self.decoupler.inputs, self.decoupler.pose
        return filled(f"{HELPERS}every_angle.c", {
            "most": max((int(abs(a.values).max()) << a.shift for a in p.arrays.values()), default=0),
            "read": p.member(read), "pose": p.member(pose),
            "shift": "decoupler_params.shift" if "shift" in p.unsigned else "0U",
        })  # fmt: skip

    def _eva(self) -> dict[str, Any]:
        """The driver of Frama-C EVA.

        EVA cannot follow that b (1 / b) is 1: it takes each reciprocal within what the trial of all divisors
        showed of it. A program without reciprocals goes through decoupler_step() itself.
        """
        p, d = self.program, self.decoupler
        box = {c: of_params(*ends(d, c)) for c in self.limited}
        if p.angles:
            any_angle = "Frama_C_unsigned_int_interval(0U, 0xFFFFFFFFU)"
            flags = self.flag_status
            body = ["decoupler_in_t in;", "decoupler_out_t out;"]
            within = {c: f"Frama_C_interval({', '.join(box[c])})" for c in self.limited}
            body += [f"in.{p.member(c)} = {within.get(c, any_angle)};" for c in d.inputs]
            body += [
                "const uint32_t status = decoupler_step(&decoupler_params, &in, &out);",
                f"//@ assert status_zero: {flags};",
                "return (int)(status & 1U);",
            ]
            return {
                "eva_about": ["/* Frama-C EVA: every input in the box. No alarm means no overflow and no entry beyond "
                              "the table. */"],
                "eva_includes": ['#include "../src/decoupler.c"', '#include "decoupler_params.h"'],
                "eva_helpers": [],
                "eva_body": body,
            }  # fmt: skip
        text = p.c(self._of_params)
        for r in p.reciprocals:
            _, _, least, most = _integers(r)
            text[r.first : r.last] = [""] * (r.last - r.first)
            text[r.last - 1] = f"const int32_t {r.r.text} = Frama_C_interval({least}, {most});"
        body = [f"const int32_t {short(c)} = Frama_C_interval({', '.join(box[c])});" for c in d.inputs]
        body += [line for line in text if line]
        for c, (name, e) in p.outputs.items():
            low, high, error = p.bounds[c]
            room = ceil((high - low) * 2.0**e * 0.01) + 8  # EVA rounds each step outwards
            body.append(f"const int32_t out_{short(c)} = {name};")
            body.append(
                f"//@ assert {short(c)}_bounded: {floor((low - error) * 2.0**e) - room} <= out_{short(c)} <= "
                f"{ceil((high + error) * 2.0**e) + room};"
            )
        return {
            "eva_about": ["/* Frama-C EVA: every input in the box, each reciprocal within its range (exhaustive.c). "
                          "No alarm means", "   no overflow. */"],
            "eva_includes": ['#include "decoupler.h"', '#include "decoupler_params.h"'],
            "eva_helpers": lines_of(f"{HELPERS}upper.c", {}),
            "eva_body": [*body, "return 0;"],
        }  # fmt: skip

    def _report(self, errors: Mapping[str, float], notes: Sequence[str]) -> dict[str, Any]:
        p, d, found = self.program, self.decoupler, self.bounds
        box = [
            f"| {c} | {low:.6g} | {high:.6g} | {p.scale(c)} |" for c in d.inputs for low, high in [d.ends(c)]
        ]
        outputs = [
            f"| {c} | {p.scale(c)} | {found.low[c]:.6g} | {found.high[c]:.6g} | "
            f"{1e9 * found.error[c]:.3g} n{unit(c)} | {1e9 * errors[c]:.3g} n{unit(c)} |"
            for c in p.outputs
        ]
        return {
            "notes": "\n".join(f"- {note}" for note in (*p.said, *notes)),
            "box": box,
            "outputs": outputs,
            "operations": len(p.lines),
            "products": sum(line.operation == "mul" for line in p.lines),
            "pose_names": ", ".join(short(c) for c in d.pose),
        }


def _is_zero(entry: Stored) -> bool:
    return entry.name.startswith("zero_")


def _integers(r: Reciprocal) -> tuple[int, int, int, int]:
    """Return least and greatest integer of divisor and reciprocal."""
    b, e, least, most = r.b, r.r.e, r.r.low - r.r.error, r.r.high + r.r.error
    return floor(b.low * 2.0**b.e), ceil(b.high * 2.0**b.e), floor(least * 2.0**e), ceil(most * 2.0**e)


def _integer(value: int, unsigned: bool) -> str:
    if unsigned:
        return f"{value}U"
    return f"({value + 1} - 1)" if value == -MOST - 1 else str(value)


def _found(condition: str, what: str) -> list[str]:
    return [f"if ({condition})", "{", f"    found |= DECOUPLER_BAD_{what};", "}"]
