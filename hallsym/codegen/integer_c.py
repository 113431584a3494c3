"""The same arithmetic in 32-bit integers, for a controller without a floating-point unit.

Each value v is an integer q with v = q 2^-e; the exponent e of every node of the printed graph is fixed at
generation from its range over the box (interval arithmetic), so that no sum or product overflows, and each
has a bound of |computed - exact|. A product keeps its upper 32 bits, made of three 16-bit products: what
Cortex-M0 multiplies in one instruction each. A quotient is a product with a reciprocal: a straight line
that is nearest over the range of the divisor, then Newton steps, each squaring the relative error, until
rounding is all that is left.

Exponents must outlast a calibration, so they are chosen for more than it: quantities of one unit share one,
values take 30 of 31 bits, and gains may vary by the square of their ratio (up to `WIDEST`). What was chosen
is the plan of a program; a recalibration is compiled by the plan of its folder, and is refused only where a
value does not fit.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import ceil, log2
from typing import Any, cast

import numpy as np

from hallsym.codegen.decoupler import Decoupler, Step
from hallsym.codegen.entries import short, unit
from hallsym.codegen.fixed_point import LARGEST, Fixed, Line, Program, Reciprocal
from hallsym.codegen.float_c import straight
from hallsym.codegen.operations import Operation, graph
from hallsym.errors import InputError
from hallsym.model import Model

ROOM = 30
"""Bits that a value takes where its exponent is chosen: one is left for rounding and for recalibrations."""
OUTPUT_ROOM = 28
"""The same of a pose coordinate, of which `decoupler_zero()` adds two, and a known one of 29 bits."""
LIKE = 16.0
"""Ratio of their sizes up to which inputs, or entries, of one unit share an exponent.

4 bits of the smallest are given up. A smaller entry, such as a coupling that is nearly zero, may still grow
to a sixteenth of the largest."""
WIDEST = 4.0
"""Ratio of a gain's ends up to which exponents and steps allow for the square of the calibrated ratio."""
SETTLED = 256.0
"""What the last Newton step may leave, in units of rounding, where a gain varies by the square of its ratio.

A line leaves a share that goes with the square of the logarithm of the ratio, and two steps take it to the
fourth power: of the calibrated ratio they leave no more than rounding. A recalibration whose gains vary more
is less exact, and its bound says so."""
DOES_NOT_FIT = (
    "does not fit the exponents of the code in the folder, which hold twice the values they were made for; "
    "generate the folder again with --force."
)
OTHER_CODE = (
    "The code in the folder was made for another model or other options; generate it again with --force."
)
LOW = 3
"""A product is low by less than so many units of its last bit (`fixed_point`)."""
MOST_STEPS = 5
"""Newton steps of a reciprocal: enough for a divisor that falls to a tenth of itself."""


def exponent(low: float, high: float, bits: int = ROOM) -> int:
    """Return the largest e with |v| 2^e <= 2^bits."""
    most = max(abs(low), abs(high), 2.0**-60)
    return bits - ceil(log2(most) + 1e-9)


def integer_program(d: Decoupler, plan: Sequence[int] | None = None, **options: Any) -> Program:
    """Return the integer program of a decoupler that is linear in the pose, or that brings one of its own.

    `plan`: that of a program whose code it shall have (`Program.plan`). `options`: what a program of its own
    takes. Raises `InputError` where a value does not fit the plan.
    """
    if d.integers is not None:
        return cast(Program, d.integers(plan=plan, **options))
    if d.at_pose or not straight(d.steps):
        raise float_instead(d.model)
    return planned(lambda given: Compiler(d, given), plan)


def float_instead(model: Model) -> InputError:
    """What to say of a model that has no integers."""
    return InputError(
        "--arithmetic q31 is generated for encoders and for stages that are linear in the pose; "
        f"{model.name} of the family {model.family} has its C in float, which runs without a floating-point "
        "unit too: leave the option out."
    )


def planned(compiler: "Callable[[Sequence[int] | None], Compiler]", plan: Sequence[int] | None) -> Program:
    """Return the program of a plan, or of the one that the compiler makes without one.

    The plan is made for wider ranges than those of the calibration; errors are those of its own.
    """
    return compiler(compiler(None).compile().plan if plan is None else plan).compile()


class Compiler:
    """Makes integer lines of steps, each with its exponent, its range and its error.

    Exponents and counts of steps are taken from `plan` in their order, or chosen, with headroom.
    """

    def __init__(self, d: Decoupler, plan: Sequence[int] | None = None) -> None:
        self.d, self.p, self.given = d, Program(d), plan

    def compile(self) -> Program:
        """Return the program."""
        d, p = self.d, self.p
        known: dict[str, Fixed] = {}
        self._inputs()
        for c, e in p.inputs.items():
            known[short(c)] = self._checked(Fixed(short(c), e, *d.ends(c)))
        for entry in d.table:
            alike = max(abs(o.value) for o in d.table if o.unit == entry.unit)
            most = alike if abs(entry.value) * LIKE >= alike else alike / LIKE
            known[entry.name] = self._constant(entry.name, entry.value, self._exponent(-most, most))
        for entry in d.zeros:
            known[entry.name] = Fixed(entry.name, 0, 0.0, 0.0)
        for step in d.steps:
            known[step.name] = self._step(step, known)
        self._outputs({c: known[step.name] for c, step in zip(d.pose, d.steps[-len(d.pose) :], strict=True)})
        return p

    def _chosen(self, choose: Callable[[], int]) -> int:
        """Return the next number of the plan; one that is chosen where there is none."""
        plan = self.p.plan
        if self.given is not None and len(plan) == len(self.given):
            raise InputError(OTHER_CODE)
        plan.append(choose() if self.given is None else self.given[len(plan)])
        return plan[-1]

    def _exponent(self, low: float, high: float, bits: int = ROOM) -> int:
        return self._chosen(lambda: exponent(low, high, bits))

    def _inputs(self) -> None:
        """Give inputs of one unit and like ranges one exponent: readings, and columns of the state."""
        d = self.d
        for columns in (d.model.channels, d.inputs[len(d.model.channels) :]):
            reach = {c: max(map(abs, d.ends(c))) for c in columns}
            for c in columns:
                like = [reach[o] for o in columns if unit(o) == unit(c) and reach[o] <= LIKE * reach[c]]
                self.p.inputs[c] = self._exponent(0.0, max(like))

    def _outputs(self, found: Mapping[str, Fixed]) -> None:
        """Give pose coordinates of one unit one exponent, and add the zeros."""
        p = self.p
        shared: dict[str, int] = {}
        for c, v in found.items():
            e = min(v.e, exponent(v.low, v.high, OUTPUT_ROOM))
            shared[unit(c)] = min(shared.get(unit(c), e), e)
        shared = {name: self._chosen(partial(int, e)) for name, e in shared.items()}
        for c, v in found.items():
            e = shared[unit(c)]
            if v.most * 2.0**e > 0.75 * 2**ROOM:
                raise InputError(f"{c} {DOES_NOT_FIT}")
            p.table[f"zero_{short(c)}"] = (0, e)
            result = self._line("add", v.text, f"zero_{short(c)}", v.e - e)
            p.outputs[c] = (result, e)
            error = v.error + self.d.left(c) + self.d.cut + (2.0**-e if v.e > e else 0.0)
            p.bounds[c] = (float(v.low), float(v.high), float(error))

    def _constant(self, name: str, value: float, e: int | None = None) -> Fixed:
        e = self._exponent(value, value) if e is None else e
        self.p.table[name] = (round(value * 2.0**e), e)
        q = self.p.table[name][0]
        return self._checked(Fixed(name, e, value, value, abs(value - q * 2.0**-e)))

    def _step(self, step: Step, known: Mapping[str, Fixed]) -> Fixed:
        found = graph([step.expression])
        made: list[Fixed] = []
        for operation in found.operations:
            if operation.op == "input":
                made.append(known[operation.symbol])
                continue
            made.append(self._operation(operation, [made[k] for k in operation.args]))
        return made[found.results[0]]

    def _operation(self, operation: Operation, args: Sequence[Fixed]) -> Fixed:
        """Return what an operation of a step gives."""
        if operation.op == "mul":
            return self._mul(*args)
        if operation.op == "sq":
            return self._mul(args[0], args[0])
        if operation.op in ("add", "sub"):
            return self._add(args[0], args[1], minus=operation.op == "sub")
        if operation.op == "div":
            return self._divide(*args)
        raise InputError(f"Operation {operation.op} of the model has no integer form; use float.")

    def _line(self, operation: str, a: str, b: str = "", i: int = 0, j: int = 0) -> str:
        name = f"q{len(self.p.lines) + 1}"
        self.p.lines.append(Line(name, operation, a, b, i, j))
        return name

    def _checked(self, v: Fixed) -> Fixed:
        """Refuse what does not fit into 31 bits and a sign."""
        if not v.most * 2.0**v.e < LARGEST:
            if self.given is not None:
                raise InputError(f"The calibration's {v.text} {DOES_NOT_FIT}")
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
        if b.text.startswith("zero_"):
            return a
        e = min(a.e, b.e, self._exponent(low, high))
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
        first, (low, high, left) = len(self.p.lines), self._varied(b)
        slope = 1 / (low * high)
        middle = np.sqrt(low * high) * (1 if low > 0 else -1)
        # equal errors at the ends and at the geometric mean
        level = 0.5 * ((1 / low + slope * low) + (1 / middle + slope * middle))
        c1 = self._constant(f"slope_{b.text}", slope)
        c0 = self._constant(f"level_{b.text}", level)
        divisor = Fixed(b.text, b.e, low, high)
        line = self._add(c0, self._mul(c1, divisor), minus=True)
        off = max(abs(level - slope * v - 1 / v) for v in (low, middle, high)) + line.error
        r = self._grown(Fixed(line.text, line.e, *_between(1 / low, 1 / high), off))
        place, steps = len(self.p.plan), self._chosen(lambda: MOST_STEPS)
        for n in range(1, steps + 1):
            r, squared = self._newton(divisor, r)
            settled = squared < left * (r.error - squared)
            if settled and self.given is None:
                self.p.plan[place] = n
                break
        if not settled:
            raise InputError(
                "A gain varies too much over the box for integers; give a smaller one with --range."
                if self.given is None
                else f"The calibration's {b.text}, a gain over the box, {DOES_NOT_FIT}"
            )
        given = Fixed(b.text, b.e, b.low - b.error, b.high + b.error)
        self.p.reciprocals.append(Reciprocal(given, r, first, len(self.p.lines)))
        least = min(abs(given.low), abs(given.high))
        return Fixed(r.text, r.e, *_between(1 / b.low, 1 / b.high), r.error + b.error / least**2)

    def _varied(self, b: Fixed) -> tuple[float, float, float]:
        """Return the range of a divisor, a wider one where a plan is made, and what may be left then."""
        low, high = b.low - b.error, b.high + b.error
        if self.given is not None:
            return low, high, SETTLED
        ratio = max(high / low, low / high)
        more = np.clip(WIDEST / ratio, 1.0, ratio)
        left = (1 + np.log(more) / np.log(ratio)) ** np.log2(SETTLED) if more > 1 else 1.0
        wide = np.sqrt(more)
        return *((low / wide, high * wide) if low > 0 else (low * wide, high / wide)), left

    def _newton(self, b: Fixed, r: Fixed) -> tuple[Fixed, float]:
        """Return r + r (1 - b r), and what it leaves but for rounding."""
        ends = (r.low, r.high)
        name = self._line("mul", b.text, r.text)  # nearly 1
        e = b.e + r.e - 32
        short_of = b.most * r.error + LOW * 2.0**-e
        rest = self._grown(Fixed(self._line("one", name, i=e), e, -short_of, short_of))
        far = r.most * short_of
        e_product = r.e + rest.e - 32
        product = Fixed(self._line("mul", r.text, rest.text), e_product, -far, far)
        if product.e < r.e:
            product = self._grown(product, r.e)
        e_sum = min(r.e, product.e, self._exponent(*ends))
        text = self._line("add", r.text, product.text, r.e - e_sum, product.e - e_sum)
        rounding = r.most * LOW * 2.0**-e + LOW * 2.0**-e_product
        rounding += ((r.e > e_sum) + (product.e > e_sum)) * 2.0**-e_sum
        squared = b.most * r.error**2
        return self._checked(Fixed(text, e_sum, *ends, squared + rounding)), squared

    def _grown(self, v: Fixed, most: int = 99) -> Fixed:
        """Shift left as far as the range allows, to exponent `most`: products keep the upper bits."""
        n = min(self._exponent(v.low - v.error, v.high + v.error), most) - v.e
        if n <= 0:
            return self._checked(v)
        return self._checked(Fixed(self._line("left", v.text, i=n), v.e + n, v.low, v.high, v.error))


def _between(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)
