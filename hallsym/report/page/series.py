"""Errors of a run over time: a static chart that a script zooms, and in which it shows other runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hallsym.report.data import RunSeries
from hallsym.report.page.content import Runs
from hallsym.report.page.frames import LOOKS, framed
from hallsym.report.page.marks import Chart, Mark, Scale, path, px
from hallsym.report.words import largest, name, scale

ACROSS, UP = 20_000, 5_000
"""A path's own units: time runs from 0 to `ACROSS`, values from -`UP` to `UP`."""
FEWEST = 200
"""Columns that are shown at least: fewer would pass for samples."""
WIDTH = 740.0
ROOM, POINT = 500_000, 13
"""Bytes that all runs beside the first may take, and those of one column of a line."""
COARSEST, FINEST = 60, 1000
"""Columns of a run beside the first."""


def runs(series: Sequence[RunSeries]) -> Runs | None:
    """Return the charts of the first of several runs, and what a script draws of all; None without any.

    Of each run: title, unit and span of time, least width of a zoom, reach of each output [in its unit] and
    paths `lines[line][output]`.
    """
    if not series:
        return None
    first, outputs = series[0], range(len(series[0].pose))
    reach = [[_reach(s, k) for k in outputs] for s in series]
    scales = [scale(first.pose[k], max(r[k] for r in reach), first.turning) for k in outputs]
    each = ROOM / (POINT * max(len(series) - 1, 1) * len(outputs) * len(first.lines))
    columns = int(np.clip(each, COARSEST, FINEST))
    shown = [first, *(s.reduced(columns) for s in series[1:])]
    data = [_run(s, r, scales) for s, r in zip(shown, reach, strict=True)]
    charts = [_panel(first, data[0], k, scales[k]) for k in outputs]
    key = "; light: " + "; dark, drawn over it: ".join(first.lines) if len(first.lines) > 1 else ""
    script = {"unit": "s" if first.timed else "samples", "runs": data}
    return Runs(series[0].title, data[0]["note"], charts, key, script)


def _reach(series: RunSeries, k: int) -> float:
    return largest(np.array([bounds[k] for pair in series.lines.values() for bounds in pair])) or 1e-12


def _run(series: RunSeries, reach: Sequence[float], scales: Sequence[tuple[float, str]]) -> dict[str, Any]:
    end = float(series.time[-1])
    start, end = (0.0, end) if end > 0.0 else (-0.5, 0.5)
    per = series.per_column
    return {
        "title": series.title,
        "note": f"a column of a line holds {per} samples, least to greatest" if per > 1 else "",
        "from": float(f"{start:.9g}"),
        "to": float(f"{end:.9g}"),
        "least": round(min(ACROSS, ACROSS * (FEWEST if per > 1 else 4) / len(series.time))),
        "reach": [float(f"{f * r:.6g}") for r, (f, _) in zip(reach, scales, strict=True)],
        "lines": [
            [_path((series.time - start) / (end - start), low[k], high[k], r) for k, r in enumerate(reach)]
            for low, high in series.lines.values()
        ],
    }


def _panel(series: RunSeries, run: dict[str, Any], k: int, shown: tuple[float, str]) -> Chart:
    last, reach, quantity, (factor, unit) = (
        k == len(series.pose) - 1,
        run["reach"][k],
        name(series.pose[k]),
        shown,
    )
    drawn = zip(LOOKS[len(run["lines"])], run["lines"], strict=True)
    lines = [path(paths[k], f"line median{ending}") for ending, paths in drawn]

    def view(x: Scale, y: Scale) -> list[Mark]:
        place = {
            "class": "view", "x": px(x.start), "y": px(y.end), "width": px(x.end - x.start),
            "height": px(y.start - y.end), "viewBox": f"0 {px(-1.05 * UP)} {ACROSS} {px(2.1 * UP)}",
            "preserveAspectRatio": "none",
        }  # fmt: skip
        return [Mark("svg", place, parts=lines)]

    what = "time in the run [s]" if series.timed else "sample of the run"
    worst = {n: factor * largest(np.array([low[k], high[k]])) for n, (low, high) in series.lines.items()}
    said = ", ".join(f"{n} up to {v:.3g} {unit}" for n, v in worst.items())
    says = f"error in {quantity} over time, {series.title}: {said}"
    x = Scale(run["from"], run["to"], title=what if last else "", most=7)
    y, place = Scale(-1.05 * reach, 1.05 * reach), {"class": "panel", "data-unit": unit}
    return framed(f"error in {quantity} [{unit}]", says, x, y, [view], width=WIDTH, attributes=place)


def _path(time: np.ndarray, low: np.ndarray, high: np.ndarray, reach: float) -> str:
    """Return a path in whole numbers, each point relative to the one before, interrupted at nan.

    `time`: from 0 to 1.
    """
    flat = np.array_equal(low, high, equal_nan=True)
    x = np.rint(time * ACROSS)
    even = np.arange(len(low)) % 2 == 0  # up in one column, down in the next: no sawtooth between them
    y = low if flat else np.column_stack([np.where(even, low, high), np.where(even, high, low)]).ravel()
    x = x if flat else np.repeat(x, 2)
    good = np.isfinite(y)
    points = np.column_stack([x, np.rint(-np.where(good, y, 0.0) / reach * UP)]).astype(np.int64)[good]
    starts = np.diff(np.flatnonzero(good), prepend=-2) > 1
    steps = np.diff(points, axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    words = []
    for k, (dx, dy) in enumerate(steps.tolist()):
        command = "m" if starts[k] else "l" if k and starts[k - 1] else " "
        words.append(f"{command}{dx}{'' if dy < 0 else ' '}{dy}")
    return "".join(words)
