"""Charts of a page as inline SVG: bars against the noise floor, profiles, maps, intervals, shares.

Nothing is told by colour alone: bars carry their names, signs are filled or hollow, sizes are areas.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hallsym.page.cells import Cells
from hallsym.page.html import Markup, join, tag
from hallsym.page.svg import (
    Scale,
    below,
    beside,
    chart,
    dot,
    label,
    line,
    polyline,
    px,
    rect,
    text,
)
from hallsym.plots.names import largest, name, scale, three, thinned

WIDE, NARROW = 740.0, 240.0
RIM = 14.0  # px: half a number at the right end of an axis
FAR = 12.0
"""Bars that differ by more than this factor are drawn on a logarithmic scale, as dots."""

Rows = Mapping[str, tuple[str, Mapping[str, Mapping[str, float]]]]
"""Name -> (look, `{"rmse": {x_m: ..}, "peak": {..}}`)."""


def against_floor(rows: Rows, floor: Mapping[str, float]) -> Markup:
    """Draw rmse and peak of every output: one bar per entry of `rows`, the noise floor as a dashed line."""
    first = next(iter(rows.values()))[1]
    panels = [
        _bars(what, output, rows, floor.get(output, 0.0) if what == "rmse" else 0.0)
        for what in ("rmse", "peak")
        for output in first[what]
    ]
    return tag("div", *panels, class_="panels")


def _bars(what: str, output: str, rows: Rows, floor: float) -> Markup:
    values = {label_: (look, gap[what][output]) for label_, (look, gap) in rows.items()}
    sizes = [v for _, v in values.values()] + ([floor] if floor > 0 else [])
    factor, unit = scale(output, max(sizes))
    positive = [factor * v for v in sizes if v > 0]
    log = len(positive) > 1 and max(positive) > FAR * min(positive)
    left, top, step = 64.0, 24.0, 19.0
    bottom = top + step * len(values) + 2
    high = 1.02 * max(positive, default=1.0)
    x = Scale(min(positive) / 1.6 if log else 0.0, high, left, NARROW - 44, log)
    title = f"{what} {name(output)} [{unit}]"
    parts = [text(0, 12, title, look="title"), *below(x, bottom, most=4, top=top)]
    for k, (words, (look, value)) in enumerate(values.items()):
        middle, end = top + step * (k + 0.5), x(factor * value)
        parts.append(text(left - 6, middle + 4, words, "end"))
        if log:
            parts += [line(left, middle, end, middle, "stem"), dot(end, middle, 4.5, look)]
        else:
            parts.append(rect(left, middle - 6, end - left, 12, look))
        parts.append(text(end + 8, middle + 4, three(factor * value)))
    height = bottom + 20
    if floor > 0:
        at = x(factor * floor)
        parts.append(line(at, top - 3, at, bottom, "floor"))
    said = "; ".join(f"{words} {three(factor * v)} {unit}" for words, (_, v) in values.items())
    if floor > 0:
        said += f"; noise floor {three(factor * floor)} {unit}"
    return chart(NARROW, height, f"{what} of {name(output)}: {said}", *parts)


def profile(cells: Cells, output: int, floor: float = 0.0) -> Markup:
    """Draw median (line) and rms (band of plus and minus rms) of one output by cell; `floor` [SI] is dashed."""
    factor, unit = scale(cells.pose[output], max(largest(cells.rms[output]), largest(cells.median[output])))
    median, rms = factor * cells.median[output], factor * cells.rms[output]
    width = WIDE if cells.labels else NARROW
    turned = bool(cells.labels) and max(map(len, cells.labels)) > 4
    left, top, bottom = 40.0, 22.0, 112.0
    reach = 1.08 * max(largest(rms), largest(median), factor * floor) or 1.0
    y = Scale(-reach, reach, bottom, top)
    parts = [text(0, 11, f"{name(cells.pose[output])} [{unit}]", look="title"), *beside(y, left, width - RIM)]
    height = bottom + 34
    if cells.labels:
        at = np.linspace(left, width - RIM, 2 * len(cells.labels) + 1)[1::2]
        half = min(12.0, 0.4 * (width - left) / len(at))
        longest = max(map(len, cells.labels))
        parts += _words(cells, at, bottom, turned)
        height = bottom + (6.2 * longest + 12 if turned else 22)
    else:
        edges = np.asarray(cells.edges)
        x = Scale(float(edges[0]), float(edges[-1]), left, width - RIM)
        parts += below(x, bottom, cells.by)
        at = np.array([x(v) for v in 0.5 * (edges[1:] + edges[:-1])])
        half = 0.5 * (width - RIM - left) / len(at)
    for k, (px_, m, r) in enumerate(zip(at, median, rms, strict=True)):
        if not math.isfinite(r):
            continue
        parts.append(rect(px_ - half, y(r), 2 * half, y(-r) - y(r), "band", _cell_title(cells, output, k)))
    for px_, m in zip(at, median, strict=True):
        if math.isfinite(m):
            parts.append(line(px_ - half, y(m), px_ + half, y(m), "median"))
    if floor > 0:
        parts += [line(left, y(v), width - RIM, y(v), "level") for v in (factor * floor, -factor * floor)]
    if cells.labels and cells.marked:
        for k in cells.marked:
            parts.append(text(at[k], top - 2, "h", "middle", "soft"))
    joined = [(float(a), y(m) if math.isfinite(m) else float("nan")) for a, m in zip(at, median, strict=True)]
    if not cells.labels:
        parts.append(polyline(joined, "median"))
    worst = int(np.nanargmax(rms)) if np.isfinite(rms).any() else 0
    says = f"{name(cells.pose[output])} by {cells.by}: largest rms {_cell_title(cells, output, worst)}"
    return chart(width, height, says, *parts)


def _words(cells: Cells, at: np.ndarray, bottom: float, turned: bool) -> list[Markup]:
    parts = []
    for k in thinned(len(at), 60 if turned else 30):
        x, y = float(at[k]), bottom + 14
        if turned:
            turn = f"rotate(-90 {px(x + 4)} {px(y - 6)})"
            words = tag(
                "text", cells.labels[k], x=px(x + 4), y=px(y - 6), text_anchor="end", transform=turn
            )
            parts.append(words)
        else:
            parts.append(text(x, y, cells.labels[k], "middle"))
    return parts


def _cell_title(cells: Cells, output: int, k: int) -> str:
    factor, unit = scale(cells.pose[output], largest(cells.rms[output]))
    where = cells.labels[k] if cells.labels else f"{label(cells.edges[k])} to {label(cells.edges[k + 1])}"
    median, rms = factor * cells.median[output][k], factor * cells.rms[output][k]
    return f"{where}: median {label(_three(median))}, rms {label(_three(rms))} {unit}, {cells.count[k]:d} samples"


def _three(value: float) -> float:
    return float(f"{value:.3g}") if math.isfinite(value) else value


def plane(cells: Cells, output: int, floor: float = 0.0) -> Markup:
    """Draw the median of one output over two coordinates: squares whose area is its size, hollow if negative.

    A full cell is the largest median, or `floor` [SI] where that is more, so that mere noise stays small.
    """
    full = max(largest(cells.median[output]), floor) or 1e-12
    factor, unit = scale(cells.pose[output], full)
    median, n = factor * cells.median[output], len(cells.edges) - 1
    left, top, right = 40.0, 24.0, NARROW - RIM
    x = Scale(float(cells.edges[0]), float(cells.edges[-1]), left, right)
    bottom = top + (right - left)
    other = np.asarray(cells.across)
    y = Scale(float(other[0]), float(other[-1]), bottom, top)
    side = (right - left) / n, (bottom - top) / (len(other) - 1)
    parts = [text(0, 12, f"{name(cells.pose[output])}, full cell: {three(factor * full)} {unit}", look="title")]
    parts += below(x, bottom, cells.by)
    parts += [line(left, top, left, bottom, "axis")]
    for value in y.ticks():
        parts += [line(left - 4, y(value), left, y(value), "tick")]
        parts.append(text(left - 6, y(value) + 4, label(value), "end"))
    for k, m in enumerate(median):
        if not math.isfinite(m):
            continue
        i, j = k % n, k // n
        cx, cy = left + (i + 0.5) * side[0], bottom - (j + 0.5) * side[1]
        parts.append(rect(cx - side[0] / 2, cy - side[1] / 2, side[0], side[1], "cell"))
        half = 0.46 * math.sqrt(abs(m) / (factor * full))
        look = "plus" if m > 0 else "minus"
        title = (
            f"{label(cells.edges[i])} to {label(cells.edges[i + 1])}, {label(other[j])} to {label(other[j + 1])}: "
            f"median {label(_three(m))}, rms {label(_three(factor * cells.rms[output][k]))} {unit}, "
            f"{cells.count[k]:d} samples"
        )
        parts.append(
            rect(cx - half * side[0], cy - half * side[1], 2 * half * side[0], 2 * half * side[1], look, title)
        )
    says = (
        f"median error of {name(cells.pose[output])} over {cells.by} and {cells.up}: "
        f"{label(_three(largest(median)))} {unit} at most"
    )
    return chart(NARROW, bottom + 34, says, *parts)


def intervals(rows: Sequence[tuple[str, float, tuple[float, float] | None]], title: str) -> Markup:
    """Draw a dot and its interval per row, in per cent."""
    left, top, step = _room([r[0] for r in rows]), 8.0, 22.0
    bottom = top + step * len(rows)
    ends = [v for _, value, span in rows for v in (value, *(span or ())) if math.isfinite(v)]
    x = Scale(min(0.0, *ends), max(1.05 * max(ends, default=1.0), 0.01), left, WIDE - 70)
    scaled = Scale(100 * x.low, 100 * x.high, left, WIDE - 70)
    parts = below(scaled, bottom, title, most=6, top=top)
    parts.append(line(x(0), top, x(0), bottom, "axis"))
    for k, (words, value, span) in enumerate(rows):
        y = top + step * (k + 0.5)
        parts.append(text(left - 8, y + 4, words, "end"))
        if span is not None:
            low, high = x(span[0]), x(span[1])
            parts += [line(low, y, high, y, "whisker")]
            parts += [line(v, y - 4, v, y + 4, "whisker") for v in (low, high)]
        parts.append(dot(x(value), y, 4.5, "after"))
        parts.append(text(WIDE - 62, y + 4, f"{100 * value:.1f} %"))
    said = "; ".join(f"{words} {100 * value:.1f} %" for words, value, _ in rows)
    return tag("div", chart(WIDE, bottom + 34, f"{title}: {said}", *parts), class_="scroll", tabindex="0")


def shares(rows: Sequence[tuple[str, float]], title: str) -> Markup:
    """Draw one bar per row, in per cent, longest first as given."""
    left, top, step = _room([r[0] for r in rows]), 6.0, 19.0
    bottom = top + step * len(rows)
    x = Scale(0.0, 100 * max(0.01, *(v for _, v in rows)) * 1.02, left, WIDE - 60)
    parts = below(x, bottom, title, most=6, top=top)
    for k, (words, value) in enumerate(rows):
        y = top + step * (k + 0.5)
        parts += [text(left - 8, y + 4, words, "end"), rect(left, y - 6, x(100 * value) - left, 12, "before")]
        parts.append(text(x(100 * value) + 6, y + 4, f"{100 * value:.0f} %"))
    said = "; ".join(f"{words} {100 * value:.0f} %" for words, value in rows)
    return tag("div", chart(WIDE, bottom + 34, f"{title}: {said}", *parts), class_="scroll", tabindex="0")


def _room(labels: Sequence[str]) -> float:
    return min(320.0, 20.0 + 6.4 * max(map(len, labels), default=0))


def in_bounds(value: float, std: float, lower: float, upper: float, nominal: float) -> Markup:
    """Draw where a value lies between its bounds, with two standard uncertainties and the nominal value."""
    if not (math.isfinite(lower) and math.isfinite(upper) and upper > lower):
        return Markup("")
    x = Scale(lower, upper, 4.0, 116.0)
    parts = [line(4, 9, 116, 9, "axis"), line(4, 4, 4, 14, "axis"), line(116, 4, 116, 14, "axis")]
    parts.append(line(x(nominal), 5, x(nominal), 13, "stem"))
    if math.isfinite(std):
        parts.append(line(x(value - 2 * std), 9, x(value + 2 * std), 9, "whisker"))
        parts.append(dot(x(value), 9, 3.5, "after"))
    else:
        parts.append(dot(x(value), 9, 3.5, "minus"))
    says = f"at {100 * (value - lower) / (upper - lower):.0f} % of the way from lower to upper bound"
    return chart(120, 18, says, *parts, class_="mark")


def panels(pictures: Sequence[Markup], look: str = "panels") -> Markup:
    """Lay pictures side by side, as many as fit."""
    return tag("div", *pictures, class_=look)


def stacked(pictures: Sequence[Markup]) -> Markup:
    """Lay wide pictures one under the other; they scroll where the window is narrow."""
    return join(tag("div", picture, class_="scroll", tabindex="0") for picture in pictures)
