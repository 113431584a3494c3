"""What an encoder's C corrects: the phase that it reads over a turn, and its inverse as a short series.

For two voltages the phase is that of the linear map which brings the model's curve nearest to the unit
circle: the ellipse of offsets, amplitudes and phase is undone by it. For a decoded angle the phase is the
reading. What is left, whatever caused it (a quadratic plate, harmonics of the magnet, an axis that is off),
is periodic: angle = phase + c0 + sum over n of c_n cos(n phase) + s_n sin(n phase).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from hallsym.arrays import on_arrays
from hallsym.errors import InputError
from hallsym.families.rotary import ANGLE
from hallsym.model import Model
from hallsym.turning import wrapped

POINTS = 1024
ENOUGH = 3e-8
"""Angle [rad] that the waves left out of a correction may add up to: a quarter of float32 rounding at pi."""
MOST_WAVES = 32
ROUNDS = 60
SETTLED = 1e-13
"""Change of the angle [rad] below which its iteration ends."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A model of two voltages or of an angle at parameters `p`, over a turn."""

    model: Model
    p: np.ndarray

    @property
    def angle_only(self) -> bool:
        """Whether the decoded angle is read."""
        return self.model.channels == ANGLE

    def readings(self, angle: np.ndarray) -> np.ndarray:
        """Return the model's readings (n_channels, s) at angles (s,)."""
        zeros = np.zeros(len(self.model.zeros))
        found = on_arrays(self.model.reading)(self.p, zeros, [np.asarray(angle, dtype=float)], [])[0]
        return np.asarray(found)

    @cached_property
    def turn(self) -> np.ndarray:
        """Angles over a turn, (POINTS,)."""
        return np.arange(POINTS) * (2 * pi / POINTS) - pi

    @cached_property
    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        circle = np.array([np.cos(self.turn), np.sin(self.turn)])
        given = np.vstack([self.readings(self.turn), np.ones(POINTS)])
        scale = np.abs(given).max(axis=1, keepdims=True)
        found, *_ = np.linalg.lstsq((given / scale).T, circle.T, rcond=None)
        matrix = (found / scale).T
        center = -np.linalg.solve(matrix[:, :2], matrix[:, 2])
        return matrix[:, :2], center

    @property
    def matrix(self) -> np.ndarray:
        """(x, y) = matrix (reading - center), nearest to (cos, sin) of the angle; rows x, y [1/V]."""
        return self._map[0]

    @property
    def center(self) -> np.ndarray:
        """Center of the ellipse [V], in the order of the channels."""
        return self._map[1]

    def phase(self, readings: np.ndarray) -> np.ndarray:
        """Return the phase (s,) [rad] of readings (n_channels, s)."""
        if self.angle_only:
            return wrapped(readings[0], 2 * pi)
        x, y = self.matrix @ (readings - self.center[:, None])
        return np.asarray(np.arctan2(y, x))

    @cached_property
    def _shift(self) -> float:
        """Circular mean of phase - angle over a turn."""
        return float(np.angle(np.exp(1j * (self.phase(self.readings(self.turn)) - self.turn)).mean()))

    def angle(self, phase: np.ndarray) -> np.ndarray:
        """Return the angle (s,) at which the model reads a phase (s,), within -pi .. pi: its inverse.

        Newton's method on the model, from the series and with its slope.
        """
        correction, slope = self.series.at(phase)
        return self._inverse(phase, phase + correction, 1 + slope)

    def _inverse(self, phase: np.ndarray, start: np.ndarray, slope: np.ndarray | float) -> np.ndarray:
        found = np.asarray(start, dtype=float)
        for _ in range(ROUNDS):
            off = wrapped(phase - self.phase(self.readings(found)), 2 * pi) * slope
            found = found + off
            if np.abs(off).max(initial=0.0) < SETTLED:
                break
        else:
            raise InputError(
                f"The distortion of this calibration of {self.model.name} is too large to be undone by a "
                "correction of the angle: the phase it reads does not grow steadily over a turn."
            )
        return np.asarray(wrapped(found, 2 * pi))

    @cached_property
    def series(self) -> "Series":
        """The correction, as many pairs of waves as count."""
        phase = self.turn
        found = (
            np.fft.rfft(wrapped(self._inverse(phase, phase - self._shift, 1.0) - phase + self._shift, 2 * pi))
            / POINTS
        )
        n = np.arange(len(found))
        waves = 2 * found * np.exp(1j * n * pi)  # the grid begins at -pi
        size = np.abs(waves)
        left = np.append(np.cumsum(size[::-1])[::-1], 0.0)  # left[k]: waves k and up
        count = next((k for k in range(0, MOST_WAVES + 2, 2) if left[k + 1] <= ENOUGH), None)
        if left[1] >= 1.0:
            raise InputError(
                f"The distortion of this calibration of {self.model.name} is more than 1 rad; no correction "
                "of the angle is generated for it."
            )
        if count is None:
            raise InputError(
                f"The correction of this calibration of {self.model.name} needs more than {MOST_WAVES} waves "
                "per turn; C is generated for smooth distortions: fit a model without "
                f"{' and '.join(self.model.effects) or 'so large a distortion'}."
            )
        constant = float(wrapped(np.array(found[0].real - self._shift), 2 * pi))
        if not count and abs(constant) <= 1e-12:
            constant = 0.0
        kept = waves[1 : count + 1]
        return Series(
            constant, tuple(kept.real.tolist()), tuple((-kept.imag).tolist()), float(left[count + 1])
        )


@dataclass(frozen=True)
class Series:
    """constant + sum of cos_n cos(n phase) + sin_n sin(n phase) [rad]; `left`: sum of the others."""

    constant: float
    cos: tuple[float, ...]
    sin: tuple[float, ...]
    left: float

    def at(self, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the correction (s,) [rad] and its derivative (s,) at phases (s,)."""
        total, slope = np.full(np.shape(phase), self.constant), np.zeros(np.shape(phase))
        for n, (c, s) in enumerate(zip(self.cos, self.sin, strict=True), 1):
            cos, sin = np.cos(n * phase), np.sin(n * phase)
            total += c * cos + s * sin
            slope += n * (s * cos - c * sin)
        return total, slope

    @property
    def waves(self) -> Sequence[float]:
        """Amplitude of each wave [rad]."""
        return np.hypot(self.cos, self.sin).tolist()

    @property
    def slope(self) -> float:
        """Bound of its derivative."""
        return float(sum((n + 1) * size for n, size in enumerate(self.waves)))

    @property
    def entries(self) -> int:
        """Entries that a table of straight lines needs to be as near: max |second derivative| h^2 / 8."""
        bend = sum((n + 1) ** 2 * size for n, size in enumerate(self.waves))
        return int(np.ceil(2 * pi * np.sqrt(bend / 8 / ENOUGH))) if bend else 0
