"""The phase that a model of one angle reads over a period, its slopes and its inverse.

Angles are those of a period as a turn (`Curve.share`): of an encoder that repeats P times a turn, P times the
mechanical angle. For two or more voltages the phase is that of the linear map which brings the model's curve
nearest to the unit circle: the ellipse of offsets, amplitudes and phase is undone by it. For a decoded angle
the phase is the reading. What is left, angle - phase, is periodic whatever caused it (a quadratic plate,
harmonics of the magnet, an axis that is off, a rail): `hallsym.codegen.lowering.correction` makes a table
of it.
"""

from dataclasses import dataclass, field
from functools import cached_property
from math import pi

import casadi as ca
import numpy as np

from hallsym.codegen.intervals import Enclosure, enclose
from hallsym.errors import InputError
from hallsym.log.phase import wrapped
from hallsym.model import Model

POINTS = 1024
BRACKETS = 4096
ROUNDS = 12
PLANE = 1e-3
"""Size of what readings do off the plane of their ellipse, relative to it, that is no direction of its own:
of three Halls and more the map is the shortest one, which adds least noise."""
SETTLED = 1e-13
"""Change of the angle [rad] below which its iteration ends."""


def check_static(model: Model, what: str) -> None:
    """Refuse a model whose readings depend on more than `what`, which is decoded from one sample."""
    if model.state:
        raise InputError(
            f"C is generated from readings that depend on {what} alone; {model.name} with "
            f"{', '.join(model.effects)} needs {', '.join(model.state)}: generate from a calibration without "
            "it."
        )
    if sum(link == "reference" for link, _ in model.steps) > bool(model.offsets):  # a zero is set by a reset
        raise InputError(
            f"The calibration of {model.name} with {', '.join(model.effects)} holds errors of its reference, "
            "which a controller does not have; fit without that effect, or correct the log's reference."
        )


@dataclass(frozen=True, eq=False)
class Curve:
    """A model of two or more voltages, or of an angle, at parameters `p`, over a turn."""

    model: Model
    p: np.ndarray
    _slopes: dict[int, tuple[np.ndarray, ...]] = field(default_factory=dict, init=False, repr=False)

    @property
    def angle_only(self) -> bool:
        """Whether the decoded angle is read: a channel that repeats."""
        return set(self.model.channels) <= self.model.period.keys()

    @property
    def share(self) -> float:
        """What an angle of the curve, of which 2 pi are a period, is multiplied by to be that of the pose."""
        return self.model.period[self.model.pose[0]] / (2 * pi)

    def readings(self, angle: np.ndarray) -> np.ndarray:
        """Return the model's readings (n_channels, s) at angles (s,), of which 2 pi are a period."""
        return self.model.readings(self.p, [np.asarray(angle, dtype=float) * self.share])

    @cached_property
    def turn(self) -> np.ndarray:
        """Angles over a turn, (POINTS,)."""
        return np.arange(POINTS) * (2 * pi / POINTS) - pi

    @cached_property
    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        circle = np.array([np.cos(self.turn), np.sin(self.turn)])
        seen = self.readings(self.turn)
        if not np.allclose(seen, self.readings(self.turn + 2 * pi), rtol=1e-9, atol=1e-9 * np.ptp(seen)):
            raise InputError(
                f"The calibration of {self.model.name} holds waves that differ from one period to the next, "
                "which readings of one moment cannot tell: fit without them, or with those of the period "
                "alone (turn_waves with the pole pairs as its step)."
            )
        middle = seen.mean(axis=1, keepdims=True)
        given = np.vstack([seen - middle, np.ones(POINTS)])
        scale = np.abs(given).max(axis=1, keepdims=True)
        found, *_ = np.linalg.lstsq((given / scale).T, circle.T, rcond=PLANE)
        matrix = (found / scale).T
        center = middle[:, 0] - np.linalg.pinv(matrix[:, :-1]) @ matrix[:, -1]
        return matrix[:, :-1], center

    @property
    def matrix(self) -> np.ndarray:
        """(x, y) = matrix (reading - center), nearest to (cos, sin) of the angle; rows x, y [1/V]."""
        return self._map[0]

    @property
    def center(self) -> np.ndarray:
        """Center of the ellipse [V], in the order of the channels."""
        return self._map[1]

    @cached_property
    def spare(self) -> np.ndarray:
        """What readings do off the plane of their ellipse, (rows, n_channels) per reading: none of two."""
        seen = self.readings(self.turn)
        off = np.linalg.svd(seen - seen.mean(axis=1, keepdims=True), full_matrices=False)[0][:, 2:]
        return off.T if off.shape[1] < 2 else off @ off.T

    def phase(self, readings: np.ndarray) -> np.ndarray:
        """Return the phase (s,) [rad] of readings (n_channels, s)."""
        if self.angle_only:
            return wrapped(readings[0], 2 * pi)
        x, y = self.matrix @ (readings - self.center[:, None])
        return np.asarray(np.arctan2(y, x))

    @cached_property
    def _grown(self) -> tuple[np.ndarray, np.ndarray]:
        """Angles over a turn, both ends included, and their phases without jumps, (n + 1,) each."""
        angles = np.linspace(-pi, pi, BRACKETS + 1)
        phases = np.unwrap(self.phase(self.readings(angles)))
        if not (np.diff(phases) > 0).all() or abs(phases[-1] - phases[0] - 2 * pi) > 1e-6:
            raise self.too_large
        return angles, phases

    @property
    def too_large(self) -> InputError:
        """What to say where no angle belongs to each phase."""
        return InputError(
            f"The distortion of this calibration of {self.model.name} is too large to be undone by a "
            "correction of the angle: the phase it reads does not grow steadily over a turn."
        )

    def angle(self, phase: np.ndarray) -> np.ndarray:
        """Return the angle (s,) at which the model reads a phase (s,), within -pi .. pi: its inverse.

        Steps with the slope of the bracket that the phase lies in; by halves where the slope jumps within it.
        """
        angles, phases = self._grown
        aim = phases[0] + np.mod(phase - phases[0], 2 * pi)
        k = np.clip(np.searchsorted(phases, aim, side="right") - 1, 0, BRACKETS - 1)
        slope = (angles[k + 1] - angles[k]) / (phases[k + 1] - phases[k])
        found = angles[k] + (aim - phases[k]) * slope
        for _ in range(ROUNDS):
            off = self._ahead(aim, found) * slope
            found = found + off
            if np.abs(off).max(initial=0.0) < SETTLED:
                break
        else:
            rest = np.abs(off) >= SETTLED
            low, high = angles[k[rest]], angles[k[rest] + 1]
            while np.abs(high - low).max(initial=0.0) >= SETTLED:
                middle = (low + high) / 2
                above = self._ahead(aim[rest], middle) > 0
                low, high = np.where(above, middle, low), np.where(above, high, middle)
            found[rest] = (low + high) / 2
        return np.asarray(wrapped(found, 2 * pi))

    def _ahead(self, phase: np.ndarray, angle: np.ndarray) -> np.ndarray:
        return np.asarray(wrapped(phase - self.phase(self.readings(angle)), 2 * pi))

    @cached_property
    def needed(self) -> tuple[float, np.ndarray]:
        """The correction angle - phase over a turn: middle of its range [rad], and the rest at `turn`."""
        angles, phases = self._grown
        middle = float((angles - phases).max() + (angles - phases).min()) / 2
        return middle, np.asarray(wrapped(self.angle(self.turn) - self.turn - middle, 2 * pi))

    @cached_property
    def trial(self) -> tuple[np.ndarray, np.ndarray]:
        """Some angles and the phases they are read at, (8 POINTS,) each."""
        angle = np.linspace(-pi, pi, 8 * POINTS, endpoint=False)
        return angle, self.phase(self.readings(angle))

    def slopes(self, count: int) -> tuple[np.ndarray, ...]:
        """Return least and greatest d phase / d angle over `count` equal intervals of a turn, (count,) each.

        And angles and phases, without jumps, at their ends, (count + 1,) each. By interval arithmetic on the
        derivative of the model's own expressions. Raises `InputError` where it may be negative: then no angle
        belongs to each phase.
        """
        angle = ca.SX.sym("angle")
        readings = self.model.reading(self.p, np.zeros(len(self.model.offsets)), angle * self.share, [])
        if count in self._slopes:
            return self._slopes[count]
        if self.angle_only:
            slope = ca.jacobian(readings, angle)
        else:
            x, y = ca.vertsplit(ca.DM(self.matrix) @ (readings - ca.DM(self.center)))
            slope = (x * ca.jacobian(y, angle) - y * ca.jacobian(x, angle)) / (x * x + y * y)
        ends = np.linspace(-pi, pi, count + 1)
        (found,) = enclose([slope], {"angle": Enclosure(ends[:-1], ends[1:])})
        low, high = np.broadcast_to(found.low, count), np.broadcast_to(found.high, count)
        if not (low > 0).all() or not np.isfinite(high).all():
            raise self.too_large
        self._slopes[count] = low, high, ends, np.unwrap(self.phase(self.readings(ends)))
        return self._slopes[count]
