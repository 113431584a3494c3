"""Which units a column may hold instead of the one it is said to hold."""

from __future__ import annotations

import math
from typing import Any

from hallsym.units import UNITS, split_unit

DEGREE = math.pi / 180
TWICE = (1e3, 1e6, float(f"{1 / DEGREE:.12g}"))
"""Factors of conversions that are done twice by mistake: of mm and um (mrad and urad), and of degrees."""


def scale_of(table: Any, column: str) -> float:
    """Return what the file's numbers of an SI column are multiplied by."""
    bindings = getattr(table, "bindings", {})
    return abs(bindings[column].factor) if column in bindings else 1.0


def other_units(table: Any, column: str) -> dict[float, str]:
    """Return the units that a column may hold instead: how much too large its values then are -> unit.

    Only powers of ten and 180/pi: any other factor is a scale, which a fit and `hallsym diagnose` deal with.
    Values that are too small because they were converted twice are in no unit: "".
    """
    unit = split_unit(column)[1]
    if unit is None:
        return {}
    stated = scale_of(table, column)
    alike = [u for u in UNITS.values() if u.si == unit.si and not u.offset and _plain(u.factor)]
    found = {float(f"{stated / u.factor:.12g}"): u.name for u in alike if not math.isclose(u.factor, stated)}
    twice = [1 / f for f in found if f in TWICE and 1 / f not in found]
    return found | dict.fromkeys(twice, "")


def option(table: Any, column: str, unit: str) -> str:
    """Return the option that states the unit of a column."""
    return f"--column {split_unit(column)[0]}_{unit}={table.source_name(column)}"


def _plain(factor: float) -> bool:
    decades = (math.log10(factor), math.log10(factor / DEGREE))
    return any(abs(d - round(d)) < 1e-9 for d in decades)
