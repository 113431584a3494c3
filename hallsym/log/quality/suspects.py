"""A second look at a column that one pass found suspicious: saturated, held, or recorded at a lower rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.log.core import Log
from hallsym.log.limits import is_reference
from hallsym.log.quality.scan import HELD_SAMPLES
from hallsym.units import Array

_SAMPLE_ROWS = 2_000_000
_FEWEST_LEVELS = 16
_PILE = 4.0  # a quantised sine has at most 2.4 times as many samples at its extreme level as at the next


def piled_up(log: Log, column: str, level: float) -> bool:
    """Say whether samples at an extreme `level` are cut off there, rather than resting or turning there.

    Cut off means: far more samples than on any level nearby, and a reference that moves meanwhile.
    """
    references = [name for name in log.columns if is_reference(name)]
    parts: list[dict[str, Array]] = []
    rows = 0
    for block in log.blocks((column, *references)):
        parts.append(block.data)
        rows += len(block.data[column])
        if rows >= _SAMPLE_ROWS:
            break
    levels, counts = np.unique(np.concatenate([part[column] for part in parts]), return_counts=True)
    reach = 0.2 * (levels[-1] - levels[0])
    near = counts[(np.abs(levels - level) <= reach) & (levels != level)]
    if len(levels) < _FEWEST_LEVELS or not len(near) or counts[levels == level].sum() <= _PILE * near.max():
        return False
    pinned = [part[column] == level for part in parts]
    concerned = _related(parts, column, references)
    return not references or any(_moves([part[name] for part in parts], pinned) for name in concerned)


def _related(parts: Sequence[dict[str, Array]], column: str, references: Sequence[str]) -> list[str]:
    """Return the references that a reading follows, or all of them where none stands out."""
    reading = np.concatenate([part[column] for part in parts])
    strength = {}
    for name in references:
        motion = np.concatenate([part[name] for part in parts])
        common = abs(np.mean((reading - reading.mean()) * (motion - motion.mean())))
        strength[name] = common / (reading.std() * motion.std() or np.inf)
    least = max(0.3, 0.9 * max(strength.values(), default=0.0))
    return [name for name in references if strength[name] >= least] or list(references)


def _moves(motion: Sequence[Array], pinned: Sequence[Array]) -> bool:
    """Say whether a reference moves, beyond its noise, within the stretches where the reading is pinned."""
    inside, steps, drift = [], [], []
    for x, mask in zip(motion, pinned, strict=True):
        for start, stop in _stretches(mask):
            inside.append(np.diff(x[start:stop]))
            drift.append(x[start:stop] - x[start:stop].mean())
        steps.append(np.diff(x))
    within, everywhere = (_rms(np.concatenate(p) if p else np.empty(0)) for p in (inside, steps))
    spread = _rms(np.concatenate(drift)) if drift else 0.0
    span = max(x.max() for x in motion) - min(x.min() for x in motion)
    wanders = spread > max(1e-3 * span, 2.0 * within / np.sqrt(2.0))
    return bool(span > 0 and (wanders or within >= 0.5 * everywhere))


@dataclass(frozen=True)
class Held:
    """Stretches in which a channel repeats one value although it moves before and after."""

    stretches: int
    longest: int
    run: int
    row: int


def held(log: Log, column: str) -> Held | None:
    """Find stale samples: `HELD_SAMPLES` or more equal ones, then a jump, where repeats are rare."""
    found: list[tuple[int, int, int]] = []
    row = 0
    for block in log.blocks((column,)):
        x = block.data[column]
        found += [(length, block.run, row + start) for start, length in _stale(x)]
        row += len(x)
    if not found:
        return None
    return Held(len(found), max(f[0] for f in found), found[0][1], found[0][2])


def _stale(x: Array) -> list[tuple[int, int]]:
    step = np.abs(np.diff(x))
    long = [(a, b) for a, b in _stretches(step == 0, shortest=HELD_SAMPLES - 1)]
    rest = np.ones(len(step), bool)
    for a, b in long:
        rest[a:b] = False
    moving = step[rest & (step > 0)]
    if not long or not len(moving) or np.mean(step[rest] == 0) > 0.2:
        return []
    usual = float(np.median(moving))
    return [(a, b - a + 1) for a, b in long if b < len(step) and step[b] > 3.0 * usual]


def repeats_each(log: Log, column: str) -> float | None:
    """Return how often each value is repeated, if the channel was recorded at a lower rate than others.

    A slow channel on a coarse ADC repeats too, but then its steps are mostly one ADC step.
    """
    steps = [np.abs(np.diff(block.data[column])) for block in log.blocks((column,), size=_SAMPLE_ROWS)]
    step = np.concatenate(steps) if steps else np.empty(0)
    changes = step[step > 0]
    if len(changes) < _FEWEST_LEVELS or len(changes) > len(step) / 2:
        return None
    return len(step) / len(changes) if np.median(changes) >= 4.0 * changes.min() else None


def _stretches(mask: Array, shortest: int = 2) -> list[tuple[int, int]]:
    """Return (start, stop) of the stretches of at least `shortest` True in a boolean array."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(np.int8)))
    return [
        (a, b) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True) if b - a >= shortest
    ]


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2))) if len(x) else 0.0
