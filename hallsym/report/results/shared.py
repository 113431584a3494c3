"""Shared parts of the reports: maps, runs, parameters, errors, origin."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, counted
from hallsym.estimation import Fit
from hallsym.estimation.calibration import LogRecord
from hallsym.log.columns import in_a_row
from hallsym.report.content import Block, Folded, Items, Note, Runs, Section, Table, Words
from hallsym.report.data.gather import Cells, RunSeries
from hallsym.report.panels import Sizes, over_time, plane, profile, script_data
from hallsym.report.picture import Picture
from hallsym.report.tables import cells, concise, heads, in_units
from hallsym.report.words import number
from hallsym.units import parameter_unit

COLOURS = "The fuller the colour the larger the error; a dash marks a negative one; no cell: too few samples."
BANDS = "Line: mean; band: plus and minus the rms."
VALUES = (
    "Values with the standard uncertainty in parentheses, on the last two digits; a value in parentheses is "
    "not identifiable."
)


def numbers(runs: Sequence[int]) -> str:
    """Return run numbers, neighbours as `3 to 9`."""
    parts = in_a_row(runs)
    return ", ".join(f"{p[0]} to {p[-1]}" if len(p) > 2 else ", ".join(map(str, p)) for p in parts)


def called(path: object) -> str:
    """Return the last two parts of a log's path."""
    return "/".join(Path(str(path)).parts[-2:]) if path else "a log in memory"


# -- how large the error is ------------------------------------------------------------------------------


def error_table(
    pose: Sequence[str],
    rows: Mapping[str, Sizes | None],
    floor: Mapping[str, float] | None = None,
    source: str = "",
    periodic: Collection[str] | None = None,
    *,
    intervals: Mapping[str, Mapping[str, tuple[float, float]]],
) -> Table:
    """Return the rmse of each output, its 95 % intervals and noise floor, then its peak.

    One line per entry of `rows`. `intervals`: of the rmse of some rows, those that are known. `source`:
    whether the noise floor is stated or estimated, where it is printed. `periodic`: coordinates that go
    round, see `hallsym.units.readable`.
    """
    known = {label: row for label, row in rows.items() if row is not None}

    def sizes(what: str) -> list[list[str]]:
        return [
            [f"{what}, {n}", *cells([v[what][c] for c in pose], pose, periodic, 4)] for n, v in known.items()
        ]

    table = sizes("rmse")
    for label, found in intervals.items():
        if found:
            ends = zip(*(found.get(c, (math.nan, math.nan)) for c in pose), strict=True)
            low, high = (cells(side, pose, periodic) for side in ends)
            spans = [f"{a} .. {b}" if a else "" for a, b in zip(low, high, strict=True)]
            table.append([f"95 % interval, {label}".removesuffix(", "), *spans])
    if floor:
        noise = cells([floor[c] for c in pose], pose, periodic, 4)
        table.append([f"noise floor, {source}" if source else "noise floor", *noise])
    head = ["errors", *heads(pose, periodic)]
    return Table(head, [*table, *sizes("peak")], "errors of each output")


def errors_by(
    title: str, rows: Mapping[str, Sizes], pose: Sequence[str], periodic: Collection[str] | None = None
) -> Table:
    """Return rmse and peak of each output, one line per run or log."""
    head = [title, *heads(pose, periodic, "rmse"), *heads(pose, periodic, "peak")]
    lines = []
    for label, row in rows.items():
        sizes = (cells([row[what][c] for c in pose], pose, periodic, 4) for what in ("rmse", "peak"))
        lines.append([label, *chain.from_iterable(sizes)])
    return Table(head, lines, f"errors of each output, {title}")


def expanded_at_rest(fit: Fit) -> list[str]:
    """Return U of the decoded position as a sentence; none where the model is not all of the error."""
    from hallsym.report.results.budget import expanded  # a terminal prints none
    from hallsym.uncertainty import position_budget

    if fit.goodness and fit.goodness.sentence:
        return []
    try:
        return [f"{expanded(position_budget(fit), 'rest')}."]
    except InputError:
        return []


# -- where, when, and how the error is distributed ---------------------------------------------------------


WORDS = {"mean": "mean error", "rms": "rms error"}
Versions = Mapping[str, Sequence[Cells]]
"""The maps of one version of the model, or the same maps of two, before and after."""


def maps_section(
    found: Versions, floor: Mapping[str, float], groups: Sequence[Picture] = (), *, seen: bool = False
) -> Section:
    """Return the maps of the error.

    Of two versions maps over two coordinates stand one under the other on a common scale; along a coordinate
    one is drawn over the other. `groups`: pictures by groups of runs. `seen`: `first_view` shows these
    versions, all that there is of a single coordinate, which is not drawn again.
    """
    how, along = _how([*found], floor), _along(found)
    along = [] if seen and len(along) == 1 else along
    content = _planes(found, floor)
    content += [Note(f"Along one coordinate. {how}")] if along else []
    content += _first([Picture(_charts(pair, floor), words=f"over {pair[0].by}") for pair in along], 1)
    content += [Note("By group of runs, on logarithmic axes.")] if groups else []
    return Section("maps", "Maps of the error", [*content, *groups])


def _along(found: Versions) -> list[list[Cells]]:
    """Return the maps along one coordinate, each of every version."""
    return [[*each] for each in zip(*found.values(), strict=True) if not each[0].up]


def _planes(found: Versions, floor: Mapping[str, float]) -> list[Any]:
    flat = {version: m for version, maps in found.items() for m in maps if m.up}
    pictures = [
        Picture(
            [plane(m, [*flat.values()], what, k, floor.get(c) or 0.0) for k, c in enumerate(m.pose)],
            words=f"{WORDS[what]}{f', {version}' if len(found) > 1 else ''}",
        )
        for what in WORDS
        for version, m in flat.items()
    ]
    more = " Before and after have one scale." if len(found) > 1 else ""
    note = f"Over the first two coordinates that move. {COLOURS}{more}"
    return [Note(note), *_first(pictures, len(flat))] if pictures else []


def _first(pictures: Sequence[Picture], shown: int) -> list[Block]:
    """Return pictures, all but the first ones folded."""
    return [*pictures[:shown], *(Folded(one.words, [replace(one, words="")]) for one in pictures[shown:])]


def _charts(both: Sequence[Cells], floor: Mapping[str, float]) -> list[Any]:
    return [profile(both, k, floor.get(output) or 0.0) for k, output in enumerate(both[0].pose)]


def first_view(series: Sequence[RunSeries], found: Versions, floor: Mapping[str, float]) -> list[Block]:
    """Return the error over the time of the worst run, and over a coordinate."""
    blocks: list[Block] = []
    if series:
        said = f"Over time, {series[0].title}. {_colours([*series[0].lines])}"
        blocks.append(Picture(over_time(series[0], every=True), words=said.rstrip()))
    if along := _along(found):
        charts = []
        for k, output in enumerate(along[0][0].pose):
            both = max(along, key=lambda each: _follows(each[0], k))
            charts.append(profile(both, k, floor.get(output) or 0.0))
        how = _how([*found], floor)
        blocks.append(Picture(charts, words=f"Over the coordinate that each error follows most. {how}"))
    return blocks


def _colours(versions: Sequence[str]) -> str:
    """Return which colour is which of two versions of the model; nothing of one alone."""
    return f"Orange: {versions[0]}; blue, drawn over it: {versions[-1]}." if len(versions) > 1 else ""


def _how(versions: Sequence[str], floor: Mapping[str, float]) -> str:
    """Return how errors by cell are drawn."""
    return " ".join(filter(None, (BANDS, _colours(versions), "Dashed: noise floor." if floor else "")))


def _follows(cells: Cells, output: int) -> float:
    """Return the mean square of the means of an output about their own mean, by samples."""
    full = cells.count > 0
    share, mean = cells.count[full] / cells.count.sum(), cells.mean[output, full]
    return float(share @ (mean - share @ mean) ** 2)


def runs_section(found: Sequence[RunSeries]) -> Section:
    """Return the errors over time of the worst run, with those of others for the script."""
    if not found:
        return Section("series", "Error over time", [])
    first, data = found[0], script_data(found)
    colours = _colours([*first.lines])
    key = f". {colours}" if colours else ""
    shown = Runs(first.title, data["runs"][0]["note"], over_time(first), key, data)
    return Section("series", "Error over time", [shown])


# -- parameters ---------------------------------------------------------------------------------------------

NAMED = 6
"""Parameters with the same remark that a table lists; the others are one row, so that none is a wall."""


def parameters_of(fit: Fit) -> list[Block]:
    """Return the parameters, and what the data determine in place of some."""
    remarks = [_remark(fit, k) for k in range(len(fit.values))]
    shown = [
        k for k, why in enumerate(remarks) if fit.determined[k] or remarks[:k].count(why) < NAMED or not why
    ]
    head = ["parameter", "value (1 sigma)", "unit", "nominal", "bounds", "meaning"]
    rows = [_parameter(fit, k, remarks[k]) for k in shown]
    table = Table(head, rows, f"parameters of {fit.model.name}", wordy=(5,), sortable=True)
    content: list[Block] = [Note(VALUES), table, *map(Words, dict.fromkeys(g.text for g in fit.gauges))]
    if len(shown) < len(remarks):
        more = f"and {counted(len(remarks) - len(shown), 'parameter')} more that this log does not determine"
        content.append(Words(f"{more}; the calibration file and --json list all"))
    if fit.combinations:
        head = ["identifiable combinations", "value (1 sigma)", "unit"]
        rows = [[c.expression, *in_units(c.value, c.std, c.unit)] for c in fit.combinations]
        content.append(Table(head, rows, "what the data determine in place of single parameters"))
    return content


def _parameter(fit: Fit, k: int, remark: str) -> list[Any]:
    """Return the row of a parameter, every number in the unit that suits it."""
    p, (factor, unit) = fit.model.parameters[k], parameter_unit(fit.model.parameters[k].unit)
    value = factor * float(fit.values[k])
    shown = concise(value, factor * float(fit.std[k])) if fit.determined[k] else f"({number(value, 4)})"
    bounds = " .. ".join(number(factor * end, 4) for end in (p.lower, p.upper)) if p.width else "fixed"
    said = "; ".join(filter(None, (p.meaning, remark)))
    return [p.name, shown, unit, number(factor * p.nominal, 4), bounds, said]


def _remark(fit: Fit, k: int) -> str:
    """Return the remark on a parameter; nothing where it is determined inside its bounds or fixed."""
    p = fit.model.parameters[k]
    if not p.width:
        return ""
    if p.name in fit.at_bound:
        return "at its bound"
    if fit.determined[k]:
        return ""
    which = "any recording" if p.name in fit.structural else "this log"
    done = "fixed at nominal" if p.name in fit.fixed else "see below"
    return f"not identifiable from {which}; {done}"


def origin_section(log: LogRecord, found: Mapping[str, Any], command: str) -> Section:
    """Return where the page comes from: command, hash of the log, versions."""
    pairs = [
        ("command", command),
        ("sha256 of the log", log.sha256),
        ("versions", ", ".join(f"{part} {version}" for part, version in found.items())),
    ]
    return Section("origin", "Origin", [Items(pairs)])
