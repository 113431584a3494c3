"""Stretches in which a column holds one value although it should not: old samples, a dropped channel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hallsym.log.core import Block, Log
from hallsym.log.drop import Drop
from hallsym.log.limits import is_moving, tells
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.motion import equal_by_chance, noise_in_codes, stretches
from hallsym.log.quality.scan import HELD_SAMPLES, Scan, Spans
from hallsym.units import Array, si_symbol

REFUSE = 0.05
"""Share of a column's samples from which a log is refused: below, the others tell what it would have told."""
_JUMP = 3.0
"""Usual steps of a column that it goes on with after a stretch of old samples."""
_CHANCE = 1e-6
"""Probability that noise repeats a code for so long somewhere in a block from which it is no chance."""
_AT_A_TURN = 4.0
"""Equal neighbours at a turning point over those elsewhere, at most."""


@dataclass(frozen=True)
class Stretch:
    """Samples `start` to `stop` of the log in which a column of `run` holds `value`."""

    run: int
    start: int
    stop: int
    value: float


def held(log: Log, seen: Scan, spans: Spans, rails: Drop) -> Iterator[Finding]:
    """Columns that hold one value for a while although they move, or should, before, meanwhile or after.

    `rails`: the values beyond which columns are saturated, which holds them too.
    """
    ends = {name: (low, high) for name, low, high in rails.between}
    for name, trace in seen.traces.items():
        if not is_moving(name) or not trace.held or name not in spans.overall:
            continue
        low, high = ends.get(name, (-np.inf, np.inf))
        found = [one for one in _stretches(log, seen, name, spans) if low < one.value < high]
        if found:
            yield _finding(log, name, found, seen.rows)


def _finding(log: Log, name: str, found: list[Stretch], rows: int) -> Finding:
    count = sum(one.stop - one.start for one in found)
    longest = max(one.stop - one.start for one in found)
    first = found[0]
    where = f"first in row {first.start + 1}, run {first.run}, {first.value:.4g} {si_symbol(name)}"
    stretches_of = "1 stretch" if len(found) == 1 else f"{len(found)} stretches"
    zero = all(one.value == 0.0 for one in found)
    return Finding(
        f"{the(log, name)} holds one value for up to {longest} samples"
        f" ({stretches_of}, {count / rows:.1%}, {where})"
        + (": the channel dropped out" if zero else ": the logger repeated old samples"),
        count > REFUSE * rows, Drop(rows=tuple((one.start, one.stop) for one in found)),
        remedy="look at the channel and the logger",
    )  # fmt: skip


def _stretches(log: Log, seen: Scan, name: str, spans: Spans) -> list[Stretch]:
    beside = tuple(c for c in seen.sample.columns if tells(c, name))
    steady = {run for run, columns in spans.runs.items() if columns[name].min == columns[name].max}
    found: list[Stretch] = []
    row = 0
    for block in log.blocks((name, *beside)):
        x = block.data[name]
        if block.run not in steady:
            found += [
                Stretch(block.run, row + a, row + b, float(x[a])) for a, b in _frozen(block, name, beside)
            ]
        row += len(x)
    return found


def _frozen(block: Block, name: str, beside: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return (start, stop) of the stretches of one value in a block that cannot be a rest."""
    x = block.data[name]
    step = np.abs(np.diff(x))
    long = [(a, b + 1) for a, b in stretches(step == 0, shortest=HELD_SAMPLES - 1)]
    if not long:
        return []
    free = np.ones(len(x), bool)
    for a, b in long:
        free[a:b] = False
    between = free[1:] | free[:-1]
    moving = step[between & (step > 0)]
    if sure := _beyond_chance(x, long):
        return sure
    usual = float(np.median(moving)) if len(moving) else np.inf
    again = min(0.5, _AT_A_TURN * float(np.mean(step[between] == 0))) if between.any() else 0.5
    leaps = [_leaps(block.data[c], free) for c in beside]
    return [(a, b) for a, b in long if _jumps(step, a, b, usual, leaps) and _no_chance(len(x), again, b - a)]


def _beyond_chance(x: Array, long: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the stretches that the noise in the longest part of a column between them would have ended."""
    edges = [0, *(edge for pair in long for edge in pair), len(x)]
    parts = [x[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    codes = noise_in_codes(max(parts, key=len))
    if not codes:
        return []
    again = equal_by_chance(codes)
    return [(a, b) for a, b in long if _no_chance(len(x), again, b - a)]


def _no_chance(samples: int, again: float, length: int) -> bool:
    """Say whether a value does not repeat so often by chance, where it does once with probability `again`."""
    return samples * again ** (length - 1) < _CHANCE


def _leaps(other: Array, free: Array) -> Array:
    """Return (n - 1,) where another column makes an unusual step too: then the motion does."""
    step = np.abs(np.diff(other))
    usual = float(np.median(step[free[1:] & free[:-1]])) if (free[1:] & free[:-1]).any() else 0.0
    return np.asarray(step > _JUMP * usual)


def _jumps(step: Array, a: int, b: int, usual: float, leaps: list[Array]) -> bool:
    """Say whether a column goes on with a jump at either end of a stretch that no other column makes."""
    ends = [i for i in (a - 1, b - 1) if 0 <= i < len(step)]
    return any(step[i] > _JUMP * usual and not any(leap[i] for leap in leaps) for i in ends)
