"""Pictures of sorted sensors: gains in their bins, drift of the bench, errors of the sets chosen."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hallsym.report.figures.saving import Place, save_figures
from hallsym.report.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    DASHES,
    FAINT,
    GREEN,
    key,
    label_x,
    label_y,
    legend,
    log_axis,
    panels,
)
from hallsym.report.words import thinned
from hallsym.units import fitting, typeset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hallsym.sorting import Matching, Sorting

HEIGHT = 2.2
MARKS = 4000
"""Readings of the reference sensor that are drawn as dots."""


def gains(found: Sorting) -> Figure:
    """Draw how many sensors each bin holds, and how many of them are expected to belong to another."""
    from matplotlib.patches import Patch

    figure, axes = panels(1, 1, HEIGHT, top=0.3, bottom=0.42)
    ax = axes[0, 0]
    labels = np.array(list(found.bins))
    counts = np.array(list(found.bins.values()))
    wrong = np.array([found.wrong[found.bin == k].sum() for k in labels])
    width = 100 * found.width
    ax.bar(labels * width, counts, 0.92 * width, color=AFTER, zorder=2)
    ax.bar(labels * width, wrong, 0.92 * width, color=BEFORE, zorder=3)
    label_y(ax, "sensors")
    label_x(ax, "gain beside the nominal one [%]")
    entries = [Patch(color=AFTER, label="sensors"), Patch(color=BEFORE, label="expected in another bin")]
    legend(figure, entries, "upper left", ncols=2)
    return figure


def drift(found: Sorting) -> Figure:
    """Draw the reference sensor's gain over time and the drift behind it."""
    d = found.drift
    figure, axes = panels(1, 1, HEIGHT, top=0.3, bottom=0.42)
    ax = axes[0, 0]
    time = d.time / 3600 if d.timed else d.time
    if d.read is not None:
        at = np.array(thinned(len(time), MARKS))
        ax.plot(time[at], 100 * (d.read[at] - 1), ".", color=FAINT, ms=2, zorder=2)
    ax.plot(time, 100 * (d.value - 1), color=AFTER, zorder=3)
    label_y(ax, "change [%]")
    label_x(ax, "time [h]" if d.timed else "measurement")
    dots = key("reference sensor, as read", color=FAINT, marker=".", ls="")
    legend(figure, [dots, key("drift taken out", color=AFTER)], "upper left", ncols=2)
    return figure


def sets(found: Matching) -> Figure:
    """Draw the share of sets with less error than x, the uncertainty of their gains included, by way."""
    figure, axes = panels(1, 1, HEIGHT, top=0.3, bottom=0.42)
    ax = axes[0, 0]
    ways = [way for way in found.ways if len(way.sets)]
    factor, unit = fitting(found.unit, max(way.overall for way in ways))
    for way, color, dash in zip(ways, (AFTER, GREEN, BEFORE), DASHES, strict=False):
        rms = np.sort(np.hypot(way.rms, found.floor)) * factor
        ax.plot(rms, 100 * (np.arange(len(rms)) + 1) / len(rms), color=color, ls=dash, zorder=3)
    shown = np.concatenate([np.hypot(way.rms, found.floor) for way in ways]) * factor
    floor = found.floor * factor
    log_axis(ax, "x", np.r_[shown[shown > 1e-3 * shown.max()], floor if floor > 0 else []])
    if floor > 0:
        ax.axvline(floor, color=BLACK, lw=0.6, ls=":")
    label_y(ax, "sets below [%]")
    label_x(ax, f"expected rms error of a set [{typeset(unit)}]")
    entries = [
        key(way.name, color=c, ls=d) for way, c, d in zip(ways, (AFTER, GREEN, BEFORE), DASHES, strict=False)
    ]
    legend(
        figure,
        [*entries, key("from the uncertainty of the gains", color=BLACK, lw=0.6, ls=":")],
        "upper left",
        ncols=4,
    )
    return figure


def save_sorting(found: Sorting, matching: Matching | None, folder: str | Path | Place) -> list[Path]:
    """Save the pictures into `folder` (made if missing) and return the files written."""
    draw = {"sorting_gains": partial(gains, found), "sorting_drift": partial(drift, found)}
    if matching is not None:
        draw["sorting_sets"] = partial(sets, matching)
    return save_figures(draw, folder)
