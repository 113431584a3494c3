"""The files of a decoupler in 32-bit integers, for a controller without a floating-point unit."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor, pi
from typing import Any, ClassVar
from zlib import crc32

import numpy as np

from hallsym.codegen import accepted, backend, residual
from hallsym.codegen.backend import VERSION, Backend, Port, Stored, ends
from hallsym.codegen.bounds import Bounds
from hallsym.codegen.decoupler import OF_ROOT, ROOT, flag_bit, short, unit
from hallsym.codegen.integer_c import ARCTANGENTS, FINE, LARGEST, MASK, UNIT, Program, Reciprocal
from hallsym.codegen.naming import identifier
from hallsym.codegen.residual import Ran
from hallsym.output import commented

KNOWN = 1 << 29
"""Largest known pose, in units of its last bit, that a zero may be taken at."""
SOME = 1 << 12
"""A small zero or pose, in the same units."""
SHIFTS = "misra-c2012-10.1:decoupler.c"
"""Deviation: numbers with a sign are shifted right."""
FRAGMENTS = "q31/fragments/"


@dataclass(frozen=True, eq=False)
class IntegerBackend(Backend):
    """One integer program: run line by line in 64-bit integers, the same bits as C."""

    program: Program

    type: ClassVar[str] = "q31"
    cpu: ClassVar[str] = "-mcpu=cortex-m0 -mthumb"
    machine: ClassVar[str] = "microbit"
    why_ends: ClassVar[str] = "with gains within these ends none comes to nothing"
    hashed = (4096, 100_000)
    batch: ClassVar[int] = 1 << 62

    @cached_property
    def bounds(self) -> Bounds:
        """Of the program, table and approximations included."""
        low, high, error = ({c: v[k] for c, v in self.program.bounds.items()} for k in range(3))
        return Bounds(low, high, error)

    def summary(self) -> dict[str, Any]:
        """Exponents of inputs and outputs."""
        return {"exponents": self.exponents}

    # -- the arithmetic ------------------------------------------------------------------------------------

    @property
    def exponents(self) -> dict[str, int]:
        """Of inputs and outputs that are no binary angles."""
        p = self.program
        found = {**p.inputs, **{c: e for c, (_, e) in p.outputs.items()}}
        return {c: e for c, e in found.items() if c not in p.angles}

    def _port(self, column: str) -> Port:
        if column in self.program.angles:
            return Port(column, "uint32_t", f"{short(column)}_bam", self.bam[1], self.bam[0])
        exponent = self.exponents[column]
        return Port(column, "int32_t", identifier(column), f"2^-{exponent} {unit(column)}", 2.0**-exponent)

    @property
    def bam(self) -> tuple[float, str]:
        """What a unit of a binary angle is [rad], and in words: 2^-32 of what the angle repeats with."""
        period = self.decoupler.model.period[self.decoupler.pose[0]]
        return UNIT * (period / (2 * pi)), f"2^-32 {'turn' if period == 2 * pi else 'period'}"

    @property
    def reads_angle(self) -> bool:
        """Whether an input is a binary angle, of which every bit pattern is one."""
        return bool(self.program.angles & set(self.decoupler.inputs))

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Integers towards zero."""
        found = []
        for port in self.inputs:
            own = [int(v / port.scale) for v in self.decoupler.ends(port.column)]
            found.append(own if port.column in self.limited else [0, MASK])
        return np.array(found)[:, :1], np.array(found)[:, 1:]

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return inputs brought back into the box, where binary angles wrap, and the status bits."""
        wide = inputs.astype(np.int64)
        return super().hold(wide & MASK if self.reads_angle else wide)

    def run(self, clamped: np.ndarray) -> Ran:
        """Line by line; raises `OverflowError` beyond 32 bits."""
        p, d = self.program, self.decoupler

        def once(given: np.ndarray, samples: Any) -> Ran:
            inputs = self.hold(given)[0]
            found = p.run({short(c): row for c, row in zip(d.inputs, inputs, strict=True)})
            flags = np.zeros(given.shape[1], dtype=np.int64)
            for k, flag in enumerate(d.flags):
                flags |= np.where(found[flag.name] < p.table[p.flags[flag.name][1]][0], flag_bit(k), 0)
            pose, none = np.array([found[c] for c in d.pose]), np.zeros(given.shape[1], np.uint32)
            return Ran(pose, flags, np.array([found[n] for n in p.left]), none)

        return residual.checked(d, once, clamped, p.root) if d.suspects else once(clamped, slice(None))

    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Any integers, three quarters of them shifted towards the box."""
        n, count = np.asarray(numbers, dtype=np.uint32), len(self.decoupler.inputs)
        raw = backend.mix(n * np.uint32(count) + np.arange(1, count + 1, dtype=np.uint32)[:, None])
        return np.asarray(raw.view(np.int32) >> ((backend.mix(n) & np.uint32(3)).astype(np.int32)))

    def _words(self, pose: np.ndarray) -> np.ndarray:
        return (pose & MASK).astype(np.uint32)

    def _rounded(self, inputs: np.ndarray) -> np.ndarray:
        whole = np.round(inputs).astype(np.int64)
        return whole & MASK if self.reads_angle else whole

    def _beyond(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        values = [np.full_like(low, -MOST - 1), low - 1, high + 1, np.full_like(high, MOST)]
        return np.array(values)[: 0 if self.reads_angle else None]

    # -- the table -----------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> Sequence[Stored]:
        """Coefficients of the program, limits, tables of binary angles, offsets."""
        p, d = self.program, self.decoupler
        meaning = {e.name: f"[2^-{{e}} {e.unit}] {e.meaning}" for e in (*d.table, *d.offsets)}
        table: list[Stored] = []
        offsets: list[Stored] = []
        for name, (q, e) in p.table.items():
            note = meaning.get(name, "[2^-{e}] of the reciprocal").replace("{e}", str(e))
            kind = "<u4" if name in p.unsigned else "<i4"
            entry = Stored(name, np.array(q, kind), p.unsigned.get(name, note))
            (offsets if name.startswith("zero_") else table).append(entry)
        for c in self.limited:
            low, high = (int(v * 2.0 ** p.inputs[c]) for v in d.ends(c))
            name, symmetric = short(c), d.box.symmetric(c)
            limits = {f"limit_{name}": high} if symmetric else {f"low_{name}": low, f"high_{name}": high}
            for limit, q in limits.items():
                table.append(Stored(limit, np.array(q, "<i4"), "end of the range, in the unit of its input"))
        for a in p.arrays.values():
            note = f"[2^{a.shift - 32} turn] at as many phases of a turn"
            table.append(Stored(a.name, a.values.astype(f"<i{a.bits // 8}"), note))
        if len(p.root):
            table.append(Stored(ROOT, p.root.astype("<i4"), OF_ROOT))
        return [*table, *offsets]

    def _accepted(self) -> accepted.Ends:
        """Those of the same table in floating point where they fit, and all integers of what it has not.

        What makes an angle may be any integers.
        """
        p, d = self.program, self.decoupler
        found, out = accepted.accepted(d), {}
        exponents = {name: e for name, (_, e) in p.table.items()} | {
            f"{side}_{short(c)}": p.inputs[c] for c in self.limited for side in ("limit", "low", "high")
        }
        for e in self.entries:
            kind = np.iinfo(e.values.dtype)
            low, high = kind.min if p.angles else -kind.max, kind.max
            if e in self.offsets and e.name not in p.unsigned:
                low, high = -2 * KNOWN, 2 * KNOWN
            elif e.name in exponents and e.name in found and not (p.angles and e.name in p.table):
                scaled = [v * 2.0 ** exponents[e.name] for v in found[e.name]]
                low, high = max(low, floor(scaled[0])), min(high, ceil(scaled[1]))
            out[e.name] = float(low), float(high)
        return out

    def _just_outside(self, name: str) -> list[str]:
        low, high = map(int, self.accepted[name])
        if name in (*self.program.arrays, *self.program.unsigned, ROOT):
            return []
        return [_integer(int(v), False) for v in (low - 1, high + 1) if -MOST - 1 <= v <= MOST]

    @cached_property
    def layout(self) -> int:
        """Of names, exponents and lines."""
        p = self.program
        rows = [f"{VERSION} q31", *(f"{e.name} {e.note}" for e in self.numbers), *p.c({})]
        rows += [f"{c} {e}" for c, e in p.inputs.items()]
        rows += [f"{c} {n} {e}" for c, (n, e) in p.outputs.items()]
        rows += [f"angle {line.i}" for line in p.lines if line.operation == "angle"]
        rows += [f"{a.name}[{len(a.values)}] {a.bits} {a.shift}" for a in p.arrays.values()]
        rows += [f"left {name}" for name in p.left]
        return crc32("\n".join(rows).encode())

    def _literal(self, value: Any) -> str:
        return _integer(int(value), False)

    def _templates(self) -> dict[str, str]:
        """Angles are proved as a whole: no reciprocal is in them; every angle that is read is tried."""
        found = super()._templates()
        if self.program.angles and self.decoupler.evident:
            found["proof/eva.c"] = "common/proof/eva.c"
        if self.reads_angle:
            found["proof/exhaustive.c"] = f"{FRAGMENTS}every_angle.c"
        return found

    def _own(self, port: Port, given: bool) -> dict[str, Any]:
        p, c = self.program, port.column
        if not given:
            return {"line": p.outputs[c][0], "hashed": _integer(SOME, c in p.angles)}
        if c in p.angles:
            return {"interval": "Frama_C_unsigned_int_interval(0U, 0xFFFFFFFFU)"}
        sides = map(backend.of_params, ends(self.decoupler, c))
        return {"interval": f"Frama_C_interval({', '.join(sides)})"}

    @property
    def said(self) -> Sequence[str]:
        """Those of the program."""
        return (*self.program.said, *self.decoupler.of_faults)

    def json(self, **more: Any) -> str:
        """With the exponents."""
        return super().json(exponents=self.exponents, **more)

    def _fields(self) -> dict[str, Any]:
        p, d = self.program, self.decoupler
        prefix = {**dict.fromkeys(p.inputs, "DECOUPLER_"), **dict.fromkeys(p.outputs, "DECOUPLER_OUT_")}
        scales = []
        for c in (*self.inputs, *self.outputs):
            if c.column not in p.angles:
                e = self.exponents[c.column]
                scales.append({
                    "macro": prefix[c.column] + short(c.column).upper(), "exponent": e, "power": repr(2.0**e),
                    "step": repr(2.0**-e), "column": commented(c.column), "unit": c.unit,
                    "input": c.column in p.inputs,
                })  # fmt: skip
        known = [f"(pose->{identifier(c)} >= -{KNOWN}) && (pose->{identifier(c)} <= {KNOWN})" for c in d.pose]
        angles = [port.column in p.angles for port in self.outputs]
        tried = [[0x7FFFFFFF if angle else KNOWN for angle in angles]]
        tried += [[0x80000001 if angle else -KNOWN for angle in angles], [SOME] * len(angles)]
        steps = [line.i for line in p.lines if line.operation == "angle"]
        used = {name for line in p.lines for name in (line.a, line.b)}
        return {
            "real": "int32_t",
            "zero": "0",
            "one": "1",
            "some_zero": str(SOME),
            "scaled": scales,
            "largest": LARGEST,
            "clamped": self.clamped([c for c in d.inputs if c in p.angles or short(c) in used]),
            "body": p.c({e.name: f"p->{e.name}" for e in self.numbers}),
            "left": p.left,
            "operations": [line.operation for line in p.lines],
            "arctangents": ARCTANGENTS[: max(steps, default=0)],
            "fine": FINE,
            "known_within": "\n        && ".join(known),
            "known": [list(map(self._input, self.outputs, row)) for row in tried],
            "far": {
                port.member: [str(KNOWN + 1), str(-KNOWN - 1), "0"]
                for port, angle in zip(self.outputs, angles, strict=True)
                if not angle
            },
            "most": str(MOST),
            "deviations": [
                *[backend.UNION] * bool(self._ends_checked()),
                backend.STEP,
                *[SHIFTS] * p.shifts,
            ],
            **self._proofs(),
        }

    def range_test(self, column: str) -> str:
        """None of a binary angle."""
        return "" if column in self.program.angles else "limited"

    # -- self-test and proofs ------------------------------------------------------------------------------

    def _input(self, port: Port, value: Any) -> str:
        return _integer(int(value), port.column in self.program.angles)

    def _proofs(self) -> dict[str, Any]:
        """Every divisor through its reciprocal, and the arithmetic for Frama-C EVA.

        EVA cannot follow that b (1 / b) is 1: it takes each reciprocal within what the trial of all divisors
        showed of it.
        """
        p = self.program
        text = p.c({e.name: f"decoupler_params.{e.name}" for e in self.numbers})
        eva, reciprocals = list(text), []
        for r in p.reciprocals:
            low, high, least, most = _integers(r)
            b, result = r.b.text, r.r.text
            reciprocals.append({
                "b": b, "lines": text[r.first : r.last], "r": result, "b_unit": repr(r.b.unit),
                "r_unit": repr(r.r.unit), "error": repr(float(r.r.error)), "least": least, "most": most,
                "low": low, "high": high,
            })  # fmt: skip
            eva[r.first : r.last] = [""] * (r.last - r.first)
            eva[r.last - 1] = f"const int32_t {result} = Frama_C_interval({least}, {most});"
        for c, (name, e) in p.outputs.items():
            low_value, high_value, error = p.bounds[c]
            room = ceil((high_value - low_value) * 2.0**e * 0.01) + 8  # EVA rounds each step outwards
            least = floor((low_value - error) * 2.0**e) - room
            most = ceil((high_value + error) * 2.0**e) + room
            eva.append(f"const int32_t out_{short(c)} = {name};")
            eva.append(f"//@ assert {short(c)}_bounded: {least} <= out_{short(c)} <= {most};")
        return {
            "turned": max((int(abs(a.values).max()) << a.shift for a in p.arrays.values()), default=0),
            "reciprocals": reciprocals,
            **({"tried": "every angle, through all of the code"} if self.reads_angle else {}),
            "eva_lines": [line for line in eva if line],
        }


def _integers(r: Reciprocal) -> tuple[int, int, int, int]:
    """Return least and greatest integer of divisor and reciprocal."""
    b, e, least, most = r.b, r.r.e, r.r.low - r.r.error, r.r.high + r.r.error
    return floor(b.low * 2.0**b.e), ceil(b.high * 2.0**b.e), floor(least * 2.0**e), ceil(most * 2.0**e)


def _integer(value: int | np.integer, unsigned: bool) -> str:
    if unsigned:
        return f"{value}U"
    return f"({value + 1} - 1)" if value == -MOST - 1 else str(value)


MOST = 2**31 - 1
"""Largest integer with a sign."""
