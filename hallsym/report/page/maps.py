"""Pictures of errors by cell: along a coordinate, by group of runs, over two coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hallsym.report.data import Cells
from hallsym.report.page.marks import (
    HALF,
    NARROW,
    RIM,
    Chart,
    Mark,
    Scale,
    below,
    label,
    line,
    polyline,
    px,
    rect,
    text,
)
from hallsym.report.page.marks import beside as axis_beside
from hallsym.report.words import largest, name, scale, thinned, three

LEFT, TOP, BOTTOM = 44.0, 22.0, 112.0
MOST = 12
"""Cells with labels in one chart."""
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


def profiles(cells: Cells, output: int, floor: float = 0.0, after: Cells | None = None) -> list[Chart]:
    """Draw median (line) and rms (band to both sides) of one output by cell; `floor` [SI] is dashed.

    `after`: the same cells of another version, drawn over it on the same scale. Cells with labels are drawn
    in two charts where they are more than `MOST`, so that they can be read on a phone.
    """
    n = len(cells.count)
    starts = range(0, n, -(-n // 2) if cells.labels and n > MOST else n)
    step = starts.step
    return [_profile(cells, output, floor, after, slice(k, min(k + step, n))) for k in starts]


def _profile(cells: Cells, output: int, floor: float, after: Cells | None, part: slice) -> Chart:
    both = [cells] if after is None else [cells, after]
    reach = max(floor, *(largest(v[output]) for c in both for v in (c.rms, c.median)))
    shown, *more = (_shown(c, output, floor, reach) for c in both)
    width = HALF if cells.labels else NARROW
    right = width - RIM
    high = 1.08 * max(shown.floor, *(largest(v) for x in (shown, *more) for v in (x.rms, x.median))) or 1.0
    y = Scale(-high, high, BOTTOM, TOP)
    if cells.labels:
        cells = _cut(cells, part)
        both = [cells] if after is None else [cells, _cut(after, part)]
        shown, *more = (_shown(c, output, floor, reach) for c in both)
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
    return Chart(width, height, says, parts)


def _cut(cells: Cells, part: slice) -> Cells:
    """Return some of the cells with labels."""
    return replace(
        cells,
        count=cells.count[part],
        median=cells.median[:, part],
        rms=cells.rms[:, part],
        labels=cells.labels[part],
        marked=tuple(k - part.start for k in cells.marked if part.start <= k < part.stop),
    )


def _bands(
    cells: Cells, shown: _Shown, y: Scale, spans: Sequence[tuple[float, float]], look: str
) -> list[Mark]:
    out = []
    for k, (start, end) in enumerate(spans):
        if cells.count[k]:
            up, down = y(shown.rms[k]), y(-shown.rms[k])
            out.append(rect(start, up, end - start, down - up, look, _says(cells, shown, k)))
    return out


def _medians(
    cells: Cells, shown: _Shown, y: Scale, spans: Sequence[tuple[float, float]], look: str
) -> list[Mark]:
    if cells.labels:
        known = [(y(m), span) for m, span in zip(shown.median, spans, strict=True) if math.isfinite(m)]
        return [line(start, at, end, at, look) for at, (start, end) in known]
    middles = [0.5 * (start + end) for start, end in spans]
    heights = [y(m) if math.isfinite(m) else math.nan for m in shown.median]
    return [polyline(list(zip(middles, heights, strict=True)), look)]


def _coordinate(cells: Cells, right: float) -> tuple[list[tuple[float, float]], list[Mark], float]:
    """Return where each cell begins and ends, the x axis, and the height of the picture."""
    edges = [float(e) for e in cells.edges]
    x = Scale(edges[0], edges[-1], LEFT, right)
    spans = [(x(a), x(b)) for a, b in pairwise(edges)]
    return spans, below(x, BOTTOM, cells.by), BOTTOM + 34


def _groups(cells: Cells, right: float) -> tuple[list[tuple[float, float]], list[Mark], float]:
    """Return the same for cells with labels; long ones stand upright."""
    longest = max(map(len, cells.labels))
    at = np.linspace(LEFT, right, 2 * len(cells.labels) + 1)[1::2]
    half = min(12.0, 0.4 * (right - LEFT) / len(at))
    upright = longest > LONG
    words = [
        _upright(float(at[k]) + 4, BOTTOM + 8, cells.labels[k])
        if upright
        else text(float(at[k]), BOTTOM + 14, cells.labels[k], "middle")
        for k in thinned(len(at), 22 if upright else 14)
    ]
    height = BOTTOM + (6.4 * longest + 12 if upright else 22)
    return [(v - half, v + half) for v in at.tolist()], words, height


def _upright(x: float, y: float, words: str) -> Mark:
    mark = text(x, y, words, "end")
    return mark._replace(attributes={**mark.attributes, "transform": f"rotate(-90 {px(x)} {px(y)})"})


@dataclass(frozen=True, eq=False)
class Plane:
    """Errors over two coordinates as they are drawn: a version of the model, median or rms, by output.

    `values`: version -> what -> (n_pose, cells) in the units of `titles`, three digits, None in an empty
    cell; cell `i + columns * j` lies at column i, row j. `full`: what -> (n_pose,), the size of
    the fullest colour.
    """

    by: str
    up: str
    edges: list[float]
    across: list[float]
    count: list[int]
    values: Mapping[str, Mapping[str, list[list[float | None]]]]
    full: Mapping[str, list[float]]


def planes(
    found: Mapping[str, Sequence[Cells]], floor: Mapping[str, float]
) -> tuple[list[tuple[str, str]], list[Plane]]:
    """Return name and unit of each output, and the maps over two coordinates.

    `found`: version of the model -> maps. An output has one unit in all maps. The fullest colour is the
    largest value of a map, in all versions, or the noise floor where that is more, so that mere noise stays
    pale.
    """
    flat = {version: [m for m in maps if len(m.across)] for version, maps in found.items()}
    every = [m for maps in flat.values() for m in maps]
    if not every:
        return [], []
    pose, turning = every[0].pose, every[0].turning
    sizes = [max(largest(m.rms[k]) for m in every) for k in range(len(pose))]
    scales = [scale(c, max(size, floor.get(c) or 0.0), turning) for c, size in zip(pose, sizes, strict=True)]
    out = []
    for same in zip(*flat.values(), strict=True):
        drawn: dict[str, dict[str, list[list[float | None]]]] = {}
        full = {}
        for what in ("median", "rms"):
            rows = [[f * getattr(m, what)[k] for k, (f, _) in enumerate(scales)] for m in same]
            least = [f * (floor.get(c) or 0.0) for c, (f, _) in zip(pose, scales, strict=True)]
            full[what] = [
                _digits(max(a, *(largest(r[k]) for r in rows))) or 1e-12 for k, a in enumerate(least)
            ]
            for version, row in zip(flat, rows, strict=True):
                drawn.setdefault(version, {})[what] = [[_digits(v) for v in values] for values in row]
        first = same[0]
        edges, across = (([float(f"{e:.6g}") for e in side]) for side in (first.edges, first.across))
        out.append(Plane(first.by, first.up, edges, across, first.count.tolist(), drawn, full))
    return [(name(c), unit) for c, (_, unit) in zip(pose, scales, strict=True)], out


def _digits(value: float) -> float | None:
    return float(f"{value:.3g}") if math.isfinite(value) else None


def plane(shown: Plane, version: str, what: str, output: int, title: tuple[str, str]) -> Chart:
    """Draw one output over two coordinates: the fuller the colour the larger, a dash where negative."""
    values, full = shown.values[version][what][output], shown.full[what][output]
    right, bottom = NARROW - RIM, TOP + NARROW - RIM - LEFT
    x = Scale(shown.edges[0], shown.edges[-1], LEFT, right)
    y = Scale(shown.across[0], shown.across[-1], bottom, TOP)
    quantity, unit = title
    words = f"{what} {quantity}, full: {three(full)} {unit}"
    parts = [text(0, 12, words, look="title"), *axis_beside(y, LEFT, LEFT, 4)]
    parts += below(x, bottom, f"{shown.by}, upwards {shown.up}")
    columns = len(shown.edges) - 1
    for k, value in enumerate(values):
        if value is None:
            continue
        i, j = k % columns, k // columns
        left, top = x(shown.edges[i]), y(shown.across[j + 1])
        width, height = x(shown.edges[i + 1]) - left, y(shown.across[j]) - top
        cells = f"{_span(shown.edges, i)}, {_span(shown.across, j)}"
        said = f"{cells}: {_number(value)} {unit}, {shown.count[k]} samples"
        look = "neg" if value < 0 else "pos"
        parts.append(rect(left, top, width, height, look, said, min(abs(value) / full, 1.0)))
        if value < -0.1 * full:
            middle = top + 0.5 * height
            parts.append(line(left + 0.3 * width, middle, left + 0.7 * width, middle, "dash"))
    most = _number(max((abs(v) for v in values if v is not None), default=math.nan))
    says = f"{what} error of {quantity} over {shown.by} and {shown.up}: {most} {unit} at most"
    place: dict[str, str | float | None] = {
        "class": "plane", "data-version": version, "data-what": what, "data-output": output,
    }  # fmt: skip
    return Chart(NARROW, bottom + 34, says, parts, place)


def _says(cells: Cells, shown: _Shown, k: int) -> str:
    """Return the numbers of a cell in words."""
    values = f"median {_number(shown.median[k])}, rms {_number(shown.rms[k])} {shown.unit}"
    return f"{_where(cells, k)}: {values}, {cells.count[k]:d} samples"


def _where(cells: Cells, k: int) -> str:
    return cells.labels[k] if cells.labels else _span(cells.edges, k)


def _span(edges: Sequence[float] | np.ndarray, k: int) -> str:
    return f"{_number(edges[k])} to {_number(edges[k + 1])}"


def _number(value: float) -> str:
    return label(float(f"{value:.3g}")) if math.isfinite(value) else "none"
