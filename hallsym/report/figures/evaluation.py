"""Pictures of a calibration on another log."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.report.data import look_over
from hallsym.report.figures.by_setting import errors_by_setting
from hallsym.report.figures.errors import errors_before_after
from hallsym.report.figures.measured import measured
from hallsym.report.figures.saving import Place, save_figures

if TYPE_CHECKING:
    from hallsym.estimation import Evaluation

TITLES = "Nominal parameters", "Calibration"


def save_evaluation(found: Evaluation, folder: str | Path | Place) -> list[Path]:
    """Draw the pictures of an evaluation into `folder` (made if missing) and return the files written.

    `measured`, `errors_before_after` (left by nominal parameters, right by the calibration) and
    `errors_by_setting`; each as for a fit, of the log that was evaluated.
    """
    fit, log = found.applied, found.decoded
    survey = cache(lambda: look_over(log, fit))
    return save_figures(
        {
            "measured": lambda: measured(log, fit, survey()),
            "errors_before_after": lambda: errors_before_after(fit, survey(), TITLES),
            "errors_by_setting": lambda: errors_by_setting(fit, survey()),
        },
        folder,
    )
