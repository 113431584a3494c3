"""How far rounding can move the corrected angle of an encoder: an argument by its parts.

Intervals over the whole of the code say nothing where it branches by octant: each value alone could be
anything. But an octant that is chosen by the computed x and y is right for those, so the angle is that of a
vector which rounding has moved, to the rounding of straight pieces that intervals bound well.
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from math import asin, floor, log2, pi, sqrt

import casadi as ca
import numpy as np

from hallsym.codegen.intervals import Enclosure, enclose
from hallsym.codegen.rotary_curve import Curve
from hallsym.codegen.trigonometry import ARCTANGENT, HALF_PI, PI, SINE, odd

CELLS = 256


@dataclass(frozen=True, eq=False)
class Rounding:
    """Digits of the significand -> range and rounding of the angle, where the field is not weak."""

    curve: Curve
    weak: float

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each pose coordinate, zeros at zero."""
        series, u = self.curve.series, 2.0**-digits
        phase = self._read(digits) if self.curve.angle_only else self._vector(digits) + _octants(digits)
        most = sum(series.waves)
        error = phase * (1 + series.slope)
        if series.cos:
            error += self._waves(digits) + _half_ulp(pi + abs(series.constant) + most, digits)
        if series.cos or series.constant:
            error += u * abs(series.constant) + _half_ulp(pi + abs(series.constant), digits)
            error += _half_ulp(pi, digits)  # a wrap rounds once: its first difference is exact
        end = float(np.float32(pi)) * (1 + 4 * u) + error
        return {c: Enclosure(-end, end, float(error)) for c in self.curve.model.pose}

    def _read(self, digits: int) -> float:
        """The wrap of the reading: rounded once, by the second part of a turn."""
        return _half_ulp(pi, digits)

    def _vector(self, digits: int) -> float:
        """The angle by which rounding can turn (x, y) = M (reading - center), M and center rounded too.

        Difference, entry, product and sum round by a share each, of |M| |reading - center|, which is at most
        |M| |M^-1| times the radius; only the center's own rounding counts more where the field is weak.
        """
        u, matrix = 2.0**-digits, np.abs(self.curve.matrix)
        spread = np.linalg.norm(matrix, 2) * np.linalg.norm(np.linalg.inv(self.curve.matrix), 2)
        center = np.linalg.norm(matrix @ np.abs(self.curve.center)) * u
        moved = (1 + 8 * u) * (4 * u * spread + center / (self.weak * (1 - 8 * u)))
        return asin(min(1.0, float(moved)))

    def _waves(self, digits: int) -> float:
        """The complex Horner rule: |partial sums| <= sum of amplitudes, |exp(i phase)| <= 1 + its error."""
        series, u = self.curve.series, 2.0**-digits
        sine = sqrt(2) * _sine(digits)
        most = sum(series.waves) * (1 + 1e-5)
        error = u * series.waves[-1]  # of the entries
        for size in reversed([0.0, *series.waves[:-1]]):
            # two products, their sum, the entry's own rounding and its addition, in two components
            error = error * (1 + sine) + sine * most + sqrt(2) * u * (2 * most + most + size + size + most)
        return float(error)


@cache
def _octants(digits: int) -> float:
    """From a rounded ratio to the phase, polynomials exact; the ratio in cells, each with intervals."""
    ratio, u = ca.SX.sym("ratio"), 2.0**-digits
    octant = ca.Function("octant", [ratio], [odd(ARCTANGENT, ratio, ratio * ratio)])
    ends = np.linspace(0.0, 1.0, CELLS + 1)
    cells = (Enclosure(float(a), float(b), 2 * u * float(b)) for a, b in pairwise(ends))
    first = max(enclose(octant, [cell], digits)[0].error for cell in cells)
    quarter = first + _constant(HALF_PI, digits).error + _half_ulp(pi / 2, digits)
    return float(quarter + _constant(PI, digits).error + _half_ulp(pi, digits))


def _half_ulp(most: float, digits: int) -> float:
    """Return what one rounding of a number of at most that magnitude changes."""
    return float(2.0 ** (floor(log2(most)) - digits))


@cache
def _sine(digits: int) -> float:
    """Rounding of the sine polynomial at a rounded argument, which two differences from pi / 2 give."""
    x, angle = ca.SX.sym("x"), ca.SX.sym("angle")
    difference = ca.Function("difference", [x, angle], [x - angle])
    (once,) = enclose(difference, [_constant(HALF_PI, digits), Enclosure(0.0, pi)], digits)
    (twice,) = enclose(difference, [_constant(HALF_PI, digits), Enclosure(0.0, pi / 2, once.error)], digits)
    polynomial = ca.Function("sine", [x], [odd(SINE, x, x * x)])
    (found,) = enclose(polynomial, [Enclosure(-pi / 2, pi / 2, twice.error)], digits)
    return found.error


def _constant(value: float, digits: int) -> Enclosure:
    stored = float(np.float32(value)) if digits == 24 else value
    return Enclosure(value, value, abs(value - stored))
