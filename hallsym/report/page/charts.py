"""What charts are made of: scales, axes, shapes, frames and rows; coordinates in px with two decimals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hallsym.report.words import MINUS, thinned

LETTER = 6.4
"""Width of a letter [px], with room to spare."""
LONG = 4
"""Names with more characters stand upright below an axis."""


class Mark(NamedTuple):
    """One SVG element: attributes that are None are left out; `title` shows when pointed at."""

    name: str
    attributes: Mapping[str, str | float | None]
    words: str = ""
    title: str = ""
    parts: Sequence[Mark] = ()


@dataclass(frozen=True, eq=False)
class Chart:
    """A picture of `width` x `height` px; `says` is read out in its place."""

    width: float
    height: float
    says: str
    marks: Sequence[Mark]
    attributes: Mapping[str, str | float | None] = field(default_factory=dict)

    @property
    def box(self) -> str:
        """The `viewBox`."""
        return f"0 0 {px(self.width)} {px(self.height)}"


@dataclass(frozen=True)
class Scale:
    """Values `low` to `high` drawn at px `start` to `end`; values beyond stay at the end.

    Its axis has a `title` and about `most` numbers, or `names`, each in the middle of a cell, 1 wide, from
    `low` on.
    """

    low: float
    high: float
    start: float = 0.0
    end: float = 1.0
    log: bool = False
    title: str = ""
    most: int = 4
    names: Sequence[str] = ()

    def __call__(self, value: float) -> float:
        """Return the px of a value."""
        if self.log:
            value = max(value, self.low)
            part = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            part = (value - self.low) / (self.high - self.low)
        return self.start + min(max(part, 0.0), 1.0) * (self.end - self.start)

    def between(self, start: float, end: float) -> Scale:
        """Return the scale drawn elsewhere."""
        return replace(self, start=start, end=end)

    def ticks(self) -> list[float]:
        """Return round values inside."""
        return (decades if self.log else ticks)(self.low, self.high, self.most)

    @property
    def upright(self) -> bool:
        """Whether the names stand upright."""
        return max(map(len, self.names), default=0) > LONG

    @property
    def depth(self) -> float:
        """The px that numbers or names and title take below an x axis."""
        return (LETTER * max(map(len, self.names)) + 12 if self.upright else 20) + (14 if self.title else 0)


def ticks(low: float, high: float, most: int = 4) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of ten from `low` to `high`, at most `most` + 1."""
    if not high > low:
        return [low]
    unit = 10.0 ** math.floor(math.log10((high - low) / most))
    for step in (s * unit for s in (0.5, 1, 2, 5, 10)):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first <= most:
            break
    return [k * step for k in range(first, last + 1)]


def decades(low: float, high: float, most: int) -> list[float]:
    """Return 1, 2, 5 times powers of ten from `low` to `high`, fewer over many decades."""
    spans = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for factors in ((1, 2, 5), (1, 3), (1,)):
        found = [f * 10.0**e for e in spans for f in factors if low * 0.999 <= f * 10.0**e <= high * 1.001]
        if len(found) <= most + 1:
            break
    return found[:: -(-len(found) // (most + 1))] if found else [low]


def label(value: float) -> str:
    """Return a tick's text: up to four digits, a true minus sign."""
    text = f"{value:.4g}"
    if "e" in text and 1e-4 < abs(value) < 1e6:
        text = np.format_float_positional(float(text), trim="-")
    return ("0" if float(text) == 0 else text).replace("-", MINUS)


def px(value: float) -> str:
    """Return a coordinate with at most two decimals."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def text(
    x: float, y: float, words: str, anchor: str | None = None, look: str | None = None, *,
    upright: bool = False,
) -> Mark:  # fmt: skip
    """Return words whose baseline starts, ends or is centred (`middle`) at (x, y)."""
    turn = f"rotate(-90 {px(x)} {px(y)})" if upright else None
    place = {"x": px(x), "y": px(y), "text-anchor": anchor, "class": look, "transform": turn}
    return Mark("text", place, words)


def path(steps: str, look: str) -> Mark:
    """Return a line or an outline."""
    return Mark("path", {"d": steps, "class": look})


def line(x1: float, y1: float, x2: float, y2: float, look: str) -> Mark:
    """Return a straight line."""
    return path(f"M{px(x1)} {px(y1)}L{px(x2)} {px(y2)}", look)


def polyline(points: Sequence[tuple[float, float]], look: str) -> Mark:
    """Return a line through points, interrupted where a coordinate is nan."""
    steps, pen = "", "M"
    for x, y in points:
        known = not (math.isnan(x) or math.isnan(y))
        steps += f"{pen}{px(x)} {px(y)}" if known else ""
        pen = "L" if known else "M"
    return path(steps, look)


def rect(x: float, y: float, width: float, height: float, look: str, title: str = "") -> Mark:
    """Return a rectangle."""
    place = {"x": px(x), "y": px(y), "width": px(max(width, 0.0)), "height": px(height), "class": look}
    return Mark("rect", place, title=title)


def dot(x: float, y: float, radius: float, look: str) -> Mark:
    """Return a disc."""
    return Mark("circle", {"cx": px(x), "cy": px(y), "r": px(radius), "class": look})


def tile(x: float, y: float, width: float, height: float, part: float, title: str) -> list[Mark]:
    """Return a cell of a map, fuller the larger `part` (-1 to 1), with a dash where it is negative."""
    fill = rect(x, y, width, height, "neg" if part < 0 else "pos", title)
    full = fill._replace(attributes={**fill.attributes, "fill-opacity": px(min(abs(part), 1.0))})
    middle = y + 0.5 * height
    return [full, *([line(x + 0.3 * width, middle, x + 0.7 * width, middle, "dash")] if part < -0.1 else [])]


def axis(scale: Scale, at: float, grid: float | None = None, *, up: bool = False) -> Mark:
    """Return an axis at y = `at`, or `up` one at x = `at`: numbers or names, title, grid lines to `grid`."""

    def stroke(a: float, b: float, c: float, d: float, look: str = "axis") -> Mark:
        return line(b, a, d, c, look) if up else line(a, b, c, d, look)

    parts = [stroke(scale.start, at, scale.end, at)]
    names = thinned(len(scale.names), 22 if scale.upright else 14) if scale.names else []
    for k in names:
        x, y = scale(scale.low + k + 0.5), at + (8 if scale.upright else 14)
        mark = text(x + 4, y, scale.names[k], "end", upright=True)
        parts.append(mark if scale.upright else text(x, y, scale.names[k], "middle"))
    for value in scale.ticks() if not scale.names else []:
        v = scale(value)
        if grid is not None:
            parts.append(stroke(v, at, v, grid, "axis" if value == 0 else "gridline"))
        parts.append(stroke(v, at - 4 if up else at + 4, v, at))
        words = label(value)
        parts.append(text(at - 6, v + 4, words, "end") if up else text(v, at + 15, words, "middle"))
    if scale.title:
        middle = (scale.start + scale.end) / 2
        parts.append(text(middle, at + scale.depth - 5, scale.title, "middle", "soft"))
    return Mark("g", {"class": "up" if up else "across"}, parts=parts)


# -- charts in a frame: a title, two axes and layers drawn over them; and charts of one row per value ----


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
