"""Picture `correlation`: which determined parameters are traded off against each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hallsym.inference.verdict import TRADED
from hallsym.report.data import blocks
from hallsym.report.figures.captions import caption, height
from hallsym.report.figures.layout import LATER, PAGE, layout
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    FONT,
    GREY,
    LINE,
    SHADE,
    broken,
    key,
    legend,
    panels,
    text_width,
)
from hallsym.report.figures.verdicts import by_verdict
from hallsym.report.words import MINUS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hallsym.inference import Identifiability

LARGEST, WRITTEN = 0.34, 0.25
"""Largest cell, and smallest one that holds a number [inches]."""


def correlation(report: Identifiability) -> Figure:
    """Draw the correlation of every two determined parameters: squares above the diagonal, numbers below.

    The area of a square is the size of the correlation; negative ones are hollow. Parameters that hang
    together by correlations of `TRADED` and more stand side by side, in a box. Where the columns of all
    parameters have no room beside each other, each of several files has a share of them, and all rows.
    """
    groups = blocks(report.correlation)
    order = [k for group in groups for k in group]
    names = [report.model.names[k] for k in order]
    values = report.correlation[np.ix_(order, order)]
    n, left = len(order), 0.1 + max(map(text_width, names))
    shown = layout().share(range(n))
    lines = _caption(report, any(len(group) > 1 for group in groups))
    top, bottom = left + LINE + 0.14, 0.1 + height(lines)
    cell = min(LARGEST, (layout().width - left - 0.1) / len(shown))
    if layout().stacked:
        cell = min(cell, (PAGE - LATER - top - bottom) / n)
    layout().need(62 * cell, FONT)  # names keep their size
    figure, axes = panels(
        1, 1, cell * n, left=left, right=layout().width - left - cell * len(shown), top=top, bottom=bottom,
        gaps=(0, 0),
    )  # fmt: skip
    ax = axes[0, 0]
    ax.set(xlim=(shown[0] - 0.5, shown[-1] + 0.5), ylim=(n - 0.5, -0.5))
    _squares(ax, values, shown, both=cell < WRITTEN)
    if cell >= WRITTEN:
        _numbers(ax, values, shown)
    _boxes(ax, [len(group) for group in groups], shown)
    _names(ax, names, shown, min(FONT, 62 * cell))
    caption(figure, lines)
    _legend(figure)
    return figure


def _squares(ax: Axes, values: np.ndarray, shown: Sequence[int], *, both: bool) -> None:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    n = len(values)
    for positive, face, edge in ((True, AFTER, AFTER), (False, "white", BEFORE)):
        squares = []
        for row, column in np.argwhere((values >= 0) if positive else (values < 0)).tolist():
            if column not in shown or row == column or (row > column and not both):
                continue
            side = 0.9 * float(np.sqrt(min(abs(values[row, column]), 1.0)))
            squares.append(Rectangle((column - side / 2, row - side / 2), side, side))
        ax.add_collection(PatchCollection(squares, facecolor=face, edgecolor=edge, linewidths=0.9, zorder=2))
    first, last = shown[0] - 0.5, shown[-1] + 0.5
    ax.hlines(np.arange(n + 1) - 0.5, first, last, color=SHADE, lw=0.5, zorder=1)
    ax.vlines(np.arange(first, last + 1), -0.5, n - 0.5, color=SHADE, lw=0.5, zorder=1)
    ax.plot(shown, shown, ls="none", marker=".", ms=2, color=GREY, zorder=2)


def _numbers(ax: Axes, values: np.ndarray, shown: Sequence[int]) -> None:
    for column in shown:
        for row in range(column + 1, len(values)):
            value = float(values[row, column])
            strong = abs(value) >= TRADED
            ax.text(
                column, row, _short(value), ha="center", va="center_baseline", fontsize=FONT - 1,
                color=BLACK if abs(value) >= 0.1 else GREY, fontweight="bold" if strong else "normal",
            )  # fmt: skip


def _short(value: float) -> str:
    """Two digits without the zero before the point."""
    if abs(value) < 0.005:
        return "0"
    text = "1.0" if abs(value) >= 0.995 else f"{abs(value):.2f}"[1:]
    return (MINUS if value < 0 else "") + text


def _boxes(ax: Axes, sizes: list[int], shown: Sequence[int]) -> None:
    """Draw the boxes; one that goes on in another file is open on that side."""
    from matplotlib.patches import Rectangle

    first = 0
    for size in sizes:
        inner = {first, first + size - 1} & set(shown)
        if size > 1 and (inner or first < shown[0] < first + size):
            at = (first - 0.5, first - 0.5)
            ax.add_patch(
                Rectangle(
                    at, size, size, fill=False, edgecolor=BLACK, lw=1.1, zorder=4, clip_on=len(inner) < 2
                )
            )
        first += size


def _names(ax: Axes, names: list[str], shown: Sequence[int], size: float) -> None:
    ax.set_xticks(shown, [names[k] for k in shown], rotation=90, fontsize=size)
    ax.set_yticks(range(len(names)), names, fontsize=size)
    ax.tick_params(length=0, top=True, bottom=False, labeltop=True, labelbottom=False)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _caption(report: Identifiability, boxed: bool) -> list[str]:
    lines = broken(f"Box: correlations of {TRADED:g} and more join these parameters.") if boxed else []
    known = np.isfinite(np.diag(report.correlation))
    rest = [entry for entry, there in zip(report.parameters, known, strict=True) if not there]
    if rest:
        lines += broken(f"Left out, {'; '.join(by_verdict(rest))}.")
    return lines


def _legend(figure: Figure) -> None:
    handles = [
        key("correlated", ls="none", marker="s", ms=7, color=AFTER),
        key("anticorrelated", ls="none", marker="s", ms=7, mfc="white", color=BEFORE),
    ]
    legend(figure, handles, "upper left", ncols=2)
