"""A program of 32-bit integers: its lines, run in Python and printed in C."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.codegen import binary_angle
from hallsym.codegen.decoupler import Decoupler
from hallsym.codegen.templates import lines_of

FRAGMENTS = "q31/fragments/"
LARGEST = 2**31 - 128
"""Largest integer of a value or an end of a range: the largest float below 2^31, where conversions end."""
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
    """One integer statement: `name` = an operation on earlier names, entries of the table and shifts i, j."""

    name: str
    operation: str
    """One of `OPERATIONS`."""
    a: str
    b: str = ""
    i: int = 0
    j: int = 0


def upper(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the upper 32 bits of a product, low by at most 2: three 16-bit products, as `upper` of the C."""
    ah, al, bh, bl = a >> 16, a & 0xFFFF, b >> 16, b & 0xFFFF
    return np.asarray(ah * bh + ((ah * bl) >> 16) + ((al * bh) >> 16))


def _shifted(text: str, n: int) -> str:
    return f"({text} >> {n})" if n else text


OPERATIONS: dict[str, tuple[Callable[..., np.ndarray], Callable[[str, str, int, int], str]]] = {
    "mul": (lambda a, b, i, j: upper(a, b), lambda a, b, i, j: f"upper({a}, {b})"),
    "add": (
        lambda a, b, i, j: (a >> i) + (b >> j),
        lambda a, b, i, j: f"{_shifted(a, i)} + {_shifted(b, j)}",
    ),
    "sub": (
        lambda a, b, i, j: (a >> i) - (b >> j),
        lambda a, b, i, j: f"{_shifted(a, i)} - {_shifted(b, j)}",
    ),
    "left": (lambda a, b, i, j: a << i, lambda a, b, i, j: f"{a} * {1 << i}"),
    "right": (lambda a, b, i, j: a >> i, lambda a, b, i, j: f"{a} >> {i}"),
    "one": (lambda a, b, i, j: (1 << i) - a, lambda a, b, i, j: f"{1 << i} - {a}"),
    "look": (lambda a, b, i, j: b.at(a), lambda a, b, i, j: f"{b}_at(p, {a})"),
    "angle": (lambda a, b, i, j: binary_angle.angle_of(a, b, i), lambda a, b, i, j: f"angle_of({a}, {b})"),
    "turn": (lambda a, b, i, j: (a + b) & binary_angle.MASK, lambda a, b, i, j: f"{a} + {b}"),
}
"""What a line computes of a, b and shifts i, j in 64-bit integers, and in C.

`one`: 2^i - a; `look`: b is a table; `angle`: of the vector (a, b), in i steps; `turn`: counted round. The
last two are binary angles (`hallsym.codegen.binary_angle`), which are unsigned.
"""


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
    plan: list[int] = field(default_factory=list)
    """Exponents and counts of steps in the order in which they were chosen: given again, they make the same
    code."""
    reciprocals: list[Reciprocal] = field(default_factory=list)
    angles: frozenset[str] = frozenset()
    """Columns that are binary angles: 2^32 to a turn, unsigned."""
    unsigned: dict[str, str] = field(default_factory=dict)
    """Entries of the table that are binary angles, and what they mean."""
    arrays: dict[str, binary_angle.AngleTable] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    """Sentences for header and report."""
    options: dict[str, Any] = field(default_factory=dict)
    """What the choices of a family came to: given again, they make the same code."""
    flags: dict[str, tuple[str, str]] = field(default_factory=dict)
    """By name of a flag: the line and the least value, an entry, below which it is set."""

    def run(self, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the integers of the pose for integers of the inputs: the same as C, in 64-bit integers."""
        value: dict[str, Any] = {n: np.asarray(v, dtype=np.int64) for n, v in inputs.items()}
        value |= {n: np.array(q, dtype=np.int64) for n, (q, _) in self.table.items()} | self.arrays
        for line in self.lines:
            compute, _ = OPERATIONS[line.operation]
            a, b = (value.get(n) for n in (line.a, line.b))
            result = compute(a, b, line.i, line.j)
            if line.operation not in UNSIGNED and np.any(np.abs(result) > 2**31 - 1):
                raise OverflowError(f"{line.name} overflows")
            value[line.name] = result
        wanted = {c: name for c, (name, _) in self.outputs.items()}
        wanted |= {flag: name for flag, (name, _) in self.flags.items()}
        return {key: value[name] for key, name in wanted.items()}

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
            if line.operation == "turn" and line.b not in self.unsigned:
                b = f"(uint32_t){b}"
            _, text = OPERATIONS[line.operation]
            kind = "uint32_t" if line.operation in UNSIGNED else "int32_t"
            out.append(f"const {kind} {line.name} = {text(a, b, line.i, line.j)};")
        return out


def helpers(program: Program) -> list[str]:
    """Return the C functions that the lines of a program call."""
    lines = {line.operation: line for line in program.lines}
    called = lines_of(f"{FRAGMENTS}upper.c", {}) if "mul" in lines else []
    if "angle" in lines:
        steps = lines["angle"].i
        angles = [f"{t}U" for t in binary_angle.ARCTANGENTS[:steps]]
        rows = [", ".join(angles[k : k + 8]) for k in range(0, steps, 8)]
        fields: dict[str, Any] = {"steps": steps, "arctangents": ",\n        ".join(rows)}
        called += lines_of(f"{FRAGMENTS}angle_of.c", fields)
    for array in program.arrays.values():
        called += _look_up(array)
    return called


def _look_up(array: binary_angle.AngleTable) -> list[str]:
    """The C of `Array.at`."""
    fine, count = binary_angle.FINE, len(array.values)
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
