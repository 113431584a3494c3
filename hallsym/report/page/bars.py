"""Charts of bars and intervals: errors against the noise floor, effects, shares, values in their bounds.

Bars carry their names and numbers, so that nothing is told by colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from hallsym.report.page.frames import HALF, Row, rows
from hallsym.report.page.marks import Chart, Scale, dot, line
from hallsym.report.words import name, scale, three

FAR = 12.0
"""Bars that differ by more than this factor are drawn on a logarithmic scale, as dots."""

Rows = Mapping[str, tuple[str, Mapping[str, Mapping[str, float]]]]
"""Name -> (look, `{"rmse": {x_m: ..}, "peak": {..}}`)."""


def against_floor(
    found: Rows, floor: Mapping[str, float], turning: Collection[str] | None = None
) -> list[Chart]:
    """Draw rmse and peak of every output: one bar per entry of `found`, the noise floor as a dashed line.

    `turning`: outputs that go round, see `hallsym.units.readable`.
    """
    first = next(iter(found.values()))[1]
    places = {
        (what, c): [gap[what][c] for _, gap in found.values()]
        for what in ("rmse", "peak")
        for c in first[what]
    }
    far = any(max(sizes) > FAR * min(v for v in sizes if v > 0) for sizes in places.values() if any(sizes))
    charts = []
    for (what, output), sizes in places.items():
        least = floor.get(output, 0.0) if what == "rmse" else 0.0
        factor, unit = scale(output, max(*sizes, least), turning)
        entries = [
            Row(label, factor * v, three(factor * v), look=look)
            for (label, (look, _)), v in zip(found.items(), sizes, strict=True)
        ]
        positive = [factor * v for v in (*sizes, least) if v > 0]
        log = far and len(set(positive)) > 1
        x = Scale(min(positive) / 1.6 if log else 0.0, 1.02 * max(positive, default=1.0), log=log)
        said = "; ".join(f"{row.name} {row.shown} {unit}" for row in entries)
        said += f"; noise floor {three(factor * least)} {unit}" if least > 0 else ""
        title = f"{what} {name(output)} [{unit}]"
        charts.append(rows(title, f"{what} of {name(output)}: {said}", x, entries, floor=factor * least))
    return charts


def shares(
    found: Sequence[tuple[str, float, tuple[float, float] | None]],
    title: str,
    digits: int = 0,
    look: str = "after",
) -> Chart:
    """Draw one share per row, in per cent: a dot with its interval, or a bar where there is none."""
    entries = [
        Row(words, 100 * value, f"{100 * value:.{digits}f} %", span and (100 * span[0], 100 * span[1]), look)
        for words, value, span in found
    ]
    ends = [v for row in entries for v in (row.value, *(row.span or ())) if math.isfinite(v)]
    x = Scale(min([0.0, *ends]), max([1.0, *(1.05 * v for v in ends)]), most=6)
    return rows(
        title, f"{title}: {'; '.join(f'{row.name} {row.shown}' for row in entries)}", x, entries, width=HALF
    )


def in_bounds(value: float, std: float, lower: float, upper: float, nominal: float) -> Chart | None:
    """Draw where a value lies between its bounds, with two standard uncertainties and the nominal value."""
    if not (math.isfinite(lower) and math.isfinite(upper) and upper > lower):
        return None
    x, known = Scale(lower, upper, 4.0, 116.0), math.isfinite(std)
    strokes = [(lower, 0, upper), (lower, 5, lower), (upper, 5, upper), (nominal, 4, nominal)]
    marks = [line(x(a), 9 - half, x(b), 9 + half, "axis") for a, half, b in strokes]
    if known:
        marks.append(line(x(value - 2 * std), 9, x(value + 2 * std), 9, "whisker"))
    marks.append(dot(x(value), 9, 3.5, "after" if known else "apart"))
    says = f"at {100 * (value - lower) / (upper - lower):.0f} % of the way from lower to upper bound"
    return Chart(120, 18, says, marks, {"class": "mark"})
