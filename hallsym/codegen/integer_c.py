"""The same arithmetic in 32-bit integers, for a controller without a floating-point unit.

Each value v is an integer q with v = q 2^-e; the exponent e of every node of the printed graph is fixed at
generation from its range over the box (interval arithmetic), so that no sum or product overflows, and each
has a bound of |computed - exact|. A product keeps its upper 32 bits, made of three 16-bit products: what
Cortex-M0 multiplies in one instruction each. A quotient is a product with a reciprocal: a straight line
that is nearest over the range of the divisor, then Newton steps, each squaring the relative error, until
rounding is all that is left.
"""

from collections.abc import Mapping
from math import ceil, log2
from typing import Any, cast

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Decoupler
from hallsym.codegen.entries import short
from hallsym.codegen.fixed_point import Fixed, Line, Program, Reciprocal
from hallsym.codegen.float_c import straight
from hallsym.codegen.operations import graph
from hallsym.errors import InputError

ROOM = 30
"""Bits that a value may take: one is left for what rounding adds."""
LOW = 3
"""A product is low by less than so many units of its last bit (`q31_program.UPPER`)."""
MOST_STEPS = 5
"""Newton steps of a reciprocal: enough for a divisor that falls to a tenth of itself."""


def exponent(low: float, high: float, bits: int = ROOM) -> int:
    """Return the largest e with |v| 2^e <= 2^bits."""
    most = max(abs(low), abs(high), 2.0**-60)
    return bits - ceil(log2(most) + 1e-9)


def integer_program(d: Decoupler, **options: Any) -> Program:
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
        found = graph([expression])
        made: list[Fixed] = []
        for operation in found.operations:
            if operation.op == "input":
                made.append(known[operation.symbol])
                continue
            args = [made[k] for k in operation.args]
            if operation.op == "mul":
                made.append(self._mul(*args))
            elif operation.op == "sq":
                made.append(self._mul(args[0], args[0]))
            elif operation.op in ("add", "sub"):
                made.append(self._add(args[0], args[1], minus=operation.op == "sub"))
            elif operation.op == "div":
                made.append(self._divide(*args))
            else:
                raise InputError(f"Operation {operation.op} of the model has no integer form; use float.")
        return made[found.results[0]]

    def _line(self, operation: str, a: str, b: str = "", i: int = 0, j: int = 0) -> str:
        name = f"q{len(self.p.lines) + 1}"
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
