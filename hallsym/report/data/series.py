"""Errors of one run over time, reduced to what a picture shows."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.report.data.trace import Trace


@dataclass(frozen=True, eq=False)
class RunSeries:
    """Errors of one run: least and greatest value per column of the picture, in SI.

    `time`: (columns,) in s from the run's start, or sample numbers if not `timed`. `lines`: name ->
    (low, high), each (n_pose, columns), nan where there is nothing. `per_column`: samples in a column.
    `turning`: coordinates that go round, see `hallsym.units.readable`.
    """

    title: str
    pose: tuple[str, ...]
    time: np.ndarray
    lines: Mapping[str, tuple[np.ndarray, np.ndarray]]
    timed: bool = True
    per_column: int = 1
    turning: Collection[str] | None = None

    def reduced(self, columns: int) -> RunSeries:
        """Return the series with at most so many columns: neighbours are taken together."""
        per = -(-len(self.time) // columns)
        if per == 1:
            return self
        starts = np.arange(0, len(self.time), per)
        lines = {
            line: (np.fmin.reduceat(low, starts, axis=1), np.fmax.reduceat(high, starts, axis=1))
            for line, (low, high) in self.lines.items()
        }
        time = np.array([self.time[a : a + per].mean() for a in starts])
        return replace(self, time=time, lines=lines, per_column=per * self.per_column)


def run_series(
    title: str, pose: Sequence[str], time: np.ndarray | None, errors: Mapping[str, np.ndarray]
) -> RunSeries:
    """Reduce one run's errors, name -> (n_pose, samples) in SI, to what a picture shows; `time` in s."""
    traces = {}
    for name, values in errors.items():
        traces[name] = Trace(1 + len(pose))
        traces[name].add(np.vstack([np.zeros(values.shape[1]) if time is None else time, values]))
    return series_of(title, tuple(pose), traces, timed=time is not None)


def series_of(
    title: str,
    pose: tuple[str, ...],
    traces: Mapping[str, Trace],
    *,
    timed: bool,
    turning: Collection[str] | None = None,
) -> RunSeries:
    """Return the series of traces by name; each holds time and the errors of every coordinate."""
    first = next(iter(traces.values()))
    time = 0.5 * (first.low[0] + first.high[0]) - first.low[0][0] if timed else first.samples
    lines = {line: (trace.low[1:], trace.high[1:]) for line, trace in traces.items()}
    return RunSeries(title, pose, time, lines, timed, first.width, turning)
