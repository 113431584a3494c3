"""Budgets and their confirmation as a person reads them: nm, um, urad, deg, per cent."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.output import percent
from hallsym.report.content import Block, Content, Heading, Section, Table
from hallsym.report.figures.uncertainty import budget_bars
from hallsym.report.words import name, number, sized
from hallsym.trajectory import Curve
from hallsym.uncertainty import Budget, Comparison, Recorded, Source
from hallsym.units import UNITS, fitting, readable, reading_unit

_SMALL = 5e-5
"""Sources with a smaller share are one line."""


def budget_content(budget: Budget, shown: str | None = None, more: Sequence[Block | str] = ()) -> Content:
    """Return a budget: U in a sentence, then the sources; `shown`: the unit of the result for reading."""
    factor, unit = _unit(budget, shown)
    (largest, share), *_ = budget.ranked()
    answer = (
        f"{budget.quantity}: U = {number(budget.expanded * factor, 4)} {unit} ({_coverage(budget)}), "
        f"of which {largest.name} makes {percent(share)}."
    )
    return Content(
        f"Budget of {budget.quantity}",
        answer,
        [Section("sources", "Sources", budget_blocks(budget, shown)), Section("more", "More", more)],
        columns=_columns(budget),
        picture=lambda log: budget_bars({budget.quantity: budget}),
    )


def position_content(
    budgets: Mapping[str, Budget], place: str, basis: str, more: Sequence[Block | str] = ()
) -> Content:
    """Return the budgets of a position: U of each coordinate in a sentence, then their sources."""
    return Content(
        "Budget of a position",
        f"{expanded(budgets, place)}; {basis}.",
        [
            *(Section(f"of_{c}", name(c), budget_blocks(b)) for c, b in budgets.items()),
            Section("more", "More", more),
        ],
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
        "distribution": [s.distribution for s in budget.sources],
        "std": [s.std for s in budget.sources],
        "unit": [s.unit for s in budget.sources],
        "sensitivity": [s.sensitivity for s in budget.sources],
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
    freedom = "" if np.isinf(dof) else f"; {dof:.0f} effective degrees of freedom"
    value = ""
    if budget.value is not None:
        size, its = fitting(budget.unit, budget.value or budget.expanded, turns=budget.turns)
        value = f" = {number(budget.value * size)} {its}"
    return [
        *([Heading(f"{budget.quantity}{value}")] if value else []),
        Table(head, rows, f"sources of {budget.quantity}", left=2),
        f"combined standard uncertainty u = {number(budget.std * factor, 4)} {unit} (1 sigma){freedom}",
        f"expanded uncertainty U = {number(budget.expanded * factor, 4)} {unit} ({_coverage(budget)})",
    ]


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
    """Return `x 100 um, z 250 um` without values next to zero; `periodic` as in `readable`."""
    least = 0.01 * max(map(abs, at.values()), default=0.0)
    parts = []
    for column, value in at.items():
        factor, unit, _ = readable(column, periodic)
        if abs(value) > least:
            parts.append(f"{name(column)} {number(value * factor)} {unit}")
    return ", ".join(parts) or "rest"
