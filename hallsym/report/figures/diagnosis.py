"""Pictures of a diagnosis: errors with and without the effects found, the gap, and what it goes with."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.report.data import Survey, compared, look_over, version_of
from hallsym.report.figures.errors import errors_before_after
from hallsym.report.figures.layout import layout
from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    FAINT,
    key,
    label_x,
    label_y,
    legend,
    panels,
    row_panels,
)
from hallsym.report.words import name, scale

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.diagnosis import Diagnosis, Examined

ACROSS, HEIGHT = 3, 1.4
"""Panels side by side, and how high each is [inches]."""
ROW = 0.2
"""Height of a row [inches]."""
MOST = 30
"""Shares that are drawn, the largest first."""
LEAST = 5e-3
"""Least share that is drawn: what rounds to 0 % has no bar."""


def gap(found: Diagnosis, period: Collection[str] | None = None) -> Figure:
    """Draw the error on the holdout runs by output: of the model, with the effects found, and noise alone.

    `period`: coordinates of the pose that repeat, which are read in degrees.
    """
    pose = list(found.noise_floor.outputs)
    across = min(len(pose), layout().across(ACROSS))
    rows = -(-len(pose) // across)
    figure, axes = panels(rows, across, HEIGHT, top=0.3, bottom=0.3, gaps=(0.66, 0.34), least=None)
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


def shares(found: Diagnosis) -> Figure:
    """Draw what share of the excess goes with each coordinate, link, output, sensor, frequency or run."""
    from matplotlib.patches import Patch

    from hallsym.diagnosis import POLICY

    told = [(s.share, s) for s in found.shares if s.share is not None and s.share >= LEAST]
    told.sort(key=lambda pair: -pair[0])
    told = told[:MOST]
    names = [s.name if s.name.startswith(s.kind) else f"{s.kind} {s.name}" for _, s in told]
    figure, (ax,) = row_panels(names, 1, ROW, right=0.1, gap=0.0, top=0.3, bottom=0.42)
    sure = [s.p_value is not None and s.p_value <= POLICY.certain for _, s in told]
    values = [100 * share for share, _ in told]
    ax.barh(range(len(told)), values, 0.6, color=[AFTER if known else FAINT for known in sure], zorder=2)
    ax.set_xlim(0, 100)
    label_x(ax, "share of what exceeds the noise [%]; rows overlap")
    handles = [Patch(color=AFTER, label=f"p ≤ {POLICY.certain:g}"), Patch(color=FAINT, label="no evidence")]
    legend(figure, handles, "upper left", ncols=2)
    return figure


def save_diagnosis(seen: Examined, folder: str | Path | Place) -> list[Path]:
    """Draw the pictures of a diagnosis into `folder` (made if missing) and return the files written.

    `errors_before_after` (left the model, right with the effects found; nominal and fitted parameters where
    none was), `gap`, and `shares` where the error exceeds the noise.
    """
    found, fit = seen.diagnosis, seen.fit
    log = seen.before.log
    titles = ("Model fitted", "With effects found") if seen.after else None

    def survey() -> Survey:
        first = look_over(log, fit, fit.keep)
        if seen.after is None:
            return first
        return compared(first, fit, version_of(seen.before, "before"), version_of(seen.after, "after"))

    draw: dict[str, Callable[[], Figure]] = {
        "errors_before_after": lambda: errors_before_after(fit, survey(), titles),
        "gap": partial(gap, found, fit.model.period),
    }
    if any(s.share is not None and s.share >= LEAST for s in found.shares):
        draw["shares"] = partial(shares, found)
    return save_figures(draw, folder)
