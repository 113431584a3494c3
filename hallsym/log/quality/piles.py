"""Samples that pile up at the ends of a reading's range: what its distribution says of rails."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hallsym.log.quality.motion import code
from hallsym.units import Array

TURN = 2.6
"""Samples within a window at the end of the range over those of the fullest window beside it, of a pile. A
sine that turns there has 1 / (sqrt(2) - 1) = 2.4, a triangle 1."""
SAME = 8
"""Samples exactly at the end of the range that are a pile where no three of the others are equal but for
rounding."""
_ROUNDING = 1e-9
"""Distance over the range up to which values are equal but for rounding: a wave that comes back to the same
phase again and again has one exact value at its ends only, where it is flat. Of 100,000 samples at random,
three are as close once in 2,000 logs."""
_CHANCE = 2.0
"""Standard deviations of a count that are left to chance."""
_WINDOWS = 2
"""Windows beside it, of which the fullest counts."""
_BESIDE = 4
"""Samples that the fullest must hold: values that repeat with each period are no piles."""
_WIDTHS = 2.0 ** np.arange(-13, -3.9, 0.5)
"""Widths of the windows over the range: noise on a rail is not wider than a sixteenth, nor codes narrower."""
_BEYOND = 0.002
"""Share of the samples that may lie beyond a rail: glitches of the logger."""
_LEVELS = 10
"""Codes that a range must have: fewer say nothing about a pile."""


@dataclass(frozen=True)
class Pile:
    """The pile at one end, `sign` +1 (high) or -1: samples from `edge` on; `ratio` to those beside it."""

    sign: float
    edge: float
    ratio: float

    def of(self, x: Array) -> Array:
        """Return which samples (n,) belong to it."""
        return np.asarray(self.sign * x >= self.sign * self.edge)


def piles(ordered: Array) -> list[Pile]:
    """Return the piles at the ends of samples (n,) by size."""
    step = code(ordered)
    if not ordered[-1] - ordered[0] > _LEVELS * step:
        return []
    ends = (-1.0, _highest(-ordered[::-1], step)), (1.0, _highest(ordered, step))
    return [Pile(sign, sign * found[0], found[1]) for sign, found in ends if found is not None]


def _highest(ordered: Array, step: float) -> tuple[float, float] | None:
    """Return edge and ratio of the pile at the end of ascending samples; windows are wider than `step`."""
    n, span = len(ordered), float(ordered[-1] - ordered[0])
    first = int(np.searchsorted(ordered, ordered[-1]))
    if n - first >= SAME and _alone(ordered[:first]):
        return float(ordered[-1]), np.inf
    end = ordered[-1 - int(_BEYOND * n)]
    widths = span * _WIDTHS
    bounds = end - np.outer(widths, np.arange(_WINDOWS + 2))
    counts = -np.diff(np.searchsorted(ordered, bounds.ravel(), side="right").reshape(bounds.shape), axis=1)
    top, fullest = counts[:, 0], counts[:, 1:].max(axis=1)
    sure = top > TURN * fullest + _CHANCE * np.sqrt(top + TURN**2 * fullest)
    good = sure & (fullest >= _BESIDE) & (widths > 1.5 * step)
    if not good.any():
        return None
    ratio = np.where(good, top / np.maximum(fullest, 1), 0.0)
    best = int(np.argmax(ratio))
    return float(np.nextafter(bounds[best, 1], np.inf)), float(ratio[best])


def _alone(ordered: Array) -> bool:
    """Say whether no three of ascending samples are equal but for rounding, but at their lower end."""
    above = ordered[int(np.searchsorted(ordered, ordered[0], side="right")) :] if len(ordered) else ordered
    near = _ROUNDING * float(ordered[-1] - ordered[0]) if len(ordered) else 0.0
    return not bool((above[2:] - above[:-2] <= near).any())
