"""The page of a diagnosis: `hallsym diagnose LOG -o report.html`. Built from its record, plain JSON data."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from hallsym.calibration import Fit
from hallsym.diagnosis.text import p_text
from hallsym.page import curves, figures, parts
from hallsym.page.cells import Cells
from hallsym.page.html import Markup, facts, items, join, table, tag
from hallsym.page.page import Section, document
from hallsym.page.series import RunSeries, all_series
from hallsym.plots.names import MINUS, scale, three
from hallsym.plots.names import name as named_column
from hallsym.tables import concise

MOST = 12
"""Statements on where the gap lies that are drawn; all of them are in the table."""

Record = Mapping[str, Any]


def diagnosis_page(
    record: Record,
    *,
    maps: Sequence[Cells] = (),
    after: Sequence[Cells] = (),
    series: Sequence[RunSeries] = (),
    fit: Fit | None = None,
    command: str = "",
) -> str:
    """Return the page of a diagnosis as HTML.

    `record`: `Diagnosis.to_dict()`; entries that are missing or None leave their place out. `maps`, `after`,
    `series`: of the errors before and after, from `gather` or `run_series`. `fit`: the calibration that was
    diagnosed, for its parameter table. `command`: what was typed. How long it took is not shown, so that the
    page of the same data is the same.
    """
    floor = _floor(record)
    sections = [
        Section("asked", "What was asked", _asked(record, floor)),
        Section("errors", _errors_title(record), _errors(record, floor)),
        Section("effects", "Which effects", _effects(record)),
        Section("where", "Where the gap lies", _where(record)),
        Section("rest", "What no effect explains", _unexplained(record)),
        Section("maps", "Maps of the error", parts.maps_section(maps, floor, after=after)),
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
        return typeset(str(record["sentence"]).removeprefix(f"{str(record['verdict']).capitalize()}: "))
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
    threshold = record.get("threshold")
    return facts(
        [
            ("log", tag("code", log.get("path") or "a log in memory")),
            ("samples", f"{log['rows']} in {log['runs']} runs" if {"rows", "runs"} <= set(log) else None),
            ("model", record.get("model")),
            ("runs held out", f"{len(runs)} ({parts.numbers(runs)}), which {apart}" if runs else None),
            ("noise floor", f"{parts.each(floor)}{_source(record, '; ')}" if floor else None),
            (
                "worth reporting",
                f"what lowers the gap by at least {100 * threshold:g} %" if threshold else None,
            ),
        ]
    )


def _source(record: Record, before: str = "") -> str:
    """Return whether the noise floor was stated or estimated."""
    source = (record.get("noise_floor") or {}).get("source")
    return f"{before}{source}" if source else ""


def _changed(record: Record) -> bool:
    """Whether there is an after that differs from before."""
    return bool(record.get("effects") or record.get("ranked"))


def _errors_title(record: Record) -> str:
    return f"{'Before and after' if _changed(record) else 'Errors'}, against the noise floor"


def _errors(record: Record, floor: Mapping[str, float]) -> Markup:
    shown = _gaps(record)
    if not shown:
        return _sizes(record)
    drawn = {k: ("before" if k == "before" else "after", gap) for k, gap in shown.items()}
    if not _changed(record):
        shown = {"held out": shown["before"]} if "before" in shown else shown
        drawn = {k: ("after", gap) for k, gap in shown.items()}
    note = "On runs that took part in neither the fit nor the choice of effects. Dashed line: noise floor."
    shrinks = _shrinks(record.get("shrinkage") or {}) if _changed(record) else None
    return join(
        [
            tag("p", shrinks, _metric(record)),
            tag("p", note, class_="note"),
            tag("figure", figures.against_floor(drawn, floor)),
            parts.gap_table(shown, floor, _source(record)),
            _sizes(record),
            _waves(record),
        ]
    )


def _waves(record: Record) -> Markup:
    """Return the error of an encoder by waves per turn."""
    waves = record.get("waves") or []
    if not waves:
        return Markup("")
    named = [e["name"] for e in record.get("effects") or []]
    rows: list[list[object]] = []
    for w in waves:
        sizes = [
            "" if w.get(k) is None else three(math.degrees(w[k])) for k in ("designed", "model", "after")
        ]
        found = [n for n in named if n in w["causes"]]
        rows.append([w["per_turn"], *sizes, ", ".join(found), ", ".join(w["causes"])])
    head = ["waves per turn", "as designed [deg]", "model", "with the effects", "named here", "made by"]
    caption = (
        "amplitude of the error over all runs: as designed (only the zero fitted), with the model's own "
        "parameters, with the effects found"
    )
    return join([tag("h3", "By waves per turn"), table(head, rows, left=1, wordy=(4, 5), caption=caption)])


def _sizes(record: Record) -> Markup:
    """Return how large the gap is per output and sensor, fitted and held-out runs apart."""
    size = record.get("size") or {}
    rows: list[list[object]] = []
    for kind in ("outputs", "sensors"):
        for column, sides in (size.get(kind) or {}).items():
            if kind == "sensors" and column in (size.get("outputs") or {}):
                continue  # a decoded angle is both
            row: list[object] = [named_column(column)]
            largest = max(side["rms"] for side in sides.values())
            factor, unit = scale(column, largest)
            row.append(unit)
            for when in ("fitted", "held_out"):
                side = sides.get(when)
                cells = [three(factor * side[k]) for k in ("rms", "noise", "above")] if side else [""] * 3
                share = "" if not side or side.get("share") is None else _percent(side["share"], 0)
                row += [*cells, share]
            rows.append(row)
    head = ["of the model", "unit"]
    for when in ("fitted", "held out"):
        head += [f"rms, {when}", "noise", "above", "share"]
    caption = (
        "what the model leaves on fitted and on held-out runs: rms, noise floor "
        f"({_source(record) or 'as given'}), what is above it, and its share of the excess of all outputs, "
        "or of all sensors, where the excess as a whole is more than chance"
    )
    return (
        join([tag("h3", "Per output and per sensor"), table(head, rows, left=2, caption=caption)])
        if rows
        else Markup("")
    )


def _metric(record: Record) -> str | None:
    """Return the one number over all outputs (SI) that shrinkage is measured by."""
    metric = dict(record.get("metric") or {})
    if not _changed(record):
        metric = {"on held-out runs" if k == "before" else k: v for k, v in metric.items() if k != "after"}
    outputs = tuple((record.get("gap_before") or {}).get("rmse") or ("x_m",))
    column = next((c for c in outputs if c.endswith("_m")), outputs[0])
    said = [f"{parts.amount(column, v)} {when}" for when, v in metric.items() if isinstance(v, int | float)]
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
        lines.append(join([tag("strong", ", ".join(group)), *_separation(s)]))
    return join([tag("h3", "Groups"), items(lines)]) if lines else Markup("")


def _separation(s: Record) -> list[object]:
    """Return what would separate a group, and by how much."""
    now = "" if s.get("sigma_now") is None else f" ({three(s['sigma_now'])} sigma)"
    out: list[object] = [f": this log cannot tell them apart{now}."]
    if not s.get("recording"):
        return out
    out.append(f" Record {s['recording']}")
    if s.get("simulated") and s.get("sigma") is not None and s.get("runs"):
        each = f": simulated, one run of {s['run_s']:.3g} s tells them apart by {three(s['sigma'])} sigma"
        total = f" ({s['seconds']:.3g} s in all)" if s["runs"] > 1 and s.get("seconds") else ""
        out.append(f"{each}; 5 sigma take {s['runs']} run{'s' if s['runs'] > 1 else ''}{total}.")
        tried = sorted((s.get("tried") or {}).items(), key=lambda x: -(x[1] or 0.0))
        rows = [[what, three(sigma)] for what, sigma in tried if sigma is not None]
        out.append(table(["recording that was simulated", "sigma per run"], rows))
    elif s.get("factor"):
        out.append(f": the difference must show {s['factor']:.3g} times more than here.")
    else:
        out.append(".")
    return out


def _where(record: Record) -> Markup:
    said = _statements(record.get("where") or [], "share of the excess above the noise floor [%]")
    if not said and record.get("size"):
        said = tag("p", "Nowhere in particular: what is above the noise goes with nothing beyond chance.")
    return join([said, _alone(record.get("shares") or [])])


def _alone(shares: Sequence[Record]) -> Markup:
    """Return what each place takes of the excess by itself, sure or not, folded away."""
    rows = [
        [
            s["kind"],
            named_column(s["name"]) if s["kind"] in ("output", "sensor") else s["name"],
            "" if s.get("share") is None else _percent(s["share"], 0),
            _p(s.get("p_value")),
            s.get("text") or "",
        ]
        for s in shares
    ]
    if not rows:
        return Markup("")
    head = ["kind", "place", "share of the excess", "p", ""]
    note = "Each with nothing before it, so that shares overlap; p above 0.01 is no evidence."
    summary = tag("summary", "every place by itself: coordinates, links, outputs, sensors, frequencies, runs")
    return tag("details", summary, table(head, rows, left=2, wordy=(4,), caption=note))


def _unexplained(record: Record) -> Markup:
    """Return what is left: how much, what it goes with, and its shape."""
    rest, statements = record.get("unexplained") or {}, record.get("remaining") or []
    if not rest and not statements:
        return Markup("")
    said = []
    if rest.get("share") is not None:
        said.append(
            tag("p", f"{_percent(rest['share'], 0)} of the gap above the noise floor has no known cause.")
        )
    if statements and statements != record.get("where"):
        said.append(_statements(statements, "share of what no effect explains [%]"))
    elif statements:
        said.append(tag("p", "It lies where the gap lies, see above."))
    elif rest.get("text"):
        said.append(tag("p", f"{typeset(str(rest['text'])).capitalize()}."))
    if rest.get("curve"):
        said.append(curves.curve(rest["curve"]))
    return join(said)


def _statements(statements: Sequence[Record], title: str) -> Markup:
    if not statements:
        return Markup("")
    drawn = [s for s in statements if s.get("share") is not None][:MOST]
    bars = [(_place(s), float(s["share"])) for s in drawn]
    rows = [
        [
            typeset(str(s.get("text") or _place(s))),
            "" if s.get("held_out") is None else _percent(max(s["held_out"], 0.0), 0),
            _p(s.get("p_value")),
        ]
        for s in statements
    ]
    picture = tag("figure", figures.shares(bars, title)) if bars else None
    return join([picture, table(["statement (fitted runs)", "on held-out runs", "p"], rows)])


def _place(statement: Record) -> str:
    """Return what a bar is called; of a coordinate the range is left to the statement under it."""
    by, at = str(statement.get("by") or ""), str(statement.get("at") or "")
    if by in ("output", "sensor"):
        return f"{by} {named_column(at)}"
    return f"{by}: {at}" if at and by in ("link", "run", "frequency") else by


def typeset(text: str) -> str:
    """Return words with the micro sign in units."""
    return re.sub(r"(?<=\d )u(?=(m|rad)\b)", "µ", text)


def _parameters(record: Record, fit: Fit | None) -> Markup:
    rows: list[list[object]] = []
    turns = "angle_rad" in (record.get("noise_floor") or {})
    for e in record.get("effects") or []:
        for name, p in (e.get("parameters") or {}).items():
            degrees = turns and p.get("unit") == "rad"
            factor, unit = (180 / math.pi, "deg") if degrees else (1.0, p.get("unit") or "")
            std = None if p.get("std") is None else factor * p["std"]
            value = "" if p.get("value") is None else concise(factor * p["value"], std).replace("-", MINUS)
            rows.append([e["name"], name, value, unit, e.get("cost") or ""])
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
    return p_text(value).replace("-", MINUS)
