"""The page of a diagnosis: `hallsym diagnose LOG -o report.html`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from hallsym.diagnosis import Diagnosis, noise_text
from hallsym.estimation import Fit
from hallsym.report.data import Cells, RunSeries
from hallsym.report.page import parts
from hallsym.report.page.diagnosis_effects import effects_section
from hallsym.report.page.diagnosis_errors import errors_section, errors_title
from hallsym.report.page.diagnosis_places import rest_section, where_section
from hallsym.report.page.diagnosis_words import percent, typeset
from hallsym.report.page.html import Markup, facts, items, join, table, tag
from hallsym.report.page.page import Section, document
from hallsym.report.page.series import all_series
from hallsym.report.tables import concise
from hallsym.report.text.diagnosis import noise_name, significance_text, units_of
from hallsym.report.words import MINUS


def diagnosis_page(
    d: Diagnosis,
    *,
    maps: Sequence[Cells] = (),
    after: Sequence[Cells] = (),
    series: Sequence[RunSeries] = (),
    fit: Fit | None = None,
    command: str = "",
) -> str:
    """Return the page of a diagnosis as HTML.

    `maps`, `after`, `series`: of the errors before and after, from `gather` or `run_series`. `fit`: the
    calibration that was diagnosed, for its parameter table. `command`: what was typed. The duration is not
    shown, so the same data give the same page.
    """
    floor = d.noise_floor.outputs
    sections = [
        Section("asked", "Input", _input(d)),
        Section("errors", errors_title(d), errors_section(d)),
        Section("effects", "Which effects", effects_section(d)),
        Section("where", "Where the gap lies", where_section(d)),
        Section("rest", "What no effect explains", rest_section(d)),
        Section("maps", "Maps of the error", parts.maps_section(maps, floor, after=after)),
        Section("series", "Decoded minus reference over time", all_series(series)),
        Section("parameters", "Parameters", _parameters(d, fit)),
        Section("notes", "Other checks", _notes(d)),
        Section("origin", "Origin", parts.provenance(asdict(d.log), d.versions, command)),
    ]
    title = f"Diagnosis of {d.model}: {parts.called(d.log.path)}"
    verdict = [tag("strong", f"{d.verdict.capitalize()}."), " ", _sentence(d)]
    return document(title, verdict, sections, f"hallsym {d.versions.get('hallsym', '')}")


def _sentence(d: Diagnosis) -> str:
    """Return the sentence of the record without the verdict, which stands before it."""
    return typeset(d.sentence.removeprefix(f"{d.verdict.capitalize()}. "))


def _input(d: Diagnosis) -> Markup:
    judging = "which took part in neither the fit nor the choice of effects"
    return facts(
        [
            ("log", tag("code", d.log.path or "a log in memory")),
            (
                "samples",
                f"{d.log.rows} in {d.log.runs} {d.held_out.rpartition(' ')[2]}s" if d.log.rows else None,
            ),
            ("model", d.model),
            (f"{d.held_out}s", f"{len(d.validation_runs)} ({parts.numbers(d.validation_runs)}), {judging}"),
            ("noise floor", f"{parts.each(d.noise_floor.outputs)}; {d.noise_floor.source}"),
            (noise_name(d), noise_text(d.noise, d.noise_floor.source == "stated") if d.noise else None),
            ("worth reporting", f"a decrease of the gap by at least {100 * d.threshold:g} %"),
            ("any effect", f"p {significance_text(d.significance)}" if d.significance else None),
        ]
    )


def _parameters(d: Diagnosis, fit: Fit | None) -> Markup:
    rows: list[list[object]] = []
    angle = units_of(d)["rad"]
    for e in d.effects:
        for name, p in e.parameters.items():
            factor, unit = angle if angle[1] == "deg" and p.unit == "rad" else (1.0, p.unit)
            std = None if p.std is None else factor * p.std
            rows.append([e.name, name, concise(factor * p.value, std).replace("-", MINUS), unit, e.cost])
    head = ["effect", "parameter", "value (std)", "unit", "adds to the model"]
    added = table(head, rows, left=2, wordy=(4,), caption="parameters of the effects")
    own = (
        join([tag("h3", f"Of {fit.model.name}"), parts.parameter_table(fit), parts.combinations(fit)])
        if fit
        else None
    )
    return join([added, own])


def _notes(d: Diagnosis) -> Markup:
    smaller = [
        f"{f.name}: significant, lowers the gap by {percent(f.shrinkage)}, less than the threshold"
        for f in d.smaller_findings
    ]
    untested = [f"{name}: not testable, {reason}" for name, reason in d.not_testable.items()]
    return items([*smaller, *untested, *d.notes])
