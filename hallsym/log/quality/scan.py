"""One pass over a log: extent, mean and spread of every column and run, and the traces that faults leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import comb

import numpy as np

from hallsym.log.columns import RUN, is_moving
from hallsym.log.core import Log, RunOrder
from hallsym.log.table import CHUNK_ROWS, Piece
from hallsym.units import Array

FEWEST_SAMPLES = 8
"""Samples of a run below which it is not checked."""
STUCK_SAMPLES = 8


@dataclass(frozen=True)
class Span:
    """Extent of one column: least, greatest, mean and standard deviation (population), in its SI unit."""

    min: float
    max: float
    mean: float
    std: float


@dataclass(frozen=True, eq=False)
class Spans:
    """Extents of every column: `overall["z_m"]`, and by run as arrays (4, runs); `samples[3]` counts rows."""

    overall: dict[str, Span]
    by_run: dict[str, Array]
    samples: dict[int, int]

    def rests(self, column: str) -> Array:
        """Return whether a column holds one value all through a run, (runs,) of bool."""
        return self.covers(column) == 0.0

    def covers(self, column: str) -> Array:
        """Return greatest minus least value of a column in each run, (runs,)."""
        return np.asarray(self.by_run[column][1] - self.by_run[column][0])


@dataclass
class Trace:
    """Result of one pass over one column.

    `parts` holds arrays (segments, 4): min, max, sum, sum of squares. `stuck`: whether `STUCK_SAMPLES`
    consecutive samples are equal.
    """

    pivot: float | None = None
    parts: list[Array] = field(default_factory=list)
    nonfinite: int = 0
    first_nonfinite: int = -1
    stuck: bool = False

    def add(self, name: str, values: Array, starts: Array, row: int) -> None:
        """Take a piece that begins at `row`, with segments from `starts` on.

        A piece that holds NaN or infinity is only counted.
        """
        if self.pivot is None:
            self.pivot = float(values[0])
        part = np.empty((len(starts), 4))
        np.minimum.reduceat(values, starts, out=part[:, 0])
        np.maximum.reduceat(values, starts, out=part[:, 1])
        if not np.isfinite(part[:, :2]).all():
            wrong = ~np.isfinite(values)
            if self.nonfinite == 0:
                self.first_nonfinite = row + int(np.argmax(wrong))
            self.nonfinite += int(np.count_nonzero(wrong))
            return
        shifted = values - self.pivot
        np.add.reduceat(shifted, starts, out=part[:, 2])
        np.add.reduceat(np.square(shifted, out=shifted), starts, out=part[:, 3])
        self.parts.append(part)
        if is_moving(name):
            equal = values[1:] == values[:-1]
            if not self.stuck and len(equal) >= STUCK_SAMPLES:
                two = equal[1:] & equal[:-1]
                four = two[2:] & two[:-2]
                self.stuck = bool((four[3:] & four[:-3]).any())


@dataclass
class Scan:
    """All that `check_log` judges. `segments` holds (run, samples) in the order of `Trace.parts`."""

    traces: dict[str, Trace]
    clock: Clock | None
    segments: list[tuple[int, int]] = field(default_factory=list)
    rows: int = 0

    @property
    def samples(self) -> dict[int, int]:
        """Number of samples of each run, in order."""
        counts: dict[int, int] = {}
        for run, n in self.segments:
            counts[run] = counts.get(run, 0) + n
        return counts

    @cached_property
    def starts(self) -> Array:
        """The first segment of each run, at the end of the pass."""
        runs = np.array([run for run, _ in self.segments])
        return np.flatnonzero(np.r_[True, runs[1:] != runs[:-1]]) if len(runs) else np.empty(0, int)

    def spans(self) -> Spans:
        """Return extents overall and per run; a column with NaN or infinity has none."""
        counts = np.array([n for _, n in self.segments], float)
        overall, by_run = {}, {}
        for name, trace in self.traces.items():
            if trace.nonfinite or not trace.parts:
                continue
            table = np.concatenate(trace.parts)
            whole, by_run[name] = (
                _extents(table, counts, trace.pivot or 0.0, starts) for starts in ([0], self.starts)
            )
            overall[name] = Span(*whole[:, 0].tolist())
        return Spans(overall, by_run, self.samples)


def scan(log: Log, columns: Sequence[str]) -> Scan:
    """Read the columns once and return the results of the pass."""
    clock = Clock() if "t_s" in columns else None
    own = tuple(name for name in columns if name != RUN)
    result = Scan({name: Trace() for name in own}, clock)
    order = RunOrder(log.name)
    wholes = log.table.pieces((RUN, *own), CHUNK_ROWS)
    for piece in (part for whole in wholes for part in _parts(whole)):
        found = order.segments(piece[RUN])
        starts = np.array([start for _, start, _ in found], int)
        result.segments += [(run, stop - start) for run, start, stop in found]
        for name, trace in result.traces.items() if found else ():
            trace.add(name, piece[name], starts, result.rows)
        if clock is not None:
            clock.add(piece["t_s"], found, result.rows)
        result.rows += len(piece[RUN])
    return result


def _parts(piece: Piece) -> Iterator[Piece]:
    """Yield a piece of any length in parts that stay in the cache while they are looked at."""
    for low in range(0, len(piece[RUN]), CHUNK_ROWS):
        yield {name: values[low : low + CHUNK_ROWS] for name, values in piece.items()}


def _extents(table: Array, counts: Array, pivot: float, starts: Sequence[int] | Array) -> Array:
    """Return least, greatest, mean and standard deviation of stretches, (4, stretches)."""
    n = np.add.reduceat(counts, starts)
    low, high = np.minimum.reduceat(table[:, 0], starts), np.maximum.reduceat(table[:, 1], starts)
    mean = np.add.reduceat(table[:, 2], starts) / n
    variance = np.maximum(np.add.reduceat(table[:, 3], starts) / n - mean**2, 0.0)
    return np.array([low, high, mean + pivot, np.where(high > low, np.sqrt(variance), 0.0)])


_LATE = 1.8  # a step longer than this many ticks means that samples are missing
_MOST_MISSING = 2.0**53  # what a clock that jumps to 1e308 s is said to miss


@dataclass
class Clock:
    """Counts of faults and where the first of each is (row, counted from 0, and run).

    `tick` is the usual step in s, the median of the last stretch of a run that was seen.
    """

    backward: int = 0
    first_backward: tuple[int, int, float, float] | None = None
    missing: int = 0
    first_missing: tuple[int, int, float, float] | None = None
    steps: int = 0
    tick: float = 0.0
    _run: int | None = None
    _last: float = np.nan

    def add(self, t: Array, segments: list[tuple[int, int, int]], row: int) -> None:
        """Take a piece of the time column, with its (run, start, stop) stretches and the row it begins at."""
        step = np.diff(t, prepend=self._last)
        for run, start, stop in segments:
            first = start + (run != self._run or start > 0)  # what lies between two runs is no step
            if first < stop:
                self._judge(step[first:stop], t[first:stop], run, row + first)
            self._run = run
        self._last = float(t[-1]) if len(t) else self._last

    def _judge(self, step: Array, t: Array, run: int, row: int) -> None:
        low, high = float(step.min()), float(step.max())
        if not -np.inf < low <= high < np.inf:
            return  # not finite: reported as such
        self.steps += len(step)
        self.tick = float(step[0])
        if low > 0 and high <= _LATE * low:  # as nearly always
            return
        if low <= 0:
            wrong = np.flatnonzero(step <= 0)
            i, self.backward = int(wrong[0]), self.backward + len(wrong)
            self.first_backward = self.first_backward or (row + i, run, float(t[i]), float(step[i]))
        self.tick = float(np.median(step[step > 0])) if high > 0 else 0.0
        late = np.flatnonzero(step > _LATE * self.tick) if high > 0 else np.empty(0, int)
        if len(late):
            self.missing += int(min((np.round(step[late] / self.tick) - 1).sum(), _MOST_MISSING))
            i = int(late[0])
            self.first_missing = self.first_missing or (row + i, run, float(t[i] - step[i]), float(step[i]))


_ROUGH = 0.5
"""Spread of sixth over that of fourth differences, each for unit white noise, from which a column is noisy: 1
for white noise, 0.75 for noise that is correlated over many samples, below 0.05 for motion."""
_OF_A_CODE = 2.0
"""Standard deviation of noise, in codes of the converter, from which it is more than rounding: that has 0.29,
and up to 1.4 in these differences where it alternates."""
_ARITHMETIC = 1e-13
"""Differences over the largest value that are due to rounding of floating-point numbers alone."""
_SMALLEST = 0.005
"""Quantile of differences that is one code: they are whole numbers of codes, whatever the motion; codes of a
converter may lie unevenly."""
_CHANCE_EQUAL = 0.01
"""Share of equal neighbours that is not suspicious."""
_MORE = 3.0
"""Equal neighbours over those by chance from which it is no noise: an axis that goes from rest to rest."""
_FEWEST = 16


def stretches(mask: Array, shortest: int = 2) -> list[tuple[int, int]]:
    """Return (start, stop) of the stretches of at least `shortest` True in a boolean array."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(np.int8)))
    return [
        (a, b) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True) if b - a >= shortest
    ]


def is_noisy(x: Array) -> bool:
    """Return whether samples (n,) carry noise beyond their rounding, so that no two recordings are equal."""
    return noise_in_codes(x) > 0.0


def noise_in_codes(x: Array) -> float:
    """Return the noise of samples (n,), one sigma, in codes of their converter; 0 if it is only rounding."""
    if len(x) < _FEWEST:
        return 0.0
    fourth = np.diff(x, 4)
    spread = _spread(fourth, 4)
    if not _spread(np.diff(fourth, 2), 6) > _ROUGH * spread:
        return 0.0
    whole = np.abs(fourth)
    whole = whole[whole > _ARITHMETIC * np.abs(x).max()]
    codes = spread / float(np.quantile(whole, _SMALLEST)) if len(whole) else 0.0
    return codes if codes > _OF_A_CODE and by_chance(np.abs(np.diff(x)), codes) else 0.0


def by_chance(steps: Array, codes: float) -> bool:
    """Say whether steps are zero no more often than noise of so many codes makes them."""
    return not len(steps) or bool(np.mean(steps == 0) < _MORE * equal_by_chance(codes) + _CHANCE_EQUAL)


def equal_by_chance(codes: float) -> float:
    """Return how often noise of so many codes, one sigma, repeats a code: 1 / (2 sqrt(pi) codes)."""
    return min(0.5, 1.0 / (2.0 * np.sqrt(np.pi) * codes))


def _spread(difference: Array, order: int) -> float:
    """Standard deviation of white noise with such differences; a few outliers do not count."""
    return float(np.median(np.abs(difference))) / (0.67449 * np.sqrt(comb(2 * order, order)))
