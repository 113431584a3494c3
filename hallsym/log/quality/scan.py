"""One pass over a log: extent, mean and spread of every column and run, and the traces that faults leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hallsym.log.columns import RUN
from hallsym.log.core import Log, RunOrder
from hallsym.log.limits import is_moving, is_reading
from hallsym.log.quality.clock import Clock
from hallsym.log.table import CHUNK_ROWS, Piece
from hallsym.units import Array

ENOUGH = 8192
"""Samples that are kept at least where a log has them; at most twice as many. 0.5 % of them are 40."""
WHOLE_ROWS = 2_000_000
"""Samples up to which a second look reads whole columns."""


class Sample:
    """Every n-th sample of a log, n a power of two that grows along the pass."""

    def __init__(self, columns: Sequence[str]) -> None:
        """Keep samples of `columns`."""
        self.columns = tuple(columns)
        self.stride = 1
        self._parts: list[tuple[Array, Array, Array]] = []
        self._count = 0

    def add(self, piece: Piece, row: int) -> None:
        """Take a piece that begins at `row` of the log."""
        here = slice(-row % self.stride, None, self.stride)
        rows = np.arange(row + here.start, row + len(piece[RUN]), self.stride)
        values = np.array([piece[name][here] for name in self.columns]).reshape(len(self.columns), len(rows))
        self._parts.append((rows, piece[RUN][here].copy(), values))  # a view would keep the whole piece
        self._count += len(rows)
        while self._count > 2 * ENOUGH:
            self._thin()

    def _thin(self) -> None:
        self.stride *= 2
        kept = [(part, part[0] % self.stride == 0) for part in self._parts]
        self._parts = [(rows[keep], run[keep], values[:, keep]) for (rows, run, values), keep in kept]
        self._count = sum(len(part[0]) for part in self._parts)

    @cached_property
    def whole(self) -> Whole:
        """The kept samples, at the end of the pass."""
        _, run, values = (np.concatenate(parts, axis=-1) for parts in zip(*self._parts, strict=True))
        return Whole(run, dict(zip(self.columns, values, strict=True)))


@dataclass(frozen=True, eq=False)
class Whole:
    """Columns of a log side by side, or those of its thinned copy: `run` and `data[column]`, (n,) each."""

    run: Array
    data: dict[str, Array]

    @cached_property
    def _ordered(self) -> dict[str, Array]:
        return {}

    def ordered(self, name: str) -> Array:
        """Return the samples of a column by size, (n,)."""
        if name not in self._ordered:
            self._ordered[name] = np.sort(self.data[name])
        return self._ordered[name]

    @staticmethod
    def of(log: Log, columns: Sequence[str]) -> Whole:
        """Read whole columns of a log, of its first `WHOLE_ROWS` samples at most."""
        parts: list[dict[str, Array]] = []
        count = 0
        for block in log.blocks((RUN, *columns)):
            parts.append(block.data)
            count += len(block.data[RUN])
            if count >= WHOLE_ROWS:
                break
        data = {name: np.concatenate([part[name] for part in parts]) for name in (RUN, *columns)}
        return Whole(data.pop(RUN).astype(np.int64), data)


HELD_SAMPLES = 8
_CACHE_ROWS = 32_768


@dataclass(frozen=True)
class Span:
    """Extent of one column: least, greatest, mean and standard deviation (population), in its SI unit."""

    min: float
    max: float
    mean: float
    std: float


@dataclass(frozen=True, eq=False)
class Spans:
    """Extents of every column: `overall["z_m"]`, and per run `runs[3]["z_m"]`; `samples[3]` counts rows."""

    overall: dict[str, Span]
    runs: dict[int, dict[str, Span]]
    samples: dict[int, int]


@dataclass
class Trace:
    """What one pass saw of one column.

    `parts` holds arrays (segments, 4): min, max, sum, sum of squares; `sums` arrays (segments,) of what the
    samples' bits come to, whatever pieces they came in: equal for runs that hold the same samples.
    """

    pivot: float | None = None
    parts: list[Array] = field(default_factory=list)
    sums: list[Array] = field(default_factory=list)
    nonfinite: int = 0
    first_nonfinite: int = -1
    repeats: int = 0
    held: bool = False
    low: float = np.inf
    high: float = -np.inf
    at_low: int = 0
    at_high: int = 0

    def statistics(self, values: Array, starts: Array, scratch: Array) -> bool:
        """Add extents and moments of the segments from `starts` on; return False if one is not finite."""
        if self.pivot is None:
            self.pivot = float(values[0])
        part = np.empty((len(starts), 4))
        np.minimum.reduceat(values, starts, out=part[:, 0])
        np.maximum.reduceat(values, starts, out=part[:, 1])
        if not np.isfinite(part[:, :2]).all():
            return False
        shifted = np.subtract(values, self.pivot, out=scratch[: len(values)])
        np.add.reduceat(shifted, starts, out=part[:, 2])
        np.add.reduceat(np.square(shifted, out=shifted), starts, out=part[:, 3])
        self.parts.append(part)
        return True

    def extremes(self, values: Array) -> None:
        """Count the samples that sit exactly at the least and at the greatest value so far."""
        low, high = self.parts[-1][:, 0].min(), self.parts[-1][:, 1].max()
        if low <= self.low:
            self.at_low = int(np.count_nonzero(values == low)) + (self.at_low if low == self.low else 0)
            self.low = low
        if high >= self.high:
            self.at_high = int(np.count_nonzero(values == high)) + (self.at_high if high == self.high else 0)
            self.high = high

    def repeated(self, values: Array) -> None:
        """Count samples equal to the one before, and look for `HELD_SAMPLES` equal ones in a row."""
        equal = values[1:] == values[:-1]
        self.repeats += int(np.count_nonzero(equal))
        if not self.held and len(equal) >= HELD_SAMPLES:
            two = equal[1:] & equal[:-1]
            four = two[2:] & two[:-2]
            self.held = bool((four[3:] & four[:-3]).any())

    def summed(self, values: Array, starts: Array, places: Array) -> None:
        """Sum the bits of the samples times their `places` in the run, which is exact in any order."""
        self.sums.append(np.add.reduceat(values.view(np.uint64) * places, starts))

    def bad(self, values: Array, row: int) -> None:
        """Count NaN and infinity."""
        wrong = ~np.isfinite(values)
        if self.nonfinite == 0:
            self.first_nonfinite = row + int(np.argmax(wrong))
        self.nonfinite += int(np.count_nonzero(wrong))


@dataclass
class Scan:
    """All that `check_log` judges. `segments` holds (run, samples) in the order of `Trace.parts`."""

    traces: dict[str, Trace]
    clock: Clock | None
    sample: Sample
    segments: list[tuple[int, int]] = field(default_factory=list)
    rows: int = 0

    @property
    def samples(self) -> dict[int, int]:
        """Number of samples of each run, in order."""
        counts: dict[int, int] = {}
        for run, n in self.segments:
            counts[run] = counts.get(run, 0) + n
        return counts

    def bit_sums(self, column: str) -> list[int]:
        """Return what the bits of a column come to in each run, modulo 2^64; [] where it is not finite."""
        trace = self.traces[column]
        if trace.nonfinite or not trace.sums:
            return []
        return np.add.reduceat(np.concatenate(trace.sums), self.starts).tolist()

    @cached_property
    def starts(self) -> Array:
        """The first segment of each run, at the end of the pass."""
        runs = np.array([run for run, _ in self.segments])
        return np.flatnonzero(np.r_[True, runs[1:] != runs[:-1]]) if len(runs) else np.empty(0, int)

    def run_of(self, row: int) -> int:
        """Return the run that a row belongs to."""
        ends = np.cumsum([n for _, n in self.segments])
        return self.segments[int(np.searchsorted(ends, row, side="right"))][0]

    def spans(self) -> Spans:
        """Return extents overall and per run; a column with NaN or infinity has none."""
        runs = np.array([run for run, _ in self.segments])
        counts = np.array([n for _, n in self.segments], float)
        starts = self.starts
        overall: dict[str, Span] = {}
        per_run: dict[int, dict[str, Span]] = {int(run): {} for run in runs[starts]}
        for name, trace in self.traces.items():
            if trace.nonfinite or not trace.parts:
                continue
            table = np.concatenate(trace.parts)
            overall[name] = _span(table, counts, trace.pivot or 0.0, np.array([0]))[0]
            for run, span in zip(
                per_run.values(), _span(table, counts, trace.pivot or 0.0, starts), strict=True
            ):
                run[name] = span
        return Spans(overall, per_run, self.samples)


def scan(log: Log, columns: Sequence[str]) -> Scan:
    """Read the columns once and return what was seen; `run` and `t_s` are included where the log has them."""
    clock = Clock() if "t_s" in log.columns and "t_s" in columns else None
    own = tuple(name for name in columns if name != RUN)
    moving = tuple(filter(is_moving, own))
    result = Scan({name: Trace() for name in own}, clock, Sample(moving))
    order = RunOrder(log.name)
    scratch = np.empty(_CACHE_ROWS)
    for piece in _small_pieces(log, columns):
        found = order.segments(piece[RUN])
        starts = np.array([start for _, start, _ in found])
        places = _places(found, result.segments)
        result.segments += [(run, stop - start) for run, start, stop in found]
        for name, trace in result.traces.items():
            _observe(name, trace, piece[name], starts, places, result.rows, scratch)
        if clock is not None:
            clock.add(piece["t_s"], found, result.rows)
        result.sample.add(piece, result.rows)
        result.rows += len(piece[RUN])
    return result


def _places(found: list[tuple[int, int, int]], before: list[tuple[int, int]]) -> Array:
    """Return the places of a piece's samples in their runs as odd numbers; `before`: segments so far."""
    first = 0
    for run, n in reversed(before):
        if run != found[0][0]:
            break
        first += n
    parts = [np.arange(stop - start, dtype=np.uint64) for _, start, stop in found]
    parts[0] = parts[0] + np.uint64(first)
    return np.uint64(2) * np.concatenate(parts) + np.uint64(1)


def _observe(
    name: str, trace: Trace, values: Array, starts: Array, places: Array, row: int, scratch: Array
) -> None:
    if not trace.statistics(values, starts, scratch):
        trace.bad(values, row)
        return
    if is_reading(name):
        trace.extremes(values)
    if is_moving(name):
        trace.repeated(values)
        trace.summed(values, starts, places)


def _small_pieces(log: Log, columns: Sequence[str]) -> Iterator[Piece]:
    """Yield pieces that fit the processor's cache."""
    asked = tuple(dict.fromkeys((RUN, *columns)))
    for piece in log.table.pieces(asked, CHUNK_ROWS):
        for lo in range(0, len(piece[RUN]), _CACHE_ROWS):
            yield {name: values[lo : lo + _CACHE_ROWS] for name, values in piece.items()}


def _span(table: Array, counts: Array, pivot: float, starts: Array) -> list[Span]:
    n = np.add.reduceat(counts, starts)
    low, high = np.minimum.reduceat(table[:, 0], starts), np.maximum.reduceat(table[:, 1], starts)
    mean = np.add.reduceat(table[:, 2], starts) / n
    variance = np.maximum(np.add.reduceat(table[:, 3], starts) / n - mean**2, 0.0)
    std = np.where(high > low, np.sqrt(variance), 0.0)
    rows = zip(low.tolist(), high.tolist(), (mean + pivot).tolist(), std.tolist(), strict=True)
    return [Span(*row) for row in rows]
