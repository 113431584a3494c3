"""How results are shown in a session: for each kind its text, its first lines, its table and its picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.diagnosis import Diagnosis
from hallsym.errors import InputError, counted
from hallsym.estimation import Evaluation, Fit, as_read, load_fit
from hallsym.experiment import Plan
from hallsym.fleets import Fleet
from hallsym.inference import Identifiability
from hallsym.log import Log, as_log
from hallsym.report.page import Table as PageTable
from hallsym.report.page import render
from hallsym.report.tables import error_rows
from hallsym.report.text import budget_text, plan_text
from hallsym.report.text.diagnosis import diagnosis_text
from hallsym.report.text.evaluation import evaluation_text
from hallsym.report.text.fit import fit_text, labelled
from hallsym.report.text.fleet import fleet_text
from hallsym.report.text.identifiability import report_text
from hallsym.report.text.watch import watch_text
from hallsym.terminal import fitted
from hallsym.uncertainty import Budget
from hallsym.watching import Watch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Table = Mapping[str, list[Any]]


@dataclass(frozen=True)
class View:
    """How one kind of result is shown: all of it as text, in a few lines, as columns, as a picture."""

    summary: Callable[[Any], str]
    brief: Callable[[Any], list[str]]
    table: Callable[[Any], Table]
    figure: Callable[[Any, Any], Figure]


def summary(result: Any) -> str:
    """Return what the command of a result prints."""
    return fitted(_view(result).summary(result))


def brief(result: Any) -> str:
    """Return a result in a few lines."""
    return "\n".join(_view(result).brief(result))


def table(result: Any) -> Table:
    """Return the table of a result: columns by name, equally long."""
    return _view(result).table(result)


def figure(result: Any, log: Any = None) -> Figure:
    """Return the picture of a result, in the style of hallsym's pictures."""
    from matplotlib import style

    from hallsym.report.figures import STYLE

    with style.context(["default", STYLE]):
        return _view(result).figure(result, log)


def page_of(result: Any, log: Any = None) -> str:
    """Return the page of a fit or a diagnosis as HTML; `log` as for `hallsym.report`."""
    from hallsym.report.page import diagnosis_page, fit_page

    if isinstance(result, Diagnosis):
        return diagnosis_page(result)
    fit = result if isinstance(result, Fit) else load_fit(result)
    return fit_page(_log_of(fit, log, "report(fit, 'page.html', 'log.csv')"), fit)


def page(result: Any) -> str:
    """Return what a notebook shows of a result: its first lines, its table, and all of it to open."""
    view, columns = _view(result), _view(result).table(result)
    first, *others = view.brief(result)
    rows = [[_cell(v) for v in row] for row in zip(*columns.values(), strict=True)]
    table = PageTable(list(columns), rows, type(result).__name__)
    return render("notebook.html.j2", first=first, others=others, columns=table, summary=view.summary(result))


def _cell(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.6g}"
    return "" if value is None else str(value)


def _view(result: Any) -> View:
    for kind, view in VIEWS.items():
        if isinstance(result, kind):
            return view
    raise InputError(f"A {type(result).__name__} cannot be shown.")


# -- a fit -----------------------------------------------------------------------------------------------


def _fit_brief(fit: Fit) -> list[str]:
    model = fit.model
    known = int(fit.determined.sum())
    where = fit.log["path"] or "arrays"
    rows = {name: row for name, row in labelled(fit.error_rows or {}).items() if row}
    amiss = fit.goodness and fit.goodness.sentence
    lines = [
        f"Fit of {model.name} to {where}: {fit.status}, {known} of"
        f" {counted(len(model.names), 'parameter')} determined"
    ]
    lines += [amiss] if amiss else []
    return [
        *lines,
        *error_rows(model.pose, rows, None, turning=model.period).split("\n"),
        "all: print(fit.summary())",
    ]


def _fit_table(fit: Fit) -> Table:
    parameters = fit.model.parameters
    return {
        "parameter": list(fit.model.names),
        "value": fit.values.tolist(),
        "std": fit.std.tolist(),
        "half_width_95": fit.half_width.tolist(),
        "unit": [p.unit for p in parameters],
        "determined": fit.determined.tolist(),
        "held": [n in fit.held for n in fit.model.names],
        "at_bound": [n in fit.at_bound for n in fit.model.names],
        "nominal": [p.nominal for p in parameters],
        "lower": [p.lower for p in parameters],
        "upper": [p.upper for p in parameters],
        "meaning": [p.meaning for p in parameters],
    }


def _fit_figure(fit: Fit, log: Any) -> Figure:
    from hallsym.report.data import look_over
    from hallsym.report.figures import errors_before_after

    seen = as_read(_log_of(fit, log, "fit.plot('log.csv')"), fit.model, fit.wiring)
    return errors_before_after(fit, look_over(seen, fit, fit.keep))


def _log_of(fit: Fit, log: Any, call: str) -> Log:
    """Return the log of a fit, or another one of the same machine, under the names that the fit knows."""
    if log is None and fit.source is None:
        raise InputError(f"A calibration that was read from a file does not hold its log; give it: {call}.")
    return fit.source if log is None and fit.source else as_log(log, fit.columns, fit.read_with)


# -- a calibration on another log ------------------------------------------------------------------------


def _evaluation_brief(found: Evaluation) -> list[str]:
    rows = {"all runs": found.table.over()}
    text = error_rows(found.model.pose, rows, None, turning=found.model.period)
    amiss = found.goodness.sentence
    head = f"Evaluation of {found.model.name} on {found.log_name}: {counted(len(found.table.runs), 'run')}"
    return [head, *([amiss] if amiss else []), *text.split("\n")]


def _evaluation_table(found: Evaluation) -> Table:
    by_run = [found.table.over([run]) for run in found.table.runs]
    columns = {
        f"{what}_{c}": [row[what][c] if row else float("nan") for row in by_run]
        for what in ("rmse", "peak")
        for c in found.model.pose
    }
    return {"run": list(found.table.runs), **columns}


def _evaluation_figure(found: Evaluation, log: Any) -> Figure:
    from hallsym.report.data import look_over
    from hallsym.report.figures import errors_before_after
    from hallsym.report.figures.evaluation import TITLES

    return errors_before_after(found.applied, look_over(found.decoded, found.applied), TITLES)


# -- a diagnosis -----------------------------------------------------------------------------------------


def _diagnosis_brief(d: Diagnosis) -> list[str]:
    names = [f"{e.name} ({e.link}): shrinks it by {100 * e.shrinkage:.1f} %" for e in d.effects]
    return [f"Diagnosis of {d.model}: {d.verdict}", d.sentence, *names, "all: print(diagnosis.summary())"]


def _diagnosis_table(d: Diagnosis) -> Table:
    return {
        "effect": [e.name for e in d.effects],
        "link": [e.link for e in d.effects],
        "shrinkage": [e.shrinkage for e in d.effects],
        "low_95": [e.interval[0] if e.interval else None for e in d.effects],
        "high_95": [e.interval[1] if e.interval else None for e in d.effects],
        "share": [e.share for e in d.effects],
        "p_value": [e.p_value for e in d.effects],
        "fit_with": [e.text for e in d.effects],
    }


def _diagnosis_figure(d: Diagnosis, log: Any) -> Figure:
    from hallsym.report.figures import gap

    return gap(d)


# -- what data determine, plans, budgets -----------------------------------------------------------------


def _identifiability_brief(found: Identifiability) -> list[str]:
    verdicts = [
        f"{p.name}: {p.verdict.word}; {p.verdict.because}".removesuffix("; ")
        for p in found.parameters
        if p.std is None
    ]
    known = len(found.parameters) - len(verdicts)
    head = f"Identifiability of {found.model.name} from {found.evidence.recorded}: {known} of "
    more = [f"... and {len(verdicts) - 4} more"] if len(verdicts) > 4 else []
    return [
        f"{head}{counted(len(found.parameters), 'parameter')} determined",
        *verdicts[:4], *more, "all: print(found.summary())",
    ]  # fmt: skip


def _identifiability_table(found: Identifiability) -> Table:
    entries = found.parameters
    meanings = {p.name: p.meaning for p in found.model.parameters}
    nan = float("nan")
    return {
        "parameter": [e.name for e in entries],
        "value": [e.value for e in entries],
        "std": [nan if e.std is None else e.std for e in entries],
        "low_95": [e.interval.low if e.interval else nan for e in entries],
        "high_95": [e.interval.high if e.interval else nan for e in entries],
        "unit": [e.unit for e in entries],
        "verdict": [e.verdict.word for e in entries],
        "meaning": [meanings.get(e.name, "") for e in entries],
    }


def _identifiability_figure(found: Identifiability, log: Any) -> Figure:
    from hallsym.report.figures import effects

    return effects(found)


def _plan_brief(plan: Plan) -> list[str]:
    return [*plan_text(plan).split("\n")[:1], "all: print(plan.summary())"]


def _plan_table(plan: Plan) -> Table:
    groups = plan.groups()
    return {
        "runs": [n for n, _, _ in groups],
        "setting": [setting for _, setting, _ in groups],
        "trajectory": [trajectory for _, _, trajectory in groups],
    }


def _plan_figure(plan: Plan, log: Any) -> Figure:
    from hallsym.report.figures import coverage

    return coverage(plan, None if log is None else as_log(log))


def _budget_brief(budget: Budget) -> list[str]:
    lines = budget_text(budget).split("\n")
    return [lines[0], *lines[-2:], "all: print(budget.summary())"]


def _budget_table(budget: Budget) -> Table:
    return {
        "source": [s.name for s in budget.sources],
        "distribution": [s.distribution for s in budget.sources],
        "std": [s.std for s in budget.sources],
        "unit": [s.unit for s in budget.sources],
        "sensitivity": [s.sensitivity for s in budget.sources],
        "contribution": np.asarray(budget.contributions).tolist(),
        "share": np.asarray(budget.shares).tolist(),
    }


def _budget_figure(budget: Budget, log: Any) -> Figure:
    from hallsym.report.figures import budget_bars

    return budget_bars({budget.quantity: budget})


# -- a watch ---------------------------------------------------------------------------------------------


def _watch_brief(found: Watch) -> list[str]:
    said = f"{len(found.changed)} changed, {len(found.not_judged)} not judged"
    head = f"Watch of {found.calibration}: {counted(len(found.logs), 'log')}, {said}"
    return [head, *(f"{log.name}: {log.sentence}" for log in found.changed)]


def _watch_table(found: Watch) -> Table:
    rows = [(log, test) for log in found.logs for test in log.tests]
    return {
        "log": [log.name for log, _ in rows],
        "test": [test.name for _, test in rows],
        "p_value": [test.p_value for _, test in rows],
        "score": [test.score for _, test in rows],
        "limit": [test.limit for _, test in rows],
        "beyond": [test.beyond for _, test in rows],
    }


def _watch_figure(found: Watch, log: Any) -> Figure:
    from hallsym.report.figures import control_chart

    return control_chart(found)


# -- a fleet ---------------------------------------------------------------------------------------------


def _fleet_brief(fleet: Fleet) -> list[str]:
    verdicts = ", ".join(f"{len(devices)} {verdict}" for verdict, devices in fleet.verdicts.items())
    return [f"Fleet of {counted(len(fleet.rows), 'device')}: {verdicts}", "all: print(fleet.summary())"]


def _fleet_figure(fleet: Fleet, log: Any) -> Figure:
    from hallsym.report.figures.fleet import distributions

    return distributions(fleet)


VIEWS: Mapping[type, View] = {
    Fit: View(fit_text, _fit_brief, _fit_table, _fit_figure),
    Evaluation: View(evaluation_text, _evaluation_brief, _evaluation_table, _evaluation_figure),
    Diagnosis: View(diagnosis_text, _diagnosis_brief, _diagnosis_table, _diagnosis_figure),
    Identifiability: View(
        report_text, _identifiability_brief, _identifiability_table, _identifiability_figure
    ),
    Plan: View(plan_text, _plan_brief, _plan_table, _plan_figure),
    Watch: View(watch_text, _watch_brief, _watch_table, _watch_figure),
    Fleet: View(fleet_text, _fleet_brief, Fleet.table, _fleet_figure),
    Budget: View(budget_text, _budget_brief, _budget_table, _budget_figure),
}
