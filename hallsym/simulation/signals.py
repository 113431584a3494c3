"""Signals: positions over time, with their entries of a campaign file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import pi
from typing import Any

import numpy as np

from hallsym.errors import require

AtTimes = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Signal:
    """A position over time, `signal(t)` with t in s, and how a campaign file describes it.

    `kind` and `values` are what the file holds; two signals are equal when these are. `fastest_hz`: its
    highest frequency, 0 where it does not oscillate, infinite where it is not known.
    """

    kind: str
    values: Mapping[str, Any]
    at: AtTimes = field(compare=False, repr=False)
    fastest_hz: float = field(default=0.0, compare=False, repr=False)

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Return the position at times `t` [s]."""
        return self.at(t)


def sine(amplitude: float, frequency_hz: float, phase_rad: float = 0.0) -> Signal:
    """Return amplitude * sin(2 pi f t + phase)."""
    values = {"amplitude": amplitude, "frequency_hz": frequency_hz}
    if phase_rad:
        values["phase_rad"] = phase_rad

    def at(t: np.ndarray) -> np.ndarray:
        return amplitude * np.sin(2 * pi * frequency_hz * t + phase_rad)

    return Signal("sine", values, at, frequency_hz)


def multi_sine(amplitude: float, frequencies_hz: list[float]) -> Signal:
    """Return a sum of equal sines with Schroeder phases, its peak at most `amplitude`."""
    n = len(frequencies_hz)
    require(n, "'frequencies_hz' of a multi-sine", "a list of one frequency or more", frequencies_hz)
    phases = [-pi * k * (k + 1) / n for k in range(n)]
    start = sum(np.sin(phase) for phase in phases)

    def at(t: np.ndarray) -> np.ndarray:
        waves = (np.sin(2 * pi * f * t + p) for f, p in zip(frequencies_hz, phases, strict=True))
        return amplitude / (2 * n) * (sum(waves, np.zeros(len(t))) - start)

    values = {"amplitude": amplitude, "frequencies_hz": list(frequencies_hz)}
    return Signal("multi-sine", values, at, max(frequencies_hz))


def triangle(amplitude: float, frequency_hz: float) -> Signal:
    """Return a triangle of the given amplitude that starts at 0 and rises."""
    values = {"amplitude": amplitude, "frequency_hz": frequency_hz}

    def at(t: np.ndarray) -> np.ndarray:
        return amplitude * (1 - 4 * np.abs(np.mod(frequency_hz * t + 0.25, 1.0) - 0.5))

    return Signal("triangle", values, at, frequency_hz)


def steps(levels: list[float], dwell_s: float) -> Signal:
    """Return `levels` in cyclic order, each for `dwell_s`."""
    require(levels, "'levels' of steps", "a list of one level or more", levels)
    sequence = np.asarray(levels, dtype=float)
    values = {"levels": sequence.tolist(), "dwell_s": dwell_s}

    def at(t: np.ndarray) -> np.ndarray:
        return sequence[np.floor(t / dwell_s + 1e-9).astype(int) % len(sequence)]

    return Signal("steps", values, at, 1 / dwell_s)


def ramp(rate: float, acceleration: float = 0.0) -> Signal:
    """Return rate * t + acceleration * t^2 / 2: rotation at a constant or a growing speed."""
    values = {"rate": rate} | ({"acceleration": acceleration} if acceleration else {})
    return Signal("ramp", values, lambda t: rate * t + 0.5 * acceleration * t**2)


SIGNALS: Mapping[str, tuple[Callable[..., Signal], tuple[str, ...], tuple[str, ...]]] = {
    "sine": (sine, ("amplitude", "frequency_hz"), ("phase_rad",)),
    "multi-sine": (multi_sine, ("amplitude", "frequencies_hz"), ()),
    "triangle": (triangle, ("amplitude", "frequency_hz"), ()),
    "steps": (steps, ("levels", "dwell_s"), ()),
    "ramp": (ramp, ("rate",), ("acceleration",)),
}
