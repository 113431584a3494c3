"""The same arithmetic in 32-bit integers, for a controller without a floating-point unit.

Each value v is an integer q with v = q 2^-e; the exponent e of every node of the printed graph is fixed at
generation from its range over the box (interval arithmetic), so that no sum or product overflows, and each
has a bound of |computed - exact|. A product keeps its upper 32 bits, made of three 16-bit products: what
Cortex-M0 multiplies in one instruction each. A quotient is a product with a reciprocal: a straight line
that is nearest over the range of the divisor, then Newton steps, each squaring the relative error, until
rounding is all that is left.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import ceil, log2
from typing import Any, cast

import casadi as ca
import numpy as np

from hallsym.codegen import turns
from hallsym.codegen.entries import short, unit
from hallsym.codegen.parts import Decoupler
from hallsym.codegen.printer import straight
from hallsym.errors import InputError

ROOM = 30
"""Bits that a value may take: one is left for what rounding adds."""
UNSIGNED = ("angle", "turn")
"""Operations whose result is a binary angle."""
LOW = 3
"""A product is low by less than so many units of its last bit (`UPPER`)."""
MOST_STEPS = 5
"""Newton steps of a reciprocal: enough for a divisor that falls to a tenth of itself."""


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
    `one n a` (2^n - a); of angles, which are unsigned (`hallsym.codegen.turns`): `angle x y` in i steps,
    `look a` in an array, `turn a b` (a plus b, counted round).
    """

    name: str
    operation: str
    a: str
    b: str = ""
    i: int = 0
    j: int = 0


def exponent(low: float, high: float, bits: int = ROOM) -> int:
    """Return the largest e with |v| 2^e <= 2^bits."""
    most = max(abs(low), abs(high), 2.0**-60)
    return bits - ceil(log2(most) + 1e-9)


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
    arrays: dict[str, turns.Array] = field(default_factory=dict)
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

    def unit(self, column: str) -> float:
        """Return the SI value of the last bit of an input or output."""
        if column in self.angles:
            return turns.UNIT
        return 2.0 ** -(self.inputs[column] if column in self.inputs else self.outputs[column][1])

    @property
    def shifts(self) -> bool:
        """Whether numbers with a sign are shifted right."""
        return any(
            line.operation in ("mul", "right", "angle", "look") or line.i or line.j for line in self.lines
        )

    def scale(self, column: str) -> str:
        """Return what the last bit of an input or output is, for a reader."""
        if column in self.angles:
            return "2^-32 turn"
        e = self.inputs[column] if column in self.inputs else self.outputs[column][1]
        return f"2^-{e} {unit(column)}"

    @property
    def exponents(self) -> dict[str, int]:
        """Of inputs and outputs that are no binary angles."""
        found = {**self.inputs, **{c: e for c, (_, e) in self.outputs.items()}}
        return {c: e for c, e in found.items() if c not in self.angles}

    def member(self, column: str) -> str:
        """Return the C name of an input or output: `angle_bam` of a binary angle."""
        return f"{short(column)}_bam" if column in self.angles else column

    def kind(self, column: str) -> str:
        """Return the C type of an input or output."""
        return "uint32_t" if column in self.angles else "int32_t"

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


def program(d: Decoupler, **options: Any) -> Program:
    """Return the integer program of a decoupler that is linear in the pose, or that brings one of its own.

    `options`: what the latter takes.
    """
    if d.integers is not None:
        return cast(Program, d.integers(**options))
    if d.at_pose:
        raise InputError(
            "--arithmetic q31 is generated for models that are linear in the pose; "
            f"{d.model.name} is iterated; use float."
        )
    if not straight(d.steps):
        raise InputError(
            f"--arithmetic q31 is generated for models without comparisons; {d.model.name} of the family "
            f"{d.model.family} chooses by branch: use float, which runs without a floating-point unit too."
        )
    return Compiler(d).compile()


class Compiler:
    """Makes integer lines of steps, each with its exponent, its range and its error."""

    def __init__(self, d: Decoupler) -> None:
        self.d, self.p = d, Program(d)

    def compile(self) -> Program:
        """Return the program."""
        d, p = self.d, self.p
        known: dict[str, Fixed] = {}
        for c in d.inputs:
            low, high = d.ends(c)
            e = exponent(low, high)
            known[short(c)] = Fixed(short(c), e, low, high)
            p.inputs[c] = e
        for entry in d.table:
            known[entry.name] = self._constant(entry.name, entry.value)
        for entry in d.zeros:
            known[entry.name] = Fixed(entry.name, 0, 0.0, 0.0)
        for step in d.steps:
            known[step.name] = self._step(step.expression, known)
        for c, step in zip(d.pose, d.steps[-len(d.pose) :], strict=True):
            found = known[step.name]
            e = min(found.e, exponent(found.low, found.high, ROOM - 1))
            p.table[f"zero_{short(c)}"] = (0, e)
            p.outputs[c] = (self._line("add", found.text, f"zero_{short(c)}", found.e - e), e)
            p.bounds[c] = (found.low, found.high, found.error + (2.0**-e if found.e > e else 0.0))
        return p

    def _constant(self, name: str, value: float, e: int | None = None) -> Fixed:
        e = exponent(value, value) if e is None else e
        self.p.table[name] = (round(value * 2.0**e), e)
        q = self.p.table[name][0]
        return Fixed(name, e, value, value, abs(value - q * 2.0**-e))

    def _step(self, expression: ca.SX, known: Mapping[str, Fixed]) -> Fixed:
        symbols = ca.symvar(expression)
        f = ca.Function("step", symbols, [ca.densify(expression)])
        work: dict[int, Fixed] = {}
        result = None
        for k in range(f.n_instructions()):
            code, i, o = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
            if code == ca.OP_INPUT:
                work[o[0]] = known[symbols[i[0]].name()]
            elif code == ca.OP_OUTPUT:
                result = work[i[0]]
            elif code == ca.OP_MUL:
                work[o[0]] = self._mul(work[i[0]], work[i[1]])
            elif code == ca.OP_SQ:
                work[o[0]] = self._mul(work[i[0]], work[i[0]])
            elif code == ca.OP_ADD:
                work[o[0]] = self._add(work[i[0]], work[i[1]])
            elif code == ca.OP_SUB:
                work[o[0]] = self._add(work[i[0]], work[i[1]], minus=True)
            elif code == ca.OP_DIV:
                work[o[0]] = self._divide(work[i[0]], work[i[1]])
            else:
                raise InputError(f"Operation {code} of the model has no integer form; use float.")
        assert result is not None  # every function has an output
        return result

    def _line(self, operation: str, a: str, b: str = "", i: int = 0, j: int = 0) -> str:
        self.p._count += 1
        name = f"q{self.p._count}"
        self.p.lines.append(Line(name, operation, a, b, i, j))
        return name

    def _checked(self, v: Fixed) -> Fixed:
        """Refuse what does not fit into 31 bits and a sign."""
        if not v.most * 2.0**v.e < 2**31:
            raise InputError(
                "A value does not fit into 32 bits over the box; give a smaller one with --range."
            )
        return v

    def _mul(self, a: Fixed, b: Fixed) -> Fixed:
        ends = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
        e = a.e + b.e - 32
        error = a.error * b.most + b.error * a.most + LOW * 2.0**-e
        return self._checked(Fixed(self._line("mul", a.text, b.text), e, min(ends), max(ends), error))

    def _add(self, a: Fixed, b: Fixed, minus: bool = False) -> Fixed:
        low, high = (a.low - b.high, a.high - b.low) if minus else (a.low + b.low, a.high + b.high)
        if a.text.startswith("zero_"):  # added at the end, in the exponent of the result
            return b
        e = min(a.e, b.e, exponent(low, high))
        error = a.error + b.error + ((a.e > e) + (b.e > e)) * 2.0**-e
        name = self._line("sub" if minus else "add", a.text, b.text, a.e - e, b.e - e)
        return self._checked(Fixed(name, e, low, high, error))

    def _divide(self, a: Fixed, b: Fixed) -> Fixed:
        if b.low - b.error <= 0 <= b.high + b.error:
            raise InputError("A gain crosses zero within the box; give a smaller one with --range.")
        return self._grown(self._mul(a, self._reciprocal(b)))

    def _reciprocal(self, b: Fixed) -> Fixed:
        """1 / b: the line c0 - c1 b that is nearest over its range, then r += r (1 - b r) until it settles.

        `off` bounds |r - 1 / b| for the integer b as it is; each step leaves b off^2 and its rounding.
        """
        first, low, high = len(self.p.lines), b.low - b.error, b.high + b.error
        least, most = sorted((abs(low), abs(high)))
        slope = 1 / (low * high)
        middle = np.sqrt(low * high) * (1 if low > 0 else -1)
        # equal errors at the ends and at the geometric mean
        level = 0.5 * ((1 / low + slope * low) + (1 / middle + slope * middle))
        c1 = self._constant(f"slope_{b.text}", slope)
        c0 = self._constant(f"level_{b.text}", level)
        line = self._add(c0, self._mul(c1, Fixed(b.text, b.e, low, high)), minus=True)
        off = max(abs(level - slope * v - 1 / v) for v in (low, middle, high)) + line.error
        ends = _between(1 / low, 1 / high)
        r = self._grown(Fixed(line.text, line.e, *ends, off))
        for _ in range(MOST_STEPS):
            name = self._line("mul", b.text, r.text)  # nearly 1
            e = b.e + r.e - 32
            short_of = most * r.error + LOW * 2.0**-e
            rest = self._grown(Fixed(self._line("one", name, i=e), e, -short_of, short_of))
            far = r.most * short_of
            e_product = r.e + rest.e - 32
            product = Fixed(self._line("mul", r.text, rest.text), e_product, -far, far)
            if product.e < r.e:
                product = self._grown(product, r.e)
            e_sum = min(r.e, product.e, exponent(*ends))
            text = self._line("add", r.text, product.text, r.e - e_sum, product.e - e_sum)
            rounding = r.most * LOW * 2.0**-e + LOW * 2.0**-e_product
            rounding += ((r.e > e_sum) + (product.e > e_sum)) * 2.0**-e_sum
            squared = most * r.error**2
            r = self._checked(Fixed(text, e_sum, *ends, squared + rounding))
            if squared < rounding:
                divisor = Fixed(b.text, b.e, low, high)
                self.p.reciprocals.append(Reciprocal(divisor, r, first, len(self.p.lines)))
                return Fixed(r.text, r.e, *_between(1 / b.low, 1 / b.high), r.error + b.error / least**2)
        raise InputError("A gain varies too much over the box for integers; give a smaller one with --range.")

    def _grown(self, v: Fixed, most: int = 99) -> Fixed:
        """Shift left as far as the range allows, to exponent `most`: products keep the upper bits."""
        n = min(exponent(v.low - v.error, v.high + v.error), most) - v.e
        if n <= 0:
            return v
        return Fixed(self._line("left", v.text, i=n), v.e + n, v.low, v.high, v.error)


def _between(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


UPPER = """\
/* Upper 32 bits of a product, low by at most 2: three 16-bit products. */
static inline int32_t upper(int32_t a, int32_t b)
{
    const int32_t a_high = a >> 16;
    const int32_t b_high = b >> 16;
    const uint32_t a_bits = (uint32_t)a & 0xFFFFU;
    const uint32_t b_bits = (uint32_t)b & 0xFFFFU;
    const int32_t a_low = (int32_t)a_bits;
    const int32_t b_low = (int32_t)b_bits;
    return (a_high * b_high) + ((a_high * b_low) >> 16) + ((a_low * b_high) >> 16);
}
"""
