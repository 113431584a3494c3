"""Errors over time that can be zoomed: a static chart that a script rescales; it stays without one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hallsym.report.data import RunSeries
from hallsym.report.page.html import Markup, join, tag
from hallsym.report.page.svg import Scale, below, beside, chart, px, text
from hallsym.report.words import largest, name, scale

HOW = (
    "Drag over a stretch to zoom in. With the keyboard: + and - zoom, arrows move, 0 shows all. Without "
    "JavaScript the whole run is shown."
)
ACROSS, UP = 20_000, 10_000
"""A path's own units: time runs from 0 to `ACROSS`, values from -`UP` to `UP`."""
FEWEST = 200
"""Columns that are shown at least: fewer would pass for samples."""
WIDTH, LEFT, TOP, HIGH = 740.0, 46.0, 20.0, 92.0


def figure(series: RunSeries) -> Markup:
    """Return the chart of one run: one panel per output over a common time."""
    span = 0.0, float(series.time[-1])
    if not span[1] > 0.0:
        span = -0.5, 0.5
    pictures = [_panel(series, k, span) for k in range(len(series.pose))]
    caption = [series.title]
    if series.per_column > 1:
        caption.append(f"; each column of the line holds {series.per_column} samples, least to greatest")
    if len(series.lines) > 1:
        caption.append("; light: " + "; dark, drawn over it: ".join(series.lines))
    return tag(
        "figure",
        tag("figcaption", *caption),
        tag("div", *pictures, class_="scroll two" if len(series.lines) > 1 else "scroll"),
        class_="series",
        tabindex="0",
        role="group",
        aria_label=f"errors over time, {series.title}",
        data_unit="s" if series.timed else "samples",
        data_least=round(min(ACROSS, ACROSS * (FEWEST if series.per_column > 1 else 4) / len(series.time))),
    )


def _panel(series: RunSeries, k: int, span: tuple[float, float]) -> Markup:
    reach = largest(np.array([bounds[k] for pair in series.lines.values() for bounds in pair])) or 1e-12
    factor, unit = scale(series.pose[k], reach, series.turning)
    last = k == len(series.pose) - 1
    right, bottom = WIDTH - 8, TOP + HIGH
    x = Scale(*span, LEFT, right)
    y = Scale(-1.05 * factor * reach, 1.05 * factor * reach, bottom, TOP)
    what = "time in the run [s]" if series.timed else "sample of the run"
    lines = [
        tag("path", d=_path(series.time, low[k], high[k], span, reach), class_=f"line line{j}")
        for j, (low, high) in enumerate(series.lines.values())
    ]
    view = tag(
        "svg", *lines, class_="view", x=px(LEFT), y=px(TOP), width=px(right - LEFT), height=px(HIGH),
        viewBox=f"0 {px(-1.05 * UP)} {ACROSS} {px(2.1 * UP)}", preserveAspectRatio="none",
    )  # fmt: skip
    parts = (
        text(0, 12, f"error in {name(series.pose[k])} [{unit}]", look="title"),
        tag("g", *beside(y, LEFT, right), class_="ticksy"),
        tag("g", *below(x, bottom, most=7), class_="ticksx"),
        view,
        text((LEFT + right) / 2, bottom + 29, what, "middle", "soft") if last else None,
    )
    worst = {n: factor * largest(np.array([low[k], high[k]])) for n, (low, high) in series.lines.items()}
    says = f"error in {name(series.pose[k])} over time, {series.title}: " + ", ".join(
        f"{n} up to {v:.3g} {unit}" for n, v in worst.items()
    )
    return chart(
        WIDTH, bottom + (34 if last else 20), says, *parts, class_="panel",
        data_from=f"{span[0]:.9g}", data_to=f"{span[1]:.9g}", data_reach=f"{factor * reach:.6g}",
    )  # fmt: skip


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


def all_series(series: Sequence[RunSeries]) -> Markup:
    """Return the charts of several runs with what can be done with them."""
    if not series:
        return Markup("")
    how = tag("p", HOW, class_="note zoomhelp")
    return join([how, *(figure(s) for s in series)])
