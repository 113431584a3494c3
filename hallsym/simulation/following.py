"""A curve as the motion of a run: in which direction, how often, at which speed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.simulation.signals import Signal
from hallsym.trajectory import Curve
from hallsym.trajectory.export import at_times

DIRECTIONS = ("forward", "backward", "both")
SPEEDS = ("parameter", "constant")
CLOSED = 1e-6
"""Gap between the ends of a curve, as a share of its extent, up to which it counts as closed."""
SAMPLES = 2001


@dataclass(frozen=True, eq=False)
class Following:
    """A curve followed over `duration_s`, the length of a run.

    `direction`: forward, backward, or both (there and back). `speed`: "parameter" (the parameter of the curve
    runs evenly) or "constant" (along the path). `times`: how often; a curve that is not closed is repeated
    only there and back. `name`: of the file that it is saved in.
    """

    curve: Curve
    duration_s: float
    direction: str = "forward"
    speed: str = "parameter"
    times: int = 1
    name: str = "curve"
    _last: dict[str, Any] = field(default_factory=dict, repr=False)
    """Times and points of the last call: each axis of a run asks for the same times."""

    def __post_init__(self) -> None:
        """Refuse what cannot be followed."""
        for key, known in (("direction", DIRECTIONS), ("speed", SPEEDS)):
            if getattr(self, key) not in known:
                raise InputError(
                    f"The {key} of a curve must be one of {', '.join(known)}; instead received "
                    f"{getattr(self, key)!r}."
                )
        if self.times < 1 or not 0 < self.duration_s < np.inf:
            raise InputError("A curve must be followed once or more, in a positive time.")
        if self.times > 1 and self.direction != "both" and not is_closed(self.curve):
            raise InputError(
                f"Curve {self.name!r} is not closed, so that it cannot be followed {self.times} times in one "
                'direction; give direction = "both", or times = 1.'
            )

    def __eq__(self, other: object) -> bool:
        """Return whether the same curve is followed in the same way; its name does not matter."""
        return isinstance(other, Following) and self._way == other._way

    @property
    def _way(self) -> tuple[object, ...]:
        return self.curve.to_dict(), self.duration_s, self.direction, self.speed, self.times

    @property
    def fastest_hz(self) -> float:
        """Half the turning points of the coordinate that turns most often, per second."""
        points = self.curve(np.linspace(self.curve.start, self.curve.stop, SAMPLES))
        least = 1e-9 * np.ptp(points, axis=0).max()
        ways = [step[np.abs(step) > least] > 0 for step in np.diff(points, axis=0).T]
        if self.direction == "both":
            ways = [np.r_[way, ~way[::-1]] for way in ways]
        turns = max(int(np.count_nonzero(way != np.roll(way, 1))) for way in ways)
        return turns * self.times / (2 * self.duration_s)

    def at(self, axis: str, t: np.ndarray) -> np.ndarray:
        """Return a coordinate (samples,) at times `t` since the reset [s]."""
        if self._last.get("t") is not t:
            self._last.update(t=t, points=self._points(t))
        return self._last["points"][axis]

    def _points(self, t: np.ndarray) -> Mapping[str, np.ndarray]:
        rounds = np.clip(np.asarray(t, float) / self.duration_s, 0.0, 1.0) * self.times
        share = rounds - np.minimum(np.floor(rounds), self.times - 1)
        if self.direction == "both":
            share = 1 - np.abs(2 * share - 1)
        elif self.direction == "backward":
            share = 1 - share
        return at_times(self.curve, share, 1.0, steady=self.speed == "constant")

    def signals(self) -> Mapping[str, Signal]:
        """Return the motion of each axis that the curve moves."""
        fastest = self.fastest_hz
        return {axis: self._signal(axis, fastest) for axis in self.curve.coordinates}

    def _signal(self, axis: str, fastest_hz: float) -> Signal:
        return Signal("curve", {"curve": self, "axis": axis}, lambda t: self.at(axis, t), fastest_hz)


def is_closed(curve: Curve) -> bool:
    """Return whether a curve ends where it begins, in every coordinate."""
    ends = curve(np.array([curve.start, curve.stop]))
    sizes = np.array([high - low for low, high in curve.extent().values()])
    return bool(np.all(np.abs(ends[1] - ends[0]) <= CLOSED * sizes))


def follow(
    curve: Curve, duration_s: float, *, direction: str = "forward", speed: str = "parameter", times: int = 1
) -> Mapping[str, Signal]:
    """Return the motion of a run of `duration_s` that follows a curve: `Run(2.0, {}, follow(curve, 2.0))`."""
    return Following(curve, duration_s, direction, speed, times).signals()
