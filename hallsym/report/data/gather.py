"""What a page shows of the errors of a log: tables, maps, and series of a few runs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import Fit
from hallsym.estimation.decoding import ErrorTable
from hallsym.estimation.prediction import Decoded, decoded
from hallsym.log import Block, Log, spans
from hallsym.log.batches import Weigh
from hallsym.report.words import LEVEL, name, scale, setting
from hallsym.units import readable, si_unit, typeset

if TYPE_CHECKING:
    from hallsym.diagnosis import Base


# -- mean and rms of errors in cells of a coordinate -----------------------------------------------------


@dataclass(frozen=True, eq=False)
class Cells:
    """Errors of the decoded pose by cell, in SI.

    `by`: what the cells are along, with the unit of `edges` (cells + 1,). `mean`, `rms`: (n_pose, cells), nan
    in an empty cell; `count`: (cells,). Over two coordinates `across` holds the edges of the second, `up` its
    name, and cell `i + columns * j` lies at column i, row j. `periodic`: coordinates that go round, see
    `hallsym.units.readable`.
    """

    by: str
    pose: tuple[str, ...]
    count: np.ndarray
    mean: np.ndarray
    rms: np.ndarray
    edges: Sequence[float] | np.ndarray
    up: str = ""
    across: Sequence[float] | np.ndarray = ()
    periodic: Collection[str] | None = None


class Tally:
    """Sums of each series in each cell; memory is (series, cells)."""

    def __init__(self, series: int, cells: int) -> None:
        """Start a tally."""
        self.count = np.zeros(cells, dtype=np.int64)
        self.sums, self.squares = np.zeros((2, series, cells))

    def add(self, cell: np.ndarray, errors: np.ndarray) -> None:
        """Add samples: `cell` (samples,), negative for none of the cells; `errors` (series, samples).

        An error that is nan takes no part.
        """
        inside = (cell >= 0) & np.isfinite(errors).all(axis=0)
        cell, errors, most = cell[inside], errors[:, inside], len(self.count)
        self.count += np.bincount(cell, minlength=most)
        self.sums += [np.bincount(cell, weights=error, minlength=most) for error in errors]
        self.squares += [np.bincount(cell, weights=error**2, minlength=most) for error in errors]

    @property
    def mean(self) -> np.ndarray:
        """Mean, (series, cells); nan in an empty cell."""
        return self.sums / np.where(self.count > 0, self.count, np.nan)

    @property
    def rms(self) -> np.ndarray:
        """Root mean square, (series, cells); nan in an empty cell."""
        return np.sqrt(self.squares / np.where(self.count > 0, self.count, np.nan))


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


# -- errors of one run over time, reduced to what a picture shows ----------------------------------------


@dataclass(frozen=True, eq=False)
class RunSeries:
    """Errors of one run: least and greatest value per column of the picture, in SI.

    `time`: (columns,) in s from the run's start, or sample numbers if not `timed`. `lines`: name ->
    (low, high), each (n_pose, columns), nan where there is nothing. `per_column`: samples in a column.
    `periodic`: coordinates that go round, see `hallsym.units.readable`.
    """

    title: str
    pose: tuple[str, ...]
    time: np.ndarray
    lines: Mapping[str, tuple[np.ndarray, np.ndarray]]
    timed: bool = True
    per_column: int = 1
    periodic: Collection[str] | None = None


def series_of(
    title: str, pose: tuple[str, ...], traces: Mapping[str, Trace], *, timed: bool,
    periodic: Collection[str] | None = None,
) -> RunSeries:  # fmt: skip
    """Return the series of traces by name; each holds time and the errors of every coordinate."""
    first = next(iter(traces.values()))
    time = 0.5 * (first.low[0] + first.high[0]) - first.low[0][0] if timed else first.samples
    lines = {line: (trace.low[1:], trace.high[1:]) for line, trace in traces.items()}
    return RunSeries(title, pose, time, lines, timed, first.width, periodic)


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


# -- one pass: maps over the coordinates that matter, and series -----------------------------------------


ALONG, PLANE = 15, 11
"""Cells along a coordinate, and along each side of a map.

Odd, so that an axis at rest in the middle of its travel lies inside a cell: on an edge, the noise of its own
reference would decide the cell, and each side would show a mean that is not there.
"""

RUNS = 20
"""Runs that have a series, those with the largest errors."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """What a page shows of a log, by version of the model: `tables` of the errors by run, `maps`, series.

    `maps`: over the first two coordinates that move, and along each. `series`: worst first. `groups`: of the
    runs, by what they share.
    """

    tables: Mapping[str, ErrorTable]
    maps: Mapping[str, tuple[Cells, ...]]
    series: tuple[RunSeries, ...]
    groups: Mapping[str, list[Group]]


_Map = tuple[Callable[..., Cells], int, Callable[[Block], np.ndarray]]
"""What makes cells of `count`, `mean` and `rms`; how many they are; the cell of each sample of a block."""


def diagnosed(base: Base) -> Decoded:
    """Return the log decoded by a model with the effects that a diagnosis found: "after"."""
    version = base.p, base.offsets, np.diag(base.covariance)
    return Decoded(base.log, base.model, {"after": version}, base.sigma, base.p, base.keep)


def gather(
    log: Log, fit: Fit, *, label: str = "decoded", keep: Weigh | None = None,
    nominal: bool = False, after: Base | None = None,
) -> Gathered:  # fmt: skip
    """Read `log` twice, in blocks, for maps and series of the errors of a fit, which is called `label`.

    `nominal`: also of the nominal parameters, before it. `after`: also of a model with the effects that a
    diagnosis found.

    Channels of the log are those of the model (`as_read`). Samples to which `keep` gives weight 0 (outliers)
    take no part and interrupt the series.
    """
    versions = [decoded(log, fit, keep, label=label, nominal=nominal)]
    versions += [] if after is None else [diagnosed(after)]
    tables = {name: table for one in versions for name, table in one.tables().items()}
    chosen, timed = worst_first(tables[label], fit.noise_floor, RUNS), "t_s" in log.columns
    groups, by = settings(fit, log)
    places = _maps(fit, tables[label].span, states=by == "run")
    maps, traces = {}, {}
    for one in versions:
        tallies = [[Tally(len(one.model.pose), cells) for _, cells, _ in places] for _ in one.versions]
        found = [{run: Trace(1 + len(one.model.pose)) for run in chosen} for _ in one.versions]
        for block, each in one.blocks(*(["t_s"] if timed else [])):
            for errors, own, series in zip(each, tallies, found, strict=True):
                for (_, _, place), tally in zip(places, own, strict=True):
                    tally.add(place(block), errors)
                if block.run in series:
                    time = block.data["t_s"] if timed else np.zeros(errors.shape[1])
                    series[block.run].add(np.vstack([time, errors]))
        for name_, own, series in zip(one.versions, tallies, found, strict=True):
            pairs = zip(places, own, strict=True)
            maps[name_] = tuple(made(count=t.count, mean=t.mean, rms=t.rms) for (made, *_), t in pairs)
            traces[name_] = series
    shown = tuple(
        series_of(
            f"run {run}{', holdout' if run in held_out(fit) else ''}", fit.model.pose,
            {key: own[run] for key, own in traces.items()}, timed=timed, periodic=fit.model.period,
        )
        for run in chosen
    )  # fmt: skip
    both = {title: own for own, title in ((groups, by), (by_run(log.runs), "run")) if len(own) > 1}
    return Gathered(tables, maps, shown, both)


def _maps(fit: Fit, reach: Mapping[str, tuple[float, float]], *, states: bool) -> list[_Map]:
    """Return maps over two coordinates, along each output, and along each state if that is asked.

    `reach`: least and greatest value by column.
    """
    model = fit.model
    made = {c.name for c in model.computed}
    moved = [c for c, (low, high) in reach.items() if high - low > LEVEL and c not in made]
    poses = [c for c in model.references if c in moved]
    axes = {c: _Axis.of(c, reach[c], fit) for c in moved}
    lengths = [c for c in poses if si_unit(c) == "m"]
    ordered = [*lengths, *(c for c in moved if c not in lengths)]
    maps = [_plane(axes[ordered[0]], axes[ordered[1]], fit)] if len(ordered) > 1 else []
    maps += [_along(axes[c], fit) for c in poses]
    if states:
        maps += [_along(axes[c], fit) for c in model.state if c in moved]
    return maps


def _cells(by: str, fit: Fit, **more: Any) -> Callable[..., Cells]:
    return partial(Cells, by, fit.model.pose, periodic=fit.model.period, **more)


@dataclass(frozen=True, eq=False)
class _Axis:
    """A coordinate that moves: label with unit, factor to it, reach [SI], and turn if it goes round."""

    column: str
    label: str
    factor: float
    low: float
    high: float
    turn: float | None

    @staticmethod
    def of(column: str, reach: tuple[float, float], fit: Fit) -> _Axis:
        turn = fit.model.period.get(column, np.inf)
        goes_round = bool(reach[1] - reach[0] > turn)  # one map of all turns
        low, high = (0.0, float(turn)) if goes_round else (float(v) for v in reach)
        factor, unit = scale(column, max(abs(low), abs(high)), fit.model.period)
        label = f"{name(column.replace('_ref_', '_'))} [{unit}]"
        return _Axis(column, label, factor, low, high, turn if goes_round else None)

    def edges(self, cells: int) -> np.ndarray:
        """Return the edges of equally wide cells, (cells + 1,)."""
        return np.linspace(self.low, self.high, cells + 1)

    def place(self, block: Block, cells: int) -> np.ndarray:
        """Return the cell of each sample."""
        values = block.data[self.column]
        values = values if self.turn is None else np.mod(values, self.turn)
        return np.clip(np.searchsorted(self.edges(cells), values, side="right") - 1, 0, cells - 1)


def _along(axis: _Axis, fit: Fit) -> _Map:
    made = _cells(axis.label, fit, edges=axis.factor * axis.edges(ALONG))
    return made, ALONG, lambda block: axis.place(block, ALONG)


def _plane(x: _Axis, y: _Axis, fit: Fit) -> _Map:
    sides = {"edges": x.factor * x.edges(PLANE), "up": y.label, "across": y.factor * y.edges(PLANE)}
    made = _cells(x.label, fit, **sides)
    return made, PLANE**2, lambda block: x.place(block, PLANE) + PLANE * y.place(block, PLANE)
