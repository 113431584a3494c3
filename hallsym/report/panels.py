"""Pictures of errors: along a coordinate, over two coordinates, by group of runs, over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hallsym.estimation import Fit
from hallsym.estimation.decoding import ErrorTable
from hallsym.report import picture as p
from hallsym.report.data.gather import Cells, Gathered, Group, RunSeries, held_out
from hallsym.report.words import largest, minus, name, number, scale

Sizes = Mapping[str, Mapping[str, float]]
"""`{"rmse": {x_m: ..}, "peak": {..}}`."""

# -- errors by cell: along a coordinate, over two coordinates -------------------------------------------


def profile(both: Sequence[Cells], output: int, floor: float = 0.0) -> p.Panel:
    """Return mean (line) and rms (band to both sides) of one output by cell; `floor` [SI] is dashed.

    `both`: the cells of one version, or of two, the second drawn over the first.
    """
    cells = both[0]
    what = name(cells.pose[output])
    reach = max(floor, *(largest(v[output]) for c in both for v in (c.rms, c.mean)))
    factor, unit = scale(cells.pose[output], reach, cells.periodic)
    left, right = cells.edges[:-1], cells.edges[1:]
    bands: list[p.Layer] = []
    means: list[p.Layer] = []
    said: list[str] = []
    for c, band, look in zip(both, p.BANDS[-len(both) :], p.MEDIANS[-len(both) :], strict=True):
        rms, mean = factor * c.rms[output], factor * c.mean[output]
        said = [
            f"{_span(c.edges, k)}: mean {minus(number(mean[k]))}, rms {number(rms[k])} {unit}, {n:d} samples"
            for k, n in enumerate(c.count)
        ]
        bands.append(p.boxes(left, right, -rms, rms, band, said=said))
        means.append(p.line(0.5 * (np.asarray(left) + right), mean, look))
    high = 1.08 * factor * reach or 1.0
    return p.Panel(
        p.Axis(cells.by, left[0], right[-1]),
        p.Axis(low=-high, high=high),
        [*bands, *(p.level(factor * v) for v in (floor, -floor) if v), *means],
        f"{what} [{unit}]",
        f"{what} by {cells.by}: largest rms {said[int(np.argmax(np.nan_to_num(both[-1].rms[output])))]}",
    )


FEWEST = 10
"""Samples of a cell of a map at least, where most cells have as many: their rms is known to a fourth."""


def plane(cells: Cells, both: Sequence[Cells], what: str, output: int, floor: float) -> p.Panel:
    """Return one output over two coordinates, as `tiles` draws it.

    `what`: mean or rms. `both`: all versions of the map; the fullest colour is their largest value, or the
    noise floor where that is more, so that mere noise stays pale. A cell of few samples is left out.
    """
    enough = cells.count >= min(FEWEST, np.median(cells.count[cells.count > 0]))
    quantity = name(cells.pose[output])
    most = max(floor, *(largest(m.rms[output][enough]) for m in both))
    factor, unit = scale(cells.pose[output], most, cells.periodic)
    values, n = np.where(enough, factor * getattr(cells, what)[output], np.nan), len(cells.edges) - 1
    full = factor * max(floor, *(largest(getattr(m, what)[output][enough]) for m in both)) or 1e-12
    x, y = cells.edges, cells.across
    said = [
        f"{_span(x, k % n)}, {_span(y, k // n)}: {minus(number(v))} {unit}, {count} samples"
        for k, (v, count) in enumerate(zip(values, cells.count, strict=True))
    ]
    return p.Panel(
        p.Axis(cells.by, x[0], x[-1]),
        p.Axis(cells.up, y[0], y[-1]),
        p.tiles(x, y, values.reshape(-1, n), full, said),
        f"{quantity}, full: {number(full)} {unit}",
        f"{what} error of {quantity} over {cells.by} and {cells.up}: "
        f"{number(largest(values))} {unit} at most",
        height=172.0,
        grid=False,
    )


def _span(edges: Sequence[float] | np.ndarray, k: int) -> str:
    return f"{minus(number(edges[k]))} to {minus(number(edges[k + 1]))}"


# -- errors by group of runs -----------------------------------------------------------------------------


def by_group(fit: Fit, groups: Sequence[Group], title: str, tables: Mapping[str, ErrorTable]) -> p.Picture:
    """Return the rmse of each output by group of runs on a logarithmic axis, with the noise floor.

    `tables`: of one version of the model, or of two; of the last one holdout runs have a mark of their own.
    """
    every = [runs for _, runs in groups]
    used, holdout = ([[r for r in runs if (r in held_out(fit)) == side] for runs in every] for side in (0, 1))
    series = [(label, table, p.BEFORE, every) for label, table in tables.items()]
    last, table, *_ = series.pop()
    series += [(last, table, p.AFTER, used), (f"{last}, holdout runs", table, p.HOLDOUT, holdout)]
    series = [one for one in series if any(one[-1])]
    place, panels = np.arange(len(groups)), []
    for k, column in enumerate(fit.model.pose):
        values = np.array([[_rmse(table, runs, k) for runs in sets] for _, table, _, sets in series])
        floor = float(fit.noise_floor.get(column, 0.0))
        factor, unit = scale(column, largest(values), fit.model.period)
        layers: list[p.Layer] = []
        for (label, _, look, _), y in zip(series, values, strict=True):
            aside = np.array([0.25 if look is p.HOLDOUT and runs else 0.0 for runs in used])
            layers.append(p.points(place + aside, factor * y, replace(look, size=4.2), label))
        layers += [p.level(factor * floor, label="noise floor")] if floor > 0 else []
        # a stroke from the least to the largest of each group
        reach = np.array([np.fmin.reduce(values), np.fmax.reduce(values), np.full(len(groups), np.nan)])
        layers.append(p.line(np.repeat(place, 3), factor * reach.T.ravel(), p.Look(p.FAINT, width=0.6)))
        x = p.Axis(title, -0.7, len(groups) - 0.3, names=[label for label, _ in groups])
        up = p.Axis(f"rmse {name(column)} [{unit}]", log=bool((values > 0).any()))
        says = (
            f"{up.title} by {title.partition(' (')[0]}: {last} up to {number(factor * largest(values[-1]))}"
        )
        panels.append(p.Panel(x, up, layers, says=says, height=97.0))
    return p.Picture(panels, across=1)


def by_groups(fit: Fit, found: Gathered) -> list[p.Picture]:
    """Return the rmse by vertical setting, where there are some, and by run."""
    return [by_group(fit, own, title, found.tables) for title, own in found.groups.items()]


def _rmse(table: ErrorTable, runs: Sequence[int], k: int) -> float:
    found = table.over(runs) if runs else None
    return found["rmse"][table.pose[k]] if found else float("nan")


# -- errors of a run over time, in whose place a script shows other runs ---------------------------------


ACROSS, UP = 20_000, 5_000
"""A path's own units: time runs from 0 to `ACROSS`, values from -`UP` to `UP`."""
NARROWEST = 200
"""Columns that are shown at least: fewer would pass for samples."""


def over_time(series: RunSeries, *, every: bool = False) -> list[p.Panel]:
    """Return the errors of a run over time, a panel per output; the last version is drawn over others.

    `every`: each panel has the title of the time axis, not the last one alone.
    """
    panels = []
    for k, column in enumerate(series.pose):
        reach = _reach(series, k)
        factor, unit = scale(column, reach, series.periodic)
        worst = {n: factor * largest(np.array([low[k], high[k]])) for n, (low, high) in series.lines.items()}
        said = ", ".join(f"{n} up to {number(v)} {unit}" for n, v in worst.items())
        versions = zip(series.lines.values(), p.MEDIANS[-len(series.lines) :], strict=True)
        lines = [
            p.line(*_zigzag(series.time, factor * low[k], factor * high[k]), look)
            for (low, high), look in versions
        ]
        high = 1.05 * factor * reach
        panels.append(
            p.Panel(
                p.Axis(
                    _when(series) if every or k == len(series.pose) - 1 else "",
                    *_span_of(series),
                    most=4 if every else 7,
                ),
                p.Axis(low=-high, high=high),
                lines,
                f"error in {name(column)} [{unit}]",
                f"error in {name(column)} over time, {series.title}: {said}",
            )
        )
    return panels


def script_data(series: Sequence[RunSeries]) -> dict[str, Any]:
    """Return what the script of a page draws of each run in place of the first.

    Of each run: title, span of time, least width of a zoom, reach of each output [in its unit] and paths
    `lines[line][output]`. `outputs`: name and unit, which all runs share.
    """
    first, outputs = series[0], range(len(series[0].pose))
    reach = [[_reach(s, k) for k in outputs] for s in series]
    scales = [scale(first.pose[k], max(r[k] for r in reach), first.periodic) for k in outputs]
    named = [{"name": name(c), "unit": unit} for c, (_, unit) in zip(first.pose, scales, strict=True)]
    runs = [_run(s, r, scales) for s, r in zip(series, reach, strict=True)]
    return {
        "unit": "s" if first.timed else "samples", "what": _when(first), "outputs": named, "runs": runs,
    }  # fmt: skip


def _when(series: RunSeries) -> str:
    return "time in the run [s]" if series.timed else "sample of the run"


def _reach(series: RunSeries, k: int) -> float:
    return largest(np.array([bounds[k] for pair in series.lines.values() for bounds in pair])) or 1e-12


def _span_of(series: RunSeries) -> tuple[float, float]:
    end = float(series.time[-1])
    return (0.0, end) if end > 0.0 else (-0.5, 0.5)


def _run(series: RunSeries, reach: Sequence[float], scales: Sequence[tuple[float, str]]) -> dict[str, Any]:
    (start, end), per = _span_of(series), series.per_column
    return {
        "title": series.title,
        "note": f"each column of the line shows least and greatest of {per} samples" if per > 1 else "",
        "from": float(f"{start:.9g}"),
        "to": float(f"{end:.9g}"),
        "least": round(min(ACROSS, ACROSS * (NARROWEST if per > 1 else 4) / len(series.time))),
        "reach": [float(f"{f * r:.6g}") for r, (f, _) in zip(reach, scales, strict=True)],
        "lines": [
            [
                _path((series.time - start) / (end - start), low[k] / r, high[k] / r)
                for k, r in enumerate(reach)
            ]
            for low, high in series.lines.values()
        ],
    }


def _zigzag(time: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a line through least and greatest value: up in one column, down in the next, no sawtooth."""
    if np.array_equal(low, high, equal_nan=True):
        return time, low
    even = np.arange(len(low)) % 2 == 0
    return np.repeat(time, 2), np.column_stack([np.where(even, low, high), np.where(even, high, low)]).ravel()


def _path(time: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
    """Return a path in whole numbers, each point relative to the one before, interrupted at nan.

    `time`: from 0 to 1, `low` and `high`: from -1 to 1.
    """
    x, y = _zigzag(np.rint(time * ACROSS), low, high)
    good = np.isfinite(y)
    points = np.column_stack([x, np.rint(-UP * np.where(good, y, 0.0))]).astype(np.int64)[good]
    starts = np.diff(np.flatnonzero(good), prepend=-2) > 1
    steps = np.diff(points, axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    words = []
    for k, (dx, dy) in enumerate(steps.tolist()):
        command = "m" if starts[k] else "l" if k and starts[k - 1] else " "
        words.append(f"{command}{dx}{'' if dy < 0 else ' '}{dy}")
    return "".join(words)
