"""Picture `detection`: how often a diagnosis finds each effect of a self-test, against its size."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    DASHED,
    GREY,
    key,
    label_x,
    label_y,
    legend,
    panels,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.diagnosis import SelfTest

ACROSS, HEIGHT = 4, 1.05
"""Panels side by side, and how high each is [inches]."""


def detection(found: SelfTest) -> Figure:
    """Draw one panel per effect that could be scaled: found, with 95 % bounds, and noticed, over the size.

    The grey line is the rate of false alarms.
    """
    drawn = [e for e in found.effects if e.curve and e.curve[0].ratio is not None]
    rows = max(1, -(-len(drawn) // ACROSS))
    figure, axes = panels(
        rows, ACROSS, HEIGHT, top=0.42, bottom=0.42, gaps=(0.14, 0.34), sharex=True, sharey=True
    )
    for ax, effect in zip(axes.flat, drawn, strict=False):
        size = [p.ratio for p in effect.curve]
        share = [100 * p.found for p in effect.curve]
        spread = [
            [100 * (p.found - p.low) for p in effect.curve],
            [100 * (p.high - p.found) for p in effect.curve],
        ]
        ax.axhline(100 * found.false_alarm_rate.found, color=GREY, lw=0.6)
        ax.errorbar(size, share, yerr=spread, color=AFTER, marker="o", ms=3, capsize=2, elinewidth=0.6)
        noticed = [100 * p.noticed for p in effect.curve]
        ax.plot(size, noticed, color=BEFORE, ls=DASHED, marker="x", ms=3)
        ax.set_title(effect.name, pad=3)
        ax.set_ylim(-4, 104)
    for ax in axes.flat[len(drawn) :]:
        ax.set_visible(False)
    for ax in axes[-1]:
        label_x(ax, "gap over noise floor")
    for ax in axes[:, 0]:
        label_y(ax, "trials [%]")
    legend(
        figure,
        [
            key("found, 95 % bounds", color=AFTER, marker="o", ms=3),
            key("noticed", color=BEFORE, ls=DASHED, marker="x", ms=3),
            key("false alarms", color=GREY, lw=0.6),
        ],
        "upper left",
        ncols=3,
    )
    return figure


def save_detection(found: SelfTest, folder: str | Path | Place) -> list[Path]:
    """Save the picture into `folder` (made if missing) and return the files written."""
    return save_figures({"detection": partial(detection, found)}, folder)
