"""The page of a diagnosis: `hallsym diagnose LOG -o report.html`. Built from its record, plain JSON data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hallsym.calibration import Fit
from hallsym.page import figures, parts
from hallsym.page.cells import Cells
from hallsym.page.html import Markup, facts, items, join, table, tag
from hallsym.page.page import Section, document
from hallsym.page.series import RunSeries, all_series
from hallsym.plots.names import MINUS
from hallsym.tables import concise

MOST = 12
"""Statements on where the gap lies that are drawn; all of them are in the table."""

Record = Mapping[str, Any]


def diagnosis_page(
    record: Record,
    *,
    maps: Sequence[Cells] = (),
    series: Sequence[RunSeries] = (),
    fit: Fit | None = None,
    command: str = "",
) -> str:
    """Return the page of a diagnosis as HTML.

    `record`: `Diagnosis.to_dict()`; entries that are missing or None leave their place out. `maps`, `series`:
    of the errors before (and after), from `gather` or `run_series`. `fit`: the calibration that was
    diagnosed, for its parameter table. `command`: what was typed. How long it took is not shown, so that the
    page of the same data is the same.
    """
    floor = _floor(record)
    sections = [
        Section("asked", "What was asked", _asked(record, floor)),
        Section("errors", "Before and after, against the noise floor", _errors(record, floor)),
        Section("effects", "Which effects", _effects(record)),
        Section("where", "Where the gap lies", _where(record)),
        Section("maps", "Maps of the error", parts.maps_section(maps, floor)),
        Section("series", "Decoded minus reference over time", all_series(series)),
        Section("parameters", "Parameters", _parameters(record, fit)),
        Section("notes", "Also looked at, and notes", _notes(record)),
        Section("origin", "Origin", parts.provenance(_log(record), record.get("versions") or {}, command)),
    ]
    title = f"Diagnosis of {record.get('model') or 'a model'}: {parts.called(_log(record).get('path'))}"
    verdict = [tag("strong", f"{str(record['verdict']).capitalize()}."), " ", _sentence(record)]
    footer = f"hallsym {(record.get('versions') or {}).get('hallsym', '')}"
    return document(title, verdict, sections, footer)


def _sentence(record: Record) -> str:
    """Return the record's own sentence, else one from its numbers."""
    if record.get("sentence"):
        return str(record["sentence"])
    ranked = record.get("ranked") or []
    found = f"The evidence names {', '.join(ranked)}" if ranked else "No effect of the catalogue is named"
    said = [f"{parts.each(gap['rmse'])} {when}" for when, gap in _gaps(record).items()]
    return f"{found}; rmse {', '.join(said)}." if said else f"{found}."


def _floor(record: Record) -> dict[str, float]:
    found = record.get("noise_floor") or {}
    return {c: v for c, v in found.items() if isinstance(v, int | float) and math.isfinite(v)}


def _log(record: Record) -> Record:
    return record.get("log") or {}


def _asked(record: Record, floor: Mapping[str, float]) -> Markup:
    log, runs = _log(record), record.get("validation_runs") or []
    apart = "took part in neither the fit nor the choice of effects"
    source = (record.get("noise_floor") or {}).get("source")
    threshold = record.get("threshold")
    return facts(
        [
            ("log", tag("code", log.get("path") or "a log in memory")),
            ("samples", f"{log['rows']} in {log['runs']} runs" if {"rows", "runs"} <= set(log) else None),
            ("model", record.get("model")),
            ("judged on runs", f"{len(runs)} ({parts.numbers(runs)}), which {apart}" if runs else None),
            ("noise floor", parts.each(floor) + (f"; {source}" if source else "") if floor else None),
            (
                "worth reporting",
                f"what lowers the gap by at least {100 * threshold:g} %" if threshold else None,
            ),
        ]
    )


def _errors(record: Record, floor: Mapping[str, float]) -> Markup:
    shown = _gaps(record)
    if not shown:
        return Markup("")
    drawn = {k: ("before" if k == "before" else "after", gap) for k, gap in shown.items()}
    note = "On runs that took part in neither the fit nor the choice of effects. Dashed line: noise floor."
    return join(
        [
            tag("p", _shrinks(record.get("shrinkage") or {}), _metric(record.get("metric") or {})),
            tag("p", note, class_="note"),
            tag("figure", figures.against_floor(drawn, floor)),
            parts.gap_table(shown, floor),
        ]
    )


def _metric(metric: Record) -> str | None:
    """Return the one number over all outputs [m] that shrinkage is measured by."""
    said = [f"{parts.amount('x_m', v)} {when}" for when, v in metric.items() if isinstance(v, int | float)]
    return f" One number over all outputs: {', '.join(said)}." if said else None


def _gaps(record: Record) -> dict[str, Any]:
    """Return the gaps that there are, with the outputs for which each of them has a number."""
    gaps = {k: record[f"gap_{k}"] for k in ("before", "after") if record.get(f"gap_{k}")}
    if not gaps:
        return {}
    outputs = [
        c
        for c in next(iter(gaps.values()))["rmse"]
        if all(isinstance(g[what].get(c), int | float) for g in gaps.values() for what in ("rmse", "peak"))
    ]
    if not outputs:
        return {}
    return {k: {what: {c: g[what][c] for c in outputs} for what in ("rmse", "peak")} for k, g in gaps.items()}


def _shrinks(shrinkage: Record) -> str | None:
    value = shrinkage.get("value")
    if value is None:
        return None
    text = f"The gap shrinks by {_percent(value)}{_interval(shrinkage.get('interval'))}"
    if shrinkage.get("share_closed") is not None:
        text += f"; {_percent(shrinkage['share_closed'], 0)} of what is above the noise floor is closed"
    if shrinkage.get("parameters_added"):
        text += f", with {shrinkage['parameters_added']} parameters more"
    return text + "."


def _effects(record: Record) -> Markup:
    effects, groups = record.get("effects") or [], record.get("groups") or []
    if not (effects or groups or record.get("ranked")):
        return tag("p", "None: no effect of the catalogue lowers the gap by what is worth reporting.")
    return join([_ranking(record, effects), _ranked(record, effects, groups), _groups(record, groups)])


def _ranking(record: Record, effects: Sequence[Record]) -> Markup:
    drawn = [e for e in effects if e.get("shrinkage") is not None]
    if not drawn:
        return Markup("")
    rows = [(str(e["name"]), float(e["shrinkage"]), _pair(e.get("interval"))) for e in drawn]
    title = "the gap without it shrinks by [%], with its 95 % interval"
    return tag("figure", figures.intervals(rows, title))


def _ranked(record: Record, effects: Sequence[Record], groups: Sequence[Sequence[str]]) -> Markup:
    """Return the ranking as a table: effects with numbers, then names that carry evidence without them."""
    head = ["effect", "link", "form", "shrinks the gap by", "share of the gap", "p", "not told apart from"]
    rows: list[list[object]] = []
    for e in effects:
        shrinks = (
            "" if e.get("shrinkage") is None else _percent(e["shrinkage"]) + _interval(e.get("interval"))
        )
        share = "" if e.get("share") is None else _percent(e["share"], 0)
        row = [e["name"], e.get("link") or "", e.get("variant") or "", shrinks, share, _p(e.get("p_value"))]
        rows.append([*row, _others(e["name"], groups)])
    named = {e["name"] for e in effects}
    for name in record.get("ranked") or []:
        if name not in named:
            rows.append([name, "", "", "", "", "", _others(name, groups)])
    return table(head, rows, left=3, wordy=(6,), caption="effects, best first")


def _others(name: str, groups: Sequence[Sequence[str]]) -> str:
    return ", ".join(dict.fromkeys(other for g in groups if name in g for other in g if other != name))


def _groups(record: Record, groups: Sequence[Sequence[str]]) -> Markup:
    """Return what the log cannot tell apart, and the recording that would."""
    found = {tuple(s.get("group") or ()): s for s in record.get("separate_by") or []}
    lines = []
    for group in dict.fromkeys([*map(tuple, groups), *found]):
        s = found.get(group, {})
        text: list[object] = [tag("strong", ", ".join(group)), ": this log cannot tell them apart."]
        if s.get("recording"):
            text.append(f" Record {s['recording']}")
            text.append(
                f": the difference must show {s['factor']:.3g} times more than here."
                if s.get("factor")
                else "."
            )
        lines.append(join(text))
    return join([tag("h3", "Groups"), items(lines)]) if lines else Markup("")


def _where(record: Record) -> Markup:
    return join(
        [
            _statements(record.get("where") or [], "share of the excess above the noise floor [%]"),
            _rest(record.get("remaining") or []),
        ]
    )


def _rest(statements: Sequence[Record]) -> Markup:
    if not statements:
        return Markup("")
    shown = _statements(statements, "share of what no effect explains [%]")
    return join([tag("h3", "Where the rest lies"), shown])


def _statements(statements: Sequence[Record], title: str) -> Markup:
    if not statements:
        return Markup("")
    drawn = [s for s in statements if s.get("share") is not None][:MOST]
    bars = [(_place(s), float(s["share"])) for s in drawn]
    rows = [[s.get("text") or _place(s), _p(s.get("p_value"))] for s in statements]
    picture = tag("figure", figures.shares(bars, title)) if bars else None
    return join([picture, table(["statement", "p"], rows)])


def _place(statement: Record) -> str:
    by, at = str(statement.get("by") or ""), str(statement.get("at") or "")
    return f"{by}: {at}" if at else by


def _parameters(record: Record, fit: Fit | None) -> Markup:
    rows: list[list[object]] = []
    for e in record.get("effects") or []:
        for name, p in (e.get("parameters") or {}).items():
            value = "" if p.get("value") is None else concise(p["value"], p.get("std")).replace("-", MINUS)
            rows.append([e["name"], name, value, p.get("unit") or "", e.get("cost") or ""])
    head = ["effect", "parameter", "value (std)", "unit", "adds to the model"]
    added = table(head, rows, left=2, wordy=(4,), caption="parameters of the effects")
    own = (
        join([tag("h3", f"Of {fit.model.name}"), parts.parameter_table(fit), parts.combinations(fit)])
        if fit
        else None
    )
    return join([added, own])


def _notes(record: Record) -> Markup:
    smaller = [
        f"{f['name']}: significant, lowers the gap by {_percent(f['shrinkage'])}, less than the threshold"
        if f.get("shrinkage") is not None
        else f"{f['name']}: significant, less than the threshold"
        for f in record.get("smaller_findings") or []
    ]
    untested = [
        f"{name}: not testable, {reason}" for name, reason in (record.get("not_testable") or {}).items()
    ]
    return items([*smaller, *untested, *(record.get("notes") or [])])


def _pair(interval: Sequence[float] | None) -> tuple[float, float] | None:
    return None if not interval or None in interval else (float(interval[0]), float(interval[1]))


def _interval(interval: Sequence[float] | None) -> str:
    pair = _pair(interval)
    return f" ({100 * pair[0]:.1f} to {100 * pair[1]:.1f})".replace("-", MINUS) if pair else ""


def _percent(value: float, digits: int = 1) -> str:
    return f"{100 * value:.{digits}f} %".replace("-", MINUS)


def _p(value: float | None) -> str:
    if value is None:
        return ""
    return "< 1e−300" if value < 1e-300 else f"{value:.1g}".replace("-", MINUS)
