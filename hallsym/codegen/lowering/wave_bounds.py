"""Rounding error bound of place and height of a decaying wave: an argument by its parts.

As for a corrected angle (`lowering.angle_bounds`): rounding moves the vector (cos, sin), which is then
decoded exactly but for straight pieces that intervals bound. Where the flag is clear the vector has at least
a known length.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import asin, hypot, pi

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Step
from hallsym.codegen.intervals import Enclosure, constant, enclose, half_ulp
from hallsym.codegen.lowering.odd_series import PI, odd
from hallsym.codegen.lowering.wave_steps import QUARTER_PI, Wave, radial_of

CELLS = 512
"""Cells of the arguments of arctangent and logarithm."""
SHORT = 1 - 1e-5
"""Share of the least field that rounding of the flag's own value leaves at least."""
RADIAL = 64
"""Roundings of a radial term, each a share of it: entry and powers up to the twelfth harmonic."""

Values = Mapping[str, float | tuple[float, float]]
"""Entries of the table by name, and ranges of the readings."""


@dataclass(frozen=True, eq=False)
class Rounding:
    """Digits of the significand -> range and rounding of place and height, the flag clear, zeros at zero.

    `steps`: those from the readings to the vector, the last two of them.
    """

    wave: Wave
    pose: tuple[str, ...]
    along: str
    steps: tuple[Step, ...]
    values: Values

    def __call__(self, digits: int) -> dict[str, Enclosure]:
        """Return the enclosure of each pose coordinate."""
        found = self.wave.phasor
        vector = vector_error(self.wave, self.steps, self.values, digits)
        place = place_error(self.wave, vector, digits)
        height = height_error(self.wave, vector, digits)
        level = constant(found.middle, digits).error + half_ulp(abs(found.middle) + self._reach, digits)
        end = pi * found.lc + place
        return {
            c: Enclosure(-end, end, place)
            if c == self.along
            else Enclosure(found.middle - self._reach, found.middle + self._reach, height + level)
            for c in self.pose
        }

    @property
    def _reach(self) -> float:
        """Height [m] from the middle that no input exceeds: |t| <= 1 whatever the flag says."""
        return float(self.wave.logarithm.at(1.0)) * self.wave.phasor.lc


def vector_error(wave: Wave, steps: Sequence[Step], values: Values, digits: int) -> float:
    """Return a bound of the length by which rounding moves (cos, sin), the flag clear."""
    dtype = np.float32 if digits == 24 else np.float64
    known: dict[str, Enclosure] = {}
    for name, value in values.items():
        ends = value if isinstance(value, tuple) else (value, value)
        if isinstance(value, tuple):
            known[name] = Enclosure(float(dtype(ends[0])), float(dtype(ends[1])))
        else:
            known[name] = constant(value, digits)
    for step in steps:
        (found,) = enclose(
            [step.expression], {s.name(): known[s.name()] for s in ca.symvar(step.expression)}, digits
        )
        # a vector of a round is no longer than `outer` with the flag clear, and its powers as they are made
        factor, power = step.within or (1.0, 1)
        if step.within or step.name.startswith(("cos", "sin")):
            most = factor * wave.outer**power
            found = Enclosure(np.maximum(found.low, -most), np.minimum(found.high, most), found.error)
        known[step.name] = found
    return hypot(*(float(known[step.name].error) for step in steps[-2:]))


def _moved(wave: Wave, vector: float) -> float:
    """Share of its length by which rounding moves the vector at most."""
    return vector / (wave.least * SHORT - vector)


def place_error(wave: Wave, vector: float, digits: int) -> float:
    """Return the bound of the place [m]: the turn of the vector, arctangent, factor, sum and wrap."""
    lc, u = wave.phasor.lc, 2.0**-digits
    t = ca.SX.sym("t")
    ends = np.linspace(0.0, 1.0, CELLS + 1)
    # numerator, denominator and quotient round once each; the first rounds by a share of itself
    cells = Enclosure(ends[:-1], ends[1:], (3 * u + 4 * u * u) * ends[1:])
    (made,) = enclose([QUARTER_PI + odd(wave.arctangent.coefficients, t, t * t)], {"t": cells}, digits)
    octants = float(np.max(made.error)) + constant(QUARTER_PI, digits).error
    turn = asin(min(1.0, _moved(wave, vector))) + octants + constant(PI, digits).error + half_ulp(PI, digits)
    most = pi * lc
    wrap = 2 * constant(most, digits).error + 2 * half_ulp(most, digits)
    return turn * lc + constant(lc, digits).error * pi + 2 * half_ulp(most * (1 + 1e-6), digits) + wrap


def height_error(wave: Wave, vector: float, digits: int) -> float:
    """Return the bound of what is added to the middle height [m]: stretch of the vector, logarithm,
    factor."""
    lc, least, stretch = wave.phasor.lc, wave.least * SHORT, _moved(wave, vector)
    size, t = ca.SX.sym("size"), ca.SX.sym("t")
    ends = np.geomspace(least**2, least**-2, CELLS + 1)
    rounded = 2.0**-digits * 3 * ends[1:]  # two squares and their sum
    (found,) = enclose(
        [(size - 1.0) / (size + 1.0)], {"size": Enclosure(ends[:-1], ends[1:], rounded)}, digits
    )
    (made,) = enclose([odd(wave.logarithm.coefficients, t, t * t)], {"t": found}, digits)
    error, most = float(np.max(made.error)) + stretch * (1 + stretch), float(np.max(made.most))
    if wave.last == "radial":  # rounded as each of its products, and once more by the sum
        term = sum(f * wave.outer ** (2 * n - 2) for n, f in radial_of(wave.phasor).items())
        error += RADIAL * 2.0**-digits * term + half_ulp(most + term, digits)
    return error * lc + constant(lc, digits).error * most + half_ulp(lc * most, digits)
