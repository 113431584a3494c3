"""A program of 32-bit integers: its lines, run in Python and printed in C."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from math import asin, atan, ceil, floor, log2, pi, prod, sqrt
from typing import Any, cast

import numpy as np

from hallsym.codegen.bounds import straight
from hallsym.codegen.decoupler import AGREEMENT, ROOT, Decoupler, Step, short, unit
from hallsym.codegen.operations import Operation
from hallsym.codegen.residual import LEAST, SUM
from hallsym.errors import InputError
from hallsym.model import Model

UNIT = 2 * pi / 2**32
"""Value [rad] of the last bit of a binary angle."""
MASK = 2**32 - 1
STEPS = 26
"""Most steps of CORDIC: beyond them shifts of 32 bits cut off more than a step leaves."""
ARCTANGENTS = tuple(round(atan(2.0**-k) / UNIT) for k in range(STEPS))
SPREAD = prod(1 + 2.0**-k for k in range(STEPS))
"""What intervals make of the growth of a vector: each coordinate by the other's, whatever their signs."""
FINE = 15
"""Bits of the way between two entries of a table."""


def steps_for(accuracy: float) -> int:
    """Return how many steps of CORDIC leave a thirty-second of an accuracy [rad], `STEPS` at most."""
    return next((n for n in range(8, STEPS) if atan(2.0 ** (1 - n)) <= accuracy / 32), STEPS)


def angle_of(x: np.ndarray, y: np.ndarray, steps: int = STEPS) -> np.ndarray:
    """Return the binary angle of vectors of integers, as `angle_of` of the generated C."""
    behind = x < 0
    across, up = np.where(behind, -x, x), np.where(behind, -y, y)
    angle = np.where(behind, np.int64(2**31), np.int64(0))
    for k, turn in enumerate(ARCTANGENTS[:steps]):
        a, b = across >> k, up >> k
        below = up < 0
        across, up = np.where(below, across - b, across + b), np.where(below, up + a, up - a)
        angle = np.where(below, angle - turn, angle + turn)
        if np.any(np.abs(across) >= 2**31) or np.any(np.abs(up) >= 2**31):
            raise OverflowError("a vector overflows in CORDIC")
    return np.asarray(angle & MASK)


def angle_error(least: float, steps: int = STEPS) -> float:
    """Return the bound of |angle_of - atan2| [rad] for vectors of at least that length, in units of a bit.

    A shift cuts off less than a bit of each coordinate, of a vector that has grown to the length of its step;
    an entry is off by half a bit; the last step leaves less than its angle.
    """
    length, cut = least, 0.0
    for k in range(steps):
        length = length * sqrt(1 + 4.0**-k) - (sqrt(2) if k else 0.0)
        cut += asin(min(1.0, sqrt(2) / length)) if k else 0.0
    return cut + steps * UNIT / 2 + atan(2.0 ** (1 - steps)) * (1 + 1e-9)


@dataclass(frozen=True, eq=False)
class AngleTable:
    """Entries at phases 0, h, 2 h, ... of a turn in units of 2^`shift` BAM, straight lines between them.

    `bits`: 16 or 32 of each entry; with 32 `shift` is 0.
    """

    name: str
    values: np.ndarray
    shift: int
    bits: int

    def __post_init__(self) -> None:
        """Refuse what could overflow."""
        if self.wide * 2.0**self.shift >= 2**30 or np.abs(self.values).max() * 2.0**self.shift >= 2**30:
            raise InputError("The correction does not fit into 32 bits; use float.")

    @property
    def wide(self) -> float:
        """Largest difference of neighbouring entries."""
        return float(np.abs(np.diff(self.values, append=self.values[:1])).max())

    @property
    def first(self) -> int:
        """Bits of a phase below those that count entries."""
        return 32 - (len(self.values).bit_length() - 1)

    def at(self, phase: np.ndarray) -> np.ndarray:
        """Return the value [BAM] at binary phases, as the generated C."""
        cell = phase >> self.first
        rest = (phase >> (self.first - FINE)) & (2**FINE - 1)
        left = self.values[cell]
        rise = self.values[(cell + 1) % len(self.values)] - left
        if self.bits == 16:
            return np.asarray((left << self.shift) + ((rise * rest) >> (FINE - self.shift)))
        return np.asarray(left + (rise >> FINE) * rest + (((rise & (2**FINE - 1)) * rest) >> FINE))

    @property
    def error(self) -> float:
        """Bound of |at - straight lines between the entries| [rad]: what bits that are cut off change."""
        return UNIT * (self.wide * 2.0 ** (self.shift - FINE) + 2)


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


def _bare(text: str, n: int) -> str:
    return f"{text} >> {n}" if n else text


OPERATIONS: dict[str, tuple[Callable[..., np.ndarray], Callable[[str, str, int, int], str]]] = {
    "mul": (lambda a, b, i, j: upper(a, b), lambda a, b, i, j: f"upper({a}, {b})"),
    "add": (
        lambda a, b, i, j: (a >> i) + (b >> j),
        lambda a, b, i, j: f"sum({_bare(a, i)}, {_bare(b, j)})",
    ),
    "sub": (
        lambda a, b, i, j: (a >> i) - (b >> j),
        lambda a, b, i, j: f"difference({_bare(a, i)}, {_bare(b, j)})",
    ),
    "left": (lambda a, b, i, j: a << i, lambda a, b, i, j: f"scaled({a}, {1 << i})"),
    "right": (lambda a, b, i, j: a >> i, lambda a, b, i, j: f"{a} >> {i}"),
    "size": (
        lambda a, b, i, j: np.abs(a),
        lambda a, b, i, j: f"({a} < 0) ? difference(0, {a}) : {a}",
    ),
    "bounded": (
        lambda a, b, i, j: np.clip(a, -(1 << i), 1 << i),
        lambda a, b, i, j: f"bounded({a}, {1 << i})",
    ),
    "neg": (lambda a, b, i, j: -a, lambda a, b, i, j: f"difference(0, {a})"),
    "one": (lambda a, b, i, j: (1 << i) - a, lambda a, b, i, j: f"difference({1 << i}, {a})"),
    "look": (lambda a, b, i, j: b.at(a), lambda a, b, i, j: f"{b}_at(p, {a})"),
    "angle": (lambda a, b, i, j: angle_of(a, b, i), lambda a, b, i, j: f"angle_of({a}, {b})"),
    "turn": (lambda a, b, i, j: (a + b) & MASK, lambda a, b, i, j: f"{a} + {b}"),
}
"""What a line computes of a, b and shifts i, j in 64-bit integers, and in C.

`one`: 2^i - a; `look`: b is a table; `angle`: of the vector (a, b), in i steps; `turn`: counted round. The
last two are binary angles (`hallsym.codegen.integer_c`), which are unsigned.
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
    """Exponents and counts of steps as they were chosen: given again, they make the same code."""
    reciprocals: list[Reciprocal] = field(default_factory=list)
    angles: frozenset[str] = frozenset()
    """Columns that are binary angles: 2^32 to a turn, unsigned."""
    unsigned: dict[str, str] = field(default_factory=dict)
    """Entries of the table that are binary angles, and what they mean."""
    arrays: dict[str, AngleTable] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    """Sentences for header and report."""
    options: dict[str, Any] = field(default_factory=dict)
    """What the choices of a family came to: given again, they make the same code."""
    flags: dict[str, tuple[str, str]] = field(default_factory=dict)
    """By name of a flag: the line and the least value, an entry, below which it is set."""
    left: list[str] = field(default_factory=list)
    """Lines of what is left of each reading that is watched."""
    root: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """Integers that these are compared by, different exponents included; see `Array` ROOT of a decoupler."""

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
        return {key: value[name] for key, name in (wanted | {n: n for n in self.left}).items()}

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
SHOWN = 4.0
"""Times the limit of a contradiction that what is left of a reading is cut off at."""
LOW = 3
"""A product is low by less than so many units of its last bit."""
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
        return cast(Program, d.integers(d, plan=plan, **options))
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
        least = {flag.least: flag for flag in d.flags}
        for entry in d.table:
            if entry.name in least:  # in the exponent of the step that it is compared with
                continue
            largest = max(abs(o.value) for o in d.table if o.unit == entry.unit)
            most = largest if abs(entry.value) * LIKE >= largest else largest / LIKE
            known[entry.name] = self._constant(entry.name, entry.value, self._exponent(-most, most))
        for entry in d.offsets:
            known[entry.name] = Fixed(entry.name, 0, 0.0, 0.0)
        for step in d.steps:
            if not (d.suspects and step.name.startswith((SUM, AGREEMENT))):
                known[step.name] = self._step(step, known)
        if d.suspects:
            known[AGREEMENT] = self._agreement([known[w.left] for w in d.watched])
        for flag in d.flags:
            self._least(flag.name, flag.least, known[flag.step])
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

    def _least(self, flag: str, entry: str, seen: Fixed) -> None:
        """Add the least value of what a flag looks at, less what integers make of it."""
        value = next(e.value for e in self.d.table if e.name == entry)
        self.p.table[entry] = (floor((value - seen.error) * 2.0**seen.e), seen.e)
        self.p.flags[flag] = (seen.text, entry)

    def _agreement(self, left: Sequence[Fixed]) -> Fixed:
        """Return less the sum of squares of what is left of readings; the row that names a suspect by it.

        Each is cut off far beyond the limit, so that its square keeps the digits that count.
        """
        d, p, squares = self.d, self.p, []
        least = sqrt(-next(e.value for e in d.table if e.name == LEAST))
        for v in left:
            bits = self._chosen(partial(min, ROOM, ceil(log2(SHOWN * least) + v.e)))
            if least * 2.0**v.e > 2**bits:
                raise InputError(f"The noise of the calibration {DOES_NOT_FIT}")
            most = 2.0 ** (bits - v.e)
            cut = Fixed(self._line("bounded", v.text, i=bits), v.e, -most, most, v.error)
            text = self._line("left", cut.text, i=ROOM - bits) if bits < ROOM else cut.text
            grown = replace(cut, text=text, e=v.e + ROOM - bits)
            squares.append(self._mul(grown, grown))
        total = reduce(self._add, squares)
        root = np.array(next(a.values for a in d.arrays if a.name == ROOT)) * 2.0 ** -np.array(
            [v.e for v in left]
        )
        scale = self._exponent(0.0, float(np.abs(root).max()))
        p.left, p.root = [v.text for v in left], np.round(root * 2.0**scale).astype(np.int64)
        if not np.abs(p.root).max() < LARGEST:
            raise InputError(f"The noise of the calibration {DOES_NOT_FIT}")
        return Fixed(self._line("neg", total.text), total.e, -total.high, 0.0, total.error)

    def _outputs(self, found: Mapping[str, Fixed]) -> None:
        """Give pose coordinates of one unit one exponent, and add the offsets."""
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
        made: list[Fixed] = []
        for o in step.graph.operations:
            given = o.op == "input"
            made.append(known[o.symbol] if given else self._operation(o, [made[k] for k in o.args]))
        return made[step.graph.results[0]]

    def _operation(self, operation: Operation, args: Sequence[Fixed]) -> Fixed:
        if operation.op in ("mul", "sq"):
            return self._mul(args[0], args[-1])
        if operation.op in ("add", "sub"):
            return self._add(args[0], args[1], minus=operation.op == "sub")
        if operation.op == "div":
            a, b = args
            if b.low - b.error <= 0 <= b.high + b.error:
                raise InputError("A gain crosses zero within the box; give a smaller one with --range.")
            return self._grown(self._mul(a, self._reciprocal(b)))
        (a, *_) = args
        if operation.op == "fabs":
            return Fixed(self._line("size", a.text), a.e, 0.0, max(abs(a.low), abs(a.high)), a.error)
        if operation.op == "neg":
            return Fixed(self._line("neg", a.text), a.e, -a.high, -a.low, a.error)
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
        r = self._grown(Fixed(line.text, line.e, *_ordered(1 / low, 1 / high), off))
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
        return Fixed(r.text, r.e, *_ordered(1 / b.low, 1 / b.high), r.error + b.error / least**2)

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


def _ordered(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)
