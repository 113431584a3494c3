"""Pictures of what data determine: correlations and effects of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.inference import VERDICTS
from hallsym.inference.identifiability import TRADED
from hallsym.report.figures import style
from hallsym.report.words import MINUS, largest, name, scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hallsym.inference import Identifiability, ParameterReport


def drawable(report: Identifiability) -> list[Callable[[Identifiability], Figure]]:
    """Return the pictures that there is something to draw of: no correlation of a single parameter."""
    out: list[Callable[[Identifiability], Figure]] = []
    if np.isfinite(np.diag(report.correlation)).sum() > 1:
        out.append(correlation)
    if shown(report):
        out.append(effects)
    return out


LOOKS = {
    "determined": (style.AFTER, "", "o", style.AFTER),
    "weak": ("#e69f00", "////", "D", "#e69f00"),
    "at bound": (style.BEFORE, "....", "s", style.BEFORE),
    "not determined": ("#cc79a7", "xxxx", "o", "white"),
    "no effect": (style.FAINT, "", "X", style.FAINT),
    "fixed": (style.FAINT, "", "|", style.FAINT),
}
"""Colour, hatch of bars, marker and its face by verdict."""
MODEST: dict[str, Any] = {"facecolor": "white", "edgecolor": style.GREY, "linewidth": 0.7}
"""Bars of 1 % of a value."""


def _bar(word: str) -> dict[str, Any]:
    color, hatch, *_ = LOOKS[word]
    return {"facecolor": color, "hatch": hatch, "edgecolor": style.BLACK, "linewidth": 0.4}


def shown(report: Identifiability) -> list[ParameterReport]:
    """Return the parameters that are not fixed."""
    return [entry for entry in report.parameters if entry.verdict.word != "fixed"]


def present(entries: Sequence[ParameterReport]) -> list[str]:
    """Return the verdicts that occur, best first."""
    found = {entry.verdict.word for entry in entries}
    return [word for word in VERDICTS if word in found]


# -- correlation -----------------------------------------------------------------------------------------

LARGEST, WRITTEN = 0.34, 0.25
"""Largest cell, and smallest one that holds a number [inches]."""


def correlation(report: Identifiability) -> Figure:
    """Draw the correlation of every two determined parameters: squares above the diagonal, numbers below.

    The area of a square is the size of the correlation; negative ones are hollow.
    """
    order = np.flatnonzero(np.isfinite(np.diag(report.correlation)))
    names = [report.model.names[k] for k in order]
    values = report.correlation[np.ix_(order, order)]
    n, left = len(order), 0.1 + max(map(style.text_width, names))
    rest = [entry for k, entry in enumerate(report.parameters) if k not in order]
    left_out = (
        f"{word}: {', '.join(entry.name for entry in rest if entry.verdict.word == word)}"
        for word in present(rest)
    )
    lines = style.broken(f"Left out, {'; '.join(left_out)}.") if rest else []
    top, bottom = left + style.LINE + 0.14, 0.1 + (style.LINE * len(lines) + 0.06 if lines else 0.0)
    cell = min(LARGEST, (style.WIDTH - left - 0.1) / n)
    figure, axes = style.panels(
        1, 1, cell * n, left=left, right=style.WIDTH - left - cell * n, top=top, bottom=bottom, gaps=(0, 0)
    )
    ax = axes[0, 0]
    ax.set(xlim=(-0.5, n - 0.5), ylim=(n - 0.5, -0.5))
    _squares(ax, values, both=cell < WRITTEN)
    if cell >= WRITTEN:
        _numbers(ax, values)
    _names(ax, names, min(style.FONT, 62 * cell))
    width, tall = figure.get_size_inches()
    for k, text in enumerate(reversed(lines)):
        figure.text(style.EDGE / width, (0.06 + style.LINE * k) / tall, text)
    handles = [
        style.key("correlated", ls="none", marker="s", ms=7, color=style.AFTER),
        style.key("anticorrelated", ls="none", marker="s", ms=7, mfc="white", color=style.BEFORE),
    ]
    style.legend(figure, handles, "upper left", ncols=2)
    return figure


def _squares(ax: Axes, values: np.ndarray, *, both: bool) -> None:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    n = len(values)
    for positive, face, edge in ((True, style.AFTER, style.AFTER), (False, "white", style.BEFORE)):
        squares = []
        for row, column in np.argwhere((values >= 0) if positive else (values < 0)).tolist():
            if row == column or (row > column and not both):
                continue
            side = 0.9 * float(np.sqrt(min(abs(values[row, column]), 1.0)))
            squares.append(Rectangle((column - side / 2, row - side / 2), side, side))
        ax.add_collection(PatchCollection(squares, facecolor=face, edgecolor=edge, linewidths=0.9, zorder=2))
    for lines in (ax.hlines, ax.vlines):
        lines(np.arange(n + 1) - 0.5, -0.5, n - 0.5, color=style.SHADE, lw=0.5, zorder=1)
    ax.plot(range(n), range(n), ls="none", marker=".", ms=2, color=style.GREY, zorder=2)


def _numbers(ax: Axes, values: np.ndarray) -> None:
    for column in range(len(values)):
        for row in range(column + 1, len(values)):
            value = float(values[row, column])
            ax.text(
                column, row, _short(value), ha="center", va="center_baseline", fontsize=style.FONT - 1,
                color=style.BLACK if abs(value) >= 0.1 else style.GREY,
                fontweight="bold" if abs(value) >= TRADED else "normal",
            )  # fmt: skip


def _short(value: float) -> str:
    """Two digits without the zero before the point."""
    if abs(value) < 0.005:
        return "0"
    text = "1.0" if abs(value) >= 0.995 else f"{abs(value):.2f}"[1:]
    return (MINUS if value < 0 else "") + text


def _names(ax: Axes, names: list[str], size: float) -> None:
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=size)
    ax.set_yticks(range(len(names)), names, fontsize=size)
    ax.tick_params(length=0, top=True, bottom=False, labeltop=True, labelbottom=False)
    for spine in ax.spines.values():
        spine.set_visible(False)


# -- effects of the parameters ---------------------------------------------------------------------------

ROW, BAR = 0.2, 0.38  # inches; rows
BESIDE = 0.24  # inches: a marker
LEAST = 1e-3
"""Changes below this part of the noise of one reading are not drawn to length."""


def effects(report: Identifiability) -> Figure:
    """Draw the largest change of each pose coordinate over the workspace, one panel each.

    Upper bar of a row: one standard uncertainty of the parameter, in the look of its verdict. Lower bar: 1 %
    of its value. Everything else is held.
    """
    entries, pose = shown(report), report.model.pose
    words = [entry.verdict.word for entry in entries]
    names = [entry.name for entry in entries]
    figure, (axes,) = style.panels(
        1, len(pose), ROW * len(names), left=0.1 + max(map(style.text_width, names)),
        right=BESIDE + 0.06 + max(map(style.text_width, words)), gaps=(0.3, 0), top=0.45, bottom=0.42,
        sharey=True,
    )  # fmt: skip
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    for ax, column in zip(axes, pose, strict=True):
        _effect_panel(ax, entries, column, report)
    _verdicts(axes[-1], words)
    _effect_legend(figure, entries)
    return figure


def _effect_panel(ax: Axes, entries: list[ParameterReport], column: str, report: Identifiability) -> None:
    sigma = np.array([np.nan if e.sigma is None else e.sigma.worst[column] for e in entries])
    percent = np.array([e.percent.worst[column] for e in entries])
    floor, together = (report.outputs[column].noise_floor, report.outputs[column].parameters_worst)
    every = np.array([*sigma, *percent, floor, together])
    factor, unit = scale(column, largest(every), report.model.period)
    least = LEAST * floor if floor > 0 else 0.0
    lined = every[np.isfinite(every) & (every > least)]
    style.log_axis(ax, "x", factor * np.array([*lined, least]))
    edge = ax.get_xlim()[0]
    ax.tick_params("y", length=0)
    for row, entry in enumerate(entries):
        if row % 2 == 0:
            ax.axhspan(row - 0.5, row + 0.5, color=style.STRIPE, lw=0, zorder=0)
        look = _bar(entry.verdict.word)
        for aside, value, options in (
            (-0.5 * BAR, sigma[row], look),
            (0.5 * BAR, percent[row], MODEST),
        ):
            if value > least:
                ax.barh(row + aside, factor * value - edge, BAR, left=edge, zorder=2, **options)
            elif value > 0:
                ax.plot(edge, row + aside, marker="<", ms=2.6, color=style.GREY, clip_on=False, zorder=3)
    for value, dashes, color in ((floor, style.DASHED, style.BLACK), (together, ":", style.AFTER)):
        if value > 0:
            ax.axvline(factor * value, color=color, lw=0.9, ls=dashes, zorder=4)
    style.label_x(ax, f"largest change of {name(column)} [{unit}]")


def _verdicts(ax: Axes, words: list[str]) -> None:
    """Write the verdicts to the right of the rows, each behind its marker."""
    at, inches = ax.get_yaxis_transform(), ax.get_position().width * style.WIDTH
    for row, word in enumerate(words):
        color, _, marker, face = LOOKS[word]
        look: dict[str, Any] = {"ls": "none", "marker": marker, "ms": 4.2, "color": color, "mfc": face}
        ax.plot(1 + 0.12 / inches, row, transform=at, clip_on=False, **look)
        ax.text(1 + BESIDE / inches, row, word, transform=at, va="center_baseline")


def _effect_legend(figure: Figure, entries: list[ParameterReport]) -> None:
    from matplotlib.patches import Patch

    drawn = present([entry for entry in entries if entry.sigma is not None])
    handles: list[Any] = [Patch(**_bar(word), label=f"1 sigma, {word}") for word in drawn]
    handles += [
        Patch(**MODEST, label="1 % of the value"),
        style.key("noise of one reading", color=style.BLACK, lw=0.9, ls=style.DASHED),
        style.key("all parameters together, 1 sigma", color=style.AFTER, lw=0.9, ls=":"),
        style.key(f"below 1/{1 / LEAST:.0f} of the noise", color=style.GREY, ls="none", marker="<", ms=2.6),
    ]
    style.legend(figure, handles, "upper left", ncols=3, columnspacing=1.4)
