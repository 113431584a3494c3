"""The charts of a page: errors by output, coordinate, run and time.

Bars carry their names and numbers, so that nothing is told by colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.diagnosis import Band, CurveShape, place_unit
from hallsym.report.data.gather import Cells, RunSeries
from hallsym.report.page.charts import (
    HALF,
    LEFT,
    LOOKS,
    NARROW,
    RIM,
    Chart,
    Mark,
    Row,
    Scale,
    area,
    boxes,
    curve,
    dot,
    framed,
    label,
    level,
    line,
    path,
    px,
    remark,
    rows,
    tile,
)  # fmt: skip
from hallsym.report.page.content import Runs
from hallsym.report.words import degrees_of, largest, name, scale, three
from hallsym.units import typeset

# -- bars and intervals ----------------------------------------------------------------------------------


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
    said = "; ".join(f"{row.name} {row.shown}" for row in entries)
    return rows(title, f"{title}: {said}", x, entries, width=HALF)


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


# -- errors by cell: along a coordinate, by group of runs, over two coordinates --------------------------


MOST = 12
"""Cells with labels in one chart."""


def profiles(cells: Cells, output: int, floor: float = 0.0, after: Cells | None = None) -> list[Chart]:
    """Draw median (line) and rms (band to both sides) of one output by cell; `floor` [SI] is dashed.

    `after`: the same cells of another version, drawn over it on the same scale. Cells with labels are drawn
    in two charts where they are more than `MOST`, so that they can be read on a phone.
    """
    both, n = [cells] if after is None else [cells, after], len(cells.count)
    reach = max(floor, *(largest(v[output]) for c in both for v in (c.rms, c.median)))
    step = -(-n // 2) if cells.labels and n > MOST else n
    return [_profile(both, output, floor, reach, range(k, min(k + step, n))) for k in range(0, n, step)]


def _profile(both: Sequence[Cells], output: int, floor: float, reach: float, part: range) -> Chart:
    cells, what, names = both[0], name(both[0].pose[output]), both[0].labels[part.start : part.stop]
    factor, unit = scale(cells.pose[output], reach, cells.turning)
    half = min(0.4, 0.04 * len(part))  # few bars are no broader than many
    spans = [(k + 0.5 - half, k + 0.5 + half) if names else tuple(cells.edges[k : k + 2]) for k in part]
    bands, medians, said = [], [], {}
    for ending, c in zip(LOOKS[len(both)], both, strict=True):
        rms, median = (factor * v[output, part] for v in (c.rms, c.median))
        said = {
            k: f"{_where(c, k)}: median {_number(a)}, rms {_number(b)} {unit}, {c.count[k]:d} samples"
            for k, a, b in zip(part, median, rms, strict=True)
        }
        bands.append(boxes(spans, rms, said.values(), f"band{ending}"))
        places = [(a, b, math.nan) if names else (0.5 * (a + b),) for a, b in spans]
        medians.append(curve(np.ravel(places), np.repeat(median, len(places[0])), f"median{ending}"))
    held = [remark(k + 0.5, "h") for k in cells.marked if k in part]
    high = 1.08 * factor * reach or 1.0
    x = Scale(part.start, part.stop, names=names)
    x = x if names else Scale(cells.edges[0], cells.edges[-1], title=cells.by)
    worst = max(part, key=lambda k: np.nan_to_num(both[-1].rms[output, k]))
    says = f"{what} by {cells.by}: largest rms {said[worst]}"
    layers = [*bands, *medians, level(factor * floor), level(-factor * floor), *held]
    return framed(f"{what} [{unit}]", says, x, Scale(-high, high), layers, width=HALF if names else NARROW)


def plane(cells: Cells, both: Sequence[Cells], what: str, output: int, floor: float) -> Chart:
    """Draw one output over two coordinates: the fuller the colour the larger, a dash where negative.

    `what`: median or rms. `both`: all versions of the map; the fullest colour is their largest value, or the
    noise floor where that is more, so that mere noise stays pale.
    """
    quantity, most = name(cells.pose[output]), max(floor, *(largest(m.rms[output]) for m in both))
    factor, unit = scale(cells.pose[output], most, cells.turning)
    values, n = factor * getattr(cells, what)[output], len(cells.edges) - 1
    full = factor * max(floor, *(largest(getattr(m, what)[output]) for m in both)) or 1e-12

    def tiles(x: Scale, y: Scale) -> Iterator[Mark]:
        for k in np.flatnonzero(np.isfinite(values)).tolist():
            (left, right), (low, high) = cells.edges[k % n : k % n + 2], cells.across[k // n : k // n + 2]
            place, size = f"{_span(left, right)}, {_span(low, high)}", f"{_number(values[k])} {unit}"
            said = f"{place}: {size}, {cells.count[k]} samples"
            yield from tile(
                x(left), y(high), x(right) - x(left), y(low) - y(high), float(values[k]) / full, said
            )

    worst = f"{_number(largest(values))} {unit} at most"
    says = f"{what} error of {quantity} over {cells.by} and {cells.up}: {worst}"
    x = Scale(cells.edges[0], cells.edges[-1], title=f"{cells.by}, upwards {cells.up}")
    words, y = f"{what} {quantity}, full: {three(full)} {unit}", Scale(cells.across[0], cells.across[-1])
    return framed(words, says, x, y, [tiles], height=NARROW - RIM - LEFT, grid=False)


def _where(cells: Cells, k: int) -> str:
    return cells.labels[k] if cells.labels else _span(*cells.edges[k : k + 2])


def _span(low: float, high: float) -> str:
    return f"{_number(low)} to {_number(high)}"


def _number(value: float) -> str:
    return label(float(f"{value:.3g}")) if math.isfinite(value) else "none"


# -- errors of a run over time: a static chart that a script zooms, and in which it shows other runs -----


ACROSS, UP = 20_000, 5_000
"""A path's own units: time runs from 0 to `ACROSS`, values from -`UP` to `UP`."""
FEWEST = 200
"""Columns that are shown at least: fewer would pass for samples."""
WIDTH = 740.0


def runs(series: Sequence[RunSeries]) -> Runs | None:
    """Return the charts of the first of several runs, and what a script draws of all; None without any.

    Of each run: title, unit and span of time, least width of a zoom, reach of each output [in its unit] and
    paths `lines[line][output]`.
    """
    if not series:
        return None
    first, outputs = series[0], range(len(series[0].pose))
    reach = [[_reach(s, k) for k in outputs] for s in series]
    scales = [scale(first.pose[k], max(r[k] for r in reach), first.turning) for k in outputs]
    data = [_run(s, r, scales) for s, r in zip(series, reach, strict=True)]
    charts = [_panel(first, data[0], k, scales[k]) for k in outputs]
    key = "; light: " + "; dark, drawn over it: ".join(first.lines) if len(first.lines) > 1 else ""
    script = {"unit": "s" if first.timed else "samples", "runs": data}
    return Runs(series[0].title, data[0]["note"], charts, key, script)


def _reach(series: RunSeries, k: int) -> float:
    return largest(np.array([bounds[k] for pair in series.lines.values() for bounds in pair])) or 1e-12


def _run(series: RunSeries, reach: Sequence[float], scales: Sequence[tuple[float, str]]) -> dict[str, Any]:
    end = float(series.time[-1])
    start, end = (0.0, end) if end > 0.0 else (-0.5, 0.5)
    per = series.per_column
    return {
        "title": series.title,
        "note": f"a column of a line holds {per} samples, least to greatest" if per > 1 else "",
        "from": float(f"{start:.9g}"),
        "to": float(f"{end:.9g}"),
        "least": round(min(ACROSS, ACROSS * (FEWEST if per > 1 else 4) / len(series.time))),
        "reach": [float(f"{f * r:.6g}") for r, (f, _) in zip(reach, scales, strict=True)],
        "lines": [
            [_path((series.time - start) / (end - start), low[k], high[k], r) for k, r in enumerate(reach)]
            for low, high in series.lines.values()
        ],
    }


def _panel(series: RunSeries, run: dict[str, Any], k: int, shown: tuple[float, str]) -> Chart:
    last, reach, quantity = k == len(series.pose) - 1, run["reach"][k], name(series.pose[k])
    factor, unit = shown
    drawn = zip(LOOKS[len(run["lines"])], run["lines"], strict=True)
    lines = [path(paths[k], f"line median{ending}") for ending, paths in drawn]

    def view(x: Scale, y: Scale) -> list[Mark]:
        place = {
            "class": "view", "x": px(x.start), "y": px(y.end), "width": px(x.end - x.start),
            "height": px(y.start - y.end), "viewBox": f"0 {px(-1.05 * UP)} {ACROSS} {px(2.1 * UP)}",
            "preserveAspectRatio": "none",
        }  # fmt: skip
        return [Mark("svg", place, parts=lines)]

    what = "time in the run [s]" if series.timed else "sample of the run"
    worst = {n: factor * largest(np.array([low[k], high[k]])) for n, (low, high) in series.lines.items()}
    said = ", ".join(f"{n} up to {v:.3g} {unit}" for n, v in worst.items())
    says = f"error in {quantity} over time, {series.title}: {said}"
    x = Scale(run["from"], run["to"], title=what if last else "", most=7)
    y, place = Scale(-1.05 * reach, 1.05 * reach), {"class": "panel", "data-unit": unit}
    return framed(f"error in {quantity} [{unit}]", says, x, y, [view], width=WIDTH, attributes=place)


def _path(time: np.ndarray, low: np.ndarray, high: np.ndarray, reach: float) -> str:
    """Return a path in whole numbers, each point relative to the one before, interrupted at nan.

    `time`: from 0 to 1.
    """
    flat = np.array_equal(low, high, equal_nan=True)
    x = np.rint(time * ACROSS)
    even = np.arange(len(low)) % 2 == 0  # up in one column, down in the next: no sawtooth between them
    y = low if flat else np.column_stack([np.where(even, low, high), np.where(even, high, low)]).ravel()
    x = x if flat else np.repeat(x, 2)
    good = np.isfinite(y)
    points = np.column_stack([x, np.rint(-np.where(good, y, 0.0) / reach * UP)]).astype(np.int64)[good]
    starts = np.diff(np.flatnonzero(good), prepend=-2) > 1
    steps = np.diff(points, axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    words = []
    for k, (dx, dy) in enumerate(steps.tolist()):
        command = "m" if starts[k] else "l" if k and starts[k - 1] else " "
        words.append(f"{command}{dx}{'' if dy < 0 else ' '}{dy}")
    return "".join(words)


# -- the shape of what no effect explains ----------------------------------------------------------------


def curves(shape: CurveShape) -> tuple[str, list[Chart]]:
    """Return caption and pictures of `unexplained.curve`: value and 95 % band by sensor."""
    gain = shape.kind == "gain"
    reach = _most_of([*shape.readings.values()])
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
    across, shown = degrees_of(shape.unit, shape.column) or _scale_of(shape.unit, max(map(abs, shape.grid)))
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


def _most_of(readings: list[Band]) -> float:
    """Return the largest value with some room, and what most of the bands need: a lone wide end is cut."""
    values = [abs(v) for r in readings for v in r.value]
    ends = sorted(abs(v) for r in readings for v in (*r.low, *r.high))
    return max(1.25 * max(values, default=0.0), ends[int(0.9 * (len(ends) - 1))] if ends else 0.0)


def _scale_of(unit: str, largest: float) -> tuple[float, str]:
    if unit in ("m", "rad", "v"):
        return scale(f"x_{unit}", largest)
    factor, shown = place_unit(unit)
    return factor, "" if unit == "1" else typeset(shown)
