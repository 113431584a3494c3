"""How results are shown in a session: for each kind its text, its first lines, its table and its picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.diagnosis import Diagnosis
from hallsym.errors import InputError
from hallsym.estimation import Evaluation, Fit, SelfFit, load_fit
from hallsym.experiment import Plan
from hallsym.fleets import Fleet, RingFleet
from hallsym.inference import Identifiability
from hallsym.log import Log, as_log
from hallsym.output import fitted
from hallsym.report.figures.campaign import evaluation_figure, fit_figure
from hallsym.report.figures.diagnosis import gap
from hallsym.report.figures.fleet import distributions
from hallsym.report.figures.plan import coverage
from hallsym.report.figures.self_calibration import waves_figure
from hallsym.report.figures.sensitivity import effects
from hallsym.report.figures.uncertainty import budget_bars
from hallsym.report.page.diagnosis_page import diagnosis_page
from hallsym.report.page.fit_page import fit_page
from hallsym.report.picture import Picture
from hallsym.report.text.budget import budget_text
from hallsym.report.text.diagnosis import diagnosis_text
from hallsym.report.text.fit import evaluation_head, evaluation_text, fit_head, fit_text
from hallsym.report.text.fleet import fleet_text
from hallsym.report.text.identifiability import report_text
from hallsym.report.text.plan import plan_text
from hallsym.report.text.self_calibration import ring_fleet_text, self_fit_text
from hallsym.uncertainty import Budget

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Table = Mapping[str, list[Any]]
FIRST = 8
"""Lines of a result that stand for all of it."""


@dataclass(frozen=True)
class View:
    """How one kind of result is shown: as text, as columns, as a picture."""

    summary: Callable[[Any], str]
    table: Callable[[Any], Table]
    picture: Callable[[Any, Any], Picture]
    head: Callable[[Any], list[str]] | None = None
    """Its first lines, where all of it takes a pass over a log."""


def summary(result: Any) -> str:
    """Return what the command of a result prints."""
    return fitted(_view(result).summary(result))


def brief(result: Any) -> str:
    """Return the first lines of what the command of a result prints."""
    view = _view(result)
    lines = view.head(result) if view.head else view.summary(result).split("\n")[:FIRST]
    return fitted("\n".join([*lines, "all: print(result.summary())"]))


def table(result: Any) -> Table:
    """Return the table of a result: columns by name, equally long."""
    return _view(result).table(result)


def figure(result: Any, log: Any = None) -> Figure:
    """Return the picture of a result, drawn."""
    from hallsym.report.drawing import draw

    return draw(_view(result).picture(result, log))


def page_of(result: Any, log: Any = None) -> str:
    """Return the page of a fit or a diagnosis as HTML; `log` as for `hallsym.report`."""
    if isinstance(result, Diagnosis):
        return diagnosis_page(result)
    fit = result if isinstance(result, Fit) else load_fit(result)
    return fit_page(_log_of(fit, log, "report(fit, 'page.html', 'log.csv')"), fit)


def _view(result: Any) -> View:
    for kind, view in VIEWS.items():
        if isinstance(result, kind):
            return view
    raise InputError(f"A {type(result).__name__} cannot be shown.")


# -- a fit -----------------------------------------------------------------------------------------------


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


def _log_of(fit: Fit, log: Any, call: str) -> Log:
    """Return the log of a fit, or another one of the same machine, under the names that the fit knows."""
    if log is None and fit.source is None:
        raise InputError(f"A calibration that was read from a file does not hold its log; give it: {call}.")
    return fit.source if log is None and fit.source else as_log(log, fit.columns, fit.read_with)


# -- a calibration on another log ------------------------------------------------------------------------


def _evaluation_table(found: Evaluation) -> Table:
    by_run = [found.table.over([run]) for run in found.table.runs]
    columns = {
        f"{what}_{c}": [row[what][c] if row else float("nan") for row in by_run]
        for what in ("rmse", "peak")
        for c in found.model.pose
    }
    return {"run": list(found.table.runs), **columns}


# -- a diagnosis -----------------------------------------------------------------------------------------


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


# -- what data determine, plans, budgets -----------------------------------------------------------------


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


def _plan_table(plan: Plan) -> Table:
    groups = plan.groups()
    return {
        "runs": [n for n, _, _ in groups],
        "setting": [setting for _, setting, _ in groups],
        "trajectory": [trajectory for _, _, trajectory in groups],
    }


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


def _waves_table(found: SelfFit) -> Table:
    rows = [w.to_dict(found.found.pairs) for w in found.found.waves]
    return {key: [row[key] for row in rows] for key in rows[0]}


VIEWS: Mapping[type, View] = {
    Fit: View(
        fit_text,
        _fit_table,
        lambda fit, log: fit_figure(_log_of(fit, log, "fit.plot('log.csv')"), fit, fit.keep),
        fit_head,
    ),
    Evaluation: View(
        evaluation_text, _evaluation_table, lambda found, log: evaluation_figure(found), evaluation_head
    ),
    Diagnosis: View(diagnosis_text, _diagnosis_table, lambda d, log: gap(d)),
    Identifiability: View(report_text, _identifiability_table, lambda found, log: effects(found)),
    Plan: View(
        plan_text, _plan_table, lambda plan, log: coverage(plan, None if log is None else as_log(log))
    ),
    Fleet: View(fleet_text, Fleet.table, lambda fleet, log: distributions(fleet)),
    SelfFit: View(self_fit_text, _waves_table, lambda found, log: waves_figure(found)),
    RingFleet: View(
        ring_fleet_text, lambda found: found.fleet.table(), lambda found, log: distributions(found.fleet)
    ),
    Budget: View(budget_text, _budget_table, lambda budget, log: budget_bars({budget.quantity: budget})),
}
