"""A program of 32-bit integers: its lines, run in Python and printed in C."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.codegen import binary_angle as turns
from hallsym.codegen.decoupler import Decoupler
from hallsym.codegen.templates import lines_of

FRAGMENTS = "q31/fragments/"
UNSIGNED = ("angle", "turn")
"""Operations whose result is a binary angle."""


@dataclass(frozen=True)
class Fixed:
    """An integer in the printed code: its C text, exponent e (value = q 2^-e), range of exact values.

    The computed value differs from the exact one by at most `error`.
    """

    text: str
    e: int
    low: float
    high: float
    error: float = 0.0

    @property
    def most(self) -> float:
        """Largest magnitude of the computed value."""
        return max(abs(self.low), abs(self.high)) + self.error

    @property
    def unit(self) -> float:
        """Value of the last bit."""
        return 2.0**-self.e


@dataclass(frozen=True)
class Line:
    """One integer statement: `name` = an operation on earlier names, constants of the table and shifts.

    Operations: `mul a b` (upper 32 bits), `add a i b j` (a >> i plus b >> j), `sub`, `left a n`, `right a n`,
    `one n a` (2^n - a); of angles, which are unsigned (`hallsym.codegen.binary_angle`): `angle x y` in i
    steps, `look a` in an array, `turn a b` (a plus b, counted round).
    """

    name: str
    operation: str
    a: str
    b: str = ""
    i: int = 0
    j: int = 0


@dataclass(frozen=True)
class Reciprocal:
    """Lines `first` to `last` (not included) turn divisor `b` into r, |r - 1/b| <= r.error for the integer b.

    Exponents and ranges are those of `b` and `r`, the ranges with what rounding adds.
    """

    b: Fixed
    r: Fixed
    first: int
    last: int


@dataclass(eq=False)
class Program:
    """Integer lines of a decoupler, its table of integers, and the exponents of inputs and outputs."""

    d: Decoupler
    lines: list[Line] = field(default_factory=list)
    table: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Integer and exponent of each entry."""
    inputs: dict[str, int] = field(default_factory=dict)
    outputs: dict[str, tuple[str, int]] = field(default_factory=dict)
    """Name of the line and exponent, by pose column."""
    bounds: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Least and greatest exact value and error [SI], by pose column."""
    reciprocals: list[Reciprocal] = field(default_factory=list)
    angles: frozenset[str] = frozenset()
    """Columns that are binary angles: 2^32 to a turn, unsigned."""
    unsigned: dict[str, str] = field(default_factory=dict)
    """Entries of the table that are binary angles, and what they mean."""
    arrays: dict[str, turns.AngleTable] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    """Sentences for header and report."""
    options: dict[str, Any] = field(default_factory=dict)
    """What the choices of a family came to: given again, they make the same code."""
    flags: dict[str, tuple[str, str]] = field(default_factory=dict)
    """By name of a flag: the line and the least value, an entry, below which it is set."""
    _count: int = 0

    def run(self, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the integers of the pose for integers of the inputs: the same as C, in 64-bit integers."""
        value: dict[str, np.ndarray] = {n: np.asarray(v, dtype=np.int64) for n, v in inputs.items()}
        value |= {n: np.array(q, dtype=np.int64) for n, (q, _) in self.table.items()}
        for line in self.lines:
            a = value[line.a]
            b = value[line.b] if line.b in value else np.int64(0)
            if line.operation in UNSIGNED:
                value[line.name] = self._angle(line, value)
                continue
            if line.operation == "mul":
                ah, al, bh, bl = a >> 16, a & 0xFFFF, b >> 16, b & 0xFFFF
                result = ah * bh + ((ah * bl) >> 16) + ((al * bh) >> 16)
            elif line.operation == "add":
                result = (a >> line.i) + (b >> line.j)
            elif line.operation == "sub":
                result = (a >> line.i) - (b >> line.j)
            elif line.operation == "left":
                result = a << line.i
            elif line.operation == "right":
                result = a >> line.i
            elif line.operation == "look":
                result = self.arrays[line.b].at(a)
            else:  # one
                result = (np.int64(1) << line.i) - a
            if np.any(np.abs(result) > 2**31 - 1):
                raise OverflowError(f"{line.name} overflows")
            value[line.name] = result
        return {c: value[name] for c, (name, _) in self.outputs.items()} | {
            flag: value[name] for flag, (name, _) in self.flags.items()
        }

    def _angle(self, line: Line, value: Mapping[str, np.ndarray]) -> np.ndarray:
        a, b = value[line.a], value[line.b]
        return turns.angle_of(a, b, line.i) if line.operation == "angle" else (a + b) & turns.MASK

    @property
    def shifts(self) -> bool:
        """Whether numbers with a sign are shifted right."""
        return any(
            line.operation in ("mul", "right", "angle", "look") or line.i or line.j for line in self.lines
        )

    def c(self, names: Mapping[str, str]) -> list[str]:
        """Return the lines in C; `names` gives the text of inputs and table entries."""
        out = []
        for line in self.lines:
            a, b = names.get(line.a, line.a), names.get(line.b, line.b)
            if line.operation == "mul":
                text = f"upper({a}, {b})"
            elif line.operation in ("add", "sub"):
                sign = "+" if line.operation == "add" else "-"
                text = f"{_shifted(a, line.i)} {sign} {_shifted(b, line.j)}"
            elif line.operation == "left":
                text = f"{a} * {1 << line.i}"
            elif line.operation == "right":
                text = f"{a} >> {line.i}"
            elif line.operation == "angle":
                text = f"angle_of({a}, {b})"
            elif line.operation == "look":
                text = f"{line.b}_at(p, {a})"
            elif line.operation == "turn":
                text = f"{a} + {b if line.b in self.unsigned else f'(uint32_t){b}'}"
            else:
                text = f"{1 << line.i} - {a}"
            kind = "uint32_t" if line.operation in UNSIGNED else "int32_t"
            out.append(f"const {kind} {line.name} = {text};")
        return out


def _shifted(text: str, n: int) -> str:
    return f"({text} >> {n})" if n else text


def helpers(program: Program) -> list[str]:
    """Return the C functions that the lines of a program call."""
    used = {line.operation for line in program.lines}
    called = lines_of(f"{FRAGMENTS}upper.c", {}) if "mul" in used else []
    for line in program.lines:
        if line.operation == "angle":
            angles = [f"{t}U" for t in turns.ARCTANGENTS[: line.i]]
            rows = [", ".join(angles[k : k + 8]) for k in range(0, line.i, 8)]
            fields: dict[str, Any] = {"steps": line.i, "arctangents": ",\n        ".join(rows)}
            called += lines_of(f"{FRAGMENTS}angle_of.c", fields)
    for array in program.arrays.values():
        called += _look_up(array)
    return called


def _look_up(array: turns.AngleTable) -> list[str]:
    """The C of `Array.at`."""
    fine, count = turns.FINE, len(array.values)
    left, right = f"p->{array.name}[cell]", f"p->{array.name}[(cell + 1U) & {count - 1}U]"
    if array.bits == 16:
        left, right = f"(int32_t){left}", f"(int32_t){right}"
        scaled = f"left * {1 << array.shift}" if array.shift else "left"
        moved = f"(rise * rest) >> {fine - array.shift}" if array.shift < fine else "rise * rest"
        between = [f"return ({scaled}) + ({moved});"]
    else:
        between = [
            f"const uint32_t rise_bits = (uint32_t)rise & 0x{2**fine - 1:X}U;",
            "const int32_t rise_low = (int32_t)rise_bits;",
            f"return left + ((rise >> {fine}) * rest) + ((rise_low * rest) >> {fine});",
        ]
    return lines_of(f"{FRAGMENTS}look_up.c", {
        "name": array.name, "count": count, "kind": f"int{array.bits}_t", "first": array.first,
        "finer": array.first - fine, "way": f"0x{2**fine - 1:X}", "left": left, "right": right,
        "between": between,
    })  # fmt: skip
