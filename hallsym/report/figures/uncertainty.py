"""Pictures of a budget, of U over the workspace, and of errors along a coordinate by cause."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from hallsym.report import picture as p
from hallsym.report.words import largest, minus, name, number, scale, setting
from hallsym.units import fitting, readable, typeset

if TYPE_CHECKING:
    from hallsym.uncertainty import Budget, ErrorModel, UncertaintyMap

MOST_BARS = 12
"""Sources shown one by one; the others are one bar."""


def budget_bars(budgets: Mapping[str, Budget], *, worst: bool = False) -> p.Picture:
    """Return the share of every source in u_c squared: one row per source, one column per quantity.

    `worst`: the budgets are those of the worst position of each coordinate, which the picture then says.
    """
    labels, shares = _bars(list(budgets.values()))
    panels: list[p.Panel] = []
    place = np.arange(len(labels))
    other = np.array([label.startswith("other ") for label in labels])
    for percent, budget in zip(100 * shares, budgets.values(), strict=True):
        words = [number(v) if abs(v) >= 0.1 else "0" if abs(v) < 1e-9 else "<0.1" for v in percent]
        low, high = min(0.0, percent.min()), 1.3 * max(percent.max(), 1.0)
        factor, unit = fitting(budget.unit, budget.expanded, turns=budget.turns)
        what = name(budget.quantity) if budget.value is not None else budget.quantity
        size = f"U = {number(budget.expanded * factor)} {typeset(unit)} (k = {number(budget.factor)})"
        layers = [
            p.boxes(0.0, np.where(own, percent, np.nan), place - 0.36, place + 0.36, look)
            for own, look in ((~other, p.AFTER), (other, p.OTHER))
        ]
        layers.append(p.text(words, np.maximum(percent, 0.0) + 0.02 * (high - low), place))
        x = p.Axis("share of u_c² [%]", low, high)
        y = p.Axis(low=len(labels) - 0.4, high=-0.6, names=() if panels else labels)
        title = f"{what}{', worst position' if worst else ''}\n{size}"
        panels.append(p.Panel(x, y, layers, title, height=12.2 * len(labels) + 7))
    return p.Picture(panels, across=len(panels))


def _bars(budgets: Sequence[Budget]) -> tuple[list[str], np.ndarray]:
    """Sources by their largest share in any budget, the small ones as one, and shares (budgets, sources)."""
    names = list(dict.fromkeys(source.name for budget in budgets for source in budget.sources))
    shares = np.zeros((len(budgets), len(names)))
    for row, budget in zip(shares, budgets, strict=True):
        for source, share in zip(budget.sources, budget.shares, strict=True):
            row[names.index(source.name)] = share
    order = np.argsort(-np.abs(shares).max(axis=0), kind="stable")
    names, shares = [names[k] for k in order], shares[:, order]
    if len(names) <= MOST_BARS:
        return names, shares
    rest = shares[:, MOST_BARS - 1 :].sum(axis=1, keepdims=True)
    kept = MOST_BARS - 1
    return [*names[:kept], f"other {len(names) - kept} sources"], np.hstack([shares[:, :kept], rest])


# -- U over the workspace ----------------------------------------------------------------------------------


def uncertainty_picture(grid: UncertaintyMap) -> p.Picture:
    """Return U over the axes of `grid`: a line over one axis; else maps over the first two.

    Maps have a row per pose coordinate and a column per value of the third axis.
    """
    fixed = setting(
        list(grid.fixed), np.array(list(grid.fixed.values())), 0.0, units=True, periodic=grid.periodic
    )
    level, coverage = grid.settings.level, grid.settings.coverage
    words = (
        f"Expanded uncertainty U ({f'k = {coverage:g}' if level is None else f'{100 * level:g} %'}) of the "
    )
    words += "decoded position" + (f" at {fixed}" if fixed != "level" else "") + "."
    if len(grid.axes) > 1:
        panels = _maps(grid)
        return p.Picture(panels, across=len(panels) // len(grid.pose), words=words)
    column, values = next(iter(grid.axes.items()))
    across, shown = scale(column, largest(values), grid.periodic)
    panels = []
    for k, (coordinate, own) in enumerate(zip(grid.pose, grid.expanded, strict=True)):
        factor, unit = scale(coordinate, largest(own), grid.periodic)
        x = p.Axis(f"{name(column)} [{shown}]", across * values[0], across * values[-1], most=8)
        y = p.Axis(f"U {name(coordinate)} [{unit}]", 0.0, 1.15 * factor * own.max())
        panels.append(
            p.Panel(_outer(x, k == len(grid.pose) - 1), y, [p.line(across * values, factor * own, p.AFTER)])
        )
    return p.Picture(panels, across=1, words=words)


def _outer(axis: p.Axis, outer: bool) -> p.Axis:
    """Return an axis that has its title and numbers only where it is the outer one of several equal ones."""
    return axis if outer else replace(axis, title="", names=())


def _maps(grid: UncertaintyMap) -> list[p.Panel]:
    (across, up), third = list(grid.axes)[:2], next(iter(list(grid.axes)[2:]), None)
    slices = grid.axes[third] if third else np.zeros(1)
    values = grid.expanded.reshape(len(grid.pose), *grid.expanded.shape[1:3], -1)
    axes = []
    for c in (across, up):
        factor, unit = scale(c, largest(grid.axes[c]), grid.periodic)
        places, edges = factor * grid.axes[c], factor * _edges(grid.axes[c])
        low, high = (places if len(places) > 1 else edges)[[0, -1]]
        axes.append((edges, p.Axis(f"{name(c)} [{unit}]", low, high, most=3)))
    (x, x_axis), (y, y_axis) = axes
    panels = []
    for coordinate, U in zip(grid.pose, values, strict=True):
        factor, unit = scale(coordinate, float(U.max()), grid.periodic)
        low, high = factor * U.min(), factor * U.max()
        if high - low < 1e-3 * high:  # flat: no colours made of rounding
            low, high = 0.98 * low, 1.02 * high
        last = coordinate == grid.pose[-1]
        for j, value in enumerate(slices):
            layers = p.tiles(x, y, _full(factor * U[:, :, j].T, low, high), 1.0)
            title = _slice_words(third, value, largest(slices), grid.periodic)
            panels.append(
                p.Panel(
                    _outer(x_axis, last), _outer(y_axis, j == 0), layers,
                    title if coordinate == grid.pose[0] else "", height=115.0, grid=False,
                )
            )  # fmt: skip
        steps = np.linspace(low, high, 24)
        key = p.tiles([0.0, 1.0], steps, _full(0.5 * (steps[1:] + steps[:-1]), low, high)[:, None], 1.0)
        title = f"U {name(coordinate)} [{unit}]"
        panels.append(
            p.Panel(
                p.Axis(low=0.0, high=1.0, names=()),
                p.Axis(title, low, high),
                key,
                height=115.0,
                share=0.08,
                grid=False,
            )
        )
    return panels


PALEST = 0.06
"""Strength of the colour of the least value of a map."""


def _full(values: np.ndarray, low: float, high: float) -> np.ndarray:
    return PALEST + (1 - PALEST) * (values - low) / (high - low)


def _edges(places: np.ndarray) -> np.ndarray:
    """Return the edges of cells around places: the middles between them, and as far beyond the outer ones."""
    if len(places) < 2:
        return np.array([places[0] - 0.5, places[0] + 0.5])
    middle = 0.5 * (places[1:] + places[:-1])
    return np.array([2 * places[0] - middle[0], *middle, 2 * places[-1] - middle[-1]])


def _slice_words(column: str | None, value: float, most: float, periodic: Collection[str]) -> str:
    """Return `Z = 125 µm`, to a thousandth of the largest height."""
    if column is None:
        return ""
    factor, unit = scale(column, most or 1e-4, periodic)
    step = 10.0 ** np.floor(np.log10(factor * (most or 1e-4)) - 2)
    return minus(f"{name(column)} = {number(round(factor * value / step) * step)} {unit}")


# -- errors along a coordinate -----------------------------------------------------------------------------


COLOURS = (p.BLUE, p.ORANGE, p.GREEN, p.PINK, p.INK, p.YELLOW, p.SKY)
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
"""Of causes; not equally many, so that pairs repeat late."""


def span(found: ErrorModel) -> tuple[float, float, float, str, str]:
    """Return first place, end of the range, factor, unit and name of the coordinate that moves."""
    column, at = found.coordinate, found.causes[0][2].at
    low, high = float(at[0]), float(at[0] + (at[1] - at[0]) * len(at))
    factor, unit, name = readable(column, found.model.period)
    if unit != "deg":
        factor, unit = fitting(column.rpartition("_")[2], max(abs(low), abs(high)))
    return low, high, factor, unit, name


def errors_along(found: ErrorModel) -> p.Picture:
    """Return the error of each coordinate of the pose over the one that moves, a line per cause."""
    pose, causes = found.model.pose, found.causes
    styles = zip(cycle(COLOURS), cycle(DASHES), causes, strict=False)
    looks = [p.Look(c, dash=dash) for c, dash, _ in styles]
    if len(causes) > 1:
        looks[-1] = p.Look(p.INK, width=1.4)  # all together
    *_, factor, unit, moving = span(found)
    panels = []
    for k, column in enumerate(pose):
        y_factor, y_unit = scale(
            column, largest(np.array([e.error[k] for *_, e in causes])), found.model.period
        )
        layers: list[p.Layer] = [p.level(0.0, p.Look(p.FAINT, width=0.6))]
        layers += [
            p.line(factor * e.at, y_factor * e.error[k], look, cause)
            for (cause, *_, e), look in zip(causes, looks, strict=True)
        ]
        at = factor * causes[0][-1].at
        x = p.Axis(f"{moving} [{typeset(unit)}]", at.min(), at.max(), most=8)
        y = p.Axis(f"error of {name(column)} [{y_unit}]")
        panels.append(p.Panel(_outer(x, k == len(pose) - 1), y, layers))
    return p.Picture(panels, across=1)
