"""Report of a fleet: verdicts, the spread of every parameter, devices that differ, groups."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hallsym.errors import InputError, counted, few
from hallsym.fleets import Fleet, Spread
from hallsym.fleets.row import VALUE, VERDICTS
from hallsym.report import picture as p
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.tables import concise
from hallsym.report.words import number
from hallsym.units import parameter_unit

MOST_LISTED = 20
"""Devices to look at that are listed; all stand in the table that is saved, and in the page's file."""
SPREAD = (
    "parameter", "mean (1 sigma)", "spread (1 sigma)", "spread, 95 % interval", "1 sigma of one fit", "unit",
    "devices", "outlying",
)  # fmt: skip


def fleet_content(fleet: Fleet) -> Content:
    """Return the report of a fleet."""
    model = f" of {fleet.model.name}" if fleet.model else ""
    count, good = len(fleet.rows), int(fleet.good.sum())
    verdicts = [[v, str(len(devices)), VERDICTS[v]] for v, devices in fleet.verdicts.items()]
    devices: dict[str, list[str]] = {}
    for device, why in fleet.outlying.items():
        devices.setdefault(why, []).append(device)
    listed, differing = [(few(names), why) for why, names in devices.items()], len(fleet.outlying)
    rest = sum(map(len, [*devices.values()][MOST_LISTED:]))
    outlying: list[Block | str] = [
        Table([f"{counted(differing, 'device')} to look at", "why"], listed[:MOST_LISTED], wordy=(1,),
              caption="devices that differ from the others or could not be fitted"),
        *([f"and {rest} more, in the table that -o writes"] if rest > 0 else []),
    ]  # fmt: skip
    groups = [[key, str(len(names)), few(names)] for key, names in fleet.groups.items()]
    groups = groups if any(row.get("diagnosis") for row in fleet.rows) else []
    also = f", {differing} to look at" if listed else ""
    return Content(
        f"Fleet of {counted(count, 'device')}{model}",
        f"{good} of {counted(count, 'device')}{model} {'is' if count == 1 else 'are'} good{also}.",
        [
            Section("spread", "Spread of the parameters", [Table(SPREAD, _spreads(fleet), "by parameter")]),
            Section("outlying", "Devices to look at", outlying),
            Section(
                "groups", "Devices of the same diagnosis",
                [Table(["devices of the same diagnosis", "devices", "which"], groups, "groups", wordy=(2,))],
            ),
        ],
        [Table(["verdict", "devices", "meaning"], verdicts, "devices by verdict", wordy=(2,))],
        state="good" if good == count else "open",
        columns=fleet.table(),
        pictures={"distributions": lambda log: distributions(fleet)},
        seconds=fleet.seconds,
    )  # fmt: skip


def _spreads(fleet: Fleet) -> list[list[str]]:
    """Return mean, spread between devices with its interval and uncertainty of one fit of every parameter."""
    rows = []
    for s in fleet.spreads:
        factor, unit = parameter_unit(s.unit)
        low, high = (number(factor * v) for v in s.interval)
        rows.append([
            s.name, concise(factor * s.mean, factor * s.mean_std), number(factor * s.std),
            f"{low} .. {high}", number(factor * s.typical_std, 2), unit, str(s.devices), str(len(s.outlying)),
        ])  # fmt: skip
    return rows


# -- picture: how a parameter differs between devices ---------------------------------------------------


CAPTION = (
    "Of each parameter first the good devices by their value, without outlying ones, and the normal "
    "distribution of the spread between devices and the uncertainty of one fit; then their values in the "
    "order of the rows, with the mean and two standard deviations of that distribution (cross: outlying)."
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
