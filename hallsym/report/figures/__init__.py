"""Pictures for print: of a fit, of what data determine, of budgets, tolerances and plans.

Those of a fit follow Figures 9 to 12 of Chen et al., Sensors 2016, 16, 872, doi:10.3390/s16060872. What is
drawn comes from `hallsym.report.data`: a log of any length is read in blocks and reduced to its least and
greatest value per picture column, so a peak never gets lost. Data stay in SI; axes say um, urad or mV.
Colours differ in lightness and every series has its own line style or marker, so that a greyscale print can
be read. matplotlib is imported only to draw.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from hallsym.estimation import Fit, as_read
from hallsym.log import Log, Weigh
from hallsym.report.data import blocks, look_over
from hallsym.report.figures.along import save_errors
from hallsym.report.figures.by_setting import errors_by_setting
from hallsym.report.figures.detection import detection, save_detection
from hallsym.report.figures.diagnosis import gap, save_diagnosis
from hallsym.report.figures.errors import errors_before_after
from hallsym.report.figures.estimates import parameters
from hallsym.report.figures.evaluation import save_evaluation
from hallsym.report.figures.measured import measured
from hallsym.report.figures.plan import coverage, criterion_by_runs, save_plan_pictures
from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.sensitivity import (
    LOOKS,
    correlation,
    drawable,
    effects,
    ends_in_words,
    profiles,
    save_sensitivity_pictures,
)
from hallsym.report.figures.style import DPI, STYLE, WIDTH, broken, text_width
from hallsym.report.figures.tolerances import save_tolerances, tolerances
from hallsym.report.figures.uncertainty import budget_bars, save_budget_pictures, uncertainty_picture
from hallsym.report.figures.watch import control_chart, save_watch

__all__ = [
    "DPI",
    "LOOKS",
    "STYLE",
    "WIDTH",
    "Place",
    "blocks",
    "broken",
    "budget_bars",
    "control_chart",
    "correlation",
    "coverage",
    "criterion_by_runs",
    "detection",
    "drawable",
    "effects",
    "ends_in_words",
    "errors_before_after",
    "errors_by_setting",
    "gap",
    "measured",
    "parameters",
    "profiles",
    "save_budget_pictures",
    "save_detection",
    "save_diagnosis",
    "save_errors",
    "save_evaluation",
    "save_figures",
    "save_pictures",
    "save_plan_pictures",
    "save_sensitivity_pictures",
    "save_tolerances",
    "save_watch",
    "text_width",
    "tolerances",
    "uncertainty_picture",
]


def save_pictures(log: Log, fit: Fit, folder: str | Path | Place, *, keep: Weigh | None = None) -> list[Path]:
    """Draw the pictures of `fit` on `log` into `folder` (made if missing) and return the files written.

    `measured`, `errors_before_after`, `errors_by_setting` and `parameters`. `keep(block) -> (samples,)`
    weights; samples of weight 0 (outliers) take no part and are marked. The log is read twice, in blocks.
    """
    log = as_read(log, fit.model, fit.wiring)
    survey = cache(lambda: look_over(log, fit, keep))  # once, and only when the folder is there
    return save_figures(
        {
            "measured": lambda: measured(log, fit, survey(), keep),
            "errors_before_after": lambda: errors_before_after(fit, survey()),
            "errors_by_setting": lambda: errors_by_setting(fit, survey()),
            "parameters": lambda: parameters(fit),
        },
        folder,
    )
