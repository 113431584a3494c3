"""How a parameter differs between the devices of a fleet: its histogram, and its course."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hallsym.errors import InputError
from hallsym.fleets import Fleet, Spread
from hallsym.fleets.row import VALUE
from hallsym.report.figures.style import AFTER, BEFORE, BLACK, GREY, SHADE
from hallsym.units import parameter_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CAPTION = (
    "Left: good devices by their value, and the normal distribution of the spread between devices and the "
    "uncertainty of one fit. Right: their values in the order of the rows, with the mean and two standard "
    "deviations of that distribution; a cross is an outlying device."
)
SIZE = 9.0, 2.6
"""Width and height [inches] of the pictures of one parameter."""


def distributions(fleet: Fleet) -> Figure:
    """Return the histogram of every parameter and its course, a line of a figure each."""
    if not fleet.spreads:
        raise InputError("No parameter has a spread to draw: three good devices at least must determine it.")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SIZE[0], SIZE[1] * len(fleet.spreads)), layout="constrained")
    lines = figure.subplots(len(fleet.spreads), 2, squeeze=False)
    for axes, spread in zip(lines, fleet.spreads, strict=True):
        _draw(axes, fleet, spread)
    return figure


def _draw(axes: np.ndarray, fleet: Fleet, spread: Spread) -> None:
    factor, unit = parameter_unit(spread.unit)
    good = fleet.good
    values, order = factor * fleet.column(VALUE + spread.name)[good], np.flatnonzero(good)
    known = np.isfinite(values)
    outlying = np.isin(np.array(fleet.devices)[good], list(spread.outlying))[known]
    values, order = values[known], order[known]
    mean, width = factor * spread.mean, factor * float(np.hypot(spread.std, spread.typical_std))
    what = f"{spread.name} [{unit}]"
    _histogram(axes[0], values, mean, width)
    axes[0].set(xlabel=what, ylabel="devices")
    axes[1].axhspan(mean - 2 * width, mean + 2 * width, color=SHADE, linewidth=0)
    axes[1].axhline(mean, color=GREY, linewidth=0.8)
    axes[1].plot(order[~outlying], values[~outlying], ".", markersize=5, color=AFTER)
    axes[1].plot(order[outlying], values[outlying], "x", markersize=7, color=BEFORE)
    axes[1].set(xlabel="device", ylabel=what)
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)


def _histogram(axes: Axes, values: np.ndarray, mean: float, width: float) -> None:
    """Draw how many devices have which value, and how many the normal distribution expects."""
    from matplotlib.ticker import MaxNLocator

    _, edges, _ = axes.hist(values, bins="auto", color=AFTER, alpha=0.45, edgecolor="white", linewidth=0.5)
    if width > 0:
        low, high = min(edges[0], mean - 3 * width), max(edges[-1], mean + 3 * width)
        at = np.linspace(low, high, 200)
        bell = np.exp(-0.5 * ((at - mean) / width) ** 2) / (width * np.sqrt(2 * np.pi))
        axes.plot(at, len(values) * (edges[1] - edges[0]) * bell, color=BLACK, linewidth=1.0)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.xaxis.set_major_locator(MaxNLocator(6))
