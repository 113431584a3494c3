"""The page of a diagnosis: `hallsym diagnose LOG -o report.html`. Built from its record, plain JSON data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hallsym.estimation.calibration import Fit
from hallsym.report.data import Cells, RunSeries
from hallsym.report.page import parts
from hallsym.report.page.diagnosis_effects import effects_section
from hallsym.report.page.diagnosis_errors import errors_section, errors_title, gaps_of
from hallsym.report.page.diagnosis_places import rest_section, where_section
from hallsym.report.page.diagnosis_record import Record, floor_of, log_of, percent, source_of, typeset
from hallsym.report.page.html import Markup, facts, items, join, table, tag
from hallsym.report.page.page import Section, document
from hallsym.report.page.series import all_series
from hallsym.report.tables import concise
from hallsym.report.words import MINUS


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
    floor = floor_of(record)
    sections = [
        Section("asked", "What was asked", _asked(record, floor)),
        Section("errors", errors_title(record), errors_section(record, floor)),
        Section("effects", "Which effects", effects_section(record)),
        Section("where", "Where the gap lies", where_section(record)),
        Section("rest", "What no effect explains", rest_section(record)),
        Section("maps", "Maps of the error", parts.maps_section(maps, floor, after=after)),
        Section("series", "Decoded minus reference over time", all_series(series)),
        Section("parameters", "Parameters", _parameters(record, fit)),
        Section("notes", "Also looked at, and notes", _notes(record)),
        Section("origin", "Origin", parts.provenance(log_of(record), record.get("versions") or {}, command)),
    ]
    title = f"Diagnosis of {record.get('model') or 'a model'}: {parts.called(log_of(record).get('path'))}"
    verdict = [tag("strong", f"{str(record['verdict']).capitalize()}."), " ", _sentence(record)]
    footer = f"hallsym {(record.get('versions') or {}).get('hallsym', '')}"
    return document(title, verdict, sections, footer)


def _sentence(record: Record) -> str:
    """Return the record's own sentence, else one from its numbers."""
    if record.get("sentence"):
        return typeset(str(record["sentence"]).removeprefix(f"{str(record['verdict']).capitalize()}: "))
    ranked = record.get("ranked") or []
    found = f"The evidence names {', '.join(ranked)}" if ranked else "No effect of the catalogue is named"
    said = [f"{parts.each(gap['rmse'])} {when}" for when, gap in gaps_of(record).items()]
    return f"{found}; rmse {', '.join(said)}." if said else f"{found}."


def _asked(record: Record, floor: Mapping[str, float]) -> Markup:
    log, runs = log_of(record), record.get("validation_runs") or []
    apart = "took part in neither the fit nor the choice of effects"
    threshold = record.get("threshold")
    return facts(
        [
            ("log", tag("code", log.get("path") or "a log in memory")),
            ("samples", f"{log['rows']} in {log['runs']} runs" if {"rows", "runs"} <= set(log) else None),
            ("model", record.get("model")),
            ("runs held out", f"{len(runs)} ({parts.numbers(runs)}), which {apart}" if runs else None),
            ("noise floor", f"{parts.each(floor)}{source_of(record, '; ')}" if floor else None),
            (
                "worth reporting",
                f"what lowers the gap by at least {100 * threshold:g} %" if threshold else None,
            ),
        ]
    )


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
        f"{f['name']}: significant, lowers the gap by {percent(f['shrinkage'])}, less than the threshold"
        if f.get("shrinkage") is not None
        else f"{f['name']}: significant, less than the threshold"
        for f in record.get("smaller_findings") or []
    ]
    untested = [
        f"{name}: not testable, {reason}" for name, reason in (record.get("not_testable") or {}).items()
    ]
    return items([*smaller, *untested, *(record.get("notes") or [])])
