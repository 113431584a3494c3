"""Panels of errors: along a coordinate, by group of runs, over two coordinates, over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.report import picture as p
from hallsym.report.data.gather import Cells, RunSeries
from hallsym.report.words import largest, minus, name, number, scale

Sizes = Mapping[str, Mapping[str, float]]
"""`{"rmse": {x_m: ..}, "peak": {..}}`."""

# -- errors by cell: along a coordinate, by group of runs, over two coordinates --------------------------


def profile(both: Sequence[Cells], output: int, floor: float = 0.0) -> p.Panel:
    """Return mean (line) and rms (band to both sides) of one output by cell; `floor` [SI] is dashed.

    `both`: the cells of one version, or of two, the second drawn over the first.
    """
    cells, names = both[0], both[0].labels
    what, n = name(cells.pose[output]), len(cells.count)
    reach = max(floor, *(largest(v[output]) for c in both for v in (c.rms, c.mean)))
    factor, unit = scale(cells.pose[output], reach, cells.periodic)
    half = min(0.4, 0.04 * n)  # few bars are no broader than many
    middle = np.arange(n)
    left, right = (middle - half, middle + half) if names else (cells.edges[:-1], cells.edges[1:])
    bands: list[p.Layer] = []
    means: list[p.Layer] = []
    said: list[str] = []
    for c, band, look in zip(both, p.BANDS[-len(both) :], p.MEDIANS[-len(both) :], strict=True):
        rms, mean = factor * c.rms[output], factor * c.mean[output]
        said = [
            f"{c.labels[k] if names else _span(c.edges, k)}: mean {minus(number(mean[k]))}, "
            f"rms {number(rms[k])} {unit}, {c.count[k]:d} samples"
            for k in range(n)
        ]
        bands.append(p.boxes(left, right, -rms, rms, band, said=said))
        if names:  # a stroke for each
            x, y = np.column_stack([left, right, np.full(n, np.nan)]), np.repeat(mean, 3)
        else:
            x, y = 0.5 * (np.asarray(left) + right), mean
        means.append(p.line(np.ravel(x), y, look))
    marks = len(cells.marked)
    high = (1.25 if marks else 1.08) * factor * reach or 1.0
    return p.Panel(
        p.Axis("", -0.6, n - 0.4, names=names) if names else p.Axis(cells.by, left[0], right[-1]),
        p.Axis(low=-high, high=high),
        [
            *bands,
            *means,
            *(p.level(factor * v) for v in (floor, -floor) if v),
            p.text(["h"] * marks, cells.marked, [0.92 * high] * marks, "center"),
        ],
        f"{what} [{unit}]",
        f"{what} by {cells.by}: largest rms {said[int(np.argmax(np.nan_to_num(both[-1].rms[output])))]}",
    )


def plane(cells: Cells, both: Sequence[Cells], what: str, output: int, floor: float) -> p.Panel:
    """Return one output over two coordinates, as `tiles` draws it.

    `what`: mean or rms. `both`: all versions of the map; the fullest colour is their largest value, or the
    noise floor where that is more, so that mere noise stays pale.
    """
    quantity, most = name(cells.pose[output]), max(floor, *(largest(m.rms[output]) for m in both))
    factor, unit = scale(cells.pose[output], most, cells.periodic)
    values, n = factor * getattr(cells, what)[output], len(cells.edges) - 1
    full = factor * max(floor, *(largest(getattr(m, what)[output]) for m in both)) or 1e-12
    x, y = cells.edges, cells.across
    said = [
        f"{_span(x, k % n)}, {_span(y, k // n)}: {minus(number(v))} {unit}, {count} samples"
        for k, (v, count) in enumerate(zip(values, cells.count, strict=True))
    ]
    return p.Panel(
        p.Axis(cells.by, x[0], x[-1]),
        p.Axis(cells.up, y[0], y[-1]),
        p.tiles(x, y, values.reshape(-1, n), full, said),
        f"{what} {quantity}, full: {number(full)} {unit}",
        f"{what} error of {quantity} over {cells.by} and {cells.up}: "
        f"{number(largest(values))} {unit} at most",
        height=172.0,
        grid=False,
    )


def _span(edges: Sequence[float] | np.ndarray, k: int) -> str:
    return f"{minus(number(edges[k]))} to {minus(number(edges[k + 1]))}"


# -- errors of a run over time, in whose place a script shows other runs ---------------------------------


ACROSS, UP = 20_000, 5_000
"""A path's own units: time runs from 0 to `ACROSS`, values from -`UP` to `UP`."""
FEWEST = 200
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
        "note": f"a column of a line holds {per} samples, least to greatest" if per > 1 else "",
        "from": float(f"{start:.9g}"),
        "to": float(f"{end:.9g}"),
        "least": round(min(ACROSS, ACROSS * (FEWEST if per > 1 else 4) / len(series.time))),
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
