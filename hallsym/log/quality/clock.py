"""The time column along one pass: running backwards, standing still, and missing ticks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.quality.findings import Finding, the
from hallsym.units import Array

_MISSING_REFUSE = 0.02
"""Share of missing ticks from which a log is refused: below, a logger was late now and then."""

_LATE = 1.8  # a step longer than this many ticks means that samples are missing
_MOST_MISSING = 2.0**53  # what a clock that jumps to 1e308 s is said to miss


@dataclass
class Clock:
    """Counts of faults and where the first of each is (row, counted from 0, and run).

    `tick` is the run's usual step in s, the median of the first stretch of that run that was seen.
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
            if run == self._run:
                self._judge(step[start:stop], t[start:stop], run, row + start)
            else:
                self.tick = 0.0
                self._judge(step[start + 1 : stop], t[start + 1 : stop], run, row + start + 1)
            self._run = run
        self._last = float(t[-1]) if len(t) else self._last

    def _judge(self, step: Array, t: Array, run: int, row: int) -> None:
        if not len(step):
            return
        low, high = step.min(), step.max()
        if not np.isfinite([low, high]).all():
            return  # not finite: reported as such
        if low <= 0:
            self._backward(step, t, run, row)
        self.steps += len(step)
        if self.tick > 0 and high <= _LATE * self.tick:
            return
        if self.tick == 0 and low > 0 and high <= _LATE * low:
            self.tick = float(step[0])
            return
        self._late(step, t, run, row)

    def _backward(self, step: Array, t: Array, run: int, row: int) -> None:
        wrong = np.flatnonzero(step <= 0)
        self.backward += len(wrong)
        if self.first_backward is None:
            i = int(wrong[0])
            self.first_backward = (row + i, run, float(t[i]), float(step[i]))

    def _late(self, step: Array, t: Array, run: int, row: int) -> None:
        forward = step[step > 0]
        if self.tick == 0:
            self.tick = float(np.median(forward)) if len(forward) else 0.0
        late = np.flatnonzero(step > _LATE * self.tick) if self.tick else np.empty(0, int)
        if not len(late):
            return
        self.missing += int(min((np.round(step[late] / self.tick) - 1).sum(), _MOST_MISSING))
        if self.first_missing is None:
            i = int(late[0])
            self.first_missing = (row + i, run, float(t[i] - step[i]), float(step[i]))


def time(log: Log, clock: Clock) -> Iterator[Finding]:
    """Time that runs backwards or repeats."""
    if clock.first_backward:
        row, run, t, step = clock.first_backward
        how = "repeats" if step == 0 else "runs backwards"
        yield Finding(
            f"{the(log, 't_s')} must increase within a run; it {how} {clock.backward} times, first in row"
            f" {row + 1} (run {run}) at {t:.6g} s",
            True, Drop(forward=True), remedy="sort the samples by time or number the runs",
        )  # fmt: skip


def ticks(log: Log, clock: Clock) -> Iterator[Finding]:
    """Samples that are missing."""
    if clock.first_missing and not clock.first_backward:
        row, run, t, step = clock.first_missing
        share = clock.missing / max(1, clock.missing + clock.steps)
        refuse = share > _MISSING_REFUSE
        yield Finding(
            f"{the(log, 't_s')} misses {clock.missing} ticks ({share:.2%}), first after {t:.6g} s in row"
            f" {row + 1} (run {run}), a step of {step:.4g} s",
            refuse, bear=True, remedy="number the stretches around a pause as runs" if refuse else "",
        )  # fmt: skip
