"""Steps of the small angle of one phasor from another: a turn of the mover moves arrays of an axis apart."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import tan

import casadi as ca
import numpy as np

from hallsym.codegen.entries import short
from hallsym.codegen.lowering.arrays_fit import Arrays
from hallsym.codegen.lowering.odd_series import Odd, shortest
from hallsym.codegen.lowering.trigonometry import odd
from hallsym.codegen.lowering.wave_steps import POLYNOMIALS, Collected, Pair, Wave
from hallsym.errors import InputError

ROOMY = 1.1
"""Times the largest tangent of the box: end of the polynomial of a turn."""
TURNED = 1e6
"""Most [rad] that the polynomial of a turn may give of readings of no pose: products of four such numbers are
far below the largest float."""


@dataclass(eq=False)
class Turns:
    """Adds the steps of the turns of the phasors of an axis from its first."""

    found: Arrays
    waves: tuple[Wave, ...]
    made: Collected = field(default_factory=Collected)

    def __post_init__(self) -> None:
        """Name the arrays: x_1, x_2, y_1, y_2."""
        pose = self.found.model.pose
        self.names = [f"{short(pose[a])}_{k + 1}" for a, m in self.found.axes.items() for k in range(len(m))]

    def turn(self, first: int, k: int, vectors: Sequence[Pair]) -> ca.SX:
        """Angle of one phasor from the first of its axis: small, so one polynomial without quadrants."""
        made, (a, b), (c, d), name = self.made, vectors[first], vectors[k], self.names[k]
        real = made.step(f"cross_real_{name}", c * a + d * b)
        imaginary = made.step(f"cross_imaginary_{name}", d * a - c * b)
        if floor := self._floor(first, k):
            least = made.entry(f"least_cross_{name}", floor, "1", "least product of two phasors of the box")
            held = made.step(f"held_cross_{name}", ca.if_else(real > least, real, least))
            return self._turned(first, k, imaginary / held)
        steep, floor = self._cone(first, k)
        cone = made.entry(f"cone_{name}", steep, "1", "cotangent of the largest turn of two phasors")
        least = made.entry(f"least_cross_{name}", floor, "1", "least product of two phasors of the box")
        bound = made.step(f"bound_{name}", cone * ca.fabs(imaginary) + least)
        held = made.step(f"held_cross_{name}", ca.if_else(real > bound, real, bound))
        return self._turned(first, k, imaginary / held)

    def _turned(self, first: int, k: int, value: ca.SX) -> ca.SX:
        made, name = self.made, self.names[k]
        tangent = made.step(f"cross_{name}", value)
        square = made.step(f"cross_square_{name}", tangent * tangent)
        return made.step(f"turn_{name}", odd(self.series(first, k).coefficients, tangent, square), "[rad]")

    def _floor(self, first: int, k: int) -> float:
        """Half the least of the products of the box, where that alone keeps every turn finite; else 0.

        The polynomial then goes beyond its end, of readings of no pose.
        """
        least = 0.5 * self.waves[first].least * self.waves[k].least * float(np.cos(self._angle(first, k)))
        most = self._longest(first) * self._longest(k) / least
        sizes = np.abs(self.series(first, k).coefficients)
        with np.errstate(over="ignore"):
            turn = (sizes * most ** (2.0 * np.arange(len(sizes)) + 1)).sum()
        return least if turn < TURNED else 0.0

    def _longest(self, k: int) -> np.float64:
        """Bound of a phasor over all readings within their limits: infinite where rounds do not bound it."""
        wave, found = self.waves[k], self.waves[k].phasor
        reach = (1 / wave.least) ** np.arange(1, found.factor.shape[1] + 1)
        swing = ROOMY * (np.abs(found.factor) @ reach) + 2 * np.abs(found.offset)
        size = start = np.float64((np.hypot(*found.weights) * swing).sum() + np.hypot(*found.shift))
        with np.errstate(over="ignore"):
            for _ in range(wave.rounds + (wave.last == "linear")):
                size = np.float64(start + found.largest(size))
        return size

    def _cone(self, first: int, k: int) -> tuple[float, float]:
        """Cotangent of the end of the polynomial, and the least that real - cotangent |imaginary| is, halved.

        So no reading whatever turns two phasors beyond that end.
        """
        angle, steep = self._angle(first, k), 1.0 / self.series(first, k).end
        least = self.waves[first].least * self.waves[k].least
        return steep, 0.5 * least * (float(np.cos(angle)) - steep * float(np.sin(angle)))

    def _angle(self, first: int, k: int) -> float:
        """Largest turn of two phasors of an axis over the box [rad]."""
        pose = self.found.poses(np.random.default_rng(3), 2000)
        u = self.found.phasors(self.found.readings(pose))
        return float(np.abs(np.angle(u[k] * u[first].conj())).max()) * 1.05

    def series(self, first: int, k: int) -> Odd:
        """Return the polynomial of that angle."""
        end = np.ceil(20 * ROOMY * tan(min(self._angle(first, k), 1.4))) / 20
        share = POLYNOMIALS * float(self.found.accuracy[0]) / self.found.groups[k].phasor.lc
        series = shortest("atan", float(end), share, fewest=1)
        if series is None:
            raise InputError(
                "Rotations of the box turn two arrays of an axis by most of a period against each other; "
                "give a "
                "smaller range of rotations with --range."
            )
        return series
