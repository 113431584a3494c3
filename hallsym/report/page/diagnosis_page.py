"""The page of a diagnosis: `hallsym diagnose LOG -o report.html`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from hallsym.diagnosis import Diagnosis, Statement, noise_text
from hallsym.estimation import Fit
from hallsym.families import added_effects, plain
from hallsym.output import percent
from hallsym.report.data.gather import Cells, RunSeries
from hallsym.report.figures.diagnosis import changed, curves, gap, shares
from hallsym.report.page import shared
from hallsym.report.page.content import (
    Facts,
    Figure,
    Heading,
    Headline,
    Items,
    Section,
    Table,
    Words,
    document,
)
from hallsym.report.picture import BEFORE
from hallsym.report.tables import concise
from hallsym.report.text.diagnosis import (
    noise_name,
    p_text,
    shrinkage_text,
    shrinks_text,
    significance_text,
    size_rows,
    units_of,
    wave_rows,
)  # fmt: skip
from hallsym.report.words import NOT_DECODED, amount, micro, three
from hallsym.report.words import name as named_column

JUDGED = "On runs that took part in neither the fit nor the choice of effects. Dashed line: noise floor."
STATES = {"no gap": "good", "explained": "good"}
"""Verdicts after which there is nothing left to find; every other one is open."""


def diagnosis_page(
    d: Diagnosis,
    *,
    maps: Sequence[Cells] = (),
    after: Sequence[Cells] = (),
    series: Sequence[RunSeries] = (),
    fit: Fit | None = None,
    command: str = "",
    reading: Sequence[str] = (),
) -> str:
    """Return the page of a diagnosis as HTML.

    `maps`, `after`, `series`: of the errors before and after, from `gather`.
    `fit`: the calibration that was diagnosed, for its parameter table. `command`: what was typed, `reading`:
    the part of it that says how the log is read, for the next command. The duration is not shown, so the same
    data give the same page.
    """
    sections = [
        Section("asked", "Input", [_input(d)]),
        errors_section(d),
        effects_section(d),
        where_section(d),
        rest_section(d),
        shared.maps_section({"before": maps, "after": after}, d.noise_floor.outputs),
        shared.runs_section(series),
        Section("parameters", "Parameters", _parameters(d, fit)),
        Section("notes", "Other checks", [Items(_notes(d))]),
        shared.origin_section(asdict(d.log), d.versions, command),
    ]
    title = f"Diagnosis of {d.model}: {shared.called(d.log.path)}"
    headline = _headline(d, fit, reading)
    return document(title, headline, sections, f"hallsym {d.versions.get('hallsym', '')}")


def _headline(d: Diagnosis, fit: Fit | None, reading: Sequence[str]) -> Headline:
    word = f"{d.verdict.capitalize()}."
    next_command, why = "", ""
    if d.next_step:
        next_command = shlex.join(["hallsym", "fit", d.log.path or "LOG", *d.next_step, *reading])
        why = "Next, fit the model with the effects found:"
    elif d.verdict == "no gap" and fit:
        words = [word for effect in added_effects(fit.model) for word in ("--effect", effect)]
        known = ["hallsym", "fit", d.log.path or "LOG", "--model", plain(fit.model).name, *words, *reading]
        next_command = shlex.join([*known, "-o", "calib.json"])
        why = "Next, keep the calibration of this model:"
    return Headline(
        STATES.get(d.verdict, "open"),
        word,
        micro(d.sentence.removeprefix(f"{word} ")),
        why,
        next_command,
        Figure(gap(d).panels, JUDGED),
    )


def _input(d: Diagnosis) -> Facts:
    judging = "which took part in neither the fit nor the choice of effects"
    pairs = [
        ("log", d.log.path or "a log in memory"),
        ("samples", f"{d.log.rows} in {d.log.runs} {d.held_out.rpartition(' ')[2]}s" if d.log.rows else None),
        ("model", d.model),
        (f"{d.held_out}s", f"{len(d.validation_runs)} ({shared.numbers(d.validation_runs)}), {judging}"),
        ("noise floor", f"{shared.each(d.noise_floor.outputs)}; {d.noise_floor.source}"),
        (noise_name(d), noise_text(d.noise, d.noise_floor.source == "stated") if d.noise else None),
        ("worth reporting", f"a decrease of the gap by at least {100 * d.threshold:g} %"),
        ("any effect", f"p {significance_text(d.significance)}" if d.significance else None),
    ]
    return Facts(pairs, frozenset({"log"}))


def _parameters(d: Diagnosis, fit: Fit | None) -> list[Any]:
    rows: list[list[Any]] = []
    angle = units_of(d)["rad"]
    for e in d.effects:
        for name, p in e.parameters.items():
            factor, unit = angle if angle[1] == "deg" and p.unit == "rad" else (1.0, p.unit)
            std = None if p.std is None else factor * p.std
            rows.append([e.name, name, concise(factor * p.value, std), unit, e.cost])
    head = ["effect", "parameter", "value (1 sigma)", "unit", "adds to the model"]
    added = Table(head, rows, "parameters of the effects", left=2, wordy=(3, 4), sortable=changed(d))
    own = [Heading(f"Of {fit.model.name}"), *shared.parameters_of(fit)] if fit else []
    return [added, *own]


def _notes(d: Diagnosis) -> list[tuple[str, str]]:
    said = "significant, lowers the gap by {}, less than the threshold"
    smaller = [(f.name, said.format(percent(f.shrinkage, 1))) for f in d.smaller_findings]
    untested = [(name, f"not testable, {reason}") for name, reason in d.not_testable.items()]
    return [*smaller, *untested, *(("", note) for note in d.notes)]


# -- errors: before and after, per output, sensor and harmonic -------------------------------------------


def errors_section(d: Diagnosis) -> Section:
    """Return how far the error falls, and its size on fitted and holdout runs and by harmonic."""
    content: list[Any] = [
        Words(f"{shrinks_text(d) if changed(d) else ''} {_metric(d)}".strip()),
        *_sizes(d),
    ]
    for coordinate in dict.fromkeys(w.coordinate for w in d.waves):
        content += _waves(d, coordinate)
    title = f"{'Before and after' if changed(d) else 'Errors'}, against the noise floor"
    return Section("errors", title, content)


def _metric(d: Diagnosis) -> str:
    """Return the gap as one number over all outputs, which shrinkage is measured by."""
    outputs = tuple(d.gap_before.rmse)
    column = next((c for c in outputs if c.endswith("_m")), outputs[0])
    sizes = asdict(d.metric)
    if not changed(d):
        sizes = {"on the holdout runs": d.metric.before, "floor": d.metric.floor}
    return f"One number over all outputs: {', '.join(f'{amount(column, v)} {k}' for k, v in sizes.items())}."


def _waves(d: Diagnosis, coordinate: str) -> list[Any]:
    head, *rows = wave_rows(d, coordinate)
    lost = any(w.designed is None for w in d.waves if w.coordinate == coordinate)
    caption = (
        f"amplitude of the error over all runs: of the nominal sensor with only its zeros fitted"
        f"{f' (none: {NOT_DECODED})' if lost else ''}, of the model, and with the effects found"
    )
    return [Heading(f"By {head[0].partition(' [')[0]}"), Table(head, rows, caption, wordy=(4, 5))]


def _sizes(d: Diagnosis) -> list[Any]:
    caption = (
        f"residual error on fitted and holdout runs: rms, noise floor ({d.noise_floor.source}), the excess "
        "above it, and its share of the excess of all outputs, or of all sensors, where the whole excess is "
        "more than chance"
    )
    found = size_rows(d)
    return [Heading("Per output and per sensor"), Table(found[0], found[1:], caption)] if found else []


# -- effects: ranked, with what the log cannot tell apart ------------------------------------------------


def effects_section(d: Diagnosis) -> Section:
    """Return the ranking of the effects, and groups that the log cannot tell apart."""
    if not (d.effects or d.groups or d.ranked):
        none = "None. No effect of the catalogue lowers the gap by what is worth reporting."
        return Section("effects", "Which effects", [Words(none)])
    rows = [(e.name, e.shrinkage, e.interval) for e in d.effects if math.isfinite(e.shrinkage)]
    drawn = [shares(rows, "decrease of the gap [%]", 1)] if rows else []
    ranking = Figure(drawn, "With the 95 % interval of each effect", look="two")
    notes = Items([(e.name, e.note) for e in d.effects if e.note])
    return Section("effects", "Which effects", [ranking, _ranked(d), notes, *_groups(d)])


def _ranked(d: Diagnosis) -> Table:
    head = [
        "effect", "link", "form", "shrinks the gap by (95 %)", "share of the excess", "p",
        "not told apart from",
    ]  # fmt: skip
    known = {e.name: [e.link, e.variant, shrinkage_text(e.shrinkage, e.interval), percent(e.share),
                      p_text(e.p_value)] for e in d.effects}  # fmt: skip
    rows: list[list[Any]] = []
    for name in dict.fromkeys([*known, *d.ranked]):
        others = dict.fromkeys(other for g in d.groups if name in g for other in g if other != name)
        rows.append([name, *known.get(name, [""] * 5), ", ".join(others)])
    return Table(head, rows, "effects, best first", left=3, wordy=(6,), sortable=True)


def _groups(d: Diagnosis) -> list[Any]:
    lines = dict.fromkeys(d.groups, "this log cannot tell them apart.")
    for s in d.separate_by:
        now = f"this log cannot tell them apart ({three(s.sigma_now)} sigma)"
        lines[s.group] = f"{now}. Record {s.recording}."
    items = Items([(", ".join(group), line) for group, line in lines.items()])
    return [Heading("Confusable effects"), items] if lines else []


# -- where the gap lies, and what no effect explains -----------------------------------------------------


MOST = 12
"""Statements on where the gap lies that are drawn; all of them are in the table."""


def where_section(d: Diagnosis) -> Section:
    """Return the statements on where the gap lies."""
    said = _statements(d.where, "share of the excess above the noise floor [%]")
    if not said and d.size.rows:
        said = [Words("The excess above the noise goes with nothing that the log holds.")]
    return Section("where", "Where the gap lies", said)


def rest_section(d: Diagnosis) -> Section:
    """Return the unexplained rest: how much it is, what it goes with, and its shape."""
    rest = d.unexplained
    said: list[Any] = []
    if rest:
        share = percent(rest.share)
        said.append(Words(f"{share} of the excess above the noise floor has no known cause."))
    if d.remaining and d.remaining != d.where:
        said += _statements(d.remaining, "share of the unexplained excess [%]")
    elif d.remaining:
        said.append(Words("It goes with what the gap goes with, see above."))
    elif rest:
        said.append(Words("It goes with no sensor, coordinate, frequency or run above chance."))
    if rest and rest.curve:
        how, panels = curves(rest.curve)
        said.append(Figure(panels, how, look="shape"))
    return Section("rest", "What no effect explains", said)


def _statements(statements: Sequence[Statement], title: str) -> list[Any]:
    drawn = [(_place(s), s.share, None) for s in statements if math.isfinite(s.share)][:MOST]
    rows = [
        [s.text, "" if s.held_out is None else percent(max(s.held_out, 0.0)), p_text(s.p_value)]
        for s in statements
    ]
    chart = [shares(drawn, title, look=BEFORE)] if drawn else []
    head = ["statement (fitted runs)", "on holdout runs", "p"]
    return [Figure(chart, look="two"), Table(head, rows, "statements on the places")] if statements else []


def _place(s: Statement) -> str:
    """Return the label of a bar; the range of a coordinate is left to the statement under it."""
    if s.by in ("output", "sensor"):
        return f"{s.by} {named_column(s.at)}"
    return f"{s.by}: {s.at}" if s.at and s.by in ("link", "run", "frequency") else s.by
