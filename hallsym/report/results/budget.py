"""Budgets and their confirmation as a person reads them: nm, um, urad, deg, per cent."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.output import percent
from hallsym.report import picture as p
from hallsym.report.content import Block, Content, Heading, Section, Table
from hallsym.report.tables import attributes
from hallsym.report.words import LEVEL, each, largest, minus, name, number, scale, sized
from hallsym.trajectory import Curve
from hallsym.uncertainty import Budget, Comparison, Recorded, Source, UncertaintyMap
from hallsym.units import UNITS, fitting, readable, reading_unit, typeset

_SMALL = 5e-5
"""Sources with a smaller share are one line."""
MANY = 1000
"""Degrees of freedom above which none are printed: Student's factor is the normal one within .2 %."""


def budget_content(budget: Budget, shown: str | None = None, more: Sequence[Block | str] = ()) -> Content:
    """Return a budget: U in a sentence, then the sources; `shown`: the unit of the result for reading."""
    factor, unit = _unit(budget, shown)
    (largest, share), *_ = budget.ranked()
    answer = (
        f"{_called(budget)}: U = {number(budget.expanded * factor, 4)} {unit} ({_coverage(budget)}); the "
        f"largest source is {largest.name}, {percent(share)} of u squared."
    )
    return Content(
        f"Budget of {_called(budget)}",
        answer,
        [Section("sources", "Sources", budget_blocks(budget, shown)), Section("more", "More", more)],
        columns=_columns(budget),
        pictures={"budget": lambda log: budget_bars({budget.quantity: budget})},
    )


def position_content(
    budgets: Mapping[str, Budget], place: str, basis: str, more: Sequence[Block | str] = (), *,
    worst: Mapping[str, Budget] | None = None, grid: UncertaintyMap | None = None,
) -> Content:  # fmt: skip
    """Return the budgets of a position: U of each coordinate in a sentence, then their sources.

    `worst`: the budgets of the worst position of each coordinate, `grid`: a map of U, to draw.
    """
    pictures: dict[str, Callable[[Any], p.Picture]] = {
        "budget": lambda log: budget_bars(worst or budgets, worst=bool(worst))
    }
    if grid is not None:
        pictures["uncertainty_map"] = lambda log: uncertainty_picture(grid)
    return Content(
        "Budget of a position",
        f"{expanded(budgets, place)}; {basis}.",
        [
            *(Section(f"of_{c}", name(c), budget_blocks(b)) for c, b in budgets.items()),
            Section("more", "More", more),
        ],
        pictures=pictures,
    )


def expanded(budgets: Mapping[str, Budget], place: str) -> str:
    """Return U of each coordinate of a position as a sentence without its end."""
    sizes = []
    for budget in budgets.values():
        size = sized(budget.expanded, budget.unit, turns=budget.turns, digits=4)
        sizes.append(f"{name(budget.quantity)} {size}")
    return f"U ({_coverage(next(iter(budgets.values())))}) of the position at {place}: {', '.join(sizes)}"


def _columns(budget: Budget) -> dict[str, list[Any]]:
    """Return the sources of a budget as columns, in SI."""
    return {
        "source": [s.name for s in budget.sources],
        **attributes(budget.sources, "distribution", "std", "unit", "sensitivity"),
        "contribution": np.asarray(budget.contributions).tolist(),
        "share": np.asarray(budget.shares).tolist(),
    }


def _unit(budget: Budget, shown: str | None) -> tuple[float, str]:
    if shown is None:
        return fitting(budget.unit, budget.expanded, turns=budget.turns)
    return (1 / UNITS[shown].factor if shown in UNITS else fitting("1", 1e-6)[0]), shown


def _coverage(budget: Budget) -> str:
    return f"k = {number(budget.factor)}" + ("" if budget.level is None else f", {100 * budget.level:g} %")


def budget_blocks(budget: Budget, shown: str | None = None) -> list[Block | str]:
    """Return the sources of a budget, largest share first, and what they make together."""
    factor, unit = _unit(budget, shown)
    head = ["source", "distribution", "std uncertainty", "sensitivity", f"u [{unit}]", "share [%]"]
    ranked = budget.ranked()
    small = [source for source, share in ranked if abs(share) < _SMALL]
    small = small if len(small) > 1 else []
    rows = [_row(s, share, budget.unit, factor, unit) for s, share in ranked if s not in small]
    if small:
        rows.append([f"other {len(small)} sources", "", "", "", "", f"<{100 * _SMALL * len(small):.2f}"])
    dof = budget.degrees_of_freedom
    freedom = "" if dof > MANY else f"; {dof:.0f} effective degrees of freedom"
    value = ""
    if budget.value is not None:
        size, its = fitting(budget.unit, budget.value or budget.expanded, turns=budget.turns)
        value = f" = {number(budget.value * size)} {its}"
    return [
        *([Heading(f"{_called(budget)}{value}")] if value else []),
        Table(head, rows, f"sources of {_called(budget)}", left=2),
        f"combined standard uncertainty u = {number(budget.std * factor, 4)} {unit} (1 sigma){freedom}",
    ]


def _called(budget: Budget) -> str:
    """Return the quantity: what people call a column of a decoded position, else as it is stated."""
    return budget.quantity if budget.value is None else name(budget.quantity)


def _row(source: Source, share: float, result: str, factor: float, unit: str) -> list[str]:
    own, its = fitting("1", source.std) if source.unit == "1" else reading_unit(source.unit)
    own, its = (factor, unit) if source.unit == result else (own, its)
    slope = number(source.sensitivity * factor / own)
    per = "" if its == unit else f" {unit}/{f'({its})' if '/' in its else its}"
    return [
        source.name,
        source.distribution,
        f"{number(source.std * own)} {its}",
        slope + per,
        number(abs(source.contribution) * factor),
        f"{100 * share:.2f}" if abs(share) < 0.01 else f"{100 * share:.1f}",
    ]


def comparison_table(comparisons: Sequence[Comparison]) -> Table:
    """Return the comparison of Monte Carlo with the linear result: a line for each output."""
    trials = f"Monte Carlo, {comparisons[0].trials} trials"
    head = [trials, "u linear", "u", "unit", "interval linear", "interval", "tolerance", ""]
    rows = []
    for c in comparisons:
        factor, unit = fitting(c.linear.unit, max(c.std, c.linear.std), turns=c.linear.turns)
        low, high = ((v - (c.linear.value or 0.0)) * factor for v in c.interval)
        half = c.linear.expanded * factor
        rows.append(
            [
                c.linear.quantity, number(c.linear.std * factor), number(c.std * factor), unit,
                f"-{number(half)} .. {number(half)}", f"{number(low)} .. {number(high)}",
                number(c.tolerance * factor), c.verdict,
            ]
        )  # fmt: skip
    return Table(head, rows, "propagation of distributions beside the linear result")


def map_content(grid: UncertaintyMap) -> Content:
    """Return U over a grid: the worst of each coordinate in a sentence, then rms, worst and its place."""
    worst = each(grid.recorded.worst, grid.periodic)
    return Content(
        "Map of the uncertainty",
        f"The largest expanded uncertainty over the map is {worst}.",
        first=[recorded_table(grid.recorded, "U over the map")],
        pictures={"uncertainty_map": lambda log: uncertainty_picture(grid)},
        columns={"output": list(grid.pose)}
        | {what: list(getattr(grid.recorded, what).values()) for what in ("rms", "worst")},
    )


def recorded_table(recorded: Recorded, title: str) -> Table:
    """Return U over a workspace: rms, worst, and where that is."""
    rows = []
    for column, worst in recorded.worst.items():
        factor, unit, _ = readable(column, recorded.periodic)
        sizes = (number(v * factor) for v in (recorded.rms[column], worst))
        rows.append([column, unit, *sizes, position_words(recorded.where[column], recorded.periodic)])
    return Table([title, "unit", "rms", "worst", "at"], rows, title, left=2)


def curve_blocks(curve: Curve, machine: Budget, budget: Budget) -> list[Block | str]:
    """Return the contribution of a curve to a machine's budget, and the error of a curve that adds 2 %."""
    factor, unit = fitting("m", budget.expanded)
    allowed = machine.expanded * (1.02**2 - 1) ** 0.5 / machine.factor
    return [
        f"curve: {curve.method}, {curve.control_points} control points, error "
        f"{_length(curve.max_error_m or 0.0)} ({curve.error_kind or 'stated'})",
        f"it adds {_length(budget.expanded - machine.expanded)} to U: "
        f"{number(budget.expanded * factor, 4)} {unit} instead of "
        f"{number(machine.expanded * factor, 4)} {unit} (k = {number(machine.factor)})",
        f"A curve with an error of up to {_length(allowed)} adds at most 2 %.",
    ]


def _length(value: float) -> str:
    """A length in its own unit; below a picometre nothing is left of it."""
    return "<0.001 nm" if 0 < abs(value) < 1e-12 else sized(value, "m")


def position_words(at: Mapping[str, float], periodic: Collection[str] | None = None) -> str:
    """Return `x 100 um, Z 250 um` without values next to zero; `periodic` as in `readable`."""
    return each({c: v for c, v in at.items() if abs(v) > LEVEL}, periodic) or "rest"


# -- pictures -------------------------------------------------------------------------------------------


MOST_BARS = 12
"""Sources shown one by one; the others are one bar."""


def budget_bars(budgets: Mapping[str, Budget], *, worst: bool = False) -> p.Picture:
    """Return the share of every source in u_c squared: one row per source, one column per quantity.

    `worst`: the budgets are those of the worst position of each coordinate, which the picture then says.
    """
    labels, shares = _bars(list(budgets.values()))
    panels: list[p.Panel] = []
    for own, budget in zip(100 * shares, budgets.values(), strict=True):
        factor, unit = fitting(budget.unit, budget.expanded, turns=budget.turns)
        size = f"U = {number(budget.expanded * factor)} {typeset(unit)} (k = {number(budget.factor)})"
        rows = [
            p.Row(label, v, number(v) if abs(v) >= 0.1 else "0" if abs(v) < 1e-9 else "<0.1")
            for label, v in zip(labels, own, strict=True)
        ]
        x = p.Axis("share of u_c² [%]", min(0.0, own.min()), 1.1 * max(own.max(), 1.0))
        title = f"{_called(budget)}{', worst position' if worst else ''}\n{size}"
        panels.append(p.rows(title, x, rows))
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
    level, coverage = grid.settings.level, grid.settings.coverage
    how = f"k = {coverage:g}" if level is None else f"{100 * level:g} %"
    place = f" at {position_words(grid.fixed, grid.periodic)}" if any(grid.fixed.values()) else ""
    words = f"Expanded uncertainty U ({how}) of the decoded position{place}."
    if len(grid.axes) > 1:
        panels = _maps(grid)
        return p.Picture(panels, across=len(panels) // len(grid.pose), words=words)
    column, values = next(iter(grid.axes.items()))
    across, shown = scale(column, largest(values), grid.periodic)
    panels = []
    for coordinate, own in zip(grid.pose, grid.expanded, strict=True):
        factor, unit = scale(coordinate, largest(own), grid.periodic)
        x = p.Axis(f"{name(column)} [{shown}]", across * values[0], across * values[-1], most=8)
        y = p.Axis(f"U {name(coordinate)} [{unit}]", 0.0, 1.15 * factor * own.max())
        panels.append(p.Panel(x, y, [p.line(across * values, factor * own, p.AFTER)]))
    return p.Picture(panels, across=1, words=words)


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
        for j, value in enumerate(slices):
            layers = p.tiles(x, y, _full(factor * U[:, :, j].T, low, high), 1.0)
            first = coordinate == grid.pose[0]
            title = _slice_words(third, value, largest(slices), grid.periodic) if first else ""
            panels.append(p.Panel(x_axis, y_axis, layers, title, height=115.0, grid=False))
        steps = np.linspace(low, high, 24)
        key = p.tiles([0.0, 1.0], steps, _full(0.5 * (steps[1:] + steps[:-1]), low, high)[:, None], 1.0)
        none, sizes = p.Axis(low=0.0, high=1.0, names=()), p.Axis(f"U {name(coordinate)} [{unit}]", low, high)
        panels.append(p.Panel(none, sizes, key, height=115.0, share=0.08, grid=False))
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
