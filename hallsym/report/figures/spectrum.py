"""Picture `spectrum`: singular values of the scaled Jacobian, and the directions that are not determined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.estimation.identifiable import UNDETERMINED
from hallsym.report.figures.captions import caption, height
from hallsym.report.figures.layout import layout
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    FAINT,
    LEFT,
    LINE,
    SHADE,
    broken,
    key,
    label_x,
    label_y,
    legend,
    log_axis,
    panels,
)
from hallsym.report.words import short, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from hallsym.inference import Identifiability, NullDirection

BESIDE = 0.78  # inches: a label and five digits
TICK = 0.14  # inches: a number of two digits, and a gap
SMALLEST = 0.01
"""Singular values below this (one sigma of 100 bound widths) are drawn at the edge."""
KINDS: dict[str, dict[str, Any]] = {
    "determined": {"marker": "o", "ms": 4.5, "color": AFTER},
    "left by this recording": {"marker": "D", "ms": 5.0, "mfc": "white", "color": BEFORE},
    "whatever is recorded": {"marker": "x", "ms": 5.5, "mew": 1.4, "color": BLACK},
}


def spectrum(report: Identifiability) -> Figure:
    """Draw the singular values, largest first, by whether their direction is determined, and name the others.

    Parameters are scaled by their bounds and readings by their noise, so the inverse of a singular value is
    the standard uncertainty of its direction in bound widths.
    """
    values, kinds = report.spectrum, sorts(report)
    lines = _caption(report)
    figure, axes = panels(
        1, 1, 2.3, top=2 * LINE + 0.16, bottom=0.46 + height(lines), right=BESIDE, gaps=(0, 0)
    )
    ax, threshold = axes[0, 0], 1 / UNDETERMINED
    log_axis(ax, "y", np.array([*values[values > SMALLEST], threshold, SMALLEST]))
    low, high = ax.get_ylim()
    at = np.maximum(values, SMALLEST)
    ax.vlines(np.arange(len(values)) + 1, low, at, color=FAINT, lw=0.7, zorder=1)
    for kind, look in KINDS.items():
        pick = np.flatnonzero([k == kind for k in kinds])
        ax.plot(pick + 1, at[pick], ls="none", zorder=3, **look)
    ax.axhline(threshold, color=BLACK, lw=0.8, ls=DASHED, zorder=2)
    ax.grid(axis="y", which="major", color=SHADE, lw=0.5, zorder=0)
    _open_end(ax.yaxis, SMALLEST, "≤ ")
    ax.set_xlim(0.3, len(values) + 0.7)
    ax.set_xticks([k + 1 for k in thinned(len(values), int((layout().width - LEFT - BESIDE) / TICK))])
    label_y(ax, "singular value")
    label_x(ax, "direction in parameter space, best determined first", 0.24)
    _uncertainty_axis(ax, low, high)
    caption(figure, lines)
    _legend(figure, kinds)
    return figure


def sorts(report: Identifiability) -> list[str]:
    """Return for each singular value which of `KINDS` it is.

    Structural directions have singular value 0 up to rounding: they are the last.
    """
    here, always, of = report.practical.rank, report.structural.rank, len(report.spectrum)
    counts = (here, always - here, of - always)
    return [kind for kind, count in zip(KINDS, counts, strict=True) for _ in range(count)]


def _open_end(axis: Axis, end: float, sign: str) -> None:
    """Label the ticks of an axis; at `end` stands what is beyond it too."""
    from matplotlib.ticker import FuncFormatter

    axis.set_major_formatter(FuncFormatter(lambda v, _: (sign if np.isclose(v, end) else "") + short(v)))


def _uncertainty_axis(ax: Axes, low: float, high: float) -> None:
    """State on the right what a singular value means in per cent of the bounds."""
    from matplotlib.ticker import LogLocator, NullLocator

    right = ax.twinx()
    right.set(yscale="log", ylim=(100 / low, 100 / high))
    right.yaxis.set_major_locator(LogLocator(subs=(1,), numticks=20))
    right.yaxis.set_minor_locator(NullLocator())
    _open_end(right.yaxis, 100 / SMALLEST, "≥ ")
    right.spines["right"].set_visible(True)
    right.set_ylabel("1 sigma [% of the bounds' width]", rotation=270, va="top")
    right.yaxis.set_label_coords(1 + (BESIDE - 0.03) / (layout().width - LEFT - BESIDE), 0.5)


def _caption(report: Identifiability) -> list[str]:
    what = "plan" if report.evidence.cost.planned else "recording"
    lines = []
    if report.structural.null:
        lines += broken(f"No recording determines (x): {_named(report.structural.null)}.")
    if report.practical.null:
        lines += broken(f"This {what} leaves (diamonds): {_named(report.practical.null)}.")
    if not np.isfinite([p.width for p in report.model.parameters]).all():
        lines += broken("Parameters without bounds count in their own unit.")
    return lines


def _named(null: Sequence[NullDirection]) -> str:
    """Directions by their parameters: alone, or those that cannot be told apart."""
    alone = ", ".join(d.parameters[0] for d in null if len(d.parameters) == 1)
    joint = [" with ".join(d.parameters) for d in null if len(d.parameters) > 1]
    return "; ".join([*joint, *([alone] if alone else [])])


def _legend(figure: Figure, kinds: Sequence[str]) -> None:
    words = {
        "determined": "determined",
        "left by this recording": "not determined by these data",
        "whatever is recorded": "not determined, whatever is recorded",
    }
    handles = [
        key(f"{words[kind]} ({kinds.count(kind)})", ls="none", **look)
        for kind, look in KINDS.items()
        if kind in kinds
    ]
    share = f"{100 * UNDETERMINED:g} %"
    handles.append(
        key(f"undetermined below: 1 sigma is {share} of the bounds", color=BLACK, lw=0.8, ls=DASHED)
    )
    legend(figure, handles, "upper left", ncols=2)
