"""Periodic signals by their value at an angle: the same chain as with waves, without multiplying them out.

A `Wave` knows its harmonics, which a fit from run summaries needs; a product of two of n and m terms has
n m of them, and a power of a sum soon has thousands. Where the readings are evaluated sample by sample
nobody asks for harmonics: a `Waveform` is only ever evaluated, and a product is one multiplication.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import pi

import casadi as ca

from hallsym.families.rotary_waves import Share, Wave


@dataclass(frozen=True, eq=False)
class Waveform:
    """A trigonometric polynomial of degree at most `degree` by `value(theta) -> SX`.

    Adds, multiplies, turns and is filtered as a `Wave` does, also together with one.
    """

    value: Callable[[ca.SX], ca.SX]
    degree: int
    _known: dict[int, tuple[ca.SX, ca.SX]] = field(default_factory=dict)

    def at(self, theta: ca.SX) -> ca.SX:
        """Return the value at an angle; made once for each expression of it."""
        key = ca.SX(theta).element_hash()
        if key not in self._known:
            self._known[key] = (theta, ca.SX(self.value(theta)))  # a hash is one's own while theta is held
        return self._known[key][1]

    def __add__(self, other: Waveform | Wave | ca.SX | float) -> Waveform:
        """Return the sum with another signal or a constant."""
        o = waveform(other)
        return Waveform(lambda theta: self.at(theta) + o.at(theta), max(self.degree, o.degree))

    def __mul__(self, other: Waveform | Wave | ca.SX | float) -> Waveform:
        """Return the product with another signal or a factor."""
        o = waveform(other)
        return Waveform(lambda theta: self.at(theta) * o.at(theta), self.degree + o.degree)

    __radd__, __rmul__ = __add__, __mul__

    def __sub__(self, other: Waveform | Wave | ca.SX | float) -> Waveform:
        """Return the difference from another signal or a constant."""
        return self + waveform(other) * -1.0

    def __rsub__(self, other: Waveform | Wave | ca.SX | float) -> Waveform:
        """Return the difference of another signal or a constant from this one."""
        return waveform(other) + self * -1.0

    def ahead(self, angle: ca.SX) -> Waveform:
        """Return the signal at theta + angle."""
        return Waveform(lambda theta: self.at(theta + angle), self.degree)

    def slope(self) -> Waveform:
        """Return the derivative with respect to theta."""
        symbol = ca.SX.sym("theta")
        slope = ca.gradient(self.value(symbol), symbol)
        return Waveform(lambda theta: ca.substitute(slope, symbol, ca.SX(theta)), self.degree)

    @property
    def terms(self) -> Mapping[int, tuple[ca.SX, ca.SX]]:
        """Harmonics as those of a `Wave`: a trigonometric polynomial is its values at 2 degree + 1 angles."""
        count = 2 * self.degree + 1
        angles = [2 * pi * k / count for k in range(count)]
        values = ca.vertcat(*(self.at(ca.SX(theta)) for theta in angles))
        out = {0: (ca.sum1(values) / count, ca.SX(0))}
        for n in range(1, self.degree + 1):
            phase = n * ca.DM(angles)
            out[n] = (2 / count * ca.dot(values, ca.cos(phase)), 2 / count * ca.dot(values, ca.sin(phase)))
        return out

    def filtered(self, share: Share) -> Waveform:
        """Return the signal with each harmonic passed through a filter, see `Wave.filtered`."""
        return waveform(Wave(self.terms).filtered(share))


def waveform(signal: Waveform | Wave | ca.SX | float) -> Waveform:
    """Return a wave or a constant as a waveform."""
    if isinstance(signal, Waveform):
        return signal
    if isinstance(signal, Wave):
        return Waveform(signal.at, max(signal.terms, default=0))
    constant = ca.SX(signal)
    return Waveform(lambda theta: constant, 0)
