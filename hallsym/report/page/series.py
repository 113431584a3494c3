"""Errors of a run over time: a static chart that a script zooms, and in which it shows other runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.report.data import RunSeries
from hallsym.report.page.marks import Chart, Mark, Scale, below, beside, px, text
from hallsym.report.words import largest, name, scale

ACROSS, UP = 20_000, 5_000
"""A path's own units: time runs from 0 to `ACROSS`, values from -`UP` to `UP`."""
FEWEST = 200
"""Columns that are shown at least: fewer would pass for samples."""
WIDTH, LEFT, TOP, HIGH = 740.0, 46.0, 20.0, 92.0
ROOM, POINT = 500_000, 13
"""Bytes that all runs beside the first may take, and those of one column of a line."""
COARSEST, FINEST = 60, 1000
"""Columns of a run beside the first."""


@dataclass(frozen=True, eq=False)
class Runs:
    """The runs of a page: the picture of the first, and what a script draws of all.

    `runs`: title, unit and span of time, least width of a zoom, reach of each output [in its unit] and paths
    `lines[line][output]`. `units`: of the outputs.
    """

    title: str
    notes: str
    charts: list[Chart]
    script: dict[str, Any]


def runs(series: Sequence[RunSeries]) -> Runs | None:
    """Return the charts of the first of several runs; None without any."""
    if not series:
        return None
    first, outputs = series[0], range(len(series[0].pose))
    reach = [[_reach(s, k) for k in outputs] for s in series]
    scales = [scale(first.pose[k], max(r[k] for r in reach), first.turning) for k in outputs]
    each = ROOM / (POINT * max(len(series) - 1, 1) * len(outputs) * len(first.lines))
    columns = int(np.clip(each, COARSEST, FINEST))
    shown = [first, *(s.reduced(columns) for s in series[1:])]
    data = [_run(s, r, scales) for s, r in zip(shown, reach, strict=True)]
    charts = [_panel(first, data[0], k, scales[k][1]) for k in outputs]
    script = {"unit": "s" if first.timed else "samples", "names": list(first.lines), "runs": data}
    return Runs(data[0]["title"], data[0]["note"], charts, script)


def _reach(series: RunSeries, k: int) -> float:
    return largest(np.array([bounds[k] for pair in series.lines.values() for bounds in pair])) or 1e-12


def _run(series: RunSeries, reach: Sequence[float], scales: Sequence[tuple[float, str]]) -> dict[str, Any]:
    span = 0.0, float(series.time[-1])
    if not span[1] > 0.0:
        span = -0.5, 0.5
    fewest = FEWEST if series.per_column > 1 else 4
    return {
        "title": series.title,
        "note": f"a column of a line holds {series.per_column} samples, least to greatest"
        if series.per_column > 1
        else "",
        "from": float(f"{span[0]:.9g}"),
        "to": float(f"{span[1]:.9g}"),
        "least": round(min(ACROSS, ACROSS * fewest / len(series.time))),
        "reach": [float(f"{f * r:.6g}") for r, (f, _) in zip(reach, scales, strict=True)],
        "lines": [
            [_path(series.time, low[k], high[k], span, reach[k]) for k in range(len(reach))]
            for low, high in series.lines.values()
        ],
    }


def _panel(series: RunSeries, run: dict[str, Any], k: int, unit: str) -> Chart:
    right, bottom, last = WIDTH - 8, TOP + HIGH, k == len(series.pose) - 1
    reach = run["reach"][k]
    x = Scale(run["from"], run["to"], LEFT, right)
    y = Scale(-1.05 * reach, 1.05 * reach, bottom, TOP)
    lines = tuple(
        Mark("path", {"d": paths[k], "class": f"line line{j}"}) for j, paths in enumerate(run["lines"])
    )
    view = {
        "class": "view", "x": px(LEFT), "y": px(TOP), "width": px(right - LEFT), "height": px(HIGH),
        "viewBox": f"0 {px(-1.05 * UP)} {ACROSS} {px(2.1 * UP)}", "preserveAspectRatio": "none",
    }  # fmt: skip
    what = "time in the run [s]" if series.timed else "sample of the run"
    quantity = name(series.pose[k])
    parts = [
        text(0, 12, f"error in {quantity} [{unit}]", look="title"),
        Mark("g", {"class": "ticksy"}, parts=tuple(beside(y, LEFT, right))),
        Mark("g", {"class": "ticksx"}, parts=tuple(below(x, bottom, most=7))),
        Mark("svg", view, parts=lines),
    ]
    if last:
        parts.append(text((LEFT + right) / 2, bottom + 29, what, "middle", "soft middle"))
    factor = reach / _reach(series, k)
    worst = {n: factor * largest(np.array([low[k], high[k]])) for n, (low, high) in series.lines.items()}
    says = f"error in {quantity} over time, {series.title}: " + ", ".join(
        f"{n} up to {v:.3g} {unit}" for n, v in worst.items()
    )
    return Chart(WIDTH, bottom + (34 if last else 20), says, parts, {"class": "panel", "data-unit": unit})


def _path(
    time: np.ndarray, low: np.ndarray, high: np.ndarray, span: tuple[float, float], reach: float
) -> str:
    """Return a path in whole numbers, each point relative to the one before, interrupted at nan."""
    flat = np.array_equal(low, high, equal_nan=True)
    x = np.rint((time - span[0]) / (span[1] - span[0]) * ACROSS)
    even = np.arange(len(low)) % 2 == 0  # up in one column, down in the next: no sawtooth between them
    y = low if flat else np.column_stack([np.where(even, low, high), np.where(even, high, low)]).ravel()
    x = x if flat else np.repeat(x, 2)
    good = np.isfinite(y)
    points = np.column_stack([x, np.rint(-np.where(good, y, 0.0) / reach * UP)]).astype(np.int64)[good]
    if not len(points):
        return ""
    starts = np.diff(np.flatnonzero(good), prepend=-2) > 1
    steps = np.diff(points, axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    words = []
    for k, (dx, dy) in enumerate(steps.tolist()):
        command = "m" if starts[k] else "l" if k and starts[k - 1] else " "
        words.append(f"{command}{dx}{'' if dy < 0 else ' '}{dy}")
    return "".join(words)
