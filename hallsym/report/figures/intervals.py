"""Picture `intervals`: each 95 % interval within the bounds, and how narrow it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hallsym.inference.verdict import WEAK
from hallsym.report.figures.captions import caption, height
from hallsym.report.figures.estimates import ROW, beside, typeset
from hallsym.report.figures.layout import HEAD, TIGHT, layout
from hallsym.report.figures.style import (
    BLACK,
    DASHED,
    EDGE,
    GREY,
    LINE,
    broken,
    key,
    label_x,
    legend,
    log_axis,
    row_panels,
    text_width,
)
from hallsym.report.figures.verdicts import LOOKS, present, shown
from hallsym.report.words import digits
from hallsym.units import parameter_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from hallsym.inference import CombinationReport, Identifiability, Interval, ParameterReport

ACROSS = 5
"""Entries of the legend in a row."""
HOW = {"normal": "", "student": "Student", "profile": "profile", "block bootstrap": "bootstrap"}
END = {
    "at bound": ("at lower bound", "at upper bound"),
    "open": ("open below", "open above"),
    "failed": ("failed below", "failed above"),
}


def intervals(report: Identifiability) -> Figure:
    """Draw where each 95 % interval lies within the bounds (left) and its width as a share of them (middle).

    The numbers stand on the right, in a panel of their own where they leave no room for the others, with how
    the interval was found unless it is a normal one; combinations that are identifiable where parameters are
    not stand below.
    """
    entries = layout().share(shown(report))
    words, header = [in_words(entry) for entry in entries], "95 % interval"
    lines, handles = _instead(report), _handles(entries)
    names, right = [entry.name for entry in entries], 0.16 + max(map(text_width, (*words, header)))
    room = layout().width - max(map(text_width, names)) - 4 * EDGE
    apart = layout().stacked and room < TIGHT + right
    words = ["\n".join(broken(text, room, "")) for text in words] if apart else words
    rows = max(text.count("\n") for text in words) + 1
    figure, (place, share, *told) = row_panels(
        names, 3 if apart else 2, ROW * rows, right=EDGE if apart else right, lines=rows, head=HEAD,
        gap=0.2, top=0.4 + LINE * ((len(handles) - 1) // ACROSS), bottom=0.52 + height(lines),
        gridspec_kw={"width_ratios": (2, 3)},
    )  # fmt: skip
    _places(place, entries, report)
    _shares(share, entries)
    for ax in told:
        ax.xaxis.set_visible(False)
        ax.spines["bottom"].set_visible(False)
    for row, text in ((-0.5 - 0.6 / rows, header), *enumerate(words)):
        beside(told[0] if told else share, row, text, inside=apart)
    caption(figure, lines)
    legend(figure, handles, "upper left", ncols=min(len(handles), ACROSS), columnspacing=1.4)
    return figure


def in_words(entry: ParameterReport | CombinationReport) -> str:
    """Return the interval in the unit people read, or the verdict where there is none."""
    if entry.interval is None:
        return entry.verdict.word if hasattr(entry, "verdict") else ""
    factor, unit = parameter_unit(entry.unit, bare=True)
    low, high = factor * entry.interval.low, factor * entry.interval.high
    half, unit = 0.5 * (high - low), f" {unit}" if unit else ""
    if half == 0:
        return f"{digits(low, 0.0)}{unit}{_how(entry.interval)}"
    if not np.isfinite(half):
        half = factor * (entry.std or 0.0)
    return f"{digits(low, half)} to {digits(high, half)}{unit}{_how(entry.interval)}"


def _how(interval: Interval) -> str:
    """How an interval was found, unless it is a normal one, and its ends that are none of the data's."""
    words = [HOW[interval.how]]
    words += [END[end][side] for side, end in enumerate(interval.ends) if end in END]
    told = ", ".join(word for word in words if word)
    return f" ({told})" if told else ""


def _places(ax: Axes, entries: list[ParameterReport], report: Identifiability) -> None:
    """Draw estimate and interval of every parameter, 0 at the lower and 1 at the upper bound."""
    known = dict(zip(report.model.names, report.model.parameters, strict=True))
    for row, entry in enumerate(entries):
        p, look = known[entry.name], LOOKS[entry.verdict.word]
        if not np.isfinite(p.width):
            ax.text(0.5, row, "no bounds", ha="center", va="center_baseline", color=GREY)
            continue
        ax.plot((entry.value - p.lower) / p.width, row, zorder=3, **look.point())
        if entry.interval is None:
            continue
        low, high = ((v - p.lower) / p.width for v in (entry.interval.low, entry.interval.high))
        ends = np.clip((low, high), 0.0, 1.0)
        ax.hlines(row, *ends, color=look.color, lw=1.6, zorder=2, capstyle="butt")
        for beyond, at, marker in ((low < -1e-9, 0.0, "<"), (high > 1 + 1e-9, 1.0, ">")):
            if beyond:
                ax.plot(at, row, marker=marker, ms=4, color=look.color, zorder=3, clip_on=False)
    ax.set_xlim(-0.04, 1.04)
    ax.set_xticks((0, 0.25, 0.5, 0.75, 1), ("lower", "", "middle", "", "upper"))
    label_x(ax, "place within the bounds")


def _shares(ax: Axes, entries: list[ParameterReport]) -> None:
    """Draw the width of the intervals over that of the bounds [%]; more than the bounds ends in an arrow."""
    shares = np.array([np.nan if entry.share is None else 100 * entry.share for entry in entries])
    log_axis(ax, "x", np.array([*np.minimum(shares[shares > 0], 100.0), 100.0, 10.0]))
    left, _ = ax.get_xlim()
    ax.set_xlim(left, 130.0)
    for row, (entry, share) in enumerate(zip(entries, shares, strict=True)):
        if share > 0:
            top = min(share, 100.0)
            ax.barh(row, top - left, 0.62, left=left, zorder=2, **LOOKS[entry.verdict.word].bar())
        if share > 100:
            ax.plot(100.0, row, marker=">", ms=4, color=BLACK, zorder=4)
    ax.axvline(100 * WEAK, color=BLACK, lw=0.8, ls=DASHED, zorder=1)
    label_x(ax, "width of the 95 % interval\n[% of the bounds' width]")


def _instead(report: Identifiability) -> list[str]:
    if not (report.combinations and layout().last):
        return []
    lines = ["Identifiable combinations"]
    for c in report.combinations:
        words = f"{typeset(c.expression)}: {in_words(c)}"
        lines += ["  " + line for line in broken(words, layout().width - 0.4)]
    return lines


def _handles(entries: list[ParameterReport]) -> list[Line2D]:

    handles = [key(word, **LOOKS[word].point()) for word in present(entries)]
    weak = f"weak: 1/{1 / WEAK:.0f} of the bounds"
    return [*handles, key(weak, color=BLACK, lw=0.8, ls=DASHED)]
