"""The shape of what no effect explains: a curve with its band, one picture per sensor, on one scale."""

from __future__ import annotations

import math

from hallsym.diagnosis import Band, CurveShape, degrees_of
from hallsym.report.page.marks import (
    NARROW,
    RIM,
    Chart,
    Scale,
    below,
    beside,
    dot,
    line,
    path,
    polyline,
    px,
    text,
)
from hallsym.report.words import name, scale, three
from hallsym.units import reading_unit, typeset

LEFT, TOP, BOTTOM = 46.0, 22.0, 122.0


def curve(shape: CurveShape) -> tuple[str, list[Chart]]:
    """Return caption and pictures of `unexplained.curve`: value and 95 % band by sensor."""
    readings = shape.readings
    reach = _reach(list(readings.values()))
    gain = shape.kind == "gain"
    channel = next(iter(readings))
    factor, unit = (100.0, "%") if gain else scale(channel, reach)
    high = 1.05 * factor * reach or 1.0
    draw = _line if shape.line else _dots
    pictures = [draw(shape, c, r, factor, unit, high) for c, r in readings.items()]
    what = "relative change of the gain" if gain else "error of the reading"
    how = f"{what} against {shape.coordinate}: line with its 95 % band, from runs left out in turn"
    if not shape.line:
        how = f"{what} per standard deviation of {shape.coordinate}, with 95 % intervals"
    return how, pictures


def _line(shape: CurveShape, channel: str, r: Band, factor: float, unit: str, high: float) -> Chart:
    grid = shape.grid
    turn = degrees_of(shape.unit, shape.column)
    across, shown = turn or _scale(shape.unit, max(map(abs, grid)))
    x = Scale(across * grid[0], across * grid[-1], LEFT, NARROW - RIM)
    y = Scale(-high, high, BOTTOM, TOP)
    places = [x(across * v) for v in grid]
    known = [k for k in range(len(grid)) if r.high[k] > r.low[k]]  # no band: no samples there
    low, top = ([(places[k], y(factor * getattr(r, end)[k])) for k in known] for end in ("low", "high"))
    outline = "L".join(f"{px(a)} {px(b)}" for a, b in [*top, *reversed(low)])
    band = [path(f"M{outline}Z", "band")] if known else []
    value = [y(factor * r.value[k]) if k in known else math.nan for k in range(len(grid))]
    title = f"{_short(shape.coordinate)} [{shown}]" if shown else _short(shape.coordinate)
    parts = [
        text(0, 12, f"{name(channel)} [{unit}]", look="title"),
        *band,
        *beside(y, LEFT, NARROW - RIM, 4),
        *below(x, BOTTOM, title),
        polyline(list(zip(places, value, strict=True)), "median"),
    ]
    k = max(range(len(grid)), key=lambda j: abs(r.value[j]))
    largest, place = three(factor * r.value[k]), three(across * grid[k])
    says = f"{name(channel)}: largest {largest} {unit} at {place} {shown}"
    return Chart(NARROW, BOTTOM + 34, says, parts)


def _dots(shape: CurveShape, channel: str, r: Band, factor: float, unit: str, high: float) -> Chart:
    labels = shape.labels or [str(k + 1) for k in range(len(shape.grid))]
    left, step = 20.0 + 6.6 * max(map(len, labels)), 19.0
    bottom = TOP + step * len(labels)
    x = Scale(-high, high, left, NARROW - RIM)
    parts = [text(0, 12, f"{name(channel)} [{unit}]", look="title"), *below(x, bottom, most=3, top=TOP)]
    parts.append(line(x(0.0), TOP, x(0.0), bottom, "zero"))
    for k, words in enumerate(labels):
        at = TOP + step * (k + 0.5)
        parts += [text(left - 6, at + 4, words, "end")]
        parts.append(line(x(factor * r.low[k]), at, x(factor * r.high[k]), at, "whisker"))
        parts.append(dot(x(factor * r.value[k]), at, 3.5, "after"))
    said = ", ".join(f"{w} {three(factor * v)} {unit}" for w, v in zip(labels, r.value, strict=True))
    return Chart(NARROW, bottom + 20, f"{name(channel)}: {said}", parts)


def _reach(readings: list[Band]) -> float:
    """Return the largest value with some room, and what most of the bands need: a lone wide end is cut."""
    values = [abs(v) for r in readings for v in r.value]
    ends = sorted(abs(v) for r in readings for v in (*r.low, *r.high))
    return max(1.25 * max(values, default=0.0), ends[int(0.9 * (len(ends) - 1))] if ends else 0.0)


def _scale(unit: str, largest: float) -> tuple[float, str]:
    """Return factor and unit of the coordinate's axis."""
    if unit in ("m", "rad", "v"):
        return scale(f"x_{unit}", largest)
    factor, shown = reading_unit(unit) if unit != "s" else (1.0, "s")
    return factor, "" if unit == "1" else typeset(shown)


def _short(coordinate: str) -> str:
    return coordinate.replace("the reading itself", "reading")
