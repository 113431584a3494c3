"""Pictures of errors by cell: along a coordinate, by group of runs, over two coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.report.data import Cells
from hallsym.report.page.frames import HALF, LEFT, LOOKS, NARROW, RIM, boxes, curve, framed, level, remark
from hallsym.report.page.marks import Chart, Mark, Scale, label, tile
from hallsym.report.words import largest, name, scale, three

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
    x = (
        Scale(part.start, part.stop, names=names)
        if names
        else Scale(cells.edges[0], cells.edges[-1], title=cells.by)
    )
    worst = max(part, key=lambda k: np.nan_to_num(both[-1].rms[output, k]))
    says = f"{what} by {cells.by}: largest rms {said[worst]}"
    layers = [*bands, *medians, level(factor * floor), level(-factor * floor), *held]
    return framed(f"{what} [{unit}]", says, x, Scale(-high, high), layers, width=HALF if names else NARROW)


def planes(
    found: Mapping[str, Sequence[Cells]], floor: Mapping[str, float]
) -> tuple[list[tuple[str, str]], list[dict[str, Any]]]:
    """Return name and unit of each output, and the maps over two coordinates, as a script reads them.

    `found`: version of the model -> maps. A map has `values`: version -> what (median, rms) -> (n_pose,
    cells) in the units of its outputs, None in an empty cell; cell `i + columns * j` lies at column i, row j.
    `full`: what -> (n_pose,), the fullest colour: the largest value of the map in all versions, or the noise
    floor where that is more, so that mere noise stays pale. An output has one unit in all maps.
    """
    flat = {version: [m for m in maps if len(m.across)] for version, maps in found.items()}
    every = [m for maps in flat.values() for m in maps]
    if not every:
        return [], []
    least = [floor.get(c) or 0.0 for c in every[0].pose]
    sizes = [max(a, *(largest(m.rms[k]) for m in every)) for k, a in enumerate(least)]
    scales = [scale(c, v, every[0].turning) for c, v in zip(every[0].pose, sizes, strict=True)]
    factors = np.array([[factor] for factor, _ in scales])
    pale, out = (factors[:, 0] * least).tolist(), []
    for first, *rest in zip(*flat.values(), strict=True):
        drawn = {w: [factors * getattr(m, w) for m in (first, *rest)] for w in ("median", "rms")}
        values = {v: {w: _rounded(drawn[w][j]) for w in drawn} for j, v in enumerate(flat)}
        full = {
            w: [_rounded(max(a, *(largest(v[k]) for v in drawn[w]))) or 1e-12 for k, a in enumerate(pale)]
            for w in drawn
        }
        edges, across = ([float(f"{e:.6g}") for e in side] for side in (first.edges, first.across))
        record = {"by": first.by, "up": first.up, "edges": edges, "across": across}
        out.append(record | {"count": first.count.tolist(), "values": values, "full": full})
    return [(name(c), unit) for c, (_, unit) in zip(every[0].pose, scales, strict=True)], out


def _rounded(values: Any) -> Any:
    """Return numbers with three digits, None for those that do not exist."""
    if np.ndim(values):
        return [_rounded(v) for v in values]
    return float(f"{values:.3g}") if math.isfinite(values) else None


def plane(shown: Mapping[str, Any], version: str, what: str, output: int, title: tuple[str, str]) -> Chart:
    """Draw one output over two coordinates: the fuller the colour the larger, a dash where negative."""
    values, full, n = (
        shown["values"][version][what][output],
        shown["full"][what][output],
        len(shown["edges"]) - 1,
    )
    (quantity, unit), edges, across, counts = title, shown["edges"], shown["across"], shown["count"]

    def cells(x: Scale, y: Scale) -> list[Mark]:
        tiles: list[Mark] = []
        for k, value in ((k, v) for k, v in enumerate(values) if v is not None):
            (left, right), (low, high) = edges[k % n : k % n + 2], across[k // n : k // n + 2]
            said = f"{_span(left, right)}, {_span(low, high)}: {_number(value)} {unit}, {counts[k]} samples"
            tiles += tile(x(left), y(high), x(right) - x(left), y(low) - y(high), value / full, said)
        return [Mark("g", {"class": "cells"}, parts=tiles)]

    most = _number(max((abs(v) for v in values if v is not None), default=math.nan))
    says = f"{what} error of {quantity} over {shown['by']} and {shown['up']}: {most} {unit} at most"
    x = Scale(edges[0], edges[-1], title=f"{shown['by']}, upwards {shown['up']}")
    place = {"class": "plane", "data-version": version, "data-what": what, "data-output": str(output)}
    words, y = f"{what} {quantity}, full: {three(full)} {unit}", Scale(across[0], across[-1])
    return framed(words, says, x, y, [cells], height=NARROW - RIM - LEFT, grid=False, attributes=place)


def _where(cells: Cells, k: int) -> str:
    return cells.labels[k] if cells.labels else _span(*cells.edges[k : k + 2])


def _span(low: float, high: float) -> str:
    return f"{_number(low)} to {_number(high)}"


def _number(value: float) -> str:
    return label(float(f"{value:.3g}")) if math.isfinite(value) else "none"
