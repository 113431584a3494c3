"""The shape of what no effect explains: a curve with its band, one picture per sensor, on one scale."""

from __future__ import annotations

import math

from hallsym.diagnosis import Band, CurveShape, place_unit
from hallsym.report.page.frames import Row, area, curve, framed, rows
from hallsym.report.page.marks import Chart, Scale
from hallsym.report.words import degrees_of, name, scale, three
from hallsym.units import typeset


def curves(shape: CurveShape) -> tuple[str, list[Chart]]:
    """Return caption and pictures of `unexplained.curve`: value and 95 % band by sensor."""
    gain = shape.kind == "gain"
    reach = _reach([*shape.readings.values()])
    factor, unit = (100.0, "%") if gain else scale(next(iter(shape.readings)), reach)
    high = 1.05 * factor * reach or 1.0
    draw = _line if shape.line else _dots
    charts = []
    for channel, r in shape.readings.items():
        value, low, top = (tuple(factor * v for v in part) for part in (r.value, r.low, r.high))
        charts.append(draw(shape, name(channel), Band(value, low, top), unit, high))
    what = "relative change of the gain" if gain else "error of the reading"
    how = f"{what} against {shape.coordinate}: line with its 95 % band, from runs left out in turn"
    if not shape.line:
        how = f"{what} per standard deviation of {shape.coordinate}, with 95 % intervals"
    return how, charts


def _line(shape: CurveShape, sensor: str, r: Band, unit: str, high: float) -> Chart:
    across, shown = degrees_of(shape.unit, shape.column) or _scale(shape.unit, max(map(abs, shape.grid)))
    grid = [across * v for v in shape.grid]
    known = [k for k in range(len(grid)) if r.high[k] > r.low[k]]  # no band: no samples there
    place, low, top = ([part[k] for k in known] for part in (grid, r.low, r.high))
    value = [v if k in known else math.nan for k, v in enumerate(r.value)]
    most = max(range(len(grid)), key=lambda k: abs(r.value[k]))
    says = f"{sensor}: largest {three(r.value[most])} {unit} at {three(grid[most])} {shown}"
    title = shape.coordinate.replace("the reading itself", "reading") + (f" [{shown}]" if shown else "")
    layers = [area(place, low, top, "band"), curve(grid, value, "median")]
    x, y = Scale(grid[0], grid[-1], title=title), Scale(-high, high)
    return framed(f"{sensor} [{unit}]", says, x, y, layers, height=100.0)


def _dots(shape: CurveShape, sensor: str, r: Band, unit: str, high: float) -> Chart:
    labels = shape.labels or [str(k + 1) for k in range(len(shape.grid))]
    spans = zip(r.low, r.high, strict=True)
    entries = [Row(w, v, three(v), s) for w, v, s in zip(labels, r.value, spans, strict=True)]
    said = ", ".join(f"{row.name} {row.shown} {unit}" for row in entries)
    return rows(f"{sensor} [{unit}]", f"{sensor}: {said}", Scale(-high, high, most=3), entries)


def _reach(readings: list[Band]) -> float:
    """Return the largest value with some room, and what most of the bands need: a lone wide end is cut."""
    values = [abs(v) for r in readings for v in r.value]
    ends = sorted(abs(v) for r in readings for v in (*r.low, *r.high))
    return max(1.25 * max(values, default=0.0), ends[int(0.9 * (len(ends) - 1))] if ends else 0.0)


def _scale(unit: str, largest: float) -> tuple[float, str]:
    """Return factor and unit of the coordinate's axis."""
    if unit in ("m", "rad", "v"):
        return scale(f"x_{unit}", largest)
    factor, shown = place_unit(unit)
    return factor, "" if unit == "1" else typeset(shown)
