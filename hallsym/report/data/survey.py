"""Series of a log of any length, and groups of its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hallsym.estimation import Fit
from hallsym.estimation.decoding import ErrorTable
from hallsym.log import Log, spans
from hallsym.report.words import LEVEL, name, setting
from hallsym.units import readable, typeset

# -- a series of any length: least and greatest value per picture column ---------------------------------


COLUMNS = 1000
"""A long trace is drawn with this many to twice this many min-max columns, a shorter one sample by sample."""


class Trace:
    """Least and greatest value of several series per column of a picture, gathered block by block.

    `low`, `high`: (series, columns), nan where no sample was kept; a column holds `width` samples. When the
    columns are used up, neighbours are merged, so a trace never holds more than 2 x `COLUMNS`.
    """

    def __init__(self, series: int) -> None:
        """Start a trace of `series` series."""
        self.count, self.width = 0, 1
        shape = (series, 2 * COLUMNS)
        self._low, self._high = np.full(shape, np.nan), np.full(shape, np.nan)

    def add(self, values: np.ndarray) -> None:
        """Append samples, shape (series, samples); nan marks what is left out."""
        n = values.shape[1]
        while self.count + n > self.width * 2 * COLUMNS:
            for array, join in ((self._low, np.fmin), (self._high, np.fmax)):
                array[:, :COLUMNS] = join(array[:, ::2], array[:, 1::2])
                array[:, COLUMNS:] = np.nan
            self.width *= 2
        column = (self.count + np.arange(n)) // self.width
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        at = slice(int(column[0]), int(column[-1]) + 1)
        self._low[:, at] = np.fmin(self._low[:, at], np.fmin.reduceat(values, starts, axis=1))
        self._high[:, at] = np.fmax(self._high[:, at], np.fmax.reduceat(values, starts, axis=1))
        self.count += n

    @property
    def low(self) -> np.ndarray:
        """Least value per column, shape (series, columns)."""
        return self._low[:, : -(-self.count // self.width)]

    @property
    def high(self) -> np.ndarray:
        """Greatest value per column, shape (series, columns)."""
        return self._high[:, : -(-self.count // self.width)]

    @property
    def samples(self) -> np.ndarray:
        """Sample number in the middle of each column."""
        return (np.arange(self.low.shape[1]) + 0.5) * self.width - 0.5


# -- groups of runs --------------------------------------------------------------------------------------


MOST_GROUPS = 60
"""More vertical settings are shown run by run; of more runs neighbours are taken together."""

Group = tuple[str, list[int]]
"""Label and runs."""


def held_out(fit: Fit) -> tuple[int, ...]:
    """Return the holdout runs, also of a fit that was read back."""
    return fit.errors.holdout if fit.errors else fit.log.holdout


def worst_first(table: ErrorTable, floor: Mapping[str, float], most: int) -> list[int]:
    """Return up to `most` runs, that with the largest error first: rms of an output over its noise floor.

    An output without a noise floor counts against its own rms over all runs.
    """
    over = table.over()
    if over is None:
        return list(table.runs[:most])
    usual = np.array([floor.get(c) or over["rmse"][c] or 1.0 for c in table.pose])
    size = np.sqrt(table.squares / np.maximum(table.count, 1.0)[:, None]) / usual
    order = np.argsort(-size.max(axis=1), kind="stable")
    return [table.runs[k] for k in order[:most]]


def by_run(runs: Sequence[int]) -> list[Group]:
    """Return the runs, each a group; of many runs neighbours are one group."""
    per = -(-len(runs) // MOST_GROUPS)
    parts = [list(runs[k : k + per]) for k in range(0, len(runs), per)]
    return [(f"{p[0]}" if len(p) == 1 else f"{p[0]}\N{EN DASH}{p[-1]}", p) for p in parts]


def settings(fit: Fit, log: Log) -> tuple[list[Group], str]:
    """Return `[(label, runs)]` by vertical setting and the axis title; `by_run` without settings.

    Settings are of the states that a campaign can set. Runs belong to one setting when their mean states
    agree within 2 % of what the campaign covers. A state that moves within runs, or never changes, makes no
    settings.
    """
    columns, periodic = [c for c in fit.model.state if c in fit.model.family.axes], fit.model.period
    if not columns or len(log.runs) < 2:
        return by_run(log.runs), "run"
    seen = spans(log, columns)
    state, drift = (np.array([of(c) for c in columns]).T for of in (lambda c: seen.by_run[c][2], seen.covers))
    spread = np.ptp(state, axis=0)
    near = np.maximum(0.02 * spread, LEVEL)
    if np.all(spread < LEVEL) or np.any(np.median(drift, axis=0) > np.maximum(0.1 * spread, 2 * LEVEL)):
        return by_run(log.runs), "run"
    centres: list[np.ndarray] = []
    members: list[list[int]] = []
    for run, point in zip(log.runs, state, strict=True):
        match = [k for k, c in enumerate(centres) if np.all(np.abs(point - c) <= near)]
        if match:
            members[match[0]].append(run)
        else:
            centres.append(point)
            members.append([run])
        if len(centres) > MOST_GROUPS:
            return by_run(log.runs), "run"

    def place(k: int) -> tuple:
        moved = np.abs(centres[k]) > near
        return (int(moved.sum()), tuple(~moved), tuple(np.where(moved, centres[k], 0.0)))

    order = sorted(range(len(centres)), key=place)
    groups = [(setting(columns, centres[k], near, periodic), members[k]) for k in order]
    by_unit: dict[str, list[str]] = {}
    for column in columns:
        by_unit.setdefault(typeset(readable(column, periodic)[1]), []).append(name(column))
    units = "; ".join(f"{', '.join(names)} in {unit}" for unit, names in by_unit.items())
    return groups, f"vertical setting ({units})"
