"""Panels of a diagnosis: shares of the gap, and the shape of the unexplained rest."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hallsym.diagnosis import Band, CurveShape, Diagnosis, place_unit
from hallsym.report import picture as p
from hallsym.report.figures.errors import Sizes, against_floor
from hallsym.report.words import name, number, scale
from hallsym.units import typeset


def changed(d: Diagnosis) -> bool:
    """Return whether there is an after that differs from before."""
    return bool(d.effects or d.ranked)


def gaps(d: Diagnosis) -> dict[str, Sizes]:
    """Return the errors before and after, or on the holdout runs, without outputs that have no number."""
    every = {"before": d.gap_before.sizes, "after": d.gap_after.sizes}
    parts = [part for gap in every.values() for part in gap.values()]
    known = [c for c in parts[0] if all(math.isfinite(part.get(c, math.nan)) for part in parts)]
    found: dict[str, Sizes] = {
        when: {what: {c: part[c] for c in known} for what, part in gap.items()} for when, gap in every.items()
    }
    return found if changed(d) else {"holdout": found["before"]}


def gap(d: Diagnosis) -> p.Picture:
    """Return rmse and peak of each output on the holdout runs, without and with the effects found."""
    words = f"Dashed: noise floor ({d.noise_floor.source})."
    return p.Picture(against_floor(gaps(d), d.noise_floor.outputs), words=words)


def shares(
    found: Sequence[tuple[str, float, tuple[float, float] | None]],
    title: str,
    digits: int = 0,
    look: p.Look = p.AFTER,
) -> p.Panel:
    """Return one share per row, in per cent: a dot with its interval, or a bar where there is none."""
    entries = [
        p.Row(
            words, 100 * value, f"{100 * value:.{digits}f} %", span and (100 * span[0], 100 * span[1]), look
        )
        for words, value, span in found
    ]
    ends = [v for row in entries for v in (row.value, *(row.span or ())) if math.isfinite(v)]
    x = p.Axis(low=min([0.0, *ends]), high=max([1.0, *(1.05 * v for v in ends)]), most=6)
    said = "; ".join(f"{row.name} {row.shown}" for row in entries)
    return p.rows(title, f"{title}: {said}", x, entries)


# -- the shape of the unexplained rest -------------------------------------------------------------------


def curves(shape: CurveShape) -> tuple[str, list[p.Panel]]:
    """Return caption and panels of `unexplained.curve`: value and 95 % band by sensor."""
    gain = shape.kind == "gain"
    reach = _most_of([*shape.readings.values()])
    factor, unit = (100.0, "%") if gain else scale(next(iter(shape.readings)), reach)
    high = 1.05 * factor * reach or 1.0
    draw = _line if shape.line else _dots
    panels = []
    for channel, r in shape.readings.items():
        band = np.clip(factor * np.array([r.value, r.low, r.high]), -high, high)
        panels.append(draw(shape, name(channel), band, unit, high))
    what = "relative change of the gain" if gain else "error of the reading"
    how = f"{what} against {shape.coordinate}: line with its 95 % band, from runs left out in turn"
    if not shape.line:
        how = f"{what} per standard deviation of {shape.coordinate}, with 95 % intervals"
    return how, panels


def _line(shape: CurveShape, sensor: str, band: np.ndarray, unit: str, high: float) -> p.Panel:
    """Return the panel of a sensor; `band` (3, places): values, and the ends of their intervals."""
    value, low, top = band
    own = shape.unit in ("m", "rad", "v")
    across, shown = scale(shape.column, max(map(abs, shape.grid))) if own else place_unit(shape.unit)
    shown = "" if shape.unit == "1" else typeset(shown)
    grid = across * np.array(shape.grid)
    known = top > low  # no band: no samples there
    most = int(np.argmax(np.abs(value)))
    says = f"{sensor}: largest {number(value[most])} {unit} at {number(grid[most])} {shown}"
    title = shape.coordinate.replace("the reading itself", "reading") + (f" [{shown}]" if shown else "")
    drawn = p.line(grid, np.where(known, value, math.nan), p.MEDIANS[1])
    layers = [p.area(grid[known], low[known], top[known], p.BANDS[1]), drawn]
    x, y = p.Axis(title, grid[0], grid[-1]), p.Axis(low=-high, high=high)
    return p.Panel(x, y, layers, f"{sensor} [{unit}]", says, height=100.0)


def _dots(shape: CurveShape, sensor: str, band: np.ndarray, unit: str, high: float) -> p.Panel:
    """Return the same where places are no line."""
    labels = shape.labels or [str(k + 1) for k in range(len(shape.grid))]
    entries = [p.Row(w, v, number(v), (a, b)) for w, v, a, b in zip(labels, *band, strict=True)]
    said = ", ".join(f"{row.name} {row.shown} {unit}" for row in entries)
    return p.rows(f"{sensor} [{unit}]", f"{sensor}: {said}", p.Axis(low=-high, high=high, most=3), entries)


def _most_of(readings: list[Band]) -> float:
    """Return the largest value with some room, and what most of the bands need: a lone wide end is cut."""
    values = [abs(v) for r in readings for v in r.value]
    ends = sorted(abs(v) for r in readings for v in (*r.low, *r.high))
    return max(1.25 * max(values, default=0.0), ends[int(0.9 * (len(ends) - 1))] if ends else 0.0)
