"""Trigonometric polynomials of one angle: the field and voltages of an encoder.

A wave is sum_n c_n cos(n theta) + s_n sin(n theta), n = 0, 1, ..., with coefficients that are CasADi
expressions of parameters and logged columns. Products stay waves, so a chain of links that adds, scales and
multiplies gives readings that are linear in cos(n a), sin(n a) of the logged angle a: functions that are
independent of each other, which powers of cos and sin are not (cos^2 + sin^2 = 1), so ranks come out right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca

from hallsym.model import Signals

ORDER = 6
"""Powers of the distortion w that are kept in the angle of two waves; the first left out is w^7 / 7: 2e-13
rad at w = 2 %, 1e-8 rad (1e-6 deg) at 10 %, 2e-6 rad at 20 %."""
HARMONICS = 12
"""Harmonics that are kept in the angle of two waves."""

Complex = tuple[ca.SX, ca.SX]
Share = Callable[[int], Complex]
"""Real and imaginary part of the response of a filter to exp(i n theta), of harmonic n."""


def plus(a: ca.SX, b: ca.SX | float) -> ca.SX:
    """Return a + b. The operator does the same in ten times the time: it looks for the types first."""
    return ca.SX.binary(ca.OP_ADD, a, b)


def minus(a: ca.SX, b: ca.SX | float) -> ca.SX:
    """Return a - b."""
    return ca.SX.binary(ca.OP_SUB, a, b)


def times(a: ca.SX, b: ca.SX | float) -> ca.SX:
    """Return a b."""
    return ca.SX.binary(ca.OP_MUL, a, b)


def rotated(angle: ca.SX) -> Complex:
    """Return cosine and sine of an angle."""
    return ca.SX.unary(ca.OP_COS, angle), ca.SX.unary(ca.OP_SIN, angle)


@dataclass(frozen=True, eq=False)
class Wave:
    """sum over n of c_n cos(n theta) + s_n sin(n theta); `terms[n] = (c_n, s_n)`."""

    terms: Mapping[int, tuple[ca.SX, ca.SX]]

    def __add__(self, other: Wave | ca.SX | float) -> Wave:
        """Return the sum with another wave or a constant."""
        if not isinstance(other, Wave | ca.SX | ca.DM | float | int):
            return NotImplemented
        out, other = dict(self.terms), _wave(other)
        for n, (c, s) in other.terms.items():
            _add(out, n, c, s)
        return Wave(out)

    def __mul__(self, other: Wave | ca.SX | float) -> Wave:
        """Return the product with another wave or a factor."""
        if not isinstance(other, Wave | ca.SX | ca.DM | float | int):
            return NotImplemented
        if not isinstance(other, Wave):
            return Wave({n: (times(c, other), times(s, other)) for n, (c, s) in self.terms.items()})
        out: dict[int, tuple[ca.SX, ca.SX]] = {}
        for n, (c, s) in self.terms.items():
            for m, (d, t) in other.terms.items():
                cd, st, sd, ct = (times(times(a, b), 0.5) for a, b in ((c, d), (s, t), (s, d), (c, t)))
                _add_harmonic(out, n + m, minus(cd, st), plus(sd, ct))
                _add_harmonic(out, n - m, plus(cd, st), minus(sd, ct))
        return Wave(out)

    __radd__, __rmul__ = __add__, __mul__

    def __sub__(self, other: Wave | ca.SX | float) -> Wave:
        """Return the difference from another wave or a constant."""
        return self + other * -1.0

    def ahead(self, angle: ca.SX) -> Wave:
        """Return the wave at theta + angle."""
        out = {}
        for n, (c, s) in self.terms.items():
            cos, sin = rotated(times(angle, float(n)))
            mixed = plus(times(c, cos), times(s, sin)), minus(times(s, cos), times(c, sin))
            out[n] = mixed if n else (c, s)
        return Wave(out)

    def slope(self) -> Wave:
        """Return the derivative with respect to theta."""
        return Wave({n: (n * s, -n * c) for n, (c, s) in self.terms.items() if n})

    def filtered(self, share: Share) -> Wave:
        """Return the wave with each harmonic times the response of a filter; the mean stays."""
        out = {}
        for n, (c, s) in self.terms.items():
            re, im = share(n) if n else (ca.SX(1), ca.SX(0))
            out[n] = (re * c + im * s, re * s - im * c)
        return Wave(out)

    def at(self, theta: ca.SX) -> ca.SX:
        """Return the value at an angle."""
        total = ca.SX(0)
        for n, (c, s) in self.terms.items():
            cos, sin = rotated(times(theta, float(n)))
            total = plus(total, plus(times(c, cos), times(s, sin)) if n else c)
        return total

    def of(self, s: Signals, column: str) -> ca.SX:
        """Return the wave of a logged angle; cos and sin of its multiples become variables of their own."""
        total = ca.SX(0)
        for n, (cos, sin) in sorted(self.terms.items()):
            if n == 0:
                total += cos
                continue
            for name, factor, function in (("cos", cos, ca.cos), ("sin", sin, ca.sin)):
                if not ca.SX(factor).is_zero():
                    total += factor * s.derive(f"{name} {n}a", function(n * s[column]))
        return total


def cosine() -> Wave:
    """Return cos(theta)."""
    return Wave({1: (ca.SX(1), ca.SX(0))})


def sine() -> Wave:
    """Return sin(theta)."""
    return Wave({1: (ca.SX(0), ca.SX(1))})


def angle(y: Wave, x: Wave, state: ca.SX, order: int = ORDER, harmonics: int = HARMONICS) -> Wave:
    """Return atan2(y, x) - theta as a wave; linear in the columns `state` (taken at zero).

    x + i y is exp(i theta) Z (1 + w) with Z the part that turns evenly, so the angle is
    arg Z + Im(w - w^2/2 + w^3/3 - ...). No coefficient is the small difference of large ones: a direction of
    the parameters that leaves the angle alone (a common factor of x and y) leaves each coefficient alone to
    rounding.
    """
    even = _turning(y, x)
    z = even.pop(0)
    size = z[0] ** 2 + z[1] ** 2
    w = {n: ((re * z[0] + im * z[1]) / size, (im * z[0] - re * z[1]) / size) for n, (re, im) in even.items()}
    power, total = w, dict(w)
    for k in range(2, order + 1):
        power = _product(power, w, harmonics)
        share = (-1.0) ** (k + 1) / k
        for n, (re, im) in power.items():
            _add(total, n, times(re, share), times(im, share))
    out = {0: (ca.atan2(z[1], z[0]), ca.SX(0))}
    for n, (re, im) in total.items():
        _add_harmonic(out, n, im, re)
    return Wave({n: (_linear(c, state), _linear(s, state)) for n, (c, s) in out.items()})


def _turning(y: Wave, x: Wave) -> dict[int, Complex]:
    """Coefficients of (x + i y) exp(-i theta) = sum over n of z_n exp(i n theta)."""
    out: dict[int, Complex] = {}
    for wave, (re, im) in ((x, (1.0, 0.0)), (y, (0.0, 1.0))):
        for n, (c, s) in wave.terms.items():
            # c cos + s sin = (c - i s) / 2 exp(i n theta) + (c + i s) / 2 exp(-i n theta)
            for sign in (1, -1) if n else (1,):
                half = 0.5 if n else 1.0
                a, b = half * c, -sign * half * s
                before = out.get(sign * n - 1, (ca.SX(0), ca.SX(0)))
                out[sign * n - 1] = (before[0] + re * a - im * b, before[1] + re * b + im * a)
    out.setdefault(0, (ca.SX(0), ca.SX(0)))
    return {n: z for n, z in out.items() if n == 0 or not (z[0].is_zero() and z[1].is_zero())}


def _product(a: dict[int, Complex], b: dict[int, Complex], most: int) -> dict[int, Complex]:
    out: dict[int, Complex] = {}
    for n, (p, q) in a.items():
        for m, (r, s) in b.items():
            if abs(n + m) <= most:
                re, im = minus(times(p, r), times(q, s)), plus(times(p, s), times(q, r))
                _add(out, n + m, re, im)
    return out


def _linear(expression: ca.SX, state: ca.SX) -> ca.SX:
    """First-order Taylor terms in `state`, whose effect on an angle is small wherever an encoder works."""
    expression = ca.SX(expression)
    if state.numel() == 0 or not ca.depends_on(expression, state):
        return expression
    zero = ca.SX.zeros(state.numel())
    at, slope = ca.substitute([expression, ca.jacobian(expression, state)], [state], [zero])
    return at + slope @ state


def _add(out: dict[int, Complex], n: int, a: ca.SX, b: ca.SX) -> None:
    """Add a pair of coefficients to those of index n."""
    out[n] = (plus(out[n][0], a), plus(out[n][1], b)) if n in out else (a, b)


def _add_harmonic(out: dict[int, Complex], n: int, c: ca.SX, s: ca.SX) -> None:
    """Add c cos(n theta) + s sin(n theta), n of either sign, to the terms of a wave."""
    _add(out, abs(n), c, s if n > 0 else -s if n < 0 else ca.SX(0))


def _wave(value: Wave | ca.SX | float) -> Wave:
    return value if isinstance(value, Wave) else Wave({0: (ca.SX(value), ca.SX(0))})
