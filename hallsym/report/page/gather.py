"""One more pass over a log: maps of the errors over the coordinates that matter, and series of a few runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import columns_of
from hallsym.log import Block, Log
from hallsym.log.batches import SIZE, Weigh
from hallsym.log.derived import extended
from hallsym.report.figures.by_setting import settings
from hallsym.report.figures.names import LEVEL, name, scale
from hallsym.report.figures.runs import representative
from hallsym.report.figures.survey import Decode, Survey, held_out, look_over
from hallsym.report.figures.trace import Trace
from hallsym.report.page.cells import Cells, Tally
from hallsym.report.page.series import RunSeries, of_trace

ALONG, PLANE, MOST = 15, 11, 60
"""Cells along a coordinate, along each side of a map, and of runs (neighbours are taken together).

Odd, so that an axis at rest in the middle of its travel lies inside a cell: on an edge, the noise of its own
reference would decide the cell, and each side would show a median that is not there.
"""


@dataclass(frozen=True, eq=False)
class Gathered:
    """What a page shows of a log: `survey`, maps and series of the errors of decoded poses.

    `after`: the same maps of another version of the model, cell by cell; empty without one.
    """

    survey: Survey
    maps: tuple[Cells, ...]
    series: tuple[RunSeries, ...]
    after: tuple[Cells, ...] = ()


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


@dataclass(frozen=True, eq=False)
class _Map:
    """Where samples go, what has come in so far, and how to name the cells."""

    place: Callable[[Block], np.ndarray]
    tally: Tally
    named: Callable[[Tally], Cells]


def gather(
    log: Log,
    fits: Mapping[str, Fit],
    *,
    keep: Weigh | None = None,
    most_runs: int = 3,
    after: Version | None = None,
) -> Gathered:
    """Read `log` twice, in blocks: maps are of the first of `fits`, series of all of them by their names.

    `after`: a version of the model that is read once more, for the same maps and series beside those.

    Channels of the log are those of the model (`wiring.rewired`). Samples to which `keep` gives weight 0
    (outliers) take no part and interrupt the series.
    """
    first = next(iter(fits.values()))
    survey = look_over(log, first, keep)
    maps = _maps(first, survey)
    decode = [Decode(fit) for fit in fits.values()]
    chosen = representative(survey, most_runs)
    columns = (*columns_of(first.model), *(("t_s",) if survey.time is not None else ()))
    traces: dict[int, Trace] = {}
    current, zeros = None, []
    sigma = first.noise.std
    wide = extended(log, first.model, sigma, first.model.named(first.values))
    for block in wide.blocks(columns, size=SIZE):
        if block.run != current:
            state = np.array([block.data[c][0] for c in first.model.state])
            current, zeros = block.run, [d.zeros(block.run, state) for d in decode]
        reference = np.array([block.data[c] for c in first.model.references])
        shown = decode if block.run in chosen else decode[:1]
        errors = [d(block, z)[1] - reference for d, z in zip(shown, zeros, strict=False)]
        if keep is not None:
            gone = keep(block) <= 0
            for error in errors:
                error[:, gone] = np.nan
        at = maps[0].tally.bin_of(errors[0]) if maps else None
        for m in maps:
            m.tally.add(m.place(block), errors[0], at)
        if block.run in chosen:
            time = block.data["t_s"] if survey.time is not None else np.zeros(reference.shape[1])
            trace = traces.setdefault(block.run, Trace(1 + len(reference) * len(decode)))
            trace.add(np.vstack([time, *errors]))
    titles = {run: f"run {run}{', held out' if run in held_out(first) else ''}" for run in chosen}
    timed, pose = survey.time is not None, first.model.pose
    series = [of_trace(titles[r], pose, tuple(fits), traces[r], timed=timed) for r in chosen]
    before = tuple(m.named(m.tally) for m in maps)
    if after is None:
        return Gathered(survey, before, tuple(series))
    maps = _maps(first, survey)
    traces = _again(after, maps, chosen, timed)
    for k, run in enumerate(chosen):
        more = of_trace(titles[run], pose, (after.name,), traces[run], timed=timed)
        series[k] = replace(series[k], lines={**series[k].lines, **more.lines})
    return Gathered(survey, before, tuple(series), tuple(m.named(m.tally) for m in maps))


def _again(version: Version, maps: Sequence[_Map], chosen: Sequence[int], timed: bool) -> dict[int, Trace]:
    """Fill the maps with the errors of a version and return its traces of the chosen runs."""
    traces: dict[int, Trace] = {}
    columns = tuple(dict.fromkeys((*version.columns, *(("t_s",) if timed else ()))))
    for block in version.log.blocks(columns, size=SIZE):
        errors = version.errors(block)
        if version.keep is not None:
            errors = np.where(version.keep(block) > 0, errors, np.nan)
        at = maps[0].tally.bin_of(errors) if maps else None
        for m in maps:
            m.tally.add(m.place(block), errors, at)
        if block.run in chosen:
            time = block.data["t_s"] if timed else np.zeros(errors.shape[1])
            trace = traces.setdefault(block.run, Trace(1 + len(errors)))
            trace.add(np.vstack([time, *errors]))
    return traces


def _maps(fit: Fit, survey: Survey) -> list[_Map]:
    """Maps over two outputs together, each output, the vertical settings or states, and runs."""
    model = fit.model
    floor = np.array([fit.noise_floor.get(c) or 0.0 for c in model.pose])
    fine = np.maximum(floor / 20, survey.fitted.peak.max(axis=0) / 1e4)
    reach = dict(zip((*model.references, *model.state), survey.reach, strict=True))
    made = {c.name for c in model.computed}
    moved = [c for c, (low, high) in reach.items() if high - low > LEVEL and c not in made]
    poses = [c for c in model.references if c in moved]
    maps = [_along(c, reach[c], fit, fine) for c in poses]
    flat = [c for c in poses if c.endswith("_m")][:2]
    if len(flat) == 2:
        maps.insert(0, _plane(flat, reach, fit, fine))
    groups, title = settings(fit, survey)
    if title == "run":
        maps += [_along(c, reach[c], fit, fine) for c in model.state if c in moved]
    else:
        maps.append(_grouped(title, [(words, runs) for words, runs in groups], fit, fine))
    if len(survey.runs) > 1:
        maps.append(_grouped("run", _few_runs(survey.runs), fit, fine, held_out(fit)))
    return maps


def _along(column: str, reach: Sequence[float], fit: Fit, fine: np.ndarray) -> _Map:
    turn = fit.model.period.get(column, np.inf)
    goes_round = reach[1] - reach[0] > turn  # one map of all turns
    edges = np.linspace(0.0, turn, ALONG + 1) if goes_round else np.linspace(reach[0], reach[1], ALONG + 1)
    factor, unit = scale(column, float(np.abs(edges).max()))
    by, pose = f"{_name(column)} [{unit}]", fit.model.pose

    def named(tally: Tally) -> Cells:
        return Cells(by, pose, tally.count, tally.median, tally.rms, edges=factor * edges)

    def place(block: Block) -> np.ndarray:
        return _cell(np.mod(block.data[column], turn) if goes_round else block.data[column], edges)

    return _Map(place, Tally(ALONG, fine), named)


def _plane(columns: Sequence[str], reach: Mapping[str, Sequence[float]], fit: Fit, fine: np.ndarray) -> _Map:
    edges = [np.linspace(reach[c][0], reach[c][1], PLANE + 1) for c in columns]
    scales = [scale(c, float(np.abs(e).max())) for c, e in zip(columns, edges, strict=True)]
    by, up = (f"{_name(c)} [{unit}]" for c, (_, unit) in zip(columns, scales, strict=True))
    pose = fit.model.pose

    def place(block: Block) -> np.ndarray:
        i, j = (_cell(block.data[c], e) for c, e in zip(columns, edges, strict=True))
        return i + PLANE * j

    def named(tally: Tally) -> Cells:
        x, y = (factor * e for (factor, _), e in zip(scales, edges, strict=True))
        return Cells(by, pose, tally.count, tally.median, tally.rms, edges=x, up=up, across=y)

    return _Map(place, Tally(PLANE**2, fine), named)


def _grouped(
    by: str,
    groups: Sequence[tuple[str, Sequence[int]]],
    fit: Fit,
    fine: np.ndarray,
    apart: Sequence[int] = (),
) -> _Map:
    """Cells of runs; a cell is marked when all of its runs are in `apart`."""
    at = {run: k for k, (_, runs) in enumerate(groups) for run in runs}
    labels = tuple(words for words, _ in groups)
    marked = tuple(k for k, (_, runs) in enumerate(groups) if apart and set(runs) <= set(apart))

    def place(block: Block) -> np.ndarray:
        return np.full(len(next(iter(block.data.values()))), at.get(block.run, -1))

    def named(tally: Tally) -> Cells:
        pose = fit.model.pose
        return Cells(by, pose, tally.count, tally.median, tally.rms, labels=labels, marked=marked)

    return _Map(place, Tally(len(groups), fine), named)


def _few_runs(runs: Sequence[int]) -> list[tuple[str, list[int]]]:
    per = -(-len(runs) // MOST)
    parts = [list(runs[k : k + per]) for k in range(0, len(runs), per)]
    return [(f"{p[0]}" if len(p) == 1 else f"{p[0]}\N{EN DASH}{p[-1]}", p) for p in parts]


def _cell(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _name(column: str) -> str:
    return name(column.replace("_ref_", "_"))
