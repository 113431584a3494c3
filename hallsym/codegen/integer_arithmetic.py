"""The decoupler in 32-bit integers: its numbers and its table; `integer_backend` prints it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar
from zlib import crc32

import numpy as np

from hallsym.codegen.arithmetic import COUNT, Port, mix
from hallsym.codegen.backend import VERSION, Backend, Stored
from hallsym.codegen.binary_angle import MASK, UNIT
from hallsym.codegen.bounds import Bounds
from hallsym.codegen.decoupler import flag_bit
from hallsym.codegen.entries import short, unit
from hallsym.codegen.fixed_point import Program
from hallsym.codegen.naming import identifier

MOST = 2**31 - 1
"""Largest integer with a sign."""


@dataclass(frozen=True, eq=False)
class IntegerArithmetic(Backend):
    """Runs an integer program: the same bits as C, in 64-bit integers."""

    program: Program

    tree: ClassVar[str] = "q31"
    hashed: ClassVar[tuple[int, int]] = (4096, 100_000)
    batch: ClassVar[int] = 1 << 62
    type: ClassVar[str] = "q31"

    @cached_property
    def bounds(self) -> Bounds:
        """Of the program, table and approximations included."""
        low, high, error = ({c: v[k] for c, v in self.program.bounds.items()} for k in range(3))
        return Bounds(low, high, error, {})

    @property
    def error_bound(self) -> Mapping[str, float]:
        """Everything is counted."""
        return self.bounds.error

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

    def _port(self, column: str, exponent: int) -> Port:
        if column in self.program.angles:
            return Port(column, "uint32_t", f"{short(column)}_bam", "2^-32 turn", UNIT)
        return Port(column, "int32_t", identifier(column), f"2^-{exponent} {unit(column)}", 2.0**-exponent)

    @cached_property
    def inputs(self) -> Sequence[Port]:
        """Integers, or binary angles."""
        return [self._port(c, self.program.inputs[c]) for c in self.decoupler.inputs]

    @cached_property
    def outputs(self) -> Sequence[Port]:
        """Integers, or binary angles."""
        return [self._port(c, self.program.outputs[c][1]) for c in self.decoupler.pose]

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
        found = [
            [int(v / port.scale) for v in self.decoupler.ends(port.column)]
            if port.column in self.limited
            else [0, MASK]
            for port in self.inputs
        ]
        return np.array(found)[:, :1], np.array(found)[:, 1:]

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return inputs brought back into the box, where binary angles wrap, and the status bits."""
        wide = inputs.astype(np.int64)
        return super().hold(wide & MASK if self.reads_angle else wide)

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

    def _words(self, pose: np.ndarray) -> np.ndarray:
        return (pose & MASK).astype(np.uint32)

    def _rounded(self, inputs: np.ndarray) -> np.ndarray:
        return np.round(inputs).astype(np.int64)

    def _trials(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Random poses are in SI."""
        if self.decoupler.drawn is None:
            return super()._trials(rng, count)
        scales = np.array([[port.scale] for port in self.inputs])
        return np.clip(np.round(self.decoupler.drawn(rng, count) / scales), *self.ends)

    def _chosen(self) -> np.ndarray:
        """Return corners and points of the box, and inputs that are out of range."""
        d, (low, high) = self.decoupler, self.ends
        rng = np.random.default_rng(1)
        share = np.hstack([rng.choice([0.0, 1.0], (len(low), 8)), rng.random((len(low), COUNT - 8))])
        given = [self._rounded(low + (high - low) * share if d.drawn is None else self._trials(rng, COUNT))]
        for k in range(0 if self.reads_angle else len(low)):
            beyond = np.repeat(given[0][:, 9 + k : 10 + k], 4, axis=1)
            beyond[k] = (-MOST - 1, low[k, 0] - 1, high[k, 0] + 1, MOST)
            given.append(beyond)
        if d.listed:
            listed = self._rounded(np.array(d.listed) / [port.scale for port in self.inputs]).T
            given.append(listed & MASK if self.reads_angle else listed)
        return np.hstack(given)

    # -- the table -----------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> Sequence[Stored]:
        """Coefficients of the program, limits, tables of binary angles, zeros."""
        p, d = self.program, self.decoupler
        meaning = {e.name: f"[2^-{{e}} {e.unit}] {e.meaning}" for e in (*d.table, *d.zeros)}
        table: list[Stored] = []
        zeros: list[Stored] = []
        for name, (q, e) in p.table.items():
            note = meaning.get(name, "[2^-{e}] of the reciprocal").replace("{e}", str(e))
            kind = "<u4" if name in p.unsigned else "<i4"
            entry = Stored(name, np.array(q, kind), p.unsigned.get(name, note))
            (zeros if name.startswith("zero_") else table).append(entry)
        for c in self.limited:
            low, high = (int(v * 2.0 ** p.inputs[c]) for v in d.ends(c))
            name, symmetric = short(c), d.box.symmetric(c)
            limits = {f"limit_{name}": high} if symmetric else {f"low_{name}": low, f"high_{name}": high}
            for limit, q in limits.items():
                table.append(Stored(limit, np.array(q, "<i4"), "end of the range, in the unit of its input"))
        rows = [
            Stored(
                a.name,
                a.values.astype(f"<i{a.bits // 8}"),
                f"[2^{a.shift - 32} turn] at as many phases of a turn",
            )
            for a in p.arrays.values()
        ]
        return [*table, *rows, *zeros]

    @property
    def numbers(self) -> list[Stored]:
        """The entries without rows."""
        return [e for e in self.entries if not e.values.ndim]

    @cached_property
    def layout(self) -> int:
        """Of names, exponents and lines."""
        p = self.program
        rows = [f"{VERSION} q31", *(f"{e.name} {e.note}" for e in self.numbers), *p.c({})]
        rows += [f"{c} {e}" for c, e in p.inputs.items()]
        rows += [f"{c} {n} {e}" for c, (n, e) in p.outputs.items()]
        rows += [f"angle {line.i}" for line in p.lines if line.operation == "angle"]
        rows += [f"{a.name}[{len(a.values)}] {a.bits} {a.shift}" for a in p.arrays.values()]
        return crc32("\n".join(rows).encode())

    def _json(self) -> dict[str, Any]:
        record: dict[str, Any] = {
            "exponents": self.exponents,
            "parameters": [{"name": e.name, "value": int(e.values), "meaning": e.note} for e in self.numbers],
        }
        if self.program.arrays:
            record["arrays"] = [
                {"name": a.name, "values": a.values.tolist(), "unit_turn": 2.0 ** (a.shift - 32)}
                for a in self.program.arrays.values()
            ]
        return record

    def _literal(self, value: Any) -> str:
        return str(value)
