"""Sections that the pages share: what was asked, maps, series, parameters of a fit, versions."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.estimation import Fit
from hallsym.report.data import Cells, ParameterRow, parameter_rows
from hallsym.report.page import figures, maps
from hallsym.report.page.html import Markup, facts, join, table, tag
from hallsym.report.tables import concise
from hallsym.report.words import MINUS, amount, largest, name, scale, three

PLANES = (
    "Median and rms over the stroke. The area of a square is its size; how much a full cell is stands above. "
    "Filled: positive, hollow: negative; no cell: no samples."
)
BANDS = "Line: median; band: plus and minus the rms."
OVER = BANDS + " Pale with a light line: before; darker, drawn over it: after."
VALUES = (
    "Values with the standard uncertainty in parentheses, on the last two digits; a value in parentheses is "
    "not identifiable. In its bounds: dot and line are the value with two standard uncertainties, the small "
    "stroke the nominal value; a hollow dot is not identifiable."
)


def numbers(runs: Sequence[int]) -> str:
    """Return run numbers, neighbours as `3 to 9`."""
    parts: list[list[int]] = []
    for run in sorted(runs):
        if parts and run == parts[-1][-1] + 1:
            parts[-1].append(run)
        else:
            parts.append([run])
    words = [f"{p[0]} to {p[-1]}" if len(p) > 2 else ", ".join(map(str, p)) for p in parts]
    return ", ".join(words)


def called(path: object) -> str:
    """Return the last two parts of a log's path."""
    return "/".join(Path(str(path)).parts[-2:]) if path else "a log in memory"


def each(values: Mapping[str, float], turning: Collection[str] | None = None) -> str:
    """Return `x 1.36 µm, y 1.54 µm, Rz 2.34 µrad`; `turning` as in `hallsym.units.readable`."""
    return ", ".join(f"{name(c)} {amount(c, v, turning)}" for c, v in values.items())


def gap_table(
    rows: Mapping[str, Mapping[str, Mapping[str, float]]],
    floor: Mapping[str, float],
    source: str = "",
    turning: Collection[str] | None = None,
) -> Markup:
    """Return the numbers behind the bars: rmse and peak per output; `source`: of the noise floor."""
    outputs = list(next(iter(rows.values()))["rmse"])
    places = [(what, c) for what in ("rmse", "peak") for c in outputs]
    scales = [scale(c, max(gap[what][c] for gap in rows.values()), turning) for what, c in places]
    every = list(zip(places, scales, strict=True))
    head = ["", *(f"{what} {name(c)} [{unit}]" for (what, c), (_, unit) in every)]
    body = [
        [label, *(three(factor * gap[what][c]) for (what, c), (factor, _) in every)]
        for label, gap in rows.items()
    ]
    if floor:
        level = [three(f * floor[c]) if what == "rmse" and c in floor else "" for (what, c), (f, _) in every]
        body.append([f"noise floor, {source}" if source else "noise floor", *level])
    return table(head, body, caption="errors of the decoded pose")


def maps_section(
    found: Sequence[Cells], floor: Mapping[str, float], note: object = None, after: Sequence[Cells] = ()
) -> Markup:
    """Return the maps of the error with how to read them; nothing without maps.

    `after`: the same cells of another version of the model: planes stand one under the other on a common
    scale, along a coordinate and by runs one is drawn over the other.
    """
    if not found:
        return Markup("")
    outputs, dashed = range(len(found[0].pose)), " Dashed: noise floor." if floor else ""
    level = [floor.get(c) or 0.0 for c in found[0].pose]
    second: Sequence[Cells | None] = after or [None] * len(found)
    pairs = list(zip(found, second, strict=True))
    flat = [(m, a) for m, a in pairs if len(m.across)]
    lines = [(m, a) for m, a in pairs if not len(m.across) and not m.labels]
    over = OVER if after else BANDS
    parts: list[object] = [note]
    if flat:
        parts.append(_note(PLANES + (" Before and after have one scale." if after else "")))
        for m, a in flat:
            parts += _planes(m, a, level)
    if lines:
        parts.append(_note(f"Along one coordinate. {over}{dashed}"))
    for m, a in lines:
        parts.append(figure([maps.profile(m, k, level[k], a) for k in outputs], "panels", _title(m)))
    for m, a in ((m, a) for m, a in pairs if m.labels):
        held = " An h marks runs that were held out." if m.marked else ""
        parts.append(tag("h3", f"By {m.by}"))
        parts.append(_note(f"{over}{dashed}{held}"))
        parts.append(tag("figure", figures.stacked([maps.profile(m, k, level[k], a) for k in outputs])))
        parts.append(_cell_table(m, a))
    return join(parts)


def _planes(m: Cells, a: Cells | None, level: Sequence[float]) -> list[Markup]:
    outputs = range(len(m.pose))
    if a is None:
        both = [maps.plane(m, k, level[k], what) for what in ("median", "rms") for k in outputs]
        return [figure(both, "panels", _title(m))]
    return [
        figure(
            [maps.plane(one, k, level[k], what, beside=other) for k in outputs],
            "panels",
            f"{what} {_title(m)}: {when}",
        )
        for what in ("median", "rms")
        for when, one, other in (("before", m, a), ("after", a, m))
    ]


def _note(words: str) -> Markup:
    return tag("p", words, class_="note")


def figure(pictures: Sequence[Markup], look: str, caption: str) -> Markup:
    """Return pictures side by side as one figure."""
    return tag("figure", tag("figcaption", caption), figures.panels(pictures, look))


def _title(cells: Cells) -> str:
    return f"over {cells.by}" + (f" and {cells.up}, upwards" if cells.up else "")


def _cell_table(cells: Cells, after: Cells | None = None) -> Markup:
    """Return the numbers behind a picture, folded away."""
    versions = [("", cells)] if after is None else [(" before", cells), (" after", after)]
    scales = [scale(c, largest(r), cells.turning) for c, r in zip(cells.pose, cells.rms, strict=True)]
    head = [cells.by, "samples"]
    head += [
        f"{what} {name(c)}{when} [{u}]"
        for c, (_, u) in zip(cells.pose, scales, strict=True)
        for when, _ in versions
        for what in ("median", "rms")
    ]
    rows = []
    for k, label in enumerate(cells.labels):
        row: list[object] = [label + (" (held out)" if k in cells.marked else ""), f"{cells.count[k]:d}"]
        for output, (factor, _) in enumerate(scales):
            for _, version in versions:
                row += [_signed(factor * v[output, k]) for v in (version.median, version.rms)]
        rows.append(row)
    return tag("details", tag("summary", f"numbers by {cells.by}"), table(head, rows))


def _signed(value: float) -> str:
    return three(value).replace("-", MINUS) if np.isfinite(value) else ""


def parameter_table(fit: Fit) -> Markup:
    """Return the parameters: value, standard uncertainty, bounds, and whether the data determine them."""
    head = ["parameter", "value (std)", "unit", "nominal", "bounds", "in its bounds", "meaning and verdict"]
    rows = [_parameter(row) for row in parameter_rows(fit)]
    return join([_note(VALUES), table(head, rows, wordy=(6,), caption="parameters")])


def _parameter(p: ParameterRow) -> list[object]:
    shown = concise(p.value, p.std) if p.determined else f"({p.value:.4g})"
    bounds = "fixed" if p.fixed else f"{p.lower:.4g} to {p.upper:.4g}"
    mark = figures.in_bounds(p.value, p.std, p.lower, p.upper, p.nominal)
    numbers_ = [n.replace("-", MINUS) for n in (shown, p.unit, f"{p.nominal:.4g}", bounds)]
    verdict = "fixed" if p.fixed else p.remark.replace("see below", "combined below") or "identifiable"
    said = join([tag("span", p.meaning, class_="note"), tag("br"), verdict]) if p.meaning else verdict
    return [p.name, *numbers_, mark, said]


def combinations(fit: Fit) -> Markup:
    """Return what the data determine instead of parameters that they do not."""
    rows = [[c.expression, concise(c.value, c.std).replace("-", MINUS), c.unit] for c in fit.combinations]
    return (
        join([tag("h3", "Identifiable combinations"), table(["combination", "value", "unit"], rows)])
        if rows
        else Markup("")
    )


def versions(found: Mapping[str, Any]) -> str:
    """Return `hallsym 0.1.0, numpy 2.1`."""
    return ", ".join(f"{name_} {version}" for name_, version in found.items())


def provenance(log: Mapping[str, Any], found: Mapping[str, Any], command: str) -> Markup:
    """Return where the page comes from: command, log, its hash, versions."""
    return facts(
        [
            ("command", tag("code", command) if command else None),
            ("log", tag("code", log.get("path") or "a log in memory")),
            ("sha256 of the log", tag("code", log["sha256"]) if log.get("sha256") else None),
            ("versions", versions(found)),
        ]
    )
