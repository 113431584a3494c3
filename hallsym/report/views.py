"""How results are shown in a session: their content as text, as columns, as a picture, as HTML."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from hallsym.errors import InputError
from hallsym.output import fitted
from hallsym.report.content import (
    Content,
    Section,
    document,
    fragment,
    printed,
    text_of,
)
from hallsym.report.picture import Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIRST = 8
"""Lines of a result that stand for all of it."""


def summary(result: Any) -> str:
    """Return the text that the command of a result prints."""
    return fitted(printed(content(result)).rstrip())


def brief(result: Any) -> str:
    """Return the first lines of what the command of a result prints, without another pass over a log."""
    said = _content_of(result)
    lines = text_of([said.answer, *said.first]).rstrip().split("\n")
    lines = lines if said.first else printed(said).split("\n")[:FIRST]
    return fitted("\n".join([*lines, "all: print(result.summary())"]))


def table(result: Any) -> Mapping[str, Any]:
    """Return the table of a result: columns by name, equally long."""
    return _content_of(result).columns or {}


def figure(result: Any, log: Any = None) -> Figure:
    """Return the picture of a result, drawn; `log`: where it is of one that the result does not hold."""
    from hallsym.report.drawing import draw

    for make in _content_of(result).pictures.values():
        return draw(make(log))
    raise InputError(f"A {type(result).__name__} has no picture.")


def pictures(result: Any, log: Any = None) -> dict[str, Picture]:
    """Return the pictures of a result, or of its content, by name, without those that show nothing.

    `log`: as for `figure`.
    """
    said, found = result if isinstance(result, Content) else _content_of(result), {}
    for name, make in said.pictures.items():
        with suppress(InputError):
            found[name] = make(log)
    return found


def html(result: Any) -> str:
    """Return the view of a result in a notebook: its answer, its first tables and its picture."""
    said = _content_of(result)
    return fragment(said, next(iter(pictures(said).values()), None))


def content(result: Any) -> Content:
    """Return the whole report of a result."""
    more = {"log": result.source} if _kind(result) == "Fit" else {}
    return _content_of(result, **more)


def page_of(result: Any, log: Any = None) -> str:
    """Return the page of a result as HTML; `log` as for `hallsym.report`."""
    if isinstance(result, str) or hasattr(result, "__fspath__"):
        from hallsym.estimation import load_fit

        result = load_fit(result)
    if _kind(result) != "Fit":
        return document(_pictured(content(result)))
    from hallsym.report.results.fit import log_of, page_content

    return document(page_content(log_of(result, log, "report(fit, 'page.html', 'log.csv')"), result))


def _pictured(said: Content) -> Content:
    """Return what a page shows: the picture too, where the report has no figures of its own."""
    own = any(isinstance(block, Picture) and block.panels for s in said.sections for block in s.content)
    picture = None if own else next(iter(pictures(said).values()), None)
    if picture is None:
        return said
    panels = [replace(panel, beside=()) for panel in picture.panels]  # words of the table
    shown = Section("picture", "Picture", [replace(picture, panels=panels)])
    notes = [section for section in said.sections if section.ident in ("notes", "origin")]
    others = [section for section in said.sections if section not in notes]
    return replace(said, sections=[*others, shown, *notes])


_CONTENTS = {
    "Fit": "fit.fit_content",
    "Evaluation": "evaluation.evaluation_content",
    "Diagnosis": "diagnosis.diagnosis_content",
    "Identifiability": "identifiability.identifiability_content",
    "SelfFit": "self_calibration.self_fit_content",
    "Plan": "plan.plan_content",
    "Budget": "budget.budget_content",
    "UncertaintyMap": "budget.map_content",
    "Fleet": "fleet.fleet_content",
    "RingFleet": "self_calibration.ring_fleet_content",
    "TurnPlan": "self_calibration.turns_content",
    "Tolerances": "tolerances.tolerances_content",
    "ErrorModel": "tolerances.errors_content",
    "DetectionPower": "power.power_content",
    "Sorting": "sorting.sorting_content",
    "Matching": "sorting.matching_content",
    "Belonging": "evaluation.belonging_content",
    "Exported": "firmware.exported_content",
    "Generated": "firmware.generated_content",
}
"""Maker of the content of each kind; its module is loaded when one is shown."""


def _kind(result: Any) -> str:
    for kind in type(result).__mro__:
        if kind.__name__ in _CONTENTS and kind.__module__.startswith("hallsym."):
            return kind.__name__
    raise InputError(f"A {type(result).__name__} cannot be shown.")


def _content_of(result: Any, **more: Any) -> Content:
    module, _, make = _CONTENTS[_kind(result)].partition(".")
    found: Content = getattr(import_module(f"hallsym.report.results.{module}"), make)(result, **more)
    return found
