"""Picture `watch`: a control chart of each quantity of the logs against their calibration."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import AFTER, BEFORE, DASHED, GREY, key, label_x, label_y, legend, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.watching import Watch

ACROSS, HEIGHT = 3, 1.0
"""Panels side by side, and how high each is [inches]."""
MOST = 12.0
"""Score at which larger ones are drawn, so that the limits can still be seen."""


def control_chart(found: Watch) -> Figure:
    """Draw one panel per test: its score by log with the limits; a log beyond them is marked."""
    names = list(found.names())
    rows = max(1, -(-len(names) // ACROSS))
    figure, axes = panels(
        rows, ACROSS, HEIGHT, top=0.42, bottom=0.42, gaps=(0.14, 0.34), sharex=True, sharey=True
    )
    for ax, name in zip(axes.flat, names, strict=False):
        places, tests = [], []
        for k, log in enumerate(found.logs):
            own = [test for test in log.tests if test.name == name]
            places += [k + 1] * len(own)
            tests += own
        score = np.clip([test.score for test in tests], -MOST, MOST)
        limit = np.array([test.limit for test in tests])
        for sign in (-1, 1) if tests[0].two_sided else (1,):
            ax.plot(places, sign * limit, color=GREY, lw=0.6, ls=DASHED, marker="_", ms=4)
        ax.plot(places, score, color=AFTER, marker="o", ms=3, lw=0.6, zorder=3)
        beyond = np.array([test.beyond for test in tests])
        ax.plot(np.array(places)[beyond], score[beyond], color=BEFORE, marker="x", ms=6, ls="", zorder=4)
        ax.set_title(name, pad=3)
    for ax in axes.flat[len(names) :]:
        ax.set_visible(False)
    for ax in axes[-1]:
        label_x(ax, "log")
    axes[0, 0].set_xlim(0.5, len(found.logs) + 0.5)
    axes[0, 0].xaxis.get_major_locator().set_params(integer=True)
    for ax in axes[:, 0]:
        label_y(ax, "score")
    legend(
        figure,
        [
            key("score", color=AFTER, marker="o", ms=3),
            key("beyond its limit", color=BEFORE, marker="x", ms=6, ls=""),
            key(f"limit: 1 log in {1 / found.false_alarm:.0f}", color=GREY, lw=0.6, ls=DASHED),
        ],
        "upper left",
        ncols=3,
    )
    return figure


def save_watch(found: Watch, folder: str | Path | Place) -> list[Path]:
    """Save the control chart into `folder` (made if missing) and return the file written.

    Nothing is drawn where no log was judged.
    """
    return save_figures({"watch": partial(control_chart, found)}, folder) if found.names() else []
