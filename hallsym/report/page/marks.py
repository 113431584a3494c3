"""What charts are made of: scales, ticks, axes, shapes; coordinates in px with two decimals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hallsym.report.words import MINUS

HALF, NARROW = 360.0, 240.0
"""Width of a picture of which two stand side by side, a phone's width, and of one of three [px]."""
RIM = 14.0
"""What half a number at the right end of an axis needs [px]."""


class Mark(NamedTuple):
    """One SVG element: attributes that are None are left out; `title` shows when pointed at."""

    name: str
    attributes: Mapping[str, str | float | None]
    words: str = ""
    title: str = ""
    parts: tuple[Mark, ...] = ()


@dataclass(frozen=True, eq=False)
class Chart:
    """A picture of `width` x `height` px; `says` is read out in its place."""

    width: float
    height: float
    says: str
    marks: list[Mark]
    attributes: Mapping[str, str | float | None] = field(default_factory=dict)

    @property
    def box(self) -> str:
        """The `viewBox`."""
        return f"0 0 {px(self.width)} {px(self.height)}"


@dataclass(frozen=True)
class Scale:
    """Values `low` to `high` drawn at px `start` to `end`; values beyond stay at the end."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value: float) -> float:
        """Return the px of a value."""
        if self.log:
            value = max(value, self.low)
            part = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            part = (value - self.low) / (self.high - self.low)
        return self.start + min(max(part, 0.0), 1.0) * (self.end - self.start)

    def ticks(self, most: int = 4) -> list[float]:
        """Return round values inside, about `most` of them."""
        return decades(self.low, self.high, most) if self.log else ticks(self.low, self.high, most)


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


def text(x: float, y: float, words: str, anchor: str | None = None, look: str | None = None) -> Mark:
    """Return words whose baseline starts, ends or is centred (`middle`) at (x, y)."""
    return Mark("text", {"x": px(x), "y": px(y), "text-anchor": anchor, "class": look}, words)


def line(x1: float, y1: float, x2: float, y2: float, look: str) -> Mark:
    """Return a straight line."""
    return path(f"M{px(x1)} {px(y1)}L{px(x2)} {px(y2)}", look)


def path(steps: str, look: str) -> Mark:
    """Return a line or an outline."""
    return Mark("path", {"d": steps, "class": look})


def rect(
    x: float, y: float, width: float, height: float, look: str, title: str = "", part: float | None = None
) -> Mark:
    """Return a rectangle; `part`: how opaque its fill is."""
    place: dict[str, str | None] = {
        "x": px(x),
        "y": px(y),
        "width": px(max(width, 0.0)),
        "height": px(height),
        "class": look,
    }
    place["fill-opacity"] = None if part is None else px(part)
    return Mark("rect", place, title=title)


def dot(x: float, y: float, radius: float, look: str, title: str = "") -> Mark:
    """Return a disc."""
    return Mark("circle", {"cx": px(x), "cy": px(y), "r": px(radius), "class": look}, title=title)


def polyline(points: Sequence[tuple[float, float]], look: str) -> Mark:
    """Return a line through points, interrupted where a coordinate is nan."""
    parts, pen = [], "M"
    for x, y in points:
        if math.isnan(x) or math.isnan(y):
            pen = "M"
            continue
        parts.append(f"{pen}{px(x)} {px(y)}")
        pen = "L"
    return path("".join(parts), look)


def below(scale: Scale, y: float, title: str = "", most: int = 4, top: float | None = None) -> list[Mark]:
    """Return the x axis at `y`: line, ticks, numbers, title, and grid lines up to `top`."""
    parts = [line(scale.start, y, scale.end, y, "axis")]
    for value in scale.ticks(most):
        at = scale(value)
        if top is not None:
            parts.append(line(at, y, at, top, "gridline"))
        parts += [line(at, y, at, y + 4, "tick"), text(at, y + 15, label(value), "middle")]
    if title:
        parts.append(text((scale.start + scale.end) / 2, y + 29, title, "middle", "soft"))
    return parts


def beside(scale: Scale, x: float, right: float, most: int = 6) -> list[Mark]:
    """Return the y axis at `x`: line, ticks, numbers, and grid lines up to `right`."""
    parts = [line(x, scale.start, x, scale.end, "axis")]
    for value in scale.ticks(most):
        at = scale(value)
        look = "zero" if value == 0 else "gridline"
        parts += [line(x, at, right, at, look), line(x - 4, at, x, at, "tick")]
        parts.append(text(x - 6, at + 4, label(value), "end"))
    return parts
