"""Errors of a calibration on a log as a person reads them."""

from typing import Any

from hallsym.errors import counted
from hallsym.estimation import Evaluation
from hallsym.report.tables import error_rows
from hallsym.report.text.fit import periodic_lines


def evaluation_text(found: Evaluation, *, by_run: bool = False) -> str:
    """Return the verdict, then the table of errors with the noise floor; `by_run`: with one line per run."""
    rows: dict[str, Any] = {"all runs" if len(found.table.runs) > 1 else "all samples": found.table.over()}
    if by_run:
        rows |= {f"run {run}": found.table.over([run]) for run in found.table.runs}
    samples = int(found.table.count.sum())
    runs = f" in {counted(len(found.table.runs), 'run')}" if len(found.table.runs) > 1 else ""
    stated = {s.source for s in found.noise.sigmas.values()}
    source = "" if stated == {"given"} else "estimated"
    periodic = periodic_lines(found.calibration, found.log)[:-1]
    return "\n".join(
        [
            found.goodness.verdict,
            "",
            f"{found.model.name} on {found.log_name}: {counted(samples, 'sample')}{runs}",
            "",
            error_rows(found.model.pose, rows, found.noise_floor, source, turning=found.model.period),
            *([""] if periodic else []),
            *periodic,
        ]
    )
