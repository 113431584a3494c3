"""The page of a diagnosis: `hallsym diagnose LOG -o report.html`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from hallsym.diagnosis import Diagnosis, noise_text
from hallsym.estimation import Fit
from hallsym.families import family_called
from hallsym.report.data import Cells, Residuals, RunSeries
from hallsym.report.page import shared
from hallsym.report.page.content import Facts, Heading, Headline, Item, Items, Section, Table, document
from hallsym.report.page.diagnosis_effects import effects_section
from hallsym.report.page.diagnosis_errors import errors_section, gaps
from hallsym.report.page.diagnosis_places import rest_section, where_section
from hallsym.report.page.diagnosis_words import changed, percent, typeset
from hallsym.report.page.sketch import CAUSE, POSSIBLE, sketch
from hallsym.report.tables import concise
from hallsym.report.text.diagnosis import noise_name, significance_text, units_of
from hallsym.report.words import MINUS

STATES = {"no gap": "good", "explained": "good"}
"""Verdicts after which there is nothing left to find; every other one is open."""


def diagnosis_page(
    d: Diagnosis,
    *,
    maps: Sequence[Cells] = (),
    after: Sequence[Cells] = (),
    series: Sequence[RunSeries] = (),
    residuals: Mapping[str, Residuals] | None = None,
    fit: Fit | None = None,
    command: str = "",
    reading: Sequence[str] = (),
) -> str:
    """Return the page of a diagnosis as HTML.

    `maps`, `after`, `series`, `residuals`: of the errors before and after, from `gather` or `run_series`.
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
        shared.residuals_section(residuals or {}),
        Section("parameters", "Parameters", _parameters(d, fit)),
        Section("notes", "Other checks", [Items(_notes(d))]),
        shared.origin_section(asdict(d.log), d.versions, command),
    ]
    title = f"Diagnosis of {d.model}: {shared.called(d.log.path)}"
    headline = _headline(d, fit, reading)
    return document(title, headline, sections, f"hallsym {d.versions.get('hallsym', '')}")


def _headline(d: Diagnosis, fit: Fit | None, reading: Sequence[str]) -> Headline:
    family = fit.model.family if fit else family_called(d.model)
    word = f"{d.verdict.capitalize()}."
    lit = _lit(d, {e.name: e.link for e in family.effects} if family else {})
    rows = gaps(d)
    next_command, why = "", ""
    if d.next_step:
        next_command = shlex.join(["hallsym", "fit", d.log.path or "LOG", *d.next_step, *reading])
        why = "Next, fit the model with the effects found:"
    return Headline(
        STATES.get(d.verdict, "open"),
        word,
        typeset(d.sentence.removeprefix(f"{word} ")),
        shared.sizes_table(rows, d.noise_floor.outputs) if next(iter(rows.values()))["rmse"] else None,
        why,
        next_command,
        sketch(family.sketch, lit) if family else None,
        _sketched(d, lit),
    )


def _lit(d: Diagnosis, links: Mapping[str, str]) -> dict[str, str]:
    """Return the links of the effects found, and of those that the log cannot tell from them."""
    found = [e.name for e in d.effects]
    confused = [name for group in d.groups if {*group} & {*found} for name in group if name not in found]
    possible = {links[name]: POSSIBLE for name in confused if name in links}
    return possible | {e.link: CAUSE for e in d.effects}


def _sketched(d: Diagnosis, lit: Mapping[str, str]) -> str:
    """Return what the sketch says in words."""
    if not lit:
        return "No link of the chain is lit: no effect was found."
    found = [f"{e.name} ({e.link})" for e in d.effects]
    others = [link for link, look in lit.items() if look == POSSIBLE]
    said = f"Lit (●): {', '.join(found)}." if found else ""
    return f"{said} As likely, from this log (○): {', '.join(others)}.".strip() if others else said


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
            rows.append([e.name, name, concise(factor * p.value, std).replace("-", MINUS), unit, e.cost])
    head = ["effect", "parameter", "value (std)", "unit", "adds to the model"]
    added = Table(head, rows, "parameters of the effects", left=2, wordy=(3, 4), sortable=changed(d))
    own = [Heading(f"Of {fit.model.name}"), *shared.parameters_of(fit)] if fit else []
    return [added, *own]


def _notes(d: Diagnosis) -> list[Item]:
    smaller = [
        f"{f.name}: significant, lowers the gap by {percent(f.shrinkage)}, less than the threshold"
        for f in d.smaller_findings
    ]
    untested = [f"{name}: not testable, {reason}" for name, reason in d.not_testable.items()]
    return [Item(words) for words in (*smaller, *untested, *d.notes)]
