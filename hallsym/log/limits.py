"""What hallsym's columns are for, and what a value of each can physically be."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from hallsym.units import UNITS, split_unit


@dataclass(frozen=True)
class Limit:
    """Columns that fit `pattern` span at most `span` and stay below `level`; else their unit is another.

    `instead` holds the units it could be, large to small. A usual log spans less than `likely`.
    """

    pattern: str
    span: float
    what: str
    instead: tuple[str, ...]
    likely: float
    level: float = math.inf


LIMITS = (
    Limit(r"(hall_\w+|[xyz](_ref)?)_m", 1.0, "a machine travels", ("mm", "um", "nm"), 0.01, 1e3),
    Limit(r"r[xyz](_ref)?_rad", 0.5, "a machine turns", ("mrad", "urad", "nrad"), 0.01, 1e3),
    Limit(r"([xy]\d+_)?(col|row|v|hall)_\w+_v", 1e3, "a sensor puts out", ("mv", "uv"), 10.0),
    Limit(r"hall_\w+_t", 100.0, "a magnet makes", ("mt", "ut"), 3.0),
    Limit(r"current\w*_a", 1e3, "a coil carries", ("ma",), 100.0),
    Limit("t_s", 1e9, "a recording lasts", ("ms", "us", "ns"), 1e6),
    Limit(r"temperature\w*_degc", 500.0, "a machine warms", ("k",), 200.0, 200.0),
)

_FASTEST = {"m": 100.0, "rad": 1e5}
"""m/s and rad/s that no reference moves at: a thousand times a stage, a million revolutions a minute."""

_READING = re.compile(r"([xy]\d+_)?(hall|col|row|v)_\w+_(m|v|t|count)|angle_rad")
_REFERENCE = re.compile(r"([xyz]|r[xyz]|angle)_ref_(m|rad)")
_POSE = re.compile(r"(z|r[xy])_(m|rad)")


@cache
def is_reading(column: str) -> bool:
    """Say whether a column is a sensor's reading (`hall_a_m`, `col_3_v`, `v_sin_v`, `angle_rad`)."""
    return bool(_READING.fullmatch(column))


@cache
def is_reference(column: str) -> bool:
    """Say whether a column is a reference of motion (`x_ref_m`, `angle_ref_rad`)."""
    return bool(_REFERENCE.fullmatch(column))


@cache
def is_moving(column: str) -> bool:
    """Say whether a column follows the motion sample by sample: readings, references, vertical pose."""
    return is_reading(column) or is_reference(column) or bool(_POSE.fullmatch(column))


def tells(column: str, of: str) -> bool:
    """Say whether a column follows the motion that another one follows, and so tells of it."""
    return (is_reading(column) and is_reference(of)) or (is_reference(column) and is_reading(of))


def has_meaning(column: str) -> bool:
    """Say whether a column is one of a kind (`v_sin_v`, `x_ref_m`), so that it is not meant for another."""
    alone = column in ("v_sin_v", "v_cos_v", "angle_rad")
    return alone or is_reference(column) or bool(_POSE.fullmatch(column))


def limit_of(column: str) -> Limit | None:
    """Return the limit of a column's span, if there is one."""
    return next((limit for limit in LIMITS if re.fullmatch(limit.pattern, column)), None)


def fastest(column: str) -> float:
    """Return the speed, in the column's SI unit per second, that no motion has."""
    unit = split_unit(column)[1]
    return _FASTEST.get(unit.si, math.inf) if unit else math.inf


def likely_units(limit: Limit, span: float) -> Sequence[str]:
    """Return the units that would make a span possible, down to the first that makes it a usual one."""
    found = []
    for unit in limit.instead:
        spans = span * UNITS[unit].factor
        if spans <= limit.span:
            found.append(unit)
        if spans <= limit.likely:
            break
    return found or limit.instead[-1:]
