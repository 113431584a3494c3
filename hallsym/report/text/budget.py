"""Budgets and their confirmation as a person reads them: nm, um, urad, deg, per cent."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hallsym.report.tables import grid
from hallsym.report.words import short
from hallsym.trajectory import Curve
from hallsym.uncertainty import Budget, Comparison, Recorded, Source
from hallsym.units import UNITS, fitting, readable, reading_unit

_SMALL = 5e-5
"""Sources with a smaller share are one line."""


def budget_text(budget: Budget, shown: str | None = None) -> str:
    """Return the table of a budget, largest share first; `shown`: the unit of the result for reading."""
    if shown is None:
        factor, unit = fitting(budget.unit, budget.expanded, turns=budget.turns)
    else:
        factor, unit = (1 / UNITS[shown].factor if shown in UNITS else fitting("1", 1e-6)[0]), shown
    head = ["source", "distribution", "std uncertainty", "sensitivity", f"u [{unit}]", "share [%]"]
    ranked = budget.ranked()
    small = [source for source, share in ranked if abs(share) < _SMALL]
    small = small if len(small) > 1 else []
    rows = [head, *(_row(s, share, budget.unit, factor, unit) for s, share in ranked if s not in small)]
    if small:
        rows.append([f"other {len(small)} sources", "", "", "", "", f"<{100 * _SMALL * len(small):.2f}"])
    dof = budget.degrees_of_freedom
    level = "" if budget.level is None else f", {100 * budget.level:g} %"
    freedom = "" if np.isinf(dof) else f"; {dof:.0f} effective degrees of freedom"
    value = ""
    if budget.value is not None:
        size, name = fitting(budget.unit, budget.value or budget.expanded, turns=budget.turns)
        value = f" = {short(budget.value * size)} {name}"
    return "\n".join(
        [
            f"{budget.quantity}{value}",
            grid(rows, left=2),
            f"combined standard uncertainty u = {budget.std * factor:.4g} {unit} (1 sigma){freedom}",
            f"expanded uncertainty U = {budget.expanded * factor:.4g} {unit} "
            f"(k = {budget.factor:.3g}{level})",
        ]
    )


def _row(source: Source, share: float, result: str, factor: float, unit: str) -> list[str]:
    own, name = fitting("1", source.std) if source.unit == "1" else reading_unit(source.unit)
    own, name = (factor, unit) if source.unit == result else (own, name)
    slope = short(source.sensitivity * factor / own)
    per = "" if name == unit else f" {unit}/{f'({name})' if '/' in name else name}"
    return [
        source.name,
        source.distribution,
        f"{short(source.std * own)} {name}",
        slope + per,
        short(abs(source.contribution) * factor),
        f"{100 * share:.2f}" if abs(share) < 0.01 else f"{100 * share:.1f}",
    ]


def comparison_text(comparisons: Sequence[Comparison]) -> str:
    """Return what Monte Carlo says of the linear result: a line for each output."""
    head = f"Monte Carlo, {comparisons[0].trials} trials"
    rows = [[head, "u linear", "u", "unit", "interval linear", "interval", "tolerance", ""]]
    for c in comparisons:
        factor, unit = fitting(c.linear.unit, max(c.std, c.linear.std), turns=c.linear.turns)
        low, high = ((v - (c.linear.value or 0.0)) * factor for v in c.interval)
        half = c.linear.expanded * factor
        rows.append(
            [
                c.linear.quantity, short(c.linear.std * factor), short(c.std * factor), unit,
                f"-{short(half)} .. {short(half)}", f"{short(low)} .. {short(high)}",
                short(c.tolerance * factor), c.verdict,
            ]
        )  # fmt: skip
    return grid(rows)


def recorded_text(recorded: Recorded, title: str) -> str:
    """Return U over a workspace: rms, worst, and where that is."""
    rows = [[title, "unit", "rms", "worst", "at"]]
    for column, worst in recorded.worst.items():
        factor, unit, _ = readable(column, recorded.turning)
        sizes = (short(v * factor) for v in (recorded.rms[column], worst))
        rows.append([column, unit, *sizes, position_words(recorded.where[column], recorded.turning)])
    return grid(rows, left=2)


def curve_text(curve: Curve, machine: Budget, budget: Budget) -> str:
    """Return what a curve adds to the budget of a machine, and which error of a curve adds 2 %."""
    factor, unit = fitting("m", budget.expanded)
    allowed = machine.expanded * (1.02**2 - 1) ** 0.5 / machine.factor
    return (
        f"curve: {curve.method}, {curve.control_points} control points, error "
        f"{_length(curve.max_error_m or 0.0)} ({curve.error_kind or 'stated'})\n"
        f"it adds {_length(budget.expanded - machine.expanded)} to U: {budget.expanded * factor:.4g} {unit} "
        f"instead of {machine.expanded * factor:.4g} {unit} (k = {machine.factor:.3g})\n"
        f"A curve with an error of up to {_length(allowed)} adds at most 2 %."
    )


def _length(value: float) -> str:
    """A length in its own unit; below a picometre nothing is left of it."""
    if 0 < abs(value) < 1e-12:
        return "<0.001 nm"
    factor, unit = fitting("m", value)
    return f"{short(value * factor)} {unit}"


def position_words(at: Mapping[str, float], turning: Collection[str] | None = None) -> str:
    """Return `x 100 um, z 250 um`: what is not next to zero beside the others; `turning` as in `readable`."""
    least = 0.01 * max(map(abs, at.values()), default=0.0)
    parts = []
    for column, value in at.items():
        factor, unit, name = readable(column, turning)
        if abs(value) > least:
            parts.append(f"{name} {short(value * factor)} {unit}")
    return ", ".join(parts) or "rest"
