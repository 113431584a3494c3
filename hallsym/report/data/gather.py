"""One more pass over a log: maps of the errors over the coordinates that matter, and series of a few runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import ErrorTable, Fit, columns_of
from hallsym.log import Block, Log, extended
from hallsym.log.batches import SIZE, Weigh
from hallsym.report.data.cells import Cells, Tally
from hallsym.report.data.decoded import decoded
from hallsym.report.data.residuals import Residuals, ResidualTally
from hallsym.report.data.series import RunSeries, series_of
from hallsym.report.data.survey import Group, Survey, held_out, look_over, settings, worst_first
from hallsym.report.data.trace import Trace
from hallsym.report.words import LEVEL, name, scale
from hallsym.units import si_unit

if TYPE_CHECKING:
    from hallsym.diagnosis import Base

ALONG, PLANE, MOST = 15, 11, 60
"""Cells along a coordinate, along each side of a map, and of runs (neighbours are taken together). As many
runs have a series, those with the largest errors.

Odd, so that an axis at rest in the middle of its travel lies inside a cell: on an edge, the noise of its own
reference would decide the cell, and each side would show a median that is not there.
"""

MOST_AXES = 6
"""Coordinates that are mapped over each other, two at a time: a rigid body has six."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """What a page shows of a log: `survey`, maps and series of the errors of decoded poses.

    `series`: worst run first. `residuals`: by version of the model. `after`: the same maps of another version
    of the model, cell by cell; empty without one.
    """

    survey: Survey
    maps: tuple[Cells, ...]
    series: tuple[RunSeries, ...]
    after: tuple[Cells, ...] = ()
    residuals: Mapping[str, Residuals] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Version:
    """Another version of a model on the same samples: `errors(block)` is (n_pose, samples), in SI.

    `log`: the same samples with all `columns` that `errors` reads. `keep`: samples that count, None for all.
    """

    name: str
    log: Log
    columns: tuple[str, ...]
    errors: Callable[[Block], np.ndarray]
    keep: Weigh | None = None

    def read(self, *, timed: bool) -> Iterator[tuple[Block, np.ndarray]]:
        """Yield each block with its errors, nan where a sample does not count."""
        columns = dict.fromkeys((*self.columns, *(("t_s",) if timed else ())))
        for block in self.log.blocks(tuple(columns), size=SIZE):
            errors = self.errors(block)
            yield block, errors if self.keep is None else np.where(self.keep(block) > 0, errors, np.nan)


def version_of(base: Base, label: str) -> Version:
    """Return a model of a diagnosis, without or with the effects found, as a version of the one diagnosed."""
    from hallsym.diagnosis import errors_of

    log = extended(base.log, base.model, base.sigma, base.values)
    return Version(label, log, columns_of(base.model), errors_of(base), base.keep)


@dataclass(frozen=True, eq=False)
class _Map:
    """Cells without numbers, how many they are, and which of them each sample of a block is in."""

    frame: Cells
    cells: int
    place: Callable[[Block], np.ndarray]


def compared(survey: Survey, fit: Fit, before: Version, after: Version) -> Survey:
    """Return a survey whose errors are those of one version of the model, then those of another."""
    (left, nominal), (right, fitted) = (_errors(survey, fit, version) for version in (before, after))
    return replace(survey, errors=(left, right), nominal=nominal, fitted=fitted)


def _errors(survey: Survey, fit: Fit, version: Version) -> tuple[Trace, ErrorTable]:
    n, at = len(fit.model.pose), {run: k for k, run in enumerate(survey.runs)}
    trace, count = Trace(n), np.zeros(len(at))
    squares, peak = np.zeros((len(at), n)), np.zeros((len(at), n))
    for block, errors in version.read(timed=False):
        trace.add(errors)
        k, kept = at[block.run], errors[:, np.isfinite(errors).all(axis=0)]
        count[k] += kept.shape[1]
        squares[k] += np.sum(kept**2, axis=1)
        peak[k] = np.maximum(peak[k], np.abs(kept).max(axis=1, initial=0.0))
    return trace, ErrorTable(fit.model.pose, survey.runs, count, squares, peak)


def gather(
    log: Log,
    fit: Fit,
    *,
    label: str = "decoded",
    keep: Weigh | None = None,
    most_runs: int = MOST,
    after: Version | None = None,
) -> Gathered:
    """Read `log` twice, in blocks, for maps and series of the errors of a fit, which is called `label`.

    `after`: a version of the model that is read once more, for the same maps and series.

    Channels of the log are those of the model (`as_read`). Samples to which `keep` gives weight 0 (outliers)
    take no part and interrupt the series.
    """
    survey = look_over(log, fit, keep)
    chosen, timed = worst_first(survey, fit.noise_floor, most_runs), survey.time is not None
    own = ((p.block, np.where(p.kept, p.fitted - p.reference, np.nan)) for p in decoded(log, fit, keep))
    passes = {label: own} | ({} if after is None else {after.name: after.read(timed=timed)})
    places = _maps(fit, survey)
    found = {key: _read(blocks, fit, survey, places, chosen) for key, blocks in passes.items()}
    series = tuple(
        series_of(
            f"run {run}{', held out' if run in held_out(fit) else ''}",
            fit.model.pose,
            {key: version.traces[run] for key, version in found.items()},
            timed=timed,
            turning=fit.model.period,
        )
        for run in chosen
    )
    return Gathered(
        survey,
        found[label].maps,
        series,
        found[after.name].maps if after else (),
        {key: version.residuals for key, version in found.items()},
    )


@dataclass(frozen=True, eq=False)
class _Read:
    """What one pass finds: maps, the traces of the chosen runs, and residuals of all runs."""

    maps: tuple[Cells, ...]
    traces: dict[int, Trace]
    residuals: Residuals


def _read(
    blocks: Iterator[tuple[Block, np.ndarray]],
    fit: Fit,
    survey: Survey,
    places: Sequence[_Map],
    chosen: Sequence[int],
) -> _Read:
    """Read the errors (n_pose, samples) of every block."""
    floor = np.array([fit.noise_floor.get(c) or 0.0 for c in fit.model.pose])
    fine = np.maximum(floor / 20, survey.fitted.peak.max(axis=0) / 1e4)
    tallies = [Tally(m.cells, fine) for m in places]
    traces = {run: Trace(1 + len(fine)) for run in chosen}
    residuals = ResidualTally(fit.model.pose, survey, floor, fit.model.period)
    for block, errors in blocks:
        at = tallies[0].bin_of(errors) if tallies else None
        for m, tally in zip(places, tallies, strict=True):
            tally.add(m.place(block), errors, at)
        time = block.data["t_s"] if survey.time is not None else np.zeros(errors.shape[1])
        residuals.add(time, errors)
        if block.run in traces:
            traces[block.run].add(np.vstack([time, errors]))
    filled = (
        replace(m.frame, count=t.count, median=t.median, rms=t.rms)
        for m, t in zip(places, tallies, strict=True)
    )
    return _Read(tuple(filled), traces, residuals.found())


def _maps(fit: Fit, survey: Survey) -> list[_Map]:
    """Return maps over every two coordinates, each output, the vertical settings or states, and runs."""
    model = fit.model
    reach = dict(zip((*model.references, *model.state), survey.reach, strict=True))
    made = {c.name for c in model.computed}
    moved = [c for c, (low, high) in reach.items() if high - low > LEVEL and c not in made]
    poses = [c for c in model.references if c in moved]
    axes = {c: _Axis.of(c, reach[c], fit) for c in moved}
    lengths = [c for c in poses if si_unit(c) == "m"]
    ordered = [*lengths, *(c for c in moved if c not in lengths)][:MOST_AXES]
    maps = [_plane(axes[a], axes[b], fit) for a, b in combinations(ordered, 2)]
    maps += [_along(axes[c], fit) for c in poses]
    groups, title = settings(fit, survey)
    if title == "run":
        maps += [_along(axes[c], fit) for c in model.state if c in moved]
    else:
        maps.append(_grouped(title, groups, fit))
    if len(survey.runs) > 1:
        maps.append(_grouped("run", _few_runs(survey.runs), fit, held_out(fit)))
    return maps


def _frame(by: str, fit: Fit, **more: Any) -> Cells:
    nothing = np.zeros(0)
    return Cells(by, fit.model.pose, nothing, nothing, nothing, turning=fit.model.period, **more)


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
    def of(column: str, reach: np.ndarray, fit: Fit) -> _Axis:
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
    frame = _frame(axis.label, fit, edges=axis.factor * axis.edges(ALONG))
    return _Map(frame, ALONG, lambda block: axis.place(block, ALONG))


def _plane(x: _Axis, y: _Axis, fit: Fit) -> _Map:
    sides = {"edges": x.factor * x.edges(PLANE), "up": y.label, "across": y.factor * y.edges(PLANE)}
    frame = _frame(x.label, fit, **sides)
    return _Map(frame, PLANE**2, lambda block: x.place(block, PLANE) + PLANE * y.place(block, PLANE))


def _grouped(by: str, groups: Sequence[Group], fit: Fit, holdout: Sequence[int] = ()) -> _Map:
    """Cells of runs; a cell is marked when all of its runs are in `holdout`."""
    at = {run: k for k, (_, runs) in enumerate(groups) for run in runs}
    labels = tuple(words for words, _ in groups)
    marked = tuple(k for k, (_, runs) in enumerate(groups) if holdout and set(runs) <= set(holdout))

    def place(block: Block) -> np.ndarray:
        return np.full(len(next(iter(block.data.values()))), at.get(block.run, -1))

    return _Map(_frame(by, fit, labels=labels, marked=marked), len(groups), place)


def _few_runs(runs: Sequence[int]) -> list[Group]:
    per = -(-len(runs) // MOST)
    parts = [list(runs[k : k + per]) for k in range(0, len(runs), per)]
    return [(f"{p[0]}" if len(p) == 1 else f"{p[0]}\N{EN DASH}{p[-1]}", p) for p in parts]
