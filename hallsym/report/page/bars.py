"""Charts of bars and intervals: errors against the noise floor, effects, shares, values in their bounds.

Bars carry their names and numbers, so that nothing is told by colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from hallsym.report.page.marks import NARROW, WIDE, Chart, Scale, below, dot, line, rect, text
from hallsym.report.words import name, scale, three

FAR = 12.0
"""Bars that differ by more than this factor are drawn on a logarithmic scale, as dots."""

LONGEST = 44
"""Characters of a label beside a chart; the table under it has all of them."""

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
    left, top, step = _room([r[0] for r in rows]), 8.0, 22.0
    bottom = top + step * len(rows)
    ends = [v for _, value, span in rows for v in (value, *(span or ())) if math.isfinite(v)]
    x = Scale(min([0.0, *ends]), max([0.01, *(1.05 * v for v in ends)]), left, WIDE - 70)
    scaled = Scale(100 * x.low, 100 * x.high, left, WIDE - 70)
    parts = below(scaled, bottom, title, most=6, top=top)
    parts.append(line(x(0), top, x(0), bottom, "axis"))
    for k, (words, value, span) in enumerate(rows):
        y = top + step * (k + 0.5)
        parts.append(text(left - 8, y + 4, _brief(words), "end"))
        if span is not None:
            low, high = x(span[0]), x(span[1])
            parts += [line(low, y, high, y, "whisker")]
            parts += [line(v, y - 4, v, y + 4, "whisker") for v in (low, high)]
        parts.append(dot(x(value), y, 4.5, "after"))
        parts.append(text(WIDE - 62, y + 4, f"{100 * value:.1f} %"))
    said = "; ".join(f"{words} {100 * value:.1f} %" for words, value, _ in rows)
    return Chart(WIDE, bottom + 34, f"{title}: {said}", parts)


def shares(rows: Sequence[tuple[str, float]], title: str) -> Chart:
    """Draw one bar per row, in per cent, longest first as given."""
    left, top, step = _room([r[0] for r in rows]), 6.0, 19.0
    bottom = top + step * len(rows)
    x = Scale(0.0, 102 * max([0.01, *(v for _, v in rows)]), left, WIDE - 60)
    parts = below(x, bottom, title, most=6, top=top)
    for k, (words, value) in enumerate(rows):
        y = top + step * (k + 0.5)
        parts += [
            text(left - 8, y + 4, _brief(words), "end"),
            rect(left, y - 6, x(100 * value) - left, 12, "before"),
        ]
        parts.append(text(x(100 * value) + 6, y + 4, f"{100 * value:.0f} %"))
    said = "; ".join(f"{words} {100 * value:.0f} %" for words, value in rows)
    return Chart(WIDE, bottom + 34, f"{title}: {said}", parts)


def _room(labels: Sequence[str]) -> float:
    return 20.0 + 6.6 * max((len(_brief(words)) for words in labels), default=0)


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
