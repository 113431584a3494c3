"""Decaying waves in 32-bit integers: what the compiler of straight code lacks for them.

The angle of a vector comes from CORDIC, as for encoders, the logarithm of its length from shifts and a
polynomial (`hallsym.codegen.binary_logarithm`); choices are comparisons of two integers. Readings of no pose
overflow nothing: each exponent comes from the range over all readings within their limits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import asin, ceil, exp, hypot, log, pi

import numpy as np

from hallsym.codegen import binary_angle, binary_logarithm
from hallsym.codegen.decoupler import Decoupler
from hallsym.codegen.fixed_point import Fixed, Program
from hallsym.codegen.integer_c import DOES_NOT_FIT, ROOM, Compiler, exponent, planned
from hallsym.codegen.operations import Operation
from hallsym.errors import InputError

LONGEST = 30
"""Largest exponent of a vector whose logarithm is taken: what is subtracted for it still fits."""
LADDER = 10
"""Ends of the polynomial of an exponential are whole multiples of 1 / LADDER: so code outlasts a
calibration."""
MOST_DEGREE = 12
GRID = 1 << 14
SHORT = 1 - 1e-5
"""Share of the least length that rounding of the flag's own value leaves at least."""


def program(
    d: Decoupler, least: Mapping[str, float], accuracy: float, plan: Sequence[int] | None = None
) -> Program:
    """Return the integer program of steps with atan2, log of hypot, fmin, fmax and fabs.

    `least`: length of the vector of each step that takes an angle or a logarithm, where no flag is set;
    `accuracy`: what each of these functions may leave [rad, 1].
    """
    return planned(lambda given: Waves(d, given, least, accuracy), plan)


@dataclass(frozen=True)
class _Vector(Fixed):
    """The length of a vector, of which only the logarithm is taken."""

    x: Fixed | None = None
    y: Fixed | None = None


class Waves(Compiler):
    """Compiles functions of vectors, and choices."""

    def __init__(
        self, d: Decoupler, plan: Sequence[int] | None, least: Mapping[str, float], accuracy: float
    ) -> None:
        super().__init__(d, plan)
        self.least, self.accuracy = least, accuracy
        self.steps = self._chosen(lambda: binary_angle.steps_for(32 * accuracy))
        self.degree = self._chosen(lambda: binary_logarithm.degree_for(accuracy))
        self.p.said += [
            f"Angles come from {self.steps} steps of CORDIC, a loop of fixed length, logarithms from shifts "
            f"and a polynomial of degree {self.degree}: errors of both are proved and counted in the bounds.",
        ]

    def _other(self, operation: Operation, args: Sequence[Fixed], step: str) -> Fixed:
        if operation.op == "const":
            return self._number(operation.value)
        if operation.op in ("fmin", "fmax"):
            return self._chosen_of(operation.op == "fmin", *args)
        if operation.op in ("fabs", "neg"):
            return self._signed(operation.op == "fabs", args[0])
        if operation.op == "twice":
            return self._add(args[0], args[0])
        if operation.op == "atan2":
            return self._angle(args[1], args[0], self.least[step])
        if operation.op == "exp":
            return self._exponential(args[0])
        if operation.op == "hypot":
            most = hypot(args[0].most, args[1].most)
            return _Vector("", 0, 0.0, most, 0.0, *args)
        if operation.op == "log":
            if isinstance(args[0], _Vector):
                return self._logarithm(args[0], self.least[step])
            return self._logarithm_of_number(args[0])
        return super()._other(operation, args, step)

    def _add(self, a: Fixed, b: Fixed, minus: bool = False) -> Fixed:
        """Whole numbers of the code take the exponent of the other, so that nothing of it is lost."""
        return super()._add(self._like(a, b), self._like(b, a), minus)

    def _mul(self, a: Fixed, b: Fixed) -> Fixed:
        """Whole numbers are multiplied in 32 bits: nothing is lost but bits that do not fit."""
        for whole, other in ((a, b), (b, a)):
            if whole.e == 0:
                far, ends = whole.most * other.most, [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
                cut = self._cut(other, min(other.e, self._exponent(-far, far)))
                name = self._line("times", whole.text, cut.text)
                error = whole.most * cut.error + whole.error * cut.most
                return self._checked(Fixed(name, cut.e, min(ends), max(ends), error))
        return super()._mul(self._full(a), self._full(b))

    def _full(self, v: Fixed) -> Fixed:
        """Shift left as far as the range allows: a product keeps the upper bits. Entries are full."""
        return v if v.text in self.p.table or v.text.endswith(")") else self._grown(v)

    def _number(self, value: float) -> Fixed:
        """A number of the code itself."""
        e = 0 if value == round(value) else min(exponent(value, value), ROOM)
        q = round(value * 2.0**e)
        return Fixed(f"({q})", e, value, value, abs(value - q * 2.0**-e))

    def _chosen_of(self, least: bool, a: Fixed, b: Fixed) -> Fixed:
        """The lesser or the greater of two: no further off than either."""
        a, b = self._like(a, b), self._like(b, a)
        e = min(a.e, b.e)
        name = self._line("lesser" if least else "greater", a.text, b.text, a.e - e, b.e - e)
        choose = min if least else max
        error = max(v.error + (2.0**-e if v.e > e else 0.0) for v in (a, b))
        return self._checked(Fixed(name, e, choose(a.low, b.low), choose(a.high, b.high), error))

    def _like(self, number: Fixed, other: Fixed) -> Fixed:
        """A whole number of the code in the exponent of what it is compared with, where it fits."""
        if not number.text.endswith(")") or number.e or number.e >= other.e:
            return number
        e = min(other.e, exponent(number.low, number.low))
        return Fixed(f"({round(number.low * 2.0**e)})", e, number.low, number.high)

    def _signed(self, size: bool, v: Fixed) -> Fixed:
        if size:
            low = 0.0 if v.low <= 0 <= v.high else min(abs(v.low), abs(v.high))
            high = max(abs(v.low), abs(v.high))
            return Fixed(self._line("size", v.text), v.e, low, high, v.error)
        return Fixed(self._line("minus", v.text), v.e, -v.high, -v.low, v.error)

    def _vector(self, x: Fixed, y: Fixed, growth: float, most: int) -> tuple[Fixed, Fixed]:
        """Both coordinates in one exponent, with room to grow."""
        far = growth * max(x.most, y.most)
        e = self._chosen(lambda: min(x.e, y.e, exponent(-far, far), most))
        self._checked(Fixed("vector", e, -far, far))
        return self._cut(x, e), self._cut(y, e)

    def _cut(self, v: Fixed, e: int) -> Fixed:
        if v.e == e:
            return v
        if v.e < e:
            return self._checked(Fixed(self._line("left", v.text, i=e - v.e), e, v.low, v.high, v.error))
        return Fixed(self._line("right", v.text, i=v.e - e), e, v.low, v.high, v.error + 2.0**-e)

    def _angle(self, x: Fixed, y: Fixed, least: float) -> Fixed:
        """The angle [rad] of a vector, within half a turn of zero."""
        x, y = self._vector(x, y, binary_angle.SPREAD, 99)
        off, length = hypot(x.error, y.error), least * SHORT
        error = asin(min(1.0, off / max(length - off, off)))
        error += binary_angle.angle_error(max(length * 2.0**x.e, 2.0), self.steps)
        name = self._line("signed", self._line("angle", x.text, y.text, self.steps))
        return self._mul(Fixed(name, 30, -1.0, 1.0, error / pi + 2.0**-30), self._number(pi))

    def _logarithm(self, vector: _Vector, least: float) -> Fixed:
        """The logarithm of the length of a vector; of none, some number below all others."""
        assert vector.x is not None
        assert vector.y is not None
        x, y = self._vector(vector.x, vector.y, 1.0, LONGEST)
        off, length, most = hypot(x.error, y.error), least * SHORT, hypot(x.most, y.most)
        error = off / max(length - off, off) + binary_logarithm.logarithm_error(
            min(length, most), max(length, most), self.degree
        )
        name = self._line("log", x.text, y.text, self.degree, 2 * x.e)
        e = binary_logarithm.FRACTION
        none = 29 + 2 * x.e  # halves of ln 2 below those of a vector of length 1
        return self._checked(Fixed(name, e, -none * log(2) / 2, log(most), error))

    def _logarithm_of_number(self, v: Fixed) -> Fixed:
        """The logarithm of a number above zero: of a vector along an axis."""
        if v.low <= v.error:
            raise InputError("A logarithm of zero lies within the box; give a smaller one with --range.")
        x = self._cut(v, self._chosen(lambda: min(v.e, LONGEST)))
        error = x.error / (v.low - x.error) + binary_logarithm.logarithm_error(v.low, x.most, self.degree)
        name = self._line("log", x.text, "(0)", self.degree, 2 * x.e)
        return self._checked(Fixed(name, binary_logarithm.FRACTION, log(v.low), log(v.high), error))

    def _exponential(self, v: Fixed) -> Fixed:
        """exp, by a polynomial over a range on both sides of zero."""
        rungs = self._chosen(lambda: ceil(v.most * LADDER * (1 + 1e-6)))
        if v.most > rungs / LADDER:
            raise InputError(f"The calibration's range of heights {DOES_NOT_FIT}")
        degree = self._chosen(lambda: _degree(rungs / LADDER, self.accuracy))
        coefficients, left = _exponential(rungs / LADDER, degree)
        total = self._number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            total = self._add(self._mul(total, v), self._number(c))
        return replace(total, low=exp(v.low), high=exp(v.high), error=total.error + left)


def _degree(end: float, accuracy: float) -> int:
    """Return the least degree of a polynomial of exp over -end .. end that leaves at most an accuracy."""
    return next((n for n in range(2, MOST_DEGREE) if _exponential(end, n)[1] <= accuracy), MOST_DEGREE)


@cache
def _exponential(end: float, degree: int) -> tuple[tuple[float, ...], float]:
    """Return the coefficients, lowest first, and a bound of what they leave (see `binary_logarithm`)."""
    nodes = np.polynomial.chebyshev.chebpts1(degree + 1)
    found = np.polynomial.chebyshev.chebfit(nodes, np.exp(end * nodes), degree)
    a = np.polynomial.chebyshev.cheb2poly(found) / end ** np.arange(degree + 1)
    x, k, h = np.linspace(-end, end, GRID + 1), np.arange(degree + 1), 2 * end / GRID
    most = float(np.abs(np.polyval(a[::-1], x) - np.exp(x)).max())
    bend = float((k * (k - 1) * np.abs(a) * end ** np.maximum(k - 2, 0)).sum()) + exp(end)
    return tuple(a.tolist()), most + h * h / 8 * bend + 1e-14
