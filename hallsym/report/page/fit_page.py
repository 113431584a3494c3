"""The page of a fit: `hallsym report calib.json LOG -o report.html`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from hallsym.errors import counted
from hallsym.estimation import Fit, evaluate
from hallsym.estimation.decoding import residuals
from hallsym.estimation.goodness_of_fit import diagnose_command
from hallsym.estimation.likelihood import cost_near
from hallsym.estimation.outliers import column_spikes, reject_spikes
from hallsym.families import added_effects
from hallsym.families.recording import as_read
from hallsym.log import Log, Weigh
from hallsym.report.data.gather import Gathered, gather
from hallsym.report.data.survey import Decoder
from hallsym.report.figures.errors import Sizes, against_floor
from hallsym.report.page import shared
from hallsym.report.page.content import Facts, Figure, Headline, Items, Section, document
from hallsym.report.text.fit import circumstances
from hallsym.report.words import name

NEAR = 1.1
"""An rmse up to this many noise floors is called at the floor."""


def fit_page(log: Log, fit: Fit, *, command: str = "", calibration: str = "calib.json") -> str:
    """Return the page of a fit as HTML: verdict, errors against the noise floor, maps, runs, parameters.

    `log`: the one that was fitted, or another one of the same machine: then each run's zero deviations are
    estimated from that run and the page says so. It is read in blocks. `command`: what was typed,
    `calibration`: the file in which the fit is saved, for the next command.
    Raises `InputError` for a log that lacks the model's columns.
    """
    same = log.sha256 == fit.to_dict()["log"]["sha256"]
    if same:
        log = as_read(log, fit.model, fit.corrections)
    else:
        seen = evaluate(fit, log)
        command_next = diagnose_command(log.path, fit.model, added_effects(fit.model))
        goodness = replace(seen.goodness, what="The calibration", next_command=command_next)
        log, fit = seen.decoded, replace(seen.applied, goodness=goodness)
    found = gather(log, fit, label="fitted")
    if same and _above_recorded(found, fit):
        found = gather(log, fit, label="fitted", keep=_spikes(log, fit))
    rows = _rows(fit, found) if same else {"this log": found.survey.fitted.over()}
    shown = {k: v for k, v in rows.items() if v is not None}
    notes = [*circumstances(fit), *_notes(log, fit, found, same)]
    origin = {"path": log.path and str(log.path), "sha256": log.sha256}
    sections = [
        Section("input", "Input", [_input(log, fit, found, same)]),
        shared.maps_section({"fitted": found.maps}, fit.noise_floor),
        shared.runs_section(found.series),
        Section("parameters", "Parameters", shared.parameters_of(fit)),
        Section("notes", "Evidence and notes", [Items([("", note) for note in notes])]),
        shared.origin_section(origin, fit.versions, command),
    ]
    title = f"Calibration of {fit.model.name}: {shared.called(log.path)}"
    headline = _headline(fit, shown, calibration, same)
    return document(title, headline, sections, f"hallsym {fit.versions.get('hallsym', '')}")


def _headline(fit: Fit, rows: Mapping[str, Sizes], calibration: str, same: bool) -> Headline:
    ratio = _ratios(fit, _judged(rows)[1])
    above = max(ratio.values(), default=0.0) > NEAR or bool(_amiss(fit))
    state = "bad" if above or _unfinished(fit) else "good" if ratio else "open"
    words = {"bad": "Not at the noise floor.", "good": "At the noise floor."}
    word = words.get(state, "No noise floor is known.")
    none = ", no zero deviations" if fit.model.zeros else ""
    note = "Dashed line: noise floor. "
    note += f"Nominal: every parameter at its nominal value{none}. " if same else ""
    note += "Where values lie far apart the scale is logarithmic and dots stand for bars."
    sizes = Figure(against_floor(rows, fit.noise_floor, fit.model.period), note)
    return Headline(state, word, verdict(fit, rows), *_next(fit, above, calibration), sizes)


def _next(fit: Fit, above: bool, calibration: str) -> tuple[str, str]:
    if above:
        found = fit.goodness.next_command if fit.goodness else ""
        own = diagnose_command(fit.log["path"], fit.model, added_effects(fit.model))
        return "Next, find out what the model leaves:", found or own
    if fit.undetermined_by_log:
        words = ["hallsym", "sensitivity", calibration, str(fit.log["path"] or "LOG")]
        return "Next, see which recording determines the rest:", shlex.join(words)
    words = ["hallsym", "codegen", calibration, "-o", "firmware"]
    return "Next, write the decoder for the controller:", shlex.join(words)


def verdict(fit: Fit, rows: Mapping[str, Sizes]) -> str:
    """Return what the fit leaves and which parameters are not identifiable, worst news first."""
    where, gap = _judged(rows)
    on = {"held out": "on runs that were held out", "fitted": "on the runs that were fitted"}
    each = partial(shared.each, turning=fit.model.period)
    ratio = _ratios(fit, gap)
    worst = max(ratio, key=lambda c: ratio[c], default=None)
    text = f"{fit.model.name} leaves an rmse of {each(gap['rmse'])} {on.get(where, 'on this log')}"
    if worst is None:
        text += "."
    elif ratio[worst] <= NEAR:
        text += ", no more than the noise floor explains."
    else:
        floor = each({c: v for c, v in fit.noise_floor.items() if v})
        text += (
            f"; the noise floor is {floor}: {name(worst)} is {ratio[worst]:.2g} times as much, so there is "
            "more in the machine than in this model, or more noise than stated."
        )
    return " ".join(filter(None, (_amiss(fit), _unfinished(fit), text, _identifiable(fit))))


def _ratios(fit: Fit, gap: Sizes) -> dict[str, float]:
    return {c: v / fit.noise_floor[c] for c, v in gap["rmse"].items() if fit.noise_floor.get(c)}


def _judged(rows: Mapping[str, Sizes]) -> tuple[str, Sizes]:
    """Return the rows to judge by: held-out runs where there are any."""
    key = next(k for k in ("held out", "this log", "fitted", "nominal") if k in rows)
    return key, rows[key]


def _amiss(fit: Fit) -> str:
    said = fit.goodness.said(f"{fit.goodness.what} does not describe this log") if fit.goodness else None
    return f"{said}." if said else ""


def _unfinished(fit: Fit) -> str:
    if fit.status == "converged":
        return ""
    return f"The solver did not converge ({fit.status}): {fit.message}. These are the best values so far."


def _identifiable(fit: Fit) -> str:
    free = [n for n, p in zip(fit.model.names, fit.model.parameters, strict=True) if p.width > 0]
    missing = [n for n, d in zip(fit.model.names, fit.determined, strict=True) if not d and n in free]
    never, here = ([n for n in missing if (n in fit.structural) == own] for own in (True, False))
    said = [] if missing else [f"All {len(free)} free parameters are identifiable."]
    if here:
        said.append(f"Not identifiable from this log: {', '.join(here)}.")
    if never:
        said.append(f"Not identifiable by themselves from any recording: {', '.join(never)}.")
    if fit.at_bound:
        said.append(f"At a bound: {', '.join(fit.at_bound)}.")
    return " ".join(said)


def _rows(fit: Fit, found: Gathered) -> dict[str, Sizes | None]:
    """Errors as the fit recorded them: without the outliers that it left out."""
    rows = fit.error_rows or {"designed": found.survey.nominal.over(), "fitted": found.survey.fitted.over()}
    return {"nominal": rows["designed"], "fitted": rows["fitted"], "held out": rows.get("holdout")}


def _input(log: Log, fit: Fit, found: Gathered, same: bool) -> Facts:
    runs, holdout = found.survey.runs, [r for r in fit.log["holdout"] if same]
    fitted = [r for r in runs if r not in holdout]
    count = int(np.diff(found.survey.edges).sum())
    judged = f"{len(holdout)} ({shared.numbers(holdout)})" if holdout else "none"
    used = f"{len(fitted)} ({shared.numbers(fitted)})"
    used = used if same else f"none: all {len(runs)} runs are only judged"
    added = list(added_effects(fit.model))
    floor = shared.each(fit.noise_floor, fit.model.period)
    pairs = [
        ("log", log.path or "a log in memory"),
        ("samples", f"{count} in {counted(len(runs), 'run')}"),
        ("model", f"{fit.model.name}{' with ' + ', '.join(added) if added else ''}"),
        ("runs fitted", used),
        ("runs held out", judged if same else None),
        ("calibrated on", None if same else fit.log["path"] or "a log in memory"),
        ("noise floor", f"{floor}: what the noise of readings and reference alone leaves"),
    ]
    return Facts(pairs, frozenset({"log", "calibrated on"}))


def _notes(log: Log, fit: Fit, found: Gathered, same: bool) -> list[str]:
    notes = list(fit.notes)
    if not same:
        other = "This log is not the one that was fitted: the zero deviations of each run were estimated"
        notes.append(f"{other} from that run.")
    gone = found.survey.n_rejected
    if gone:
        notes.append(f"Maps and series leave {gone} isolated spikes out, as the fit did.")
    if same and _above_recorded(found, fit):
        notes.append("Maps and series show samples that the fit gave little or no weight, as outliers.")
    return notes + [note for note in log.notes if note not in notes]


def _above_recorded(found: Gathered, fit: Fit) -> bool:
    """Whether peaks are larger than the fit recorded: it left outliers out, but its record names none."""
    known = [row["peak"] for k, row in fit.error_rows.items() if k != "designed" and row]
    peak = found.survey.fitted.over()
    if not known or peak is None:
        return False
    return any(v > 1.001 * max(row[c] for row in known) for c, v in peak["peak"].items())


def _spikes(log: Log, fit: Fit) -> Weigh:
    """Return what leaves out isolated spikes by the rule of the fit."""
    model, cost = fit.model, cost_near(log, fit.model, fit.values, fit.noise.std)
    place = Decoder(fit)
    zeros = {
        run: place.zeros(run, state)
        for run, state in zip(cost.summary.runs, cost.summary.first_state, strict=True)
    }
    suspects = column_spikes((*model.references, *model.channels))
    covariance = cost.at(fit.values).covariance.mean(axis=0)
    return reject_spikes(residuals(model, fit.values, zeros), covariance, suspects)
