"""Pictures of errors by cell: along a coordinate, by group of runs, over two coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hallsym.report.data import Cells
from hallsym.report.page.html import Markup, tag
from hallsym.report.page.svg import (
    NARROW,
    RIM,
    WIDE,
    Scale,
    below,
    chart,
    label,
    line,
    polyline,
    px,
    rect,
    text,
)
from hallsym.report.page.svg import beside as axis_beside
from hallsym.report.words import largest, name, scale, thinned, three

LEFT, TOP, BOTTOM = 44.0, 22.0, 112.0
LONG = 4
"""Labels with more characters stand upright."""


@dataclass(frozen=True)
class _Shown:
    """Values of one output in the unit that is shown; `floor` is 0 where there is none."""

    name: str
    unit: str
    median: np.ndarray
    rms: np.ndarray
    floor: float


def _shown(cells: Cells, output: int, floor: float, reach: float) -> _Shown:
    factor, unit = scale(cells.pose[output], reach, cells.turning)
    median, rms = factor * cells.median[output], factor * cells.rms[output]
    return _Shown(name(cells.pose[output]), unit, median, rms, factor * floor)


def profile(cells: Cells, output: int, floor: float = 0.0, after: Cells | None = None) -> Markup:
    """Draw median (line) and rms (band to both sides) of one output by cell; `floor` [SI] is dashed.

    `after`: the same cells of another version, drawn over it on the same scale.
    """
    both = [cells] if after is None else [cells, after]
    reach = max(floor, *(largest(v[output]) for c in both for v in (c.rms, c.median)))
    shown, *more = (_shown(c, output, floor, reach) for c in both)
    width = WIDE if cells.labels else NARROW
    right = width - RIM
    high = 1.08 * max(shown.floor, *(largest(v) for x in (shown, *more) for v in (x.rms, x.median))) or 1.0
    y = Scale(-high, high, BOTTOM, TOP)
    spans, axis, height = _groups(cells, right) if cells.labels else _coordinate(cells, right)
    parts = [text(0, 11, f"{shown.name} [{shown.unit}]", look="title"), *axis_beside(y, LEFT, right), *axis]
    for x, c, old in zip((shown, *more), both, (bool(more), False), strict=False):
        parts += _bands(c, x, y, spans, "band0" if old else "band")
    for x, old in zip((shown, *more), (bool(more), False), strict=False):
        parts += _medians(cells, x, y, spans, "median0" if old else "median")
    if floor > 0:
        parts += [line(LEFT, y(v), right, y(v), "level") for v in (shown.floor, -shown.floor)]
    parts += [text(0.5 * sum(spans[k]), TOP - 2, "h", "middle", "soft") for k in cells.marked]
    worst = int(np.nanargmax(shown.rms)) if np.isfinite(shown.rms).any() else 0
    says = f"{shown.name} by {cells.by}: largest rms {_says(cells, shown, worst)}"
    return chart(width, height, says, *parts)


def _bands(
    cells: Cells, shown: _Shown, y: Scale, spans: Sequence[tuple[float, float]], look: str
) -> list[Markup]:
    out = []
    for k, (start, end) in enumerate(spans):
        if cells.count[k]:
            up, down = y(shown.rms[k]), y(-shown.rms[k])
            out.append(rect(start, up, end - start, down - up, look, _says(cells, shown, k)))
    return out


def _medians(
    cells: Cells, shown: _Shown, y: Scale, spans: Sequence[tuple[float, float]], look: str
) -> list[Markup]:
    if cells.labels:
        known = [(y(m), span) for m, span in zip(shown.median, spans, strict=True) if math.isfinite(m)]
        return [line(start, at, end, at, look) for at, (start, end) in known]
    middles = [0.5 * (start + end) for start, end in spans]
    heights = [y(m) if math.isfinite(m) else math.nan for m in shown.median]
    return [polyline(list(zip(middles, heights, strict=True)), look)]


def _coordinate(cells: Cells, right: float) -> tuple[list[tuple[float, float]], list[Markup], float]:
    """Return where each cell begins and ends, the x axis, and the height of the picture."""
    edges = [float(e) for e in cells.edges]
    x = Scale(edges[0], edges[-1], LEFT, right)
    spans = [(x(a), x(b)) for a, b in pairwise(edges)]
    return spans, below(x, BOTTOM, cells.by), BOTTOM + 34


def _groups(cells: Cells, right: float) -> tuple[list[tuple[float, float]], list[Markup], float]:
    """Return the same for cells with labels; long ones stand upright."""
    longest = max(map(len, cells.labels))
    at = np.linspace(LEFT, right, 2 * len(cells.labels) + 1)[1::2]
    half = min(12.0, 0.4 * (right - LEFT) / len(at))
    upright = longest > LONG
    words = [
        _upright(float(at[k]) + 4, BOTTOM + 8, cells.labels[k])
        if upright
        else text(float(at[k]), BOTTOM + 14, cells.labels[k], "middle")
        for k in thinned(len(at), 40 if upright else 30)
    ]
    height = BOTTOM + (6.4 * longest + 12 if upright else 22)
    return [(v - half, v + half) for v in at.tolist()], words, height


def _upright(x: float, y: float, words: str) -> Markup:
    turn = f"rotate(-90 {px(x)} {px(y)})"
    return tag("text", words, x=px(x), y=px(y), text_anchor="end", transform=turn)


def plane(
    cells: Cells, output: int, floor: float = 0.0, what: str = "median", beside: Cells | None = None
) -> Markup:
    """Draw median or rms of one output over two coordinates: squares of its size, hollow if negative.

    A full cell is the largest value, also of the picture `beside` it, or `floor` [SI] where that is more, so
    that mere noise stays small.
    """
    both = [getattr(c, what)[output] for c in (cells, beside) if c is not None]
    full = max(floor, *map(largest, both)) or 1e-12
    shown = _shown(cells, output, floor, full)
    values = shown.median if what == "median" else shown.rms
    right, bottom = NARROW - RIM, TOP + NARROW - RIM - LEFT
    x = Scale(float(cells.edges[0]), float(cells.edges[-1]), LEFT, right)
    y = Scale(float(cells.across[0]), float(cells.across[-1]), bottom, TOP)
    largest_shown = scale(cells.pose[output], full, cells.turning)[0] * full
    title = f"{what} {shown.name}, full cell: {three(largest_shown)} {shown.unit}"
    parts = [
        text(0, 12, title, look="title"),
        *axis_beside(y, LEFT, LEFT, 4),
        *below(x, bottom, cells.by),
    ]
    columns = len(cells.edges) - 1
    for k in np.flatnonzero(cells.count).tolist():
        i, j = k % columns, k // columns
        box = x(cells.edges[i]), y(cells.across[j + 1]), x(cells.edges[i + 1]), y(cells.across[j])
        part = math.sqrt(abs(values[k]) / largest_shown)
        parts += _square(box, part, values[k] > 0, _says(cells, shown, k))
    most = _number(largest(values))
    says = f"{what} error of {shown.name} over {cells.by} and {cells.up}: {most} {shown.unit} at most"
    return chart(NARROW, bottom + 34, says, *parts)


def _square(box: Sequence[float], part: float, positive: bool, title: str) -> list[Markup]:
    """Return a cell and in its middle a square whose side is `part` of the cell's."""
    left, top, right, bottom = box
    width, height = right - left, bottom - top
    across, up = 0.92 * part * width, 0.92 * part * height
    cell = rect(left, top, width, height, "cell", title)
    look = "plus" if positive else "minus"
    place = left + 0.5 * (width - across), top + 0.5 * (height - up)
    return [cell, rect(*place, across, up, look, title)]


def _says(cells: Cells, shown: _Shown, k: int) -> str:
    """Return the numbers of a cell in words."""
    values = f"median {_number(shown.median[k])}, rms {_number(shown.rms[k])} {shown.unit}"
    return f"{_where(cells, k)}: {values}, {cells.count[k]:d} samples"


def _where(cells: Cells, k: int) -> str:
    if cells.labels:
        return cells.labels[k]
    columns = len(cells.edges) - 1
    first = _span(cells.edges, k % columns)
    return f"{first}, {_span(cells.across, k // columns)}" if len(cells.across) else first


def _span(edges: Sequence[float] | np.ndarray, k: int) -> str:
    return f"{_number(edges[k])} to {_number(edges[k + 1])}"


def _number(value: float) -> str:
    return label(float(f"{value:.3g}")) if math.isfinite(value) else "none"
