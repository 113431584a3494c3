"""Picture `tolerances`: first and total Sobol indices of the error of each coordinate, one row each."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import AFTER, BLACK, LIGHT, key, label_x, legend, row_panels
from hallsym.report.words import name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.uncertainty.tolerances import Tolerances

ROW, BAR = 0.155, 0.36


def tolerances(found: Tolerances) -> Figure:
    """Draw first and total indices of the error, one panel per coordinate.

    Rows are in the order of the ranking; whiskers are 95 % intervals.
    """
    from matplotlib.patches import Patch

    order, pose = [found.active.index(n) for n in found.ranking], found.model.pose
    rows = np.arange(len(order))
    figure, axes = row_panels(found.ranking, len(pose), ROW, right=0.1, gap=0.16, top=0.42, bottom=0.42)
    for ax, column in zip(axes, pose, strict=True):
        indices = found.indices[column]
        for side, color, values, half in (
            (-0.5, AFTER, indices.first, indices.first_half),
            (0.5, LIGHT, indices.total, indices.total_half),
        ):
            ax.barh(rows + side * BAR, 100 * values[order], BAR, color=color, zorder=2)
            ax.errorbar(
                100 * values[order], rows + side * BAR, xerr=100 * half[order],
                fmt="none", ecolor=BLACK, elinewidth=0.6, zorder=3,
            )  # fmt: skip
        ax.set_title(name(column), pad=3)
        ax.set_xlim(min(0.0, ax.get_xlim()[0]), ax.get_xlim()[1])
        label_x(ax, "share of the variance [%]")
    legend(
        figure,
        [
            Patch(color=AFTER, label="Error: first index"),
            Patch(color=LIGHT, label="total index"),
            key("95 %", color=BLACK, lw=0.6),
        ],
        "upper left",
        ncols=3,
    )
    return figure


def save_tolerances(found: Tolerances, folder: str | Path | Place) -> list[Path]:
    """Save the picture into `folder` (made if missing) and return the files written."""
    return save_figures({"tolerances": partial(tolerances, found)}, folder)
