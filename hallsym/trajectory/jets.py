"""Taylor coefficients of a function over intervals of its argument, each enclosed in an interval.

A `Jet` holds x(t0), x'(t0), x''(t0)/2, ... for every t0 of an interval. The recurrences are those of
automatic differentiation (Griewank and Walther, Evaluating Derivatives, SIAM 2008, Section 13.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.trajectory.intervals import Interval, hyperbolic_cosine, rising, sine

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Jet:
    """Taylor coefficients 0 .. order of one quantity."""

    terms: tuple[Interval, ...]

    @classmethod
    def variable(cls, t: Interval, order: int) -> Jet:
        """Return the argument itself."""
        zero = Interval.of(np.zeros_like(t.low))
        one = Interval.of(np.ones_like(t.low))
        return cls((t, one, *(zero for _ in range(order - 1)))[: order + 1])

    def constant(self, value: float) -> Jet:
        """Return a constant of the same order and shape."""
        first = Interval.of(np.full_like(self.terms[0].low, value))
        zero = Interval.of(np.zeros_like(first.low))
        return Jet((first, *(zero for _ in self.terms[1:])))

    def __add__(self, other: Jet) -> Jet:
        """Return the sum."""
        return Jet(tuple(a + b for a, b in zip(self.terms, other.terms, strict=True)))

    def __sub__(self, other: Jet) -> Jet:
        """Return the difference."""
        return Jet(tuple(a - b for a, b in zip(self.terms, other.terms, strict=True)))

    def __neg__(self) -> Jet:
        """Return the negative."""
        return Jet(tuple(-a for a in self.terms))

    def __mul__(self, other: Jet) -> Jet:
        """Return the product."""
        a, b = self.terms, other.terms
        return Jet(tuple(_sum([a[i] * b[k - i] for i in range(k + 1)]) for k in range(len(a))))

    def __truediv__(self, other: Jet) -> Jet:
        """Return the quotient."""
        b = other.terms
        out: list[Interval] = []
        for k, a in enumerate(self.terms):
            rest = _less(a, [b[i] * out[k - i] for i in range(1, k + 1)])
            out.append(rest / b[0])
        return Jet(tuple(out))

    def scaled(self, factor: float) -> Jet:
        """Return the product with a number."""
        return Jet(tuple(a.scaled(factor) for a in self.terms))

    def slope(self) -> list[Interval]:
        """Return i a_i for i = 0 .. order."""
        return [a.scaled(i) for i, a in enumerate(self.terms)]


def _sum(terms: Sequence[Interval]) -> Interval:
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def _less(first: Interval, terms: Sequence[Interval]) -> Interval:
    return first - _sum(terms) if terms else first


def _over(total: Interval, k: int) -> Interval:
    return total / Interval.of(float(k))


def sqrt(x: Jet) -> Jet:
    """Square root; everything where the argument may be negative."""
    a, out = x.terms, [rising(np.sqrt, x.terms[0], 0.0)]
    for k in range(1, len(a)):
        rest = _less(a[k], [out[i] * out[k - i] for i in range(1, k)])
        out.append(rest / out[0].scaled(2.0))
    return Jet(tuple(out))


def exp(x: Jet) -> Jet:
    """Exponential function."""
    slope, out = x.slope(), [rising(np.exp, x.terms[0])]
    for k in range(1, len(slope)):
        out.append(_over(_sum([slope[i] * out[k - i] for i in range(1, k + 1)]), k))
    return Jet(tuple(out))


def log(x: Jet) -> Jet:
    """Natural logarithm; everything where the argument may not be positive."""
    a, out = x.terms, [rising(np.log, x.terms[0], 5e-324)]
    for k in range(1, len(a)):
        terms = [(out[i] * a[k - i]).scaled(i) for i in range(1, k)]
        rest = _less(a[k], [_over(_sum(terms), k)] if terms else [])
        out.append(rest / a[0])
    return Jet(tuple(out))


def sin_cos(x: Jet) -> tuple[Jet, Jet]:
    """Sine and cosine."""
    slope = x.slope()
    s, c = [sine(x.terms[0])], [sine(x.terms[0], np.pi / 2)]
    for k in range(1, len(slope)):
        up = _sum([slope[i] * c[k - i] for i in range(1, k + 1)])
        down = _sum([slope[i] * s[k - i] for i in range(1, k + 1)])
        s.append(_over(up, k))
        c.append(-_over(down, k))
    return Jet(tuple(s)), Jet(tuple(c))


def sinh_cosh(x: Jet) -> tuple[Jet, Jet]:
    """Hyperbolic sine and cosine."""
    slope = x.slope()
    s, c = [rising(np.sinh, x.terms[0])], [hyperbolic_cosine(x.terms[0])]
    for k in range(1, len(slope)):
        up = _sum([slope[i] * c[k - i] for i in range(1, k + 1)])
        down = _sum([slope[i] * s[k - i] for i in range(1, k + 1)])
        s.append(_over(up, k))
        c.append(_over(down, k))
    return Jet(tuple(s)), Jet(tuple(c))


def _integral(first: Interval, x: Jet, factor: Jet) -> Jet:
    """Return y with y(t0) = first and y' = x' * factor."""
    slope, out = x.slope(), [first]
    for k in range(1, len(slope)):
        out.append(_over(_sum([slope[i] * factor.terms[k - i] for i in range(1, k + 1)]), k))
    return Jet(tuple(out))


def atan(x: Jet) -> Jet:
    """Inverse tangent."""
    one = x.constant(1.0)
    return _integral(rising(np.arctan, x.terms[0]), x, one / (one + x * x))


def asin(x: Jet) -> Jet:
    """Inverse sine; everything where the argument may leave (-1, 1)."""
    one = x.constant(1.0)
    return _integral(rising(np.arcsin, x.terms[0], -1.0, 1.0), x, one / sqrt(one - x * x))


def power(x: Jet, exponent: float) -> Jet:
    """A constant power: whole ones for any argument, others for positive ones."""
    if exponent == int(exponent) and abs(exponent) <= 64:
        one = x.constant(1.0)
        out, base, left = one, x, abs(int(exponent))
        while left:
            out = out * base if left & 1 else out
            base = base * base if left > 1 else base
            left >>= 1
        return one / out if exponent < 0 else out
    return exp(log(x).scaled(exponent))
