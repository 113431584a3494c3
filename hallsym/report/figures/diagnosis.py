"""Pictures of a diagnosis: errors with and without the effects found, and the gap."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.report.data import Survey, compared, look_over, version_of
from hallsym.report.figures.errors import errors_before_after
from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    key,
    label_y,
    legend,
    panels,
)
from hallsym.report.words import name, scale

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.diagnosis import Diagnosis, Examined

ACROSS, HEIGHT = 3, 1.4
"""Panels side by side, and how high each is [inches]."""


def gap(found: Diagnosis, period: Collection[str] | None = None) -> Figure:
    """Draw the error on the holdout runs by output: of the model, with the effects found, and noise alone.

    `period`: coordinates of the pose that repeat, which are read in degrees.
    """
    pose = list(found.noise_floor.outputs)
    across = min(len(pose), ACROSS)
    rows = -(-len(pose) // across)
    figure, axes = panels(rows, across, HEIGHT, top=0.3, bottom=0.3, gaps=(0.66, 0.34))
    for ax, c in zip(axes.flat, pose, strict=False):
        sizes = (found.gap_before.rmse[c], found.gap_after.rmse[c], found.noise_floor.outputs[c])
        factor, unit = scale(c, max(sizes), period)
        ax.bar((0, 1), [factor * size for size in sizes[:2]], color=(BEFORE, AFTER), width=0.6)
        ax.axhline(factor * sizes[2], color=BLACK, lw=0.8, ls=DASHED)
        ax.set_xticks((0, 1), ("model", "with effects"))
        ax.set_xlim(-0.6, 1.6)
        label_y(ax, f"rmse {name(c)} [{unit}]")
    for ax in axes.flat[len(pose) :]:
        ax.set_visible(False)
    label = f"noise floor ({found.noise_floor.source})"
    legend(figure, [key(label, color=BLACK, lw=0.8, ls=DASHED)], "upper left")
    return figure


def save_diagnosis(seen: Examined, folder: str | Path | Place) -> list[Path]:
    """Draw the pictures of a diagnosis into `folder` (made if missing) and return the files written.

    `errors_before_after` (left the model, right with the effects found; nominal and fitted parameters where
    none was) and `gap`.
    """
    found, fit = seen.diagnosis, seen.fit
    log = seen.before.log
    titles = ("Model fitted", "With effects found") if seen.after else None

    def survey() -> Survey:
        first = look_over(log, fit, fit.keep)
        if seen.after is None:
            return first
        return compared(first, fit, version_of(seen.before, "before"), version_of(seen.after, "after"))

    return save_figures(
        {
            "errors_before_after": lambda: errors_before_after(fit, survey(), titles),
            "gap": lambda: gap(found, fit.model.period),
        },
        folder,
    )
