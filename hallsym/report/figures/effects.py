"""Picture `effects`: what a change of each parameter does to the decoded pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.report.figures.layout import layout
from hallsym.report.figures.style import (
    AFTER,
    BLACK,
    DASHED,
    GREY,
    key,
    label_x,
    legend,
    log_axis,
    row_panels,
    text_width,
)
from hallsym.report.figures.verdicts import LOOKS, present, shown
from hallsym.report.words import largest, name, scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hallsym.inference import Identifiability, ParameterReport

ROW, BAR = 0.2, 0.38  # inches; rows
BESIDE = 0.24  # inches: a marker
LEAST = 1e-3
"""Changes below this part of the noise of one reading are not drawn to length."""


def effects(report: Identifiability) -> Figure:
    """Draw the largest change of each pose coordinate over the workspace, one panel each.

    Upper bar of a row: one standard uncertainty of the parameter, in the look of its verdict. Lower bar: 1 %
    of its value. Everything else is held.
    """
    entries, pose = shown(report), layout().share(report.model.pose)
    words = [entry.verdict.word for entry in entries]
    figure, axes = row_panels(
        [entry.name for entry in entries], len(pose), ROW, right=BESIDE + 0.06 + max(map(text_width, words)),
        gap=0.3, top=0.45, bottom=0.42,
    )  # fmt: skip
    for ax, column in zip(axes, pose, strict=True):
        _panel(ax, entries, column, report)
    _verdicts(axes[-1], words)
    _legend(figure, entries)
    return figure


def _panel(ax: Axes, entries: list[ParameterReport], column: str, report: Identifiability) -> None:
    """Draw the bars of one coordinate."""
    sigma = np.array([np.nan if e.sigma is None else e.sigma.worst[column] for e in entries])
    percent = np.array([e.percent.worst[column] for e in entries])
    floor, together = (report.outputs[column].noise_floor, report.outputs[column].parameters_worst)
    every = np.array([*sigma, *percent, floor, together])
    factor, unit = scale(column, largest(every), report.model.period)
    least = LEAST * floor if floor > 0 else 0.0
    lined = every[np.isfinite(every) & (every > least)]
    log_axis(ax, "x", factor * np.array([*lined, least]))
    edge = ax.get_xlim()[0]
    for row, entry in enumerate(entries):
        look = LOOKS[entry.verdict.word].bar()
        for aside, value, options in (
            (-0.5 * BAR, sigma[row], look),
            (0.5 * BAR, percent[row], {"facecolor": "white", "edgecolor": GREY, "linewidth": 0.7}),
        ):
            if value > least:
                ax.barh(row + aside, factor * value - edge, BAR, left=edge, zorder=2, **options)
            elif value > 0:
                ax.plot(edge, row + aside, marker="<", ms=2.6, color=GREY, clip_on=False, zorder=3)
    for value, dashes, color in ((floor, DASHED, BLACK), (together, ":", AFTER)):
        if value > 0:
            ax.axvline(factor * value, color=color, lw=0.9, ls=dashes, zorder=4)
    label_x(ax, f"largest change of {name(column)} [{unit}]")


def _verdicts(ax: Axes, words: list[str]) -> None:
    """Write the verdicts to the right of the rows, each behind its marker."""
    at, inches = ax.get_yaxis_transform(), ax.get_position().width * layout().width
    for row, word in enumerate(words):
        ax.plot(1 + 0.12 / inches, row, transform=at, clip_on=False, **LOOKS[word].point())
        ax.text(1 + BESIDE / inches, row, word, transform=at, va="center_baseline")


def _legend(figure: Figure, entries: list[ParameterReport]) -> None:
    from matplotlib.patches import Patch

    drawn = present([entry for entry in entries if entry.sigma is not None])
    handles: list[Any] = [Patch(**LOOKS[word].bar(), label=f"1 sigma, {word}") for word in drawn]
    handles += [
        Patch(facecolor="white", edgecolor=GREY, linewidth=0.7, label="1 % of the value"),
        key("noise of one reading", color=BLACK, lw=0.9, ls=DASHED),
        key("all parameters together, 1 sigma", color=AFTER, lw=0.9, ls=":"),
        key(f"below 1/{1 / LEAST:.0f} of the noise", color=GREY, ls="none", marker="<", ms=2.6),
    ]
    legend(figure, handles, "upper left", ncols=3, columnspacing=1.4)
