"""Picture `profiles`: how far each quantity can move before the data object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hallsym.report.figures.estimates import COVERAGE, typeset
from hallsym.report.figures.layout import PAGE, layout
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHED,
    FAINT,
    GREY,
    LIGHT,
    LINE,
    broken,
    key,
    label_y,
    legend,
)
from hallsym.report.words import digits
from hallsym.units import parameter_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hallsym.inference import Identifiability, Interval, Profile, Side

ACROSS, TOP = 4, 1.6
"""Panels in a row; upper end of the y axis, in thresholds."""
BESIDE, GAP, HIGH, BELOW = 0.5, 0.16, 0.95, 0.3  # inches
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
    found = layout().share(report.intervals.profiles)
    across = layout().across(ACROSS)
    wide = (layout().width - BESIDE - 0.1 - (across - 1) * GAP) / across
    titles = [_title(profile, wide) for profile in found]
    figure, axes = _figure([len(title) for title in titles], wide, across)
    for ax, profile, title in zip(axes, found, titles, strict=True):
        name = profile.quantity.name
        _panel(ax, profile, report.intervals.std.get(name), report.intervals.of.get(name))
        ax.set(ylim=(-0.16, TOP), yticks=(0, 0.5, 1, 1.5))
        for k, line in enumerate(reversed(title)):
            ax.annotate(
                line, (0, 1), xytext=(0, 2 + 72 * LINE * k),
                xycoords="axes fraction", textcoords="offset points", color=GREY if k == 0 else BLACK,
            )  # fmt: skip
    for k, ax in enumerate(axes):
        if k % across:
            ax.tick_params("y", labelleft=False)
        else:
            label_y(ax, "rise / threshold", BESIDE)
    _legend(figure, found)
    return figure


def _figure(lines: Sequence[int], wide: float, across: int) -> tuple[Figure, list[Axes]]:
    """Return panels of `wide` inches, `across` in a row, with room for so many lines above each of them."""
    from matplotlib.figure import Figure

    page = layout().width
    above = [LINE * max(lines[k : k + across]) + 0.12 for k in range(0, len(lines), across)]
    total = 2 * LINE + 0.1 + sum(above) + len(above) * (HIGH + BELOW)
    layout().need(PAGE, total)
    figure, axes, floor = Figure(figsize=(page, total)), [], total - 2 * LINE - 0.1
    for row, title in enumerate(above):
        floor -= title + HIGH
        for column in range(min(across, len(lines) - row * across)):
            left = BESIDE + column * (wide + GAP)
            place = (left / page, floor / total, wide / page, HIGH / total)
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


def _panel(ax: Axes, profile: Profile, std: float | None, interval: Interval | None) -> None:
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


def _legend(figure: Figure, found: Sequence[Profile]) -> None:
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
