"""Picture `parameters`: every parameter within its bounds, how sharp it is, and the numbers to copy."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation import Fit
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    FAINT,
    GREY,
    key,
    label_x,
    legend,
    log_axis,
    row_panels,
    text_width,
)
from hallsym.report.words import MINUS, plus_minus

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COVERAGE = 1.96
"""Standard deviations in half a 95 % interval."""
ROW = 0.155  # inches
POINT: dict[str, Any] = {"ls": "none", "ms": 4.2, "color": AFTER}
NOMINAL: dict[str, Any] = {"ls": "none", "mew": 1.2, "color": BEFORE}


def parameters(fit: Fit) -> Figure:
    """Draw every parameter within its bounds, how narrow its 95 % interval is, and the numbers to copy.

    Left: nominal value and estimate, 0 at the lower and 1 at the upper bound; hollow where the data do not
    determine it. Middle: half the 95 % interval as a share of the bounds. Combinations that the data
    determine instead stand below.
    """
    model, n = fit.model, len(fit.model.parameters)
    words = [_number_words(fit, row) for row in range(n)]
    instead = [plus_minus(c.value, c.half_width, c.unit) for c in fit.combinations]
    header = "estimate ± 95 %"
    right = 0.14 + max(map(text_width, (*words, *instead, header)))
    below = [textwrap.wrap(typeset(c.expression), 84) for c in fit.combinations]
    extra = sum(map(len, below)) + 1.5 if below else 0.0
    figure, (place, sharp) = row_panels(
        model.names, 2, ROW, right=right, gap=0.34, top=0.4, bottom=0.52 + ROW * extra,
        gridspec_kw={"width_ratios": (3, 2)},
    )  # fmt: skip
    _values(place, sharp, fit)
    for row, text in enumerate(words):
        _beside(sharp, row, text)
    _beside(sharp, -1.1, header)
    place.set_xlim(-0.04, 1.04)
    label_x(place, "position within the bounds")
    place.set_xticks((0, 0.25, 0.5, 0.75, 1), ("lower", "", "middle", "", "upper"))
    _precision_axis(sharp, fit)
    if below:
        _combinations(figure, below, instead, right)
    _parameter_legend(figure, fit)
    return figure


def _values(place: Axes, sharp: Axes, fit: Fit) -> None:
    """Draw nominal values, estimates and intervals."""
    lower, upper = fit.model.bounds
    width = np.asarray(upper, dtype=float) - lower
    bounded = np.isfinite(width) & (width > 0)
    for k in np.flatnonzero(~bounded):
        word = "fixed" if width[k] == 0 else "no bounds"
        place.text(0.5, float(k), word, ha="center", va="center_baseline", color=GREY)
    rows = np.flatnonzero(bounded)
    nominal = (np.asarray(fit.model.nominal)[rows] - lower[rows]) / width[rows]
    at, known = (fit.values[rows] - lower[rows]) / width[rows], np.asarray(fit.determined)[rows]
    edge = np.isin(np.array(fit.model.names)[rows], fit.at_bound)
    drawn = np.clip(nominal, -0.03, 1.03)
    place.hlines(rows, drawn, at, color=FAINT, lw=0.8, zorder=1)
    for marker, size, pick in (
        ("|", 6, drawn == nominal),
        (">", 4, drawn < nominal),
        ("<", 4, drawn > nominal),
    ):
        place.plot(drawn[pick], rows[pick], marker=marker, ms=size, **NOMINAL, zorder=2)
    for marker, face, pick in (
        ("s", AFTER, edge),
        ("o", AFTER, known & ~edge),
        ("o", "white", ~known & ~edge),
    ):
        place.plot(at[pick], rows[pick], marker=marker, mfc=face, **POINT, zorder=3)
    half = np.where(known, fit.half_width[rows], np.nan) / width[rows]
    ends = at[known] - half[known], at[known] + half[known]
    place.hlines(rows[known], *ends, color=AFTER, lw=1.4, zorder=2, capstyle="butt")
    sharp.plot(100 * half[half > 0], rows[half > 0], marker="o", **POINT, zorder=3)


def _number_words(fit: Fit, row: int) -> str:
    """The estimate with its interval, or why there is none."""
    p = fit.model.parameters[row]
    if p.width == 0:
        return "fixed"
    if p.name in fit.at_bound:
        return "at its bound"
    if fit.determined[row]:
        return plus_minus(float(fit.values[row]), float(fit.half_width[row]), p.unit)
    return "not identifiable, fixed" if p.name in fit.held else "not identifiable"


def _beside(ax: Axes, row: float, text: str) -> None:
    """Write to the right of a row."""
    ax.text(1.03, row, text, transform=ax.get_yaxis_transform(), va="center_baseline")


def _combinations(figure: Figure, below: Sequence[list[str]], instead: Sequence[str], right: float) -> None:
    """List the identifiable combinations, one picture row per line."""
    width, height = figure.get_size_inches()
    rows = [("Identifiable combinations", "")]
    for lines, value in zip(below, instead, strict=True):
        indents = (1, *[3] * (len(lines) - 1))
        rows += [(" " * i + line, "") for i, line in zip(indents, lines, strict=True)]
        rows[-1] = (rows[-1][0], value)
    for k, (text, value) in enumerate(reversed(rows)):
        y = (0.06 + ROW * k) / height
        figure.text(0.1 / width, y, text)
        figure.text(1 - (right - 0.06) / width, y, value)


def typeset(expression: str) -> str:
    """Return an expression as it is printed: minus signs, no stars."""
    return re.sub(r"(?<!e)-", MINUS, expression.replace("*", " "))


def _precision_axis(ax: Axes, fit: Fit) -> None:
    width = np.array([p.width for p in fit.model.parameters])
    with np.errstate(divide="ignore", invalid="ignore"):
        half = 100 * fit.half_width / width
    half = half[np.isfinite(half) & (half > 0)]
    label_x(ax, "half of the 95 % interval\n[% of the bounds' width]")
    if len(half):
        log_axis(ax, "x", np.array([*half, 0.1, 1.0]))
    else:
        ax.set_xticks([])


def _parameter_legend(figure: Figure, fit: Fit) -> None:
    handles = [
        key("nominal", marker="|", ms=6, **NOMINAL),
        key("estimate", marker="o", **POINT),
    ]
    lower, upper = fit.model.bounds
    if np.any((fit.model.nominal < lower - 0.03 * (upper - lower)) | (fit.model.nominal > upper)):
        beyond = key("nominal beyond the bounds", marker=">", ms=4, **NOMINAL)
        handles.insert(1, beyond)
    if fit.at_bound:
        handles.append(key("estimate at its bound", marker="s", **POINT))
    if not np.all(fit.determined):
        handles.append(key("not identifiable from the data", marker="o", mfc="white", **POINT))
    legend(figure, handles, "upper left", ncols=len(handles))
