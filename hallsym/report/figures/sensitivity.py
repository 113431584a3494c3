"""Pictures of what data determine: correlations, effects of the parameters, profiles of the likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.inference import VERDICTS
from hallsym.inference.identifiability import TRADED
from hallsym.report.data.fit import blocks
from hallsym.report.figures.campaign import COVERAGE, typeset
from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    EDGE,
    FAINT,
    FONT,
    GREY,
    LIGHT,
    LINE,
    SHADE,
    WIDTH,
    broken,
    key,
    label_x,
    label_y,
    legend,
    log_axis,
    panels,
    row_panels,
    text_width,
)
from hallsym.report.words import MINUS, digits, largest, name, scale
from hallsym.units import parameter_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hallsym.inference import Identifiability, Interval, ParameterReport, Profile, Side


def save_sensitivity_pictures(report: Identifiability, folder: str | Path | Place) -> list[Path]:
    """Draw the pictures of `report` into `folder` (made if missing) and return the files written.

    `correlation`, `effects` and `profiles`, without those that there is nothing to draw of: no correlation of
    fewer than two parameters, no profiles where none was computed.
    """
    return save_figures({draw.__name__: partial(draw, report) for draw in drawable(report)}, folder)


def drawable(report: Identifiability) -> list[Callable[[Identifiability], Figure]]:
    """Return the pictures that there is something to draw of."""
    out: list[Callable[[Identifiability], Figure]] = []
    if np.isfinite(np.diag(report.correlation)).sum() > 1:
        out.append(correlation)
    if shown(report):
        out.append(effects)
    if report.intervals.profiles:
        out.append(profiles)
    return out


@dataclass(frozen=True)
class Look:
    """Colour of bars and markers, hatch of bars, marker and whether it is filled."""

    color: str
    hatch: str
    marker: str
    filled: bool = True

    def bar(self) -> dict[str, Any]:
        """Return options of a bar."""
        return {"facecolor": self.color, "hatch": self.hatch, "edgecolor": BLACK, "linewidth": 0.4}

    def point(self) -> dict[str, Any]:
        """Return options of a marker."""
        face = self.color if self.filled else "white"
        return {"ls": "none", "marker": self.marker, "ms": 4.2, "color": self.color, "mfc": face}


LOOKS = {
    "determined": Look(AFTER, "", "o"),
    "weak": Look("#e69f00", "////", "D"),
    "at bound": Look(BEFORE, "....", "s"),
    "not determined": Look("#cc79a7", "xxxx", "o", filled=False),
    "no effect": Look(FAINT, "", "X"),
    "fixed": Look(FAINT, "", "|"),
}


def shown(report: Identifiability) -> list[ParameterReport]:
    """Return the parameters that are not fixed."""
    return [entry for entry in report.parameters if entry.verdict.word != "fixed"]


def present(entries: Sequence[ParameterReport]) -> list[str]:
    """Return the verdicts that occur, best first."""
    found = {entry.verdict.word for entry in entries}
    return [word for word in VERDICTS if word in found]


def by_verdict(entries: Sequence[ParameterReport]) -> list[str]:
    """Return `not determined: H1x, H1y` for every verdict that occurs."""
    return [
        f"{word}: {', '.join(entry.name for entry in entries if entry.verdict.word == word)}"
        for word in present(entries)
    ]


# -- correlation -----------------------------------------------------------------------------------------

LARGEST, WRITTEN = 0.34, 0.25
"""Largest cell, and smallest one that holds a number [inches]."""


def correlation(report: Identifiability) -> Figure:
    """Draw the correlation of every two determined parameters: squares above the diagonal, numbers below.

    The area of a square is the size of the correlation; negative ones are hollow. Parameters that hang
    together by correlations of `TRADED` and more stand side by side, in a box.
    """
    groups = blocks(report.correlation)
    order = [k for group in groups for k in group]
    names = [report.model.names[k] for k in order]
    values = report.correlation[np.ix_(order, order)]
    n, left = len(order), 0.1 + max(map(text_width, names))
    lines = _caption(report, any(len(group) > 1 for group in groups))
    top, bottom = left + LINE + 0.14, 0.1 + (LINE * len(lines) + 0.06 if lines else 0.0)
    cell = min(LARGEST, (WIDTH - left - 0.1) / n)
    figure, axes = panels(
        1, 1, cell * n, left=left, right=WIDTH - left - cell * n, top=top, bottom=bottom, gaps=(0, 0)
    )
    ax = axes[0, 0]
    ax.set(xlim=(-0.5, n - 0.5), ylim=(n - 0.5, -0.5))
    _squares(ax, values, both=cell < WRITTEN)
    if cell >= WRITTEN:
        _numbers(ax, values)
    _boxes(ax, [len(group) for group in groups])
    _names(ax, names, min(FONT, 62 * cell))
    width, tall = figure.get_size_inches()
    for k, text in enumerate(reversed(lines)):
        figure.text(EDGE / width, (0.06 + LINE * k) / tall, text)
    handles = [
        key("correlated", ls="none", marker="s", ms=7, color=AFTER),
        key("anticorrelated", ls="none", marker="s", ms=7, mfc="white", color=BEFORE),
    ]
    legend(figure, handles, "upper left", ncols=2)
    return figure


def _squares(ax: Axes, values: np.ndarray, *, both: bool) -> None:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    n = len(values)
    for positive, face, edge in ((True, AFTER, AFTER), (False, "white", BEFORE)):
        squares = []
        for row, column in np.argwhere((values >= 0) if positive else (values < 0)).tolist():
            if row == column or (row > column and not both):
                continue
            side = 0.9 * float(np.sqrt(min(abs(values[row, column]), 1.0)))
            squares.append(Rectangle((column - side / 2, row - side / 2), side, side))
        ax.add_collection(PatchCollection(squares, facecolor=face, edgecolor=edge, linewidths=0.9, zorder=2))
    for lines in (ax.hlines, ax.vlines):
        lines(np.arange(n + 1) - 0.5, -0.5, n - 0.5, color=SHADE, lw=0.5, zorder=1)
    ax.plot(range(n), range(n), ls="none", marker=".", ms=2, color=GREY, zorder=2)


def _numbers(ax: Axes, values: np.ndarray) -> None:
    for column in range(len(values)):
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


def _boxes(ax: Axes, sizes: list[int]) -> None:
    from matplotlib.patches import Rectangle

    first = 0
    for size in sizes:
        if size > 1:
            at = (first - 0.5, first - 0.5)
            ax.add_patch(
                Rectangle(at, size, size, fill=False, edgecolor=BLACK, lw=1.1, zorder=4, clip_on=False)
            )
        first += size


def _names(ax: Axes, names: list[str], size: float) -> None:
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=size)
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
    figure, axes = row_panels(
        [entry.name for entry in entries], len(pose), ROW, right=BESIDE + 0.06 + max(map(text_width, words)),
        gap=0.3, top=0.45, bottom=0.42,
    )  # fmt: skip
    for ax, column in zip(axes, pose, strict=True):
        _effect_panel(ax, entries, column, report)
    _verdicts(axes[-1], words)
    _effect_legend(figure, entries)
    return figure


def _effect_panel(ax: Axes, entries: list[ParameterReport], column: str, report: Identifiability) -> None:
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
    at, inches = ax.get_yaxis_transform(), ax.get_position().width * WIDTH
    for row, word in enumerate(words):
        ax.plot(1 + 0.12 / inches, row, transform=at, clip_on=False, **LOOKS[word].point())
        ax.text(1 + BESIDE / inches, row, word, transform=at, va="center_baseline")


def _effect_legend(figure: Figure, entries: list[ParameterReport]) -> None:
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


# -- profiles --------------------------------------------------------------------------------------------

ACROSS, TOP = 4, 1.6
"""Panels in a row; upper end of the y axis, in thresholds."""
SIDE, GAP, HIGH, BELOW = 0.5, 0.16, 0.95, 0.3  # inches
MARGIN = 0.2
"""What is shown beyond the ends of an interval, in its width: room for their labels."""
TITLE = 3
"""Lines that the name of a quantity may take."""
ENDS = {"reached": "o", "at bound": "s"}
"""Markers of ends that have a place; open ends are arrows and failed ones are only words."""


def profiles(report: Identifiability) -> Figure:
    """Draw every profile that was computed: rise of -2 log likelihood over the threshold of 95 %.

    Where the curve meets 1 the interval ends; the dashed parabola is the normal approximation with the stated
    standard uncertainty. The bar below 0 is the interval that the report states.
    """
    found = report.intervals.profiles
    wide = (WIDTH - SIDE - 0.1 - (ACROSS - 1) * GAP) / ACROSS
    titles = [_title(profile, wide) for profile in found]
    figure, axes = _figure([len(title) for title in titles], wide)
    for ax, profile, title in zip(axes, found, titles, strict=True):
        own = profile.quantity.name
        _profile(ax, profile, report.intervals.std.get(own), report.intervals.of.get(own))
        ax.set(ylim=(-0.16, TOP), yticks=(0, 0.5, 1, 1.5))
        for k, line in enumerate(reversed(title)):
            ax.annotate(
                line, (0, 1), xytext=(0, 2 + 72 * LINE * k),
                xycoords="axes fraction", textcoords="offset points", color=GREY if k == 0 else BLACK,
            )  # fmt: skip
    for k, ax in enumerate(axes):
        if k % ACROSS:
            ax.tick_params("y", labelleft=False)
        else:
            label_y(ax, "rise / threshold", SIDE)
    _profile_legend(figure, found)
    return figure


def _figure(lines: Sequence[int], wide: float) -> tuple[Figure, list[Axes]]:
    """Return panels of `wide` inches, with room for so many lines above each of them."""
    from matplotlib.figure import Figure

    above = [LINE * max(lines[k : k + ACROSS]) + 0.12 for k in range(0, len(lines), ACROSS)]
    total = 2 * LINE + 0.1 + sum(above) + len(above) * (HIGH + BELOW)
    figure, axes, floor = Figure(figsize=(WIDTH, total)), [], total - 2 * LINE - 0.1
    for row, title in enumerate(above):
        floor -= title + HIGH
        for column in range(min(ACROSS, len(lines) - row * ACROSS)):
            left = SIDE + column * (wide + GAP)
            place = (left / WIDTH, floor / total, wide / WIDTH, HIGH / total)
            axes.append(figure.add_axes(place))
        floor -= BELOW
    return figure, axes


def ends_in_words(profile: Profile) -> str:
    """Return how both ends of a profile came, in a few words."""
    lower, upper = profile.lower.status, profile.upper.status
    return f"ends {lower}" if lower == upper else f"{lower} | {upper}"


def _title(profile: Profile, width: float) -> list[str]:
    """Name and unit of a quantity, at most `TITLE` lines, then how its ends came."""
    _, unit = parameter_unit(profile.quantity.unit, bare=True)
    lines = broken(typeset(profile.quantity.name) + (f" [{unit}]" if unit else ""), width, "  ")
    if len(lines) > TITLE:
        lines = [*lines[: TITLE - 1], "  … " + lines[-1].strip()]
    if profile.better is not None:
        lines.append("met a better optimum")
    return [*lines, ends_in_words(profile)]


def _profile(ax: Axes, profile: Profile, std: float | None, interval: Interval | None) -> None:
    factor, _ = parameter_unit(profile.quantity.unit, bare=True)
    distinct, first = np.unique(profile.values, return_index=True)  # a bound may be met more than once
    low, high = _range(profile, std, interval)
    values, rises = replace(profile, values=distinct, rises=profile.rises[first]).curve()
    ax.plot(factor * values, rises / profile.threshold, color=AFTER, zorder=3)
    ax.plot(
        factor * profile.values, profile.rises / profile.threshold, ls="none", marker=".", ms=3, color=AFTER
    )
    if std:
        x = np.linspace(low, high, 101)
        normal = ((x - profile.value) / (COVERAGE * std)) ** 2
        ax.plot(factor * x, normal, color=BEFORE, ls=DASHED, zorder=4)
    if interval is not None:
        ends = np.clip((interval.low, interval.high), low, high)
        ax.hlines(-0.08, *(factor * ends), color=LIGHT, lw=3.5, zorder=2, capstyle="butt")
    ax.axhline(1.0, color=BLACK, lw=0.7, ls=":", zorder=1)
    ax.axvline(factor * profile.value, color=FAINT, lw=0.6, zorder=0)
    ax.set_xlim(factor * low, factor * high)
    for side, edge, arrow in ((profile.lower, low, "<"), (profile.upper, high, ">")):
        _end(ax, side, factor, edge, arrow, profile)
    _ticks(ax, profile, factor, high - low)
    ax.tick_params("x", length=2.5, pad=2)


def _range(profile: Profile, std: float | None, interval: Interval | None) -> tuple[float, float]:
    """What of the x axis to show: both ends, the estimate and the points below the upper edge."""
    near = profile.values[profile.rises <= 0.95 * TOP * profile.threshold]
    told = [profile.lower.value, profile.upper.value]
    if interval is not None:
        told += [interval.low, interval.high]
    every = np.array([profile.value, *near, *told])
    every = every[np.isfinite(every)]
    low, high = float(every.min()), float(every.max())
    least = COVERAGE * (std or 0.0) or 1e-3 * abs(profile.value) or 1e-3
    if high - low < 1e-3 * least:
        low, high = profile.value - least, profile.value + least
    return low - MARGIN * (high - low), high + MARGIN * (high - low)


def _end(ax: Axes, side: Side, factor: float, edge: float, arrow: str, profile: Profile) -> None:
    """Mark one end: on the threshold if reached, where the bound cuts the curve, or an arrow if open."""
    if side.status in ENDS:
        rise = 1.0
        if side.status == "at bound":
            rise = float(np.interp(side.value, profile.values, profile.rises)) / profile.threshold
            ax.axvline(factor * side.value, color=GREY, lw=1.2, zorder=1)
        face = "white" if side.status == "at bound" else AFTER
        ax.plot(factor * side.value, rise, marker=ENDS[side.status], ms=4.5, color=AFTER, mfc=face, zorder=5)
    elif side.status == "open":
        inward = edge + (0.04 if arrow == "<" else -0.04) * (ax.get_xlim()[1] - ax.get_xlim()[0]) / factor
        ax.plot(factor * inward, 0.5, marker=arrow, ms=5, color=AFTER, zorder=5)


def _ticks(ax: Axes, profile: Profile, factor: float, width: float) -> None:
    """Label the ends of the interval, or the estimate where there are none."""
    ends = [side.value for side in (profile.lower, profile.upper) if np.isfinite(side.value)]
    apart = not ends or min(abs(end - profile.value) for end in ends) > 0.45 * width
    if len(ends) < 2 and apart:
        ends.append(profile.value)
    places = sorted(dict.fromkeys(ends))
    if len(places) > 1 and places[-1] - places[0] < 0.3 * width:
        places = [profile.value]
    half = 0.5 * factor * width
    ax.set_xticks([factor * v for v in places], [digits(factor * v, half) for v in places])


def _profile_legend(figure: Figure, found: Sequence[Profile]) -> None:
    sides = {side.status for profile in found for side in (profile.lower, profile.upper)}
    rises = sorted({f"{profile.threshold:.3g}" for profile in found}, key=float)
    threshold = rises[0] if len(rises) == 1 else f"{rises[0]} to {rises[-1]}"
    handles = [
        key("profile of −2 log likelihood", color=AFTER, marker=".", ms=3),
        key("normal approximation", color=BEFORE, ls=DASHED),
        key(f"95 %: a rise of {threshold}", color=BLACK, lw=0.7, ls=":"),
        key("interval reported", color=LIGHT, lw=3.5),
    ]
    for status, marker, face in (("reached", "o", AFTER), ("at bound", "s", "white"), ("open", ">", AFTER)):
        if status in sides:
            handles.append(key(f"end: {status}", ls="none", marker=marker, ms=4.5, color=AFTER, mfc=face))
    legend(figure, handles, "upper left", ncols=4, columnspacing=1.4)
