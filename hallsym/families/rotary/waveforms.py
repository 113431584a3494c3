"""Periodic signals by their value at an angle: the same chain as with waves, without expanding products.

A `Wave` knows its harmonics, which a fit from run statistics needs; a product of two of n and m terms has
n m of them, and a power of a sum soon has thousands. Evaluation sample by sample needs no harmonics: a
`Waveform` is only evaluated, and a product is one multiplication.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from math import pi
from typing import Any

import casadi as ca

from hallsym.families.rotary.waves import Share, Wave, plus, times

FEW = 4
"""Degree up to which harmonics are multiplied out where a filter needs them; above, they are a sum over
2 degree + 1 angles, exact too."""


@dataclass(frozen=True, eq=False)
class Waveform:
    """A trigonometric polynomial of degree at most `degree`: its `value(theta) -> SX`, and its `waves()`.

    Adds, multiplies, turns and is filtered as a `Wave` does, also together with one.
    """

    value: Callable[[ca.SX], ca.SX]
    degree: int
    waves: Callable[[], Wave]
    _known: dict[int, tuple[ca.SX, ca.SX]] = field(default_factory=dict)

    def at(self, theta: ca.SX) -> ca.SX:
        """Return the value at an angle; made once for each expression of it."""
        if id(theta) not in self._known:  # unique while theta is referenced
            self._known[id(theta)] = theta, self.value(theta)
        return self._known[id(theta)][1]

    @cached_property
    def wave(self) -> Wave:
        """The harmonics."""
        if self.degree <= FEW:
            return self.waves()
        count = 2 * self.degree + 1
        angles = [2 * pi * k / count for k in range(count)]
        values = ca.vertcat(*(self.at(ca.SX(theta)) for theta in angles)) * (2 / count)
        terms = {0: (ca.sum1(values) / 2, ca.SX(0))}
        for n in range(1, self.degree + 1):
            phase = n * ca.DM(angles)
            terms[n] = (ca.dot(values, ca.cos(phase)), ca.dot(values, ca.sin(phase)))
        return Wave(terms)

    def __add__(self, other: Waveform | Wave | ca.SX | float) -> Waveform:
        """Return the sum with another signal or a constant."""
        return self._with(other, plus, operator.add, max)

    def __mul__(self, other: Waveform | Wave | ca.SX | float) -> Waveform:
        """Return the product with another signal or a factor."""
        return self._with(other, times, operator.mul, operator.add)

    def _with(self, other: Any, of_values: Callable, of_waves: Callable, of_degrees: Callable) -> Waveform:
        if not isinstance(other, Waveform | Wave):
            return Waveform(
                lambda theta: of_values(self.at(theta), other),
                self.degree,
                lambda: of_waves(self.wave, other),
            )
        o = waveform(other)
        return Waveform(
            lambda theta: of_values(self.at(theta), o.at(theta)),
            of_degrees(self.degree, o.degree),
            lambda: of_waves(self.wave, o.wave),
        )

    __radd__, __rmul__ = __add__, __mul__

    def __sub__(self, other: Waveform | Wave | ca.SX | float) -> Waveform:
        """Return the difference from another signal or a constant."""
        return self + other * -1.0

    def ahead(self, angle: ca.SX) -> Waveform:
        """Return the signal at theta + angle."""
        return Waveform(
            lambda theta: self.at(plus(theta, angle)), self.degree, lambda: self.wave.ahead(angle)
        )

    def slope(self) -> Waveform:
        """Return the derivative with respect to theta."""
        symbol = ca.SX.sym("theta")
        slope = ca.gradient(self.value(symbol), symbol)
        return Waveform(
            lambda theta: ca.substitute(slope, symbol, theta), self.degree, lambda: self.wave.slope()
        )

    def filtered(self, share: Share) -> Waveform:
        """Return the signal with each harmonic passed through a filter, see `Wave.filtered`."""
        return waveform(self.wave.filtered(share))


def waveform(signal: Waveform | Wave) -> Waveform:
    """Return a wave as a waveform."""
    if isinstance(signal, Waveform):
        return signal
    return Waveform(signal.at, max(signal.terms, default=0), lambda: signal)
