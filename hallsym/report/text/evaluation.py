"""Errors of a calibration on a log as a person reads them."""

from typing import Any

from hallsym.estimation import Evaluation
from hallsym.report.tables import error_rows


def evaluation_text(found: Evaluation, *, by_run: bool = False) -> str:
    """Return the table of errors, begun by what is amiss; `by_run`: with one line per run."""
    rows: dict[str, Any] = {"all runs": found.table.over()}
    if by_run:
        rows |= {f"run {run}": found.table.over([run]) for run in found.table.runs}
    amiss = found.goodness.sentence
    table = error_rows(found.model.pose, rows, None, turning=found.model.period)
    return "\n".join([*([amiss, ""] if amiss else []), table])
