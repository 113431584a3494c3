"""Charts in a frame, a title, two axes and layers drawn over them, and charts of one row per value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from hallsym.report.page.marks import (
    LETTER,
    Chart,
    Mark,
    Scale,
    axis,
    dot,
    line,
    polyline,
    rect,
    text,
)

HALF, NARROW = 360.0, 240.0
"""Width of a picture of which two stand side by side, a phone's width, and of one of three [px]."""
LEFT, TOP, RIM = 54.0, 22.0, 14.0
"""What five digits, a title, and half a number at the right end of an axis need [px]."""
LOOKS = {1: ("",), 2: ("0", "")}
"""Endings of the looks of one version of a model, and of the first, pale one of two."""
LONGEST = 44
"""Characters of a label in a chart; the table under it has all of them."""

Layer = Callable[[Scale, Scale], Iterable[Mark]]
"""What is drawn on two scales, across and up."""


def framed(
    title: str, says: str, x: Scale, y: Scale, layers: Sequence[Layer], *, width: float = NARROW,
    height: float = 90.0, grid: bool = True, attributes: Mapping[str, str | float | None] | None = None,
) -> Chart:  # fmt: skip
    """Draw layers over the axes of two scales; `height`: of the y axis."""
    right, bottom = width - RIM, TOP + height
    across, up = x.between(LEFT, right), y.between(bottom, TOP)
    marks = [
        text(0, 12, title, look="title"),
        axis(up, LEFT, right if grid else None, up=True),
        axis(across, bottom),
    ]
    marks += [mark for layer in layers for mark in layer(across, up)]
    return Chart(width, bottom + x.depth, says, marks, attributes or {})


def curve(xs: Iterable[float], ys: Iterable[float], look: str) -> Layer:
    """Return a line, interrupted at nan."""
    return lambda x, y: [polyline([(x(a), y(b)) for a, b in zip(xs, ys, strict=True)], look)]


def area(xs: Iterable[float], low: Iterable[float], high: Iterable[float], look: str) -> Layer:
    """Return what lies between two lines."""
    upper, lower = [*zip(xs, high, strict=True)], [*zip(xs, low, strict=True)]
    return lambda x, y: [polyline([(x(a), y(b)) for a, b in (*upper, *lower[::-1])], look)]


def level(value: float) -> Layer:
    """Return a dashed line across; none at 0."""
    return lambda x, y: [line(x.start, y(value), x.end, y(value), "level")] if value else []


def boxes(
    spans: Iterable[tuple[float, float]], sizes: Iterable[float], said: Iterable[str], look: str
) -> Layer:
    """Return boxes of a size up and down from 0, where it is known; `said`: shows when pointed at."""
    known = [box for box in zip(spans, sizes, said, strict=True) if math.isfinite(box[1])]
    return lambda x, y: [
        rect(x(a), y(v), x(b) - x(a), y(-v) - y(v), look, words) for (a, b), v, words in known
    ]


def remark(at: float, words: str) -> Layer:
    """Return words above the frame."""
    return lambda x, y: [text(x(at), y.end - 2, words, "middle", "soft")]


class Row(NamedTuple):
    """A value with its name, as it is `shown`; with a `span` it is a dot with its interval, else a bar."""

    name: str
    value: float
    shown: str
    span: tuple[float, float] | None = None
    look: str = "after"


def rows(
    title: str, says: str, x: Scale, found: Sequence[Row], *, floor: float = 0.0, width: float = NARROW
) -> Chart:
    """Draw one row per value; names stand beside the bars, long ones above them; `floor` is dashed.

    On a logarithmic scale, which has no zero, dots on stems stand for bars.
    """
    room = LETTER * max(len(row.name) for row in found) + 10
    above = room > 0.4 * width
    step, bottom = 32.0 if above else 19.0, TOP + 2
    x, bottom = x.between(RIM if above else room, width - 48), bottom + step * len(found)
    zero = x(max(x.low, 0.0))
    marks = [text(0, 12, title, look="title"), axis(x, bottom, TOP), line(zero, TOP, zero, bottom, "axis")]
    for k, row in enumerate(found):
        y, at = TOP + 2 + step * (k + 1) - 10, x(row.value)
        name = row.name if len(row.name) <= LONGEST else f"{row.name[: LONGEST - 1]}…"
        marks.append(text(0, y - 10 if above else y + 4, name))
        marks.append(text(width - 2, y + 4, row.shown, "end"))
        if row.span is None and not x.log:
            marks.append(rect(min(zero, at), y - 6, abs(at - zero), 12, row.look))
            continue
        if row.span is None:
            marks.append(line(zero, y, at, y, "axis"))
        elif all(map(math.isfinite, row.span)):
            low, high = map(x, row.span)
            marks += [
                line(a, y - b, c, y + b, "whisker")
                for a, b, c in ((low, 0, high), (low, 4, low), (high, 4, high))
            ]
        marks.append(dot(at, y, 4.5, row.look))
    marks += [line(x(floor), TOP - 3, x(floor), bottom, "level")] if floor > 0 else []
    return Chart(width, bottom + x.depth, says, marks)
