"""How a parameter differs between the devices of a fleet: its histogram, and its course."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hallsym.errors import InputError
from hallsym.fleets import Fleet, Spread
from hallsym.fleets.row import VALUE
from hallsym.report import picture as p
from hallsym.report.words import number
from hallsym.units import parameter_unit

CAPTION = (
    "Left: good devices by their value, without outlying ones, and the normal distribution of the spread "
    "between devices and the uncertainty of one fit. Right: their values in the order of the rows, with the "
    "mean and two standard deviations of that distribution; a cross is an outlying device."
)


def distributions(fleet: Fleet) -> p.Picture:
    """Return the histogram of every parameter and beside it its course."""
    if not fleet.spreads:
        raise InputError("No parameter has a spread to draw: three good devices at least must determine it.")
    panels = [panel for spread in fleet.spreads for panel in _of(fleet, spread)]
    return p.Picture(panels, across=2, words=CAPTION)


def _of(fleet: Fleet, spread: Spread) -> tuple[p.Panel, p.Panel]:
    factor, unit = parameter_unit(spread.unit)
    good = fleet.good
    values, order = factor * fleet.column(VALUE + spread.name)[good], np.flatnonzero(good)
    known = np.isfinite(values)
    outlying = np.isin(np.array(fleet.devices)[good], list(spread.outlying))[known]
    values, order = values[known], order[known]
    mean, width = factor * spread.mean, factor * float(np.hypot(spread.std, spread.typical_std))
    what = f"{spread.name} [{unit}]"
    says = f"{spread.name} of {len(values)} devices: {number(mean, 4)} +- {number(width, 2)} {unit} (1 sigma)"
    first, last = -1.0, float(len(fleet.rows))
    course = [
        p.boxes(first, last, mean - 2 * width, mean + 2 * width, p.Look(p.GRID, p.GRID, width=0)),
        p.level(mean, p.GREY),
        p.points(order[~outlying], values[~outlying], replace(p.AFTER, size=2.5)),
        p.points(order[outlying], values[outlying], p.Look(p.ORANGE, marker="x", size=7.0)),
    ]
    right = p.Panel(p.Axis("device", first, last), p.Axis(what), course, says=says)
    return _histogram(values[~outlying], mean, width, what, says), right


def _histogram(values: np.ndarray, mean: float, width: float, what: str, says: str) -> p.Panel:
    """Return how many devices have which value, and how many the normal distribution expects."""
    count, edges = np.histogram(values, bins="auto")
    bars = p.boxes(edges[:-1], edges[1:], 0.0, count, p.Look(p.PAPER, p.PALE_BLUE, width=0.5))
    if not width > 0:
        return p.Panel(p.Axis(what), p.Axis("devices", low=0.0), [bars], says=says)
    at = np.linspace(min(edges[0], mean - 3 * width), max(edges[-1], mean + 3 * width), 200)
    bell = np.exp(-0.5 * ((at - mean) / width) ** 2) / (width * np.sqrt(2 * np.pi))
    normal = p.line(at, len(values) * (edges[1] - edges[0]) * bell, p.Look(p.INK))
    return p.Panel(p.Axis(what), p.Axis("devices", low=0.0), [bars, normal], says=says)
