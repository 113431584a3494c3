"""Report of identifiability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hallsym.errors import InputError, counted, few
from hallsym.inference import (
    VERDICTS,
    Change,
    CombinationReport,
    Identifiability,
    NullDirection,
    Offsets,
    ParameterReport,
)
from hallsym.model import Model
from hallsym.report import picture as p
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.results.shared import NAMED, called
from hallsym.report.tables import attributes, cells, concise, heads, in_units
from hallsym.report.words import minus, number
from hallsym.units import parameter_unit


def identifiability_content(report: Identifiability) -> Content:
    """Return the report of identifiability: number of parameters, each of them, lost ones and why."""
    cost = report.evidence.cost
    runs, recorded = len(cost.summary.runs), report.evidence.recorded
    amiss = report.evidence.amiss
    entries = shown(report)
    known = sum(e.std is not None for e in entries)
    verb = "will determine" if cost.planned else "determine" if runs > 1 else "determines"
    what = f"{runs} runs of {recorded}" if runs > 1 else recorded
    lost = [e.name for e in entries if e.std is None]
    some = f"only {counted(len(report.combinations), 'combination')}" if report.combinations else "nothing"
    rest = f"; of {few(lost)} {some}" if lost else ""
    answer = f"{what} {verb} {known} of {len(entries)} free parameters of {report.model.name}{rest}."
    combinations: list[Block] = []
    if report.combinations:
        rows = [
            [c.expression, *in_units(c.value, c.std, c.unit), _interval(c, parameter_unit(c.unit)[0])]
            for c in report.combinations
        ]
        head = ["identifiable combinations", "value (1 sigma)", "unit", "95 % interval"]
        combinations = [Table(head, rows, "what is determined in place of single parameters")]
    found = report.evidence.uncertainty
    notes = [f"uncertainty: {found.method} ({found.reason})"]
    notes += [f"not computed: {sentence}" for sentence in report.partial]
    notes += [f"note: {note}" for note in report.evidence.notes if note != amiss]
    return Content(
        f"What {called(recorded)} determines of {report.model.name}",
        "\n".join(filter(None, (amiss, answer))),
        [
            Section("parameters", "Parameters", [*_parameters(report), *combinations]),
            Section("lost", "What is not identifiable", null_text(report)),
            Section("further", "Further recordings", [further_table(report)] if report.further else []),
            Section("effects", "Effect on the position", [effects_table(report)]),
            Section("notes", "Evidence and notes", [*offsets_text(report.offsets), *notes]),
        ],
        columns=_columns(report),
        pictures={"correlation": lambda log: correlation(report)},
    )


def _columns(found: Identifiability) -> dict[str, list[Any]]:
    """Return the parameters as columns, in SI."""
    entries, meanings = found.parameters, {p.name: p.meaning for p in found.model.parameters}
    spans = [e.interval and (e.interval.low, e.interval.high) for e in entries]
    return {
        "parameter": [e.name for e in entries],
        **attributes(entries, "value", "std", "unit"),
        "low_95": [span and span[0] for span in spans],
        "high_95": [span and span[1] for span in spans],
        "verdict": [e.verdict.word for e in entries],
        "meaning": [meanings.get(e.name, "") for e in entries],
    }


def _parameters(report: Identifiability) -> list[Block | str]:
    """Return value, interval, strongest correlation and verdict of every parameter, lost ones up to a few."""
    meanings = {p.name: p.meaning for p in report.model.parameters}
    head = [
        "parameter",
        "value (1 sigma)",
        "unit",
        "95 % interval",
        "of bounds",
        "correlated with",
        "verdict",
    ]
    lost = [entry for entry in report.parameters if entry.std is None]
    rest = lost[NAMED:] if len(lost) > NAMED + 1 else []
    rows = []
    for entry in (e for e in report.parameters if e not in rest):
        factor, unit = parameter_unit(entry.unit)
        value = f"({number(entry.value * factor, 4)})"
        if entry.std is not None:
            value = concise(entry.value * factor, entry.std * factor)
        share = "" if entry.share is None else f"{number(100 * entry.share, 2)} %"
        other = "".join(f"{name} {r:+.2f}" for name, r in entry.correlated_with[:1] if entry.std is not None)
        because, _, _ = (entry.verdict.because or "").partition("; only ")  # combinations have a table
        meaning = meanings.get(entry.name)
        why = because and f"{' ' if because.startswith('from ') else ': '}{because}"
        verdict = entry.verdict.word + (why or (f"; {meaning}" if meaning else ""))
        rows.append([entry.name, value, unit, _interval(entry, factor), share, other, verdict])
    more = f"and {counted(len(rest), 'parameter')} more without a value; --json and -o list all"
    return [Table(head, rows, "parameters", wordy=(6,)), *([more] if rest else [])]


def _interval(entry: ParameterReport | CombinationReport, factor: float) -> str:
    if entry.interval is None or entry.std is None:
        return ""
    digits = max(1, 2 - int(np.floor(np.log10(max(entry.std * factor, 1e-300)))))
    ends = (f"{v * factor:.{min(digits, 9)}f}" for v in (entry.interval.low, entry.interval.high))
    mark = {"normal": "", "student": " t", "profile": " p"}[entry.interval.how]
    return " .. ".join(ends) + mark


def null_text(report: Identifiability) -> list[str]:
    """Return the sentences on free factors and null directions."""
    structural, practical = report.structural, report.practical
    gauges = report.evidence.found.gauges_of(report.model)
    but = f" but for {counted(len(gauges), 'free factor')}:" if gauges else ""
    some = "not identifiable from any recording:" if structural.null else f"all are identifiable{but}"
    less = "not identifiable from this recording:" if practical.null else "nothing more is lost"
    return [
        f"structural rank {structural.rank} of {structural.of}: {some}",
        *_directions(structural.null),
        *dict.fromkeys(f"  {gauge.text}" for gauge, _ in gauges),
        f"practical rank {practical.rank} of {practical.of}: {less}",
        *_directions(practical.null),
    ]


def _directions(found: Sequence[NullDirection]) -> list[str]:
    """Return a line for each of a few directions; many of single parameters are one line."""
    lines = [_direction(one) for one in found]
    rest = len(lines) - NAMED
    return [*lines[:NAMED], f"  and {rest} more; --json and -o list all"] if rest > 1 else lines


def _direction(direction: NullDirection) -> str:
    named = few(direction.parameters)
    if not direction.determined:
        return f"  {named}: no combination is identifiable"
    if direction.is_wide:
        known = len(direction.determined)
        return f"  {named} may change together; {known} combinations of them are identifiable (table above)"
    return f"  {named}: only {' and '.join(direction.determined)}"


def further_table(report: Identifiability) -> Table:
    """Return the parameters that each further recording would determine."""
    head, rows = ["with another recording", "practical rank", "then determined (1 sigma)"], []
    for f in report.further:
        units = {n: parameter_unit(report[n].unit, bare=True) for n in f.determined}
        spans = {n: f"{number(s * units[n][0], 2)} {units[n][1]}".rstrip() for n, s in f.determined.items()}
        sized = [f"{n} ({span})" for n, span in spans.items()]
        rows.append([f.recording, f"{f.rank} of {f.of}", few(sized, LISTED) or "nothing more"])
    return Table(head, rows, "what another recording would determine beside this one", wordy=(2,))


LISTED = 8
"""Gains of a further recording that are listed; all are in the JSON record."""


def effects_table(report: Identifiability) -> Table:
    """Return the change of the decoded pose by 1 sigma and by 1 % of each parameter, then by all together."""
    pose, period = report.model.pose, report.model.period
    head = ["largest effect", *heads(pose, period, "1 sigma"), *heads(pose, period, "1 %")]
    lost = [entry for entry in shown(report) if entry.std is None]
    entries = [entry for entry in shown(report) if len(lost) <= NAMED + 1 or entry not in lost[NAMED:]]
    sigma = _numbers([entry.sigma for entry in entries], report.model)
    percent = _numbers([entry.percent for entry in entries], report.model)
    rows = [[e.name, *s, *p] for e, s, p in zip(entries, sigma, percent, strict=True)]
    for key, label in TOGETHER.items():
        sizes = cells([getattr(report.outputs[c], key) for c in pose], pose, period)
        rows.append([label, *sizes, *[""] * len(pose)])
    return Table(head, rows, "largest change of the decoded pose by 1 sigma and by 1 % of each parameter")


TOGETHER = {
    "parameters_rms": "all parameters, rms",
    "parameters_worst": "all parameters, worst",
    "noise_floor": "noise of one reading",
}
NIL = 1e-9
"""Part of the largest change of a coordinate below which a change is a rounding error: 0."""


def _numbers(changes: Sequence[Change | None], model: Model) -> list[list[str]]:
    """Return each change of each coordinate, in its unit; empty where a parameter has none."""
    largest = {c: max((abs(x.worst[c]) for x in changes if x), default=0.0) for c in model.pose}

    def sizes(change: Change) -> list[float]:
        found = change.worst
        return [found[c] if abs(found[c]) > NIL * largest[c] else 0.0 for c in model.pose]

    none = [""] * len(model.pose)
    return [cells(sizes(change), model.pose, model.period) if change else none for change in changes]


def offsets_text(offsets: Offsets) -> list[str]:
    """Return the zero deviations: their sizes over all runs."""
    if not offsets.names:
        return []
    sizes = offsets.sizes()
    factor, unit = (1e6, "um") if offsets.units[0] == "m" else (float(np.degrees(1.0)), "deg")
    said = [
        f"{n} {number(factor * z['rms'])} {unit} rms, {number(factor * z['worst'])} {unit} at most"
        for n, z in sizes.items()
    ]
    std = factor * max(z["std"] for z in sizes.values())
    each = f"each +-{number(std, 2)} {unit} (1 sigma)"
    return [f"{offsets.values.size} zero deviations, eliminated: {'; '.join(said)}; {each}"]


def shown(report: Identifiability) -> list[ParameterReport]:
    """Return the parameters that are not fixed."""
    return [entry for entry in report.parameters if entry.verdict.word != "fixed"]


# -- correlation -----------------------------------------------------------------------------------------

CELL, WRITTEN, HIGH = 24.0, 22, 560.0
"""Height of a cell, at most [px]; so many parameters have their numbers written; height of all [px]."""


def correlation(report: Identifiability) -> p.Picture:
    """Return the correlation of every two determined parameters: cells above the diagonal, numbers below.

    The fuller a cell the larger the correlation; negative ones have a dash.
    """
    order = np.flatnonzero(np.isfinite(np.diag(report.correlation)))
    if len(order) < 2:
        raise InputError("There is no correlation to draw: no two parameters are determined.")
    names = [report.model.names[k] for k in order]
    values, n = report.correlation[np.ix_(order, order)], len(order)
    rest = [entry for k, entry in enumerate(report.parameters) if k not in order]
    left_out = (
        f"{word}: {', '.join(entry.name for entry in rest if entry.verdict.word == word)}"
        for word in VERDICTS
        if any(entry.verdict.word == word for entry in rest)
    )
    written = n <= WRITTEN
    drawn = np.where(np.triu(np.ones((n, n)), 1) if written else ~np.eye(n, dtype=bool), values, np.nan)
    edges = np.arange(n + 1) - 0.5
    pairs = [(names[j], names[i], values[j, i]) for j in range(n) for i in range(n)]
    said = [f"{a}, {b}: {minus(f'{v:+.2f}')}" for a, b, v in pairs]
    row, column = np.tril_indices(n, -1)
    strongest = int(np.argmax(np.abs(values[row, column])))
    numbers = p.text([_short(v) for v in values[row, column]], column, row, "center")
    panel = p.Panel(
        p.Axis(low=-0.5, high=max(n, WRITTEN) - 0.5, names=names),
        p.Axis(low=n - 0.5, high=-0.5, names=names),
        p.tiles(edges, edges, drawn, 1.0, said, labels=("correlated", "anticorrelated")),
        says=f"correlation of {n} parameters; strongest {said[n * row[strongest] + column[strongest]]}",
        height=min(CELL * n, HIGH),
        inside=[numbers] if written else [],
    )
    return p.Picture([panel], words=f"Left out, {'; '.join(left_out)}." if rest else "")


def _short(value: float) -> str:
    """Two digits without the zero before the point."""
    if abs(value) < 0.005:
        return "0"
    text = "1.0" if abs(value) >= 0.995 else f"{abs(value):.2f}"[1:]
    return minus(("-" if value < 0 else "") + text)
