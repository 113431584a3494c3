"""Pictures of what data determine: correlations, effects, profiles, singular values, intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hallsym.report.figures.correlation import correlation
from hallsym.report.figures.effects import effects
from hallsym.report.figures.intervals import intervals
from hallsym.report.figures.profiles import profiles
from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.spectrum import spectrum
from hallsym.report.figures.verdicts import shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.inference import Identifiability


def save_sensitivity_pictures(
    report: Identifiability, folder: str | Path | Place, *, suffixes: Sequence[str] = ("png",)
) -> list[Path]:
    """Draw the pictures of `report` into `folder` (made if missing) and return the files written.

    `correlation`, `effects`, `intervals`, `profiles` and `spectrum`, without those that there is nothing to
    draw of: no correlation of fewer than two parameters, no profiles where none was computed. `suffixes`: any
    of png, pdf, svg. Raises `InputError` for another suffix or a folder that cannot be written.
    """
    return save_figures({draw.__name__: partial(draw, report) for draw in drawable(report)}, folder, suffixes)


def drawable(report: Identifiability) -> list[Callable[[Identifiability], Figure]]:
    """Return the pictures that there is something to draw of."""
    out: list[Callable[[Identifiability], Figure]] = []
    if np.isfinite(np.diag(report.correlation)).sum() > 1:
        out.append(correlation)
    if shown(report):
        out += [effects, intervals]
    if report.intervals.profiles:
        out.append(profiles)
    if len(report.spectrum):
        out.append(spectrum)
    return out
