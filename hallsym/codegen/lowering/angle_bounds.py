"""Rounding error bound of a corrected angle: an argument by its parts.

Intervals over the whole of the code say nothing where it branches by octant: each value alone could be
anything. But an octant that is chosen by the computed x and y is right for those, so the angle is that of a
vector which rounding has moved, to the rounding of straight pieces that intervals bound well.
"""

from dataclasses import dataclass
from functools import cache
from math import asin, floor, log2, pi, sqrt

import casadi as ca
import numpy as np

from hallsym.codegen.intervals import Enclosure, constant, enclose
from hallsym.codegen.lowering.correction import Grid, Series
from hallsym.codegen.lowering.phase_curve import Curve
from hallsym.codegen.lowering.trigonometry import ARCTANGENT, HALF_PI, PI, SINE, odd

CELLS = 256


@dataclass(frozen=True, eq=False)
class Rounding:
    """Digits of the significand -> range and rounding of the angle, where the field is not weak."""

    curve: Curve
    correction: Series | Grid
    weak: float

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each pose coordinate, zeros at zero."""
        found, u = self.correction, 2.0**-digits
        phase = self._read(digits) if self.curve.angle_only else self._vector(digits) + octants(digits)
        error = phase * (1 + found.slope)
        if found.most:
            error += self._looked_up(found, digits) if isinstance(found, Grid) else self._waves(found, digits)
            error += half_ulp(pi + abs(found.constant) + found.most, digits)
        if found.most or found.constant:
            error += u * abs(found.constant) + half_ulp(pi + abs(found.constant), digits)
            error += half_ulp(pi, digits)  # a wrap rounds once: its first difference is exact
        end = float(np.float32(pi)) * (1 + 4 * u) + error
        return {c: Enclosure(-end, end, float(error)) for c in self.curve.model.pose}

    def _read(self, digits: int) -> float:
        """The wrap of the reading: rounded once, by the second part of a turn."""
        return half_ulp(pi, digits)

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

    def _looked_up(self, grid: Grid, digits: int) -> float:
        """A place that rounding moves, by the slope of what is looked up, and the arithmetic between entries.

        The interpolation is continuous, and what rounding takes into the next cell is looked up there.
        """
        u, count = 2.0**-digits, len(grid.values)
        scale = count / (2 * pi)
        moved = constant(PI, digits).error + half_ulp(2 * pi, digits)
        moved += (constant(scale, digits).error * 2 * pi + half_ulp(count, digits)) / scale
        moved += 2 * pi * 2.0**-31  # bits of a place that are cut off
        return moved * grid.slope + _between(grid, digits) + u * grid.most

    def _waves(self, series: Series, digits: int) -> float:
        """The complex Horner rule: |partial sums| <= sum of amplitudes, |exp(i phase)| <= 1 + its error."""
        u = 2.0**-digits
        sine = sqrt(2) * _sine(digits)
        most = sum(series.waves) * (1 + 1e-5)
        error = u * series.waves[-1]  # of the entries
        for size in reversed([0.0, *series.waves[:-1]]):
            # two products, their sum, the entry's own rounding and its addition, in two components
            error = error * (1 + sine) + sine * most + sqrt(2) * u * (2 * most + most + size + size + most)
        return float(error)


def _between(grid: Grid, digits: int) -> float:
    """Rounding from entries and part of a cell to the correction; a part is exact, entries are as stored."""
    part, left, right, before, after = (ca.SX.sym(n) for n in ("part", "left", "right", "before", "after"))
    line = left + part * (right - left)
    if grid.degree == 3:
        rise = right - left
        bends = (2.0 - part) * ((before - left) + rise) + (1.0 + part) * ((after - right) - rise)
        line = left + part * (rise - (1.0 - part) * (1 / 6) * bends)
    scale = constant(grid.unit, digits) if grid.integers else Enclosure(1.0, 1.0)
    most = float(np.abs(grid.values).max())
    given = dict.fromkeys(("left", "right", "before", "after"), Enclosure(-most, most))
    (found,) = enclose([line], {"part": Enclosure(0.0, 1.0), **given}, digits)
    return float(found.error * grid.unit + most * scale.error + 2.0**-digits * grid.most * 2)


@cache
def octants(digits: int) -> float:
    """From a rounded ratio to the phase, polynomials exact; the ratio in cells, each with intervals."""
    ratio, u = ca.SX.sym("ratio"), 2.0**-digits
    ends = np.linspace(0.0, 1.0, CELLS + 1)
    cells = Enclosure(ends[:-1], ends[1:], 2 * u * ends[1:])
    (octant,) = enclose([odd(ARCTANGENT, ratio, ratio * ratio)], {"ratio": cells}, digits)
    first = octant.error.max()
    quarter = first + constant(HALF_PI, digits).error + half_ulp(pi / 2, digits)
    return float(quarter + constant(PI, digits).error + half_ulp(pi, digits))


def half_ulp(most: float, digits: int) -> float:
    """Return what one rounding of a number of at most that magnitude changes."""
    return float(2.0 ** (floor(log2(most)) - digits))


@cache
def _sine(digits: int) -> float:
    """Rounding of the sine polynomial at a rounded argument, which two differences from pi / 2 give."""
    x, angle = ca.SX.sym("x"), ca.SX.sym("angle")
    quarter = constant(HALF_PI, digits)
    (once,) = enclose([x - angle], {"x": quarter, "angle": Enclosure(0.0, pi)}, digits)
    (twice,) = enclose([x - angle], {"x": quarter, "angle": Enclosure(0.0, pi / 2, once.error)}, digits)
    (found,) = enclose([odd(SINE, x, x * x)], {"x": Enclosure(-pi / 2, pi / 2, twice.error)}, digits)
    return float(found.error)
