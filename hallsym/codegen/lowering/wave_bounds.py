"""Rounding error bound of place and height of a decaying wave: an argument by its parts.

As for a corrected angle (`lowering.angle_bounds`): rounding moves the vector (cos, sin), which is then decoded
exactly but for straight pieces that intervals bound. Where the flag is clear the vector has at least a known length.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import asin, hypot, pi, sqrt
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Step
from hallsym.codegen.intervals import Enclosure, constant, enclose
from hallsym.codegen.lowering.angle_bounds import half_ulp, octants
from hallsym.codegen.lowering.trigonometry import odd

if TYPE_CHECKING:
    from hallsym.codegen.lowering.wave import Wave

CELLS = 512
"""Cells of the logarithm's argument."""


@dataclass(frozen=True, eq=False)
class Rounding:
    """Digits of the significand -> range and rounding of place and height, the flag clear, zeros at zero.

    `values`: of the table's entries by name, and the ranges of the readings.
    """

    wave: "Wave"
    pose: tuple[str, ...]
    along: str
    steps: tuple[Step, ...]
    values: Mapping[str, float | tuple[float, float]]

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each pose coordinate."""
        vector = vector_error(self.wave, self.steps, self.values, digits)
        found = self.wave.phasor
        place = place_error(self.wave, vector, digits)
        end = pi * found.lc + place
        height = Enclosure(*self._heights(), height_error(self.wave, vector, found.middle, digits))
        return {c: Enclosure(-end, end, place) if c == self.along else height for c in self.pose}

    def _heights(self) -> tuple[float, float]:
        found, series = self.wave.phasor, self.wave.series
        most = float(odd_value(series.coefficients, 1.0)) * found.lc  # whatever the flag says
        return found.middle - most, found.middle + most


def odd_value(coefficients: Sequence[float], x: float) -> float:
    """Return x (a0 + a1 x^2 + ...)."""
    return float(x * np.polyval(np.array(coefficients)[::-1], x * x))


def vector_error(
    wave: "Wave", steps: Sequence[Step], values: Mapping[str, float | tuple[float, float]], digits: int, tag: str = ""
) -> float:
    """Return a bound of the length by which rounding moves (cos, sin), the flag clear."""
    dtype = np.float32 if digits == 24 else np.float64
    known: dict[str, Enclosure] = {}
    for name, value in values.items():
        if isinstance(value, tuple):
            known[name] = Enclosure(float(dtype(value[0])), float(dtype(value[1])))
        else:
            known[name] = constant(value, digits)
    error = 0.0
    for step in steps:
        needs = [s.name() for s in ca.symvar(step.expression)]
        (found,) = enclose([step.expression], {n: known[n] for n in needs}, digits)
        if step.name.startswith(("cos_", "sin_")) or step.name in (f"cos{tag}", f"sin{tag}"):
            found = _within(found, wave.outer)
        known[step.name] = found
        if step.name == f"sin{tag}":
            error = hypot(float(known[f"cos{tag}"].error), float(found.error))
            break
    return error


def _within(found: Enclosure, most: float) -> Enclosure:
    """What no round exceeds where the flag is clear."""
    return Enclosure(np.maximum(found.low, -most), np.minimum(found.high, most), found.error)


def place_error(wave: "Wave", vector: float, digits: int) -> float:
    """Return the bound of the place [m]: the turn of the vector, octants, factor, sum and wrap."""
    lc = wave.phasor.lc
    turn = asin(min(1.0, vector / (wave.least * (1 - 1e-6) - vector))) + octants(digits)
    most = pi * lc
    factor = constant(lc, digits).error * pi
    wrap = constant(2 * most, digits).error + half_ulp(most, digits)
    return turn * lc + factor + 2 * half_ulp(most * (1 + 1e-6), digits) + wrap


def height_error(wave: "Wave", vector: float, middle: float, digits: int) -> float:
    """Return the bound of the height [m]: the stretch of the vector, and the rounding of its logarithm."""
    stretch = vector / (wave.least * (1 - 1e-6) - vector)
    size = ca.SX.sym("size")
    tangent = (size - 1.0) / (size + 1.0)
    ends = np.geomspace((wave.least * (1 - 1e-6)) ** 2, (wave.least * (1 - 1e-6)) ** -2, CELLS + 1)
    rounded = 2.0**-digits * 3 * ends[1:]  # two squares and their sum
    (found,) = enclose([tangent], {"size": Enclosure(ends[:-1], ends[1:], rounded)}, digits)
    t = ca.SX.sym("t")
    held = Enclosure(
        np.maximum(found.low, -wave.series.end), np.minimum(found.high, wave.series.end), found.error
    )
    (made,) = enclose([odd(wave.series.coefficients, t, t * t)], {"t": held}, digits)
    error = float(np.max(made.error)) + stretch * (1 + stretch)
    lc, most = wave.phasor.lc, float(np.max(np.abs([made.low, made.high])))
    out = error * lc + constant(lc, digits).error * most + half_ulp(lc * most, digits)
    return out + constant(middle, digits).error + half_ulp(abs(middle) + lc * most, digits)


__all__ = ["Rounding", "height_error", "place_error", "sqrt", "vector_error"]
