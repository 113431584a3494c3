"""Charts of bars and intervals: errors against the noise floor, effects, shares, values in their bounds.

Bars carry their names and numbers, so that nothing is told by colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from hallsym.report.page.marks import HALF, NARROW, RIM, Chart, Mark, Scale, below, dot, line, rect, text
from hallsym.report.words import name, scale, three

FAR = 12.0
"""Bars that differ by more than this factor are drawn on a logarithmic scale, as dots."""

LONGEST = 44
"""Characters of a label in a chart; the table under it has all of them."""

Rows = Mapping[str, tuple[str, Mapping[str, Mapping[str, float]]]]
"""Name -> (look, `{"rmse": {x_m: ..}, "peak": {..}}`)."""


def against_floor(
    rows: Rows, floor: Mapping[str, float], turning: Collection[str] | None = None
) -> list[Chart]:
    """Draw rmse and peak of every output: one bar per entry of `rows`, the noise floor as a dashed line.

    `turning`: outputs that go round, see `hallsym.units.readable`.
    """
    first = next(iter(rows.values()))[1]
    places = [(what, output) for what in ("rmse", "peak") for output in first[what]]
    far = any(_far([gap[what][output] for _, gap in rows.values()]) for what, output in places)
    return [
        _bars(what, output, rows, floor.get(output, 0.0) if what == "rmse" else 0.0, far, turning)
        for what, output in places
    ]


def _far(sizes: Sequence[float]) -> bool:
    positive = [v for v in sizes if v > 0]
    return len(positive) > 1 and max(positive) > FAR * min(positive)


def _bars(
    what: str, output: str, rows: Rows, floor: float, far: bool, turning: Collection[str] | None
) -> Chart:
    values = {label_: (look, gap[what][output]) for label_, (look, gap) in rows.items()}
    sizes = [v for _, v in values.values()] + ([floor] if floor > 0 else [])
    factor, unit = scale(output, max(sizes), turning)
    positive = [factor * v for v in sizes if v > 0]
    log = far and len(positive) > 1 and max(positive) > min(positive)
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
    return Chart(NARROW, height, f"{what} of {name(output)}: {said}", parts)


def intervals(rows: Sequence[tuple[str, float, tuple[float, float] | None]], title: str) -> Chart:
    """Draw a dot and its interval per row, in per cent."""
    ends = [v for _, value, span in rows for v in (value, *(span or ())) if math.isfinite(v)]
    x = Scale(100 * min([0.0, *ends]), 100 * max([0.01, *(1.05 * v for v in ends)]), RIM, HALF - 60)
    parts, middles = _rows(x, [(words, f"{100 * value:.1f} %") for words, value, _ in rows], title)
    for (_, value, span), y in zip(rows, middles, strict=True):
        if span is not None and all(map(math.isfinite, span)):
            low, high = x(100 * span[0]), x(100 * span[1])
            parts += [line(low, y, high, y, "whisker")]
            parts += [line(v, y - 4, v, y + 4, "whisker") for v in (low, high)]
        parts.append(dot(x(100 * value), y, 4.5, "after"))
    said = "; ".join(f"{words} {100 * value:.1f} %" for words, value, _ in rows)
    return Chart(HALF, middles[-1] + 44, f"{title}: {said}", parts)


def shares(rows: Sequence[tuple[str, float]], title: str) -> Chart:
    """Draw one bar per row, in per cent, longest first as given."""
    x = Scale(0.0, 102 * max([0.01, *(v for _, v in rows)]), RIM, HALF - 60)
    parts, middles = _rows(x, [(words, f"{100 * value:.0f} %") for words, value in rows], title)
    parts += [
        rect(x.start, y - 5, x(100 * value) - x.start, 10, "before")
        for (_, value), y in zip(rows, middles, strict=True)
    ]
    said = "; ".join(f"{words} {100 * value:.0f} %" for words, value in rows)
    return Chart(HALF, middles[-1] + 44, f"{title}: {said}", parts)


def _rows(x: Scale, rows: Sequence[tuple[str, str]], title: str) -> tuple[list[Mark], list[float]]:
    """Return axis, labels above their rows and values beside them, and the middles of the rows."""
    top, step = 6.0, 31.0
    middles = [top + step * k + 22 for k in range(len(rows))]
    parts = below(x, middles[-1] + 10, most=6, top=top)
    parts.append(text(HALF / 2, middles[-1] + 39, title, "middle", "soft"))
    parts.append(line(x(0), top, x(0), middles[-1] + 10, "axis"))
    for (words, value), y in zip(rows, middles, strict=True):
        parts += [text(x.start + 2, y - 9, _brief(words)), text(HALF - 52, y + 4, value)]
    return parts, middles


def _brief(words: str) -> str:
    return words if len(words) <= LONGEST else f"{words[: LONGEST - 1]}…"


def in_bounds(value: float, std: float, lower: float, upper: float, nominal: float) -> Chart | None:
    """Draw where a value lies between its bounds, with two standard uncertainties and the nominal value."""
    if not (math.isfinite(lower) and math.isfinite(upper) and upper > lower):
        return None
    x = Scale(lower, upper, 4.0, 116.0)
    parts = [line(4, 9, 116, 9, "axis"), line(4, 4, 4, 14, "axis"), line(116, 4, 116, 14, "axis")]
    parts.append(line(x(nominal), 5, x(nominal), 13, "stem"))
    if math.isfinite(std):
        parts.append(line(x(value - 2 * std), 9, x(value + 2 * std), 9, "whisker"))
    parts.append(dot(x(value), 9, 3.5, "after" if math.isfinite(std) else "minus"))
    says = f"at {100 * (value - lower) / (upper - lower):.0f} % of the way from lower to upper bound"
    return Chart(120, 18, says, parts, {"class": "mark"})
