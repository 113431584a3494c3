"""What the pages share: maps, runs, parameters, origin."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from hallsym.estimation import Fit
from hallsym.log.columns import in_a_row
from hallsym.report.data.fit import ParameterRow, parameter_rows
from hallsym.report.data.gather import Cells, RunSeries
from hallsym.report.figures.errors import in_bounds, over_time, plane, profiles, script_data
from hallsym.report.page.content import Facts, Figure, Heading, Runs, Section, Table, Words
from hallsym.report.tables import concise
from hallsym.report.words import amount, name

COLOURS = "The fuller the colour the larger the error; a dash marks a negative one; no cell: no samples."
BANDS = "Line: median; band: plus and minus the rms."
OVER = BANDS + " Pale with a light line: before; darker, drawn over it: after."
VALUES = (
    "Values with the standard uncertainty in parentheses, on the last two digits; a value in parentheses is "
    "not identifiable."
)
BOUNDS = (
    "Dot and line: the value with two standard uncertainties; a hollow dot is not identifiable; stroke: the "
    "nominal value."
)


def numbers(runs: Sequence[int]) -> str:
    """Return run numbers, neighbours as `3 to 9`."""
    parts = in_a_row(runs)
    return ", ".join(f"{p[0]} to {p[-1]}" if len(p) > 2 else ", ".join(map(str, p)) for p in parts)


def called(path: object) -> str:
    """Return the last two parts of a log's path."""
    return "/".join(Path(str(path)).parts[-2:]) if path else "a log in memory"


def each(values: Mapping[str, float], turning: Collection[str] | None = None) -> str:
    """Return `x 1.36 µm, y 1.54 µm, Rz 2.34 µrad`; `turning` as in `hallsym.units.readable`."""
    return ", ".join(f"{name(c)} {amount(c, v, turning)}" for c, v in values.items())


# -- where, when, and how the error is distributed ---------------------------------------------------------


def maps_section(found: Mapping[str, Sequence[Cells]], floor: Mapping[str, float]) -> Section:
    """Return the maps of the error; `found`: version of the model -> the same maps, one or two versions.

    Of two versions maps over two coordinates stand one under the other on a common scale; along a coordinate
    and by runs one is drawn over the other.
    """
    versions = {version: cells for version, cells in found.items() if cells}
    content: list[Any] = []
    if versions:
        first, *second = versions.values()
        pairs = list(zip(first, second[0] if second else [None] * len(first), strict=True))
        content += _planes(versions, floor)
        content += _profiles([(m, a) for m, a in pairs if not m.up], floor, bool(second))
    return Section("maps", "Where the error is", content)


def _planes(versions: Mapping[str, Sequence[Cells]], floor: Mapping[str, float]) -> list[Any]:
    flat = {version: m for version, maps in versions.items() for m in maps if m.up}
    figures = [
        Figure(
            [plane(m, [*flat.values()], what, k, floor.get(c) or 0.0) for k, c in enumerate(m.pose)],
            f"{what}{f', {version}' if len(versions) > 1 else ''}",
        )
        for what in ("median", "rms")
        for version, m in flat.items()
    ]
    more = " Before and after have one scale." if len(versions) > 1 else ""
    note = f"Over the first two coordinates that move. {COLOURS}{more}"
    return [Words(note, note=True), *figures] if figures else []


def _profiles(
    pairs: Sequence[tuple[Cells, Cells | None]], floor: Mapping[str, float], both: bool
) -> list[Any]:
    lines = [(m, a) for m, a in pairs if not m.labels]
    how = (OVER if both else BANDS) + (" Dashed: noise floor." if floor else "")
    content: list[Any] = [Words(f"Along one coordinate. {how}", note=True)] if lines else []
    for m, a in lines:
        content.append(Figure(_charts(m, a, floor), f"over {m.by}"))
    for m, a in ((m, a) for m, a in pairs if m.labels):
        held = " An h marks runs that were held out." if m.marked else ""
        content += [Heading(f"By {m.by}"), Words(f"{how}{held}", note=True)]
        content.append(Figure(_charts(m, a, floor), look="two"))
    return content


def _charts(m: Cells, a: Cells | None, floor: Mapping[str, float]) -> list[Any]:
    return [c for k, name_ in enumerate(m.pose) for c in profiles(m, k, floor.get(name_) or 0.0, a)]


def runs_section(found: Sequence[RunSeries]) -> Section:
    """Return the errors over time of the worst run, with those of others for the script."""
    if not found:
        return Section("series", "Decoded minus reference over time", [])
    first, data = found[0], script_data(found)
    key = "; light: " + "; dark, drawn over it: ".join(first.lines) if len(first.lines) > 1 else ""
    shown = Runs(first.title, data["runs"][0]["note"], over_time(first), key, data)
    return Section("series", "Decoded minus reference over time", [shown])


# -- parameters ---------------------------------------------------------------------------------------------


def parameters_of(fit: Fit) -> list[Any]:
    """Return the parameters, and what the data determine in place of some."""
    head = ["parameter", "value (std)", "unit", "nominal", "bounds", "meaning", "verdict"]
    found = parameter_rows(fit)
    rows = [_parameter(row) for row in found]
    table = Table(head, rows, f"parameters of {fit.model.name}", wordy=(5, 6), sortable=True)
    content: list[Any] = [Words(VALUES, note=True), table]
    inside = [row for row in found if math.isfinite(row.upper - row.lower) and not row.fixed]
    if inside:
        content += [Words(BOUNDS, note=True), Figure([in_bounds(inside)], look="two")]
    if fit.combinations:
        rows = [[c.expression, concise(c.value, c.std), c.unit] for c in fit.combinations]
        content.append(Heading("Identifiable combinations"))
        content.append(Table(["combination", "value", "unit"], rows, "identifiable combinations", wordy=(2,)))
    return content


def _parameter(p: ParameterRow) -> list[Any]:
    shown = concise(p.value, p.std) if p.determined else f"({p.value:.4g})"
    bounds = "fixed" if p.fixed else f"{p.lower:.4g} to {p.upper:.4g}"
    verdict = "fixed" if p.fixed else p.remark.replace("see below", "combined below") or "identifiable"
    return [p.name, shown, p.unit, f"{p.nominal:.4g}", bounds, p.meaning, verdict]


def origin_section(log: Mapping[str, Any], found: Mapping[str, Any], command: str) -> Section:
    """Return where the page comes from: command, log, its hash, versions."""
    pairs = [
        ("command", command),
        ("log", log.get("path") or "a log in memory"),
        ("sha256 of the log", log.get("sha256")),
        ("versions", ", ".join(f"{part} {version}" for part, version in found.items())),
    ]
    code = frozenset({"command", "log", "sha256 of the log"})
    return Section("origin", "Origin", [Facts(pairs, code)])
