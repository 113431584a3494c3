"""Units: one table, and the rule that a column's name ends with its unit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from hallsym.errors import InputError

Array = np.ndarray


@dataclass(frozen=True)
class Unit:
    """A unit: `SI value = factor * value + offset`, the SI value being in unit `si`."""

    name: str
    si: str
    factor: float
    offset: float = 0.0


_DEGREE = math.pi / 180
_TABLE: tuple[tuple[str, str, float], ...] = (
    ("m", "m", 1.0), ("mm", "m", 1e-3), ("um", "m", 1e-6), ("nm", "m", 1e-9),
    ("rad", "rad", 1.0), ("mrad", "rad", 1e-3), ("urad", "rad", 1e-6), ("nrad", "rad", 1e-9),
    ("deg", "rad", _DEGREE), ("mdeg", "rad", _DEGREE / 1e3), ("arcsec", "rad", _DEGREE / 3600),
    ("rev", "rad", 2 * math.pi),
    ("s", "s", 1.0), ("ms", "s", 1e-3), ("us", "s", 1e-6), ("ns", "s", 1e-9), ("min", "s", 60.0),
    ("v", "v", 1.0), ("mv", "v", 1e-3), ("uv", "v", 1e-6),
    ("a", "a", 1.0), ("ma", "a", 1e-3),
    ("t", "t", 1.0), ("mt", "t", 1e-3), ("ut", "t", 1e-6),
    ("hz", "hz", 1.0), ("khz", "hz", 1e3),
    ("rad_s", "rad_s", 1.0), ("deg_s", "rad_s", _DEGREE), ("rpm", "rad_s", 2 * math.pi / 60),
    ("m_s", "m_s", 1.0), ("mm_s", "m_s", 1e-3),
    ("degc", "degc", 1.0), ("count", "count", 1.0),
)  # fmt: skip
UNITS: dict[str, Unit] = {name: Unit(name, si, factor) for name, si, factor in _TABLE}
UNITS["k"] = Unit("k", "degc", 1.0, -273.15)

# What hallsym's own names measure: a name that fits a row has one of its SI units.
_QUANTITIES: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"hall_[a-z0-9]+(_\d+)*", ("m", "v", "t", "count")),
    (r"(col|v)_[a-z0-9]+", ("v", "t", "count")),
    (r"[xyz](_ref)?", ("m",)),
    (r"r[xyz](_ref)?", ("rad",)),
    (r"angle(_ref)?", ("rad", "count")),
    (r"t", ("s",)),
    (r"speed", ("rad_s", "m_s")),
    (r"temperature", ("degc",)),
    (r"current(_[a-z0-9]+)?", ("a",)),
)


def split_unit(column: str) -> tuple[str, Unit | None]:
    """Split `x_ref_um` into its stem `x_ref` and its unit; the unit is None where none is stated.

    `hall_a` has no unit: the `a` names the probe, not amperes.
    """
    if quantity(column):
        return column, None
    for parts in (2, 1):
        pieces = column.rsplit("_", parts)
        suffix = "_".join(pieces[1:]).lower()
        if len(pieces) == parts + 1 and pieces[0] and suffix in UNITS:
            return pieces[0], UNITS[suffix]
    return column, None


def quantity(stem: str) -> tuple[str, ...]:
    """Return the SI units that one of hallsym's own stems may have; empty for a foreign stem."""
    return next((units for pattern, units in _QUANTITIES if re.fullmatch(pattern, stem)), ())


def si_name(column: str) -> str:
    """Return the SI name of a column: `x_ref_um` gives `x_ref_m`; without a unit it stays."""
    stem, unit = split_unit(column)
    return f"{stem}_{unit.si}" if unit else column


def require_unit(column: str) -> Unit:
    """Return the unit a column's name states; refuse a name that states none or one that cannot be."""
    stem, unit = split_unit(column)
    allowed = quantity(stem)
    known = [u.name for u in UNITS.values() if not allowed or u.si in allowed]
    if unit is None:
        example = f"{stem}_{known[0] if allowed else 'um'}"
        raise InputError(
            f"Column name '{column}' must end with the unit its values are in, such as '{example}'"
            f" (known: {', '.join(known)})."
        )
    if allowed and unit.si not in allowed:
        raise InputError(
            f"Column name '{column}' must end with a unit of '{stem}' ({', '.join(known)});"
            f" instead received '{unit.name}'."
        )
    return unit


def to_si(column: str, values: Array) -> Array:
    """Convert values of a column, in the unit its name states, to SI (float64, same shape)."""
    unit = require_unit(column)
    scaled = np.asarray(values, float) * unit.factor
    return scaled + unit.offset if unit.offset else scaled


def from_si(column: str, values: Array) -> Array:
    """Convert SI values to the unit the column's name states (float64, same shape)."""
    unit = require_unit(column)
    return (np.asarray(values, float) - unit.offset) / unit.factor


ANGLES = re.compile(r"angle\w*")
"""Angles that go round are read in degrees; small ones in urad."""
READ = {"m": (1e6, "um"), "rad": (1e6, "urad"), "v": (1e3, "mV"), "s": (1e3, "ms"), "degc": (1.0, "degC")}
"""Unit of a column -> factor and unit for reading."""


def readable(column: str) -> tuple[float, str, str]:
    """Return factor, unit and short name of a column: `x_ref_m` -> 1e6, "um", "x_ref"."""
    name, _, unit = column.rpartition("_")
    if unit == "rad" and ANGLES.fullmatch(name):
        return 180 / np.pi, "deg", name
    factor, shown = READ.get(unit, (1.0, unit))
    return factor, shown, name
