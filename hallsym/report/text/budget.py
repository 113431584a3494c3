"""Budgets and their confirmation as a person reads them: nm, um, urad, deg, per cent."""

from collections.abc import Mapping, Sequence

import numpy as np

from hallsym.report.tables import grid
from hallsym.uncertainty.gum import Budget, Source
from hallsym.uncertainty.monte_carlo import Comparison
from hallsym.uncertainty.position import Recorded
from hallsym.units import UNITS, readable

_READ = {
    "m": ((1e9, "nm"), (1e6, "um"), (1e3, "mm"), (1.0, "m")),
    "rad": ((1e9, "nrad"), (1e6, "urad"), (1e3, "mrad"), (1.0, "rad")),
    "v": ((1e6, "uV"), (1e3, "mV"), (1.0, "V")),
    "1": ((1e6, "ppm"), (1.0, "1")),
}
_ANGLE = ((1e3 * 180 / np.pi, "mdeg"), (180 / np.pi, "deg"))
_SMALL = 5e-5
"""Sources with a smaller share are one line."""
_MOST = 1000.0
"""Values of this and above are read in the next larger unit."""


def unit_for(unit: str, largest: float) -> tuple[float, str]:
    """Return factor and unit in which values up to `largest` of an SI unit are read."""
    known = _READ.get(unit, ((1.0, unit),))
    return next(((f, name) for f, name in known if abs(largest) * f < _MOST), known[-1])


def unit_of(quantity: str, unit: str, largest: float) -> tuple[float, str]:
    """Return the same for a named quantity: an angle that goes round is read in degrees."""
    if readable(quantity)[1] == "deg":
        return next(((f, name) for f, name in _ANGLE if abs(largest) * f < _MOST), _ANGLE[-1])
    return unit_for(unit, largest)


def budget_text(budget: Budget, shown: str | None = None) -> str:
    """Return the table of a budget, largest share first; `shown`: the unit of the result for reading."""
    if shown is None:
        factor, unit = unit_of(budget.quantity, budget.unit, budget.expanded)
    else:
        factor, unit = (1 / UNITS[shown].factor if shown in UNITS else unit_for("1", 1e-6)[0]), shown
    head = ["source", "distribution", "std uncertainty", "sensitivity", f"u [{unit}]", "share [%]"]
    ranked = budget.ranked()
    small = [source for source, share in ranked if abs(share) < _SMALL]
    if len(small) < 2:
        small = []
    rows = [head, *(_row(s, share, budget.unit, factor, unit) for s, share in ranked if s not in small)]
    if small:
        rows.append([f"other {len(small)} sources", "", "", "", "", f"<{100 * _SMALL * len(small):.2f}"])
    dof = budget.degrees_of_freedom
    level = "" if budget.level is None else f", {100 * budget.level:g} %"
    freedom = "" if np.isinf(dof) else f"; {dof:.0f} effective degrees of freedom"
    value = "" if budget.value is None else f" = {_three(budget.value * factor)} {unit}"
    return "\n".join(
        [
            f"{budget.quantity}{value}",
            grid(rows, left=2),
            f"combined standard uncertainty u = {budget.std * factor:.4g} {unit}{freedom}",
            f"expanded uncertainty U = {budget.expanded * factor:.4g} {unit} "
            f"(k = {budget.factor:.3g}{level})",
        ]
    )


def _row(source: Source, share: float, result: str, factor: float, unit: str) -> list[str]:
    own, name = (factor, unit) if source.unit == result else _own(source)
    slope = _three(source.sensitivity * factor / own)
    per = "" if name == unit else f" {unit}/{f'({name})' if '/' in name else name}"
    return [
        source.name,
        source.distribution,
        f"{_three(source.std * own)} {name}",
        slope + per,
        _three(abs(source.contribution) * factor),
        f"{100 * share:.2f}" if abs(share) < 0.01 else f"{100 * share:.1f}",
    ]


def _own(source: Source) -> tuple[float, str]:
    """Unit of a source that has another than the result: um, urad, ppm."""
    if source.unit == "1":
        return unit_for("1", source.std)
    factor, name, _ = readable(f"_{source.unit}")
    return factor, name


def comparison_text(comparisons: Sequence[Comparison]) -> str:
    """Return what Monte Carlo says of the linear result: one table and one sentence for each output."""
    rows = [["Monte Carlo", "u linear", "u", "unit", "interval linear", "interval", "tolerance", ""]]
    for c in comparisons:
        factor, unit = unit_of(c.linear.quantity, c.linear.unit, max(c.std, c.linear.std))
        low, high = ((v - c.linear.value) * factor for v in c.interval)
        half = c.linear.factor * c.linear.std * factor
        rows.append(
            [
                c.linear.quantity, _three(c.linear.std * factor), _three(c.std * factor), unit,
                f"-{_three(half)} .. {_three(half)}", f"{_three(low)} .. {_three(high)}",
                _three(c.tolerance * factor), c.verdict,
            ]
        )  # fmt: skip
    return "\n".join([grid(rows), *map(comparison_sentence, comparisons)])


def comparison_sentence(c: Comparison) -> str:
    """Return the verdict on one output in words."""
    percent, ratio = f"{100 * c.level:g} %", c.width_ratio
    trials = f"{c.trials} trials"
    name = c.linear.quantity
    if c.verdict == "confirmed":
        return f"{name}: confirmed by {trials}; the {percent} interval agrees within {_size(c, c.tolerance)}."
    off = max(map(abs, c.differences))
    if c.verdict == "undecided":
        return (
            f"{name}: undecided after {trials}; the ends of the {percent} interval differ by {_size(c, off)} "
            f"and are themselves known to {_size(c, 2 * max(c.scatter[2:]))} only: ask for more trials."
        )
    low, high = c.differences  # linear minus Monte Carlo
    if abs(low + high) > 0.5 * (abs(low) + abs(high)):
        how = f"is off to one side: its ends by {_size(c, low)} and {_size(c, high)}"
    else:
        how = f"is {100 * abs(ratio - 1):.2g} % too {'wide' if ratio > 1 else 'narrow'}"
    advice = "which is on the safe side" if low < 0 < high else "so use that of Monte Carlo"
    return f"{name}: not confirmed by {trials}; the linear {percent} interval {how}, {advice}."


def _size(c: Comparison, value: float) -> str:
    factor, unit = unit_of(c.linear.quantity, c.linear.unit, max(c.std, c.linear.std))
    return f"{_three(value * factor)} {unit}"


def recorded_text(recorded: Recorded, title: str) -> str:
    """Return U over a workspace: rms, worst, and where that is."""
    rows = [[title, "unit", "rms", "worst", "at"]]
    for column, worst in recorded.worst.items():
        factor, unit, _ = readable(column)
        rows.append(
            [column, unit, _three(recorded.rms[column] * factor), _three(worst * factor),
             position_words(recorded.where[column])]
        )  # fmt: skip
    return grid(rows, left=2)


def position_words(at: Mapping[str, float]) -> str:
    """`x 100 um, z 250 um`: what is not next to zero beside the others."""
    least = 0.01 * max(map(abs, at.values()), default=0.0)
    parts = [
        f"{name} {_three(v * f)} {unit}"
        for c, v in at.items()
        for f, unit, name in [readable(c)]
        if abs(v) > least
    ]
    return ", ".join(parts) or "rest"


def _three(value: float) -> str:
    return "0" if value == 0 else f"{value:.3g}" if abs(value) < 1e3 else f"{value:.4g}"
