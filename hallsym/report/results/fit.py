"""Report of a calibration: on its own log, or on another one."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import Any

from hallsym.errors import InputError, counted, few
from hallsym.estimation import Fit, evaluate
from hallsym.estimation.calibration import MANY, LogRecord, coverage_factor, rmse_interval
from hallsym.estimation.decoding import ErrorTable
from hallsym.estimation.goodness_of_fit import diagnose_command
from hallsym.estimation.prediction import decoded, is_own
from hallsym.estimation.task import without_spikes
from hallsym.families import added_effects
from hallsym.families.recording import as_read
from hallsym.log import Log, Weigh, as_log
from hallsym.model import Parameter
from hallsym.report import picture as p
from hallsym.report.content import Block, Content, Items, Section, Table
from hallsym.report.data.gather import Gathered, gather, settings
from hallsym.report.data.periodic import periodic_of
from hallsym.report.panels import by_group, by_groups
from hallsym.report.results import shared
from hallsym.report.results.periodic import periodic
from hallsym.report.tables import attributes, in_units
from hallsym.report.words import number
from hallsym.units import readable

TOO_SMALL = 0.1
"""Cost per degree of freedom below which the noise is more than three times the residual."""
LABELS = {"designed": "nominal"}


def fit_content(fit: Fit, *, log: Log | None = None) -> Content:
    """Return the report of a calibration without another pass over its log, in which periodic errors are."""
    repeating = [] if fit.logs or log is None else periodic_blocks(fit, log)
    notes = [*circumstances(fit), *(f"note: {note}" for note in fit.notes)]
    return Content(
        f"Calibration of {fit.model.name}: {shared.called(fit.log.path)}",
        "\n".join([*(f"claim: {one.text}" for one in fit.claims), verdict(fit)]),
        [
            Section("repeating", "Errors that repeat", repeating),
            Section("logs", "By log", several_blocks(fit) if fit.logs else []),
            Section("parameters", "Parameters", shared.parameters_of(fit)),
            Section("notes", "Evidence and notes", notes),
        ],
        ["", basis(fit), _errors(fit, fit.errors.fitted if fit.errors else None)],
        state="bad" if amiss(fit) else "good",
        columns=_columns(fit),
        pictures={
            "errors_by_setting": lambda other: fit_figure(
                log_of(fit, other, "fit.plot('log.csv')"), fit, fit.keep
            )
        },
    )


def _errors(fit: Fit, table: ErrorTable | None, nominal: ErrorTable | None = None) -> Table:
    """Return the errors of a fit, with the interval of those that judge it; `nominal`: of another log."""
    rows, holdout = {LABELS.get(k, k): v for k, v in fit.error_rows.items()}, fit.log.holdout
    judge = "holdout" if holdout else "fitted"
    if table and nominal:
        rows, holdout, judge = {"nominal": nominal.over(), "this log": table.over()}, (), "this log"
    known = {judge: rmse_interval(table, holdout or table.runs)} if table else {}
    model = fit.model
    return shared.error_table(model.pose, rows, fit.noise_floor, periodic=model.period, intervals=known)


def log_of(fit: Fit, log: Any, call: str) -> Log:
    """Return the log of a fit, or another one of the same machine, under the names that the fit knows."""
    if log is None and fit.source is None:
        raise InputError(f"A calibration that was read from a file does not hold its log; give it: {call}.")
    return fit.source if log is None and fit.source else as_log(log, fit.columns, fit.read_with)


def verdict(fit: Fit) -> str:
    """Return whether the model describes the log, the worst first."""
    unfinished = "" if fit.status == "converged" else f"The solver did not converge ({fit.status})."
    described = fit.goodness.verdict if fit.goodness else ""
    return " ".join(filter(None, (unfinished, described))) or basis(fit)


def amiss(fit: Fit) -> bool:
    """Return whether a calibration needs checking before use."""
    return bool(fit.goodness and fit.goodness.sentence) or fit.status != "converged" or bool(fit.claims)


def basis(fit: Fit) -> str:
    """Return model, log and samples that a calibration rests on."""
    log, fitted = fit.log, [each.name for each in fit.logs if not each.held_out]
    used = log.runs - len(log.holdout)
    name = counted(len(fitted), "log") if fitted else log.path or "a log in memory"
    runs = f"{counted(used, 'run')} fitted" if log.runs > 1 else "fitted"
    holdout = f", {len(log.holdout)} holdout" if log.holdout else ""
    samples = counted(log.rows, "sample")
    return f"{fit.model.name} on {name}: {samples}, {runs}{holdout}; {fit.status} in {fit.seconds:.2f} s"


def periodic_blocks(fit: Fit, log: Log | None) -> list[Block | str]:
    """Return the blocks on periodic errors; none where there are none."""
    found = periodic_of(fit, log)
    return periodic(found, fit.model.family) if found else []


def circumstances(fit: Fit) -> list[str]:
    """Return the sentences on solver, uncertainty and noise."""
    s = fit.solver
    how = f"{s.name}: {s.evaluations} evaluations"
    if s.starts > 1:
        same = round(s.share_at_optimum * s.starts)
        how += f"; {same} of {s.starts} refined starts reached this optimum"
    by_source: dict[str, dict[str, list[str]]] = {}
    for channel, sigma in fit.noise.sigmas.items():
        factor, unit, called = readable(channel, fit.model.period)
        size = f"{number(sigma.value * factor)} {unit}"
        by_source.setdefault(sigma.source, {}).setdefault(size, []).append(called)
    noise = "; ".join(
        f"{source}: {few([f'{few(names, 3)} {size}' for size, names in sizes.items()], 12)}"
        for source, sizes in by_source.items()
    )
    return [
        f"solver: {how}{_bounded(fit)}",
        _goodness(fit),
        f"uncertainty: {fit.covariance_record.method} ({fit.covariance_record.reason}){_interval(fit)}",
        f"noise (1 sigma) {noise}",
    ]


def _interval(fit: Fit) -> str:
    """Factor from the standard uncertainty to half of the 95 % interval."""
    known = fit.degrees_of_freedom[fit.determined]
    if not len(known):
        return ""
    factors = coverage_factor(known)
    few, most = factors.min(), factors.max()
    size = number(few) if most < 1.005 * few else f"{number(few)} to {number(most)}"
    said = f"; 95 % interval: value +- {size} x the standard uncertainty"
    if known.min() >= MANY:
        return said
    fewest = fit.model.names[fit.degrees_of_freedom.tolist().index(known.min())]
    more = f" to {number(known.max(), 2)}" if known.max() > known.min() else ""
    return f"{said} (Student's t; degrees of freedom {number(known.min(), 2)} (of {fewest}){more})"


def _bounded(fit: Fit) -> str:
    """Ratio of the cost to its lower bound."""
    bound = fit.solver.lower_bound
    if not bound:
        return ""
    said = (
        f"; cost {number(bound.ratio, 4)} x the lower bound, a linear fit with "
        f"{bound.coefficients} free coefficients ({number(bound.expected, 4)} by their number alone)"
    )
    if bound.near:
        return said
    limits = f", or the bounds of {', '.join(fit.at_bound)}, cost" if fit.at_bound else " costs"
    return f"{said}: the form of the model{limits} that much, whatever the start"


def _goodness(fit: Fit) -> str:
    """Cost per degree of freedom with its expected scatter, and the place of the largest residual."""
    cost, fitted = fit.solver.cost_per_degree_of_freedom, fit.goodness
    said = f"goodness of fit: cost per degree of freedom {cost:.3f}"
    if fitted is not None:
        more = ", more than noise" if fitted.significant else ""
        said += f" (expected 1 +- {number(fitted.scatter, 2)}, 1 sigma){more}; "
        said += f"the residual is {fitted.where}"
    if not 0 < cost < TOO_SMALL:
        return said
    guessed = any(sigma.source == "estimated" for sigma in fit.noise.sigmas.values())
    what = "was estimated" if guessed else "is stated"
    why = ": motion from sample to sample was counted as noise; state it with --noise" if guessed else ""
    return (
        f"{said} (the noise {what} {number(cost**-0.5)} x as large as the residual{why}; uncertainties and "
        "noise floor are too large by that)"
    )


# -- a fit of several logs -------------------------------------------------------------------------------


def several_blocks(fit: Fit) -> list[Block | str]:
    """Return errors by log and each log's own parameters."""
    rows = {}
    for log in fit.logs:
        for kind, said in (("fitted", ""), ("holdout", ", holdout")):
            if found := log.errors.get(kind):
                rows[f"{log.name}{said}"] = found
    own = fit.logs[0].parameters
    return [
        shared.errors_by("by log", rows, fit.model.pose, fit.model.period),
        *(_own(fit, p) for p in fit.model.parameters if p.name in own),
    ]


def _own(fit: Fit, parameter: Parameter) -> Table:
    """Return one parameter log by log, with how it changed since the first."""
    logs = [log for log in fit.logs if parameter.name in log.parameters]
    since = [] if fit.joint is None else ["since the first (1 sigma)"]
    head = [f"{parameter.name} by log", "value (1 sigma)", "unit", *since]
    rows = []
    for log in logs:
        found = log.parameters[parameter.name]
        row = [log.name, *in_units(found.value, found.std, parameter.unit)]
        if fit.joint is not None and log is not logs[0]:
            moved, sigma = fit.joint.change(parameter.name, logs[0].name, log.name)
            row.append(in_units(moved, sigma, parameter.unit)[0])
        rows.append([*row, *[""] * (len(head) - len(row))])
    return Table(head, rows, f"{parameter.name} by log")


def _columns(fit: Fit) -> dict[str, list[Any]]:
    """Return the parameters of a fit as columns, in SI."""
    same = ("value", "std", "interval", "unit", "determined", "at_bound", "nominal", "lower", "upper")
    return {
        "parameter": list(fit.params),
        **attributes(fit.params.values(), *same),
        "fixed": [n in fit.fixed for n in fit.model.names],
        "meaning": [p.meaning for p in fit.model.parameters],
    }


# -- with its log, or another one: where and when the error is -------------------------------------------


def page_content(log: Log, fit: Fit, *, command: str = "", calibration: str = "calib.json") -> Content:
    """Return the whole report of a fit on a log, with the place and time of the errors, before and after.

    `log`: the one that was fitted, or another one of the same machine: then each run's zero deviations are
    estimated from that run and a note says so. It is read in blocks. `command`: what was typed,
    `calibration`: the file in which the fit is saved, for the next command.
    Raises `InputError` for a log that lacks the model's columns.
    """
    same = is_own(fit, log)
    if same:
        log = as_read(log, fit.model, fit.corrections)
    else:
        seen = evaluate(fit, log)
        next_command = diagnose_command(log.path, fit.model, added_effects(fit.model))
        goodness = replace(seen.goodness, what="The calibration", next_command=next_command)
        log, fit = seen.decoded, seen.applied.changed(goodness=goodness)
    found = gather(log, fit, label="fitted", nominal=True)
    if same and _above_recorded(found, fit):
        found = gather(log, fit, label="fitted", keep=without_spikes(fit, log), nominal=True)
    errors = _errors(
        fit, found.tables["fitted"], None if same and fit.error_rows else found.tables["nominal"]
    )
    said = fit_content(fit)
    notes = [*circumstances(fit), *_notes(log, fit, found, same)]
    described = verdict(fit).partition("; next: ")[0].rstrip(".")  # the card has the next command
    claims = [f"Claim: {one.text}" for one in fit.claims]
    answer = " ".join([f"{described}.", *claims, *_identifiable(fit)])
    origin = LogRecord(str(log.path) if log.path else None, log.sha256)
    why, next_command = _next(fit, calibration)
    return replace(
        said,
        title=f"Calibration of {fit.model.name}: {shared.called(log.path)}",
        answer=answer,
        word="Not at the noise floor." if fit.goodness and fit.goodness.sentence else "At the noise floor.",
        why=why,
        command=next_command,
        first=[
            errors,
            *shared.expanded_at_rest(fit),
            *shared.first_view(found.series, found.maps, fit.noise_floor),
        ],
        sections=[
            Section("input", "Input", [_input(log, fit, found, same)]),
            shared.maps_section({"fitted": found.maps["fitted"]}, fit.noise_floor, by_groups(fit, found)),
            shared.runs_section([replace(s, lines={"fitted": s.lines["fitted"]}) for s in found.series]),
            Section("repeating", "Errors that repeat", periodic_blocks(fit, log)),
            *(s for s in said.sections if s.ident in ("logs", "parameters")),
            Section("notes", "Evidence and notes", [Items([("", note) for note in notes])]),
            shared.origin_section(origin, fit.versions, command),
        ],
    )


def _next(fit: Fit, calibration: str) -> tuple[str, str]:
    if fit.goodness and fit.goodness.sentence:
        own = diagnose_command(fit.log.path, fit.model, added_effects(fit.model))
        return "Next, find the cause of the residual error:", fit.goodness.next_command or own
    if fit.undetermined_by_log:
        words = ["hallsym", "sensitivity", calibration, str(fit.log.path or "LOG")]
        return "Next, see which recording determines the rest:", shlex.join(words)
    if fit.model.computed:  # of the history of a whole log, which a controller does not have
        words = ["hallsym", "evaluate", calibration, "LOG"]
        return "Next, decode other logs:", shlex.join(words)
    words = ["hallsym", "codegen", calibration, "-o", "firmware"]
    return "Next, write the decoder for the controller:", shlex.join(words)


def _identifiable(fit: Fit) -> list[str]:
    """Return how many parameters are identifiable; the table names them."""
    free = [n for n, p in zip(fit.model.names, fit.model.parameters, strict=True) if p.width > 0]
    missing = [n for n, d in zip(fit.model.names, fit.determined, strict=True) if not d and n in free]
    never = sum(n in fit.structural for n in missing)
    said = [] if missing else [f"All {len(free)} free parameters are identifiable."]
    if missing:
        here = len(missing) - never
        of = f"({never} from any recording)" if here and never else "from any recording"
        of = of if never else "from this log"
        known = f"; {counted(len(fit.combinations), 'combination')} of them are" if fit.combinations else ""
        said.append(f"{len(missing)} of {len(free)} free parameters are not identifiable {of}{known}.")
    if fit.at_bound:
        said.append(f"At a bound: {few(fit.at_bound)}.")
    return said


def _input(log: Log, fit: Fit, found: Gathered, same: bool) -> Items:
    runs, holdout = found.tables["fitted"].runs, [r for r in fit.log.holdout if same]
    fitted = [r for r in runs if r not in holdout]
    judged = f"{len(holdout)} ({shared.numbers(holdout)})" if holdout else "none"
    used = f"{len(fitted)} ({shared.numbers(fitted)})"
    used = used if same else f"none: all {len(runs)} runs are only judged"
    added = list(added_effects(fit.model))
    pairs = [
        ("log", log.path or "a log in memory"),
        ("samples", f"{log.rows} in {counted(len(runs), 'run')}"),
        ("model", f"{fit.model.name}{' with ' + ', '.join(added) if added else ''}"),
        ("runs fitted", used),
        ("holdout runs", judged if same else None),
        ("calibrated on", None if same else fit.log.path or "a log in memory"),
        ("noise floor", "the error by noise of readings and reference alone"),
        (
            "nominal",
            f"every parameter at its nominal value{', no zero deviations' if fit.model.offsets else ''}",
        ),
    ]
    return Items(pairs)


def _notes(log: Log, fit: Fit, found: Gathered, same: bool) -> list[str]:
    notes = list(fit.notes)
    if not same:
        other = "This log is not the one that was fitted: the zero deviations of each run were estimated"
        notes.append(f"{other} from that run.")
    gone = log.rows - int(found.tables["fitted"].count.sum())
    if gone:
        notes.append(f"Maps and series leave {gone} isolated spikes out, as the fit did.")
    if same and _above_recorded(found, fit):
        notes.append("Maps and series show samples that the fit gave little or no weight, as outliers.")
    return notes + [note for note in log.notes if note not in notes]


def _above_recorded(found: Gathered, fit: Fit) -> bool:
    """Whether peaks are larger than the fit recorded: it left outliers out, but its record names none."""
    known = [row["peak"] for k, row in fit.error_rows.items() if k != "designed" and row]
    peak = found.tables["fitted"].over()
    if not known or peak is None:
        return False
    return any(v > 1.001 * max(row[c] for row in known) for c, v in peak["peak"].items())


# -- picture: errors by setting -------------------------------------------------------------------------


def fit_figure(log: Log, fit: Fit, keep: Weigh | None = None) -> p.Picture:
    """Return `errors_by_setting` of `fit` on `log`, which is read once, in blocks.

    `keep(block) -> (samples,)` weights; samples of weight 0 (outliers) take no part.
    """
    read = as_read(log, fit.model, fit.corrections)
    return by_group(fit, *settings(fit, read), decoded(read, fit, keep).tables())
