"""Units: one table, and the rule that a column's name ends with its unit."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache

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

    @property
    def symbol(self) -> str:
        """The unit as people write it: `mv` -> mV."""
        return _SYMBOLS.get(self.name, self.name)


_DEGREE = math.pi / 180
_TABLE: tuple[tuple[str, str, float], ...] = (
    ("m", "m", 1.0), ("mm", "m", 1e-3), ("um", "m", 1e-6), ("nm", "m", 1e-9), ("cm", "m", 1e-2),
    ("pm", "m", 1e-12), ("inch", "m", 0.0254),
    ("rad", "rad", 1.0), ("mrad", "rad", 1e-3), ("urad", "rad", 1e-6), ("nrad", "rad", 1e-9),
    ("deg", "rad", _DEGREE), ("mdeg", "rad", _DEGREE / 1e3), ("arcmin", "rad", _DEGREE / 60),
    ("arcsec", "rad", _DEGREE / 3600),
    ("rev", "rad", 2 * math.pi), ("grad", "rad", math.pi / 200),
    ("s", "s", 1.0), ("ms", "s", 1e-3), ("us", "s", 1e-6), ("ns", "s", 1e-9), ("min", "s", 60.0),
    ("v", "v", 1.0), ("mv", "v", 1e-3), ("uv", "v", 1e-6),
    ("a", "a", 1.0), ("ma", "a", 1e-3),
    ("t", "t", 1.0), ("mt", "t", 1e-3), ("ut", "t", 1e-6), ("gauss", "t", 1e-4),
    ("hz", "hz", 1.0), ("khz", "hz", 1e3),
    ("rad_s", "rad_s", 1.0), ("deg_s", "rad_s", _DEGREE), ("rpm", "rad_s", 2 * math.pi / 60),
    ("m_s", "m_s", 1.0), ("mm_s", "m_s", 1e-3),
    ("degc", "degc", 1.0), ("count", "count", 1.0),
)  # fmt: skip
UNITS: dict[str, Unit] = {name: Unit(name, si, factor) for name, si, factor in _TABLE}
UNITS |= {"k": Unit("k", "degc", 1.0, -273.15), "degf": Unit("degf", "degc", 5 / 9, -160 / 9)}
_SYMBOLS = {
    "v": "V", "mv": "mV", "uv": "uV", "a": "A", "ma": "mA", "t": "T", "mt": "mT", "ut": "uT", "hz": "Hz",
    "gauss": "G",
    "khz": "kHz", "rad_s": "rad/s", "deg_s": "deg/s", "m_s": "m/s", "mm_s": "mm/s", "degc": "degC", "k": "K",
    "degf": "degF",
}  # fmt: skip

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

# What hallsym's own names measure: a name that fits a row has one of its SI units.
_QUANTITIES: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"hall_[a-z0-9]+(_\d+)*", ("m", "v", "t", "count")),
    (r"(col|v)_[a-z0-9]+|hall\d+", ("v", "t", "count")),
    (r"[xyz](_ref)?", ("m",)),
    (r"r[xyz](_ref)?", ("rad",)),
    (r"angle(_ref)?", ("rad", "count")),
    (r"t", ("s",)),
    (r"speed", ("rad_s", "m_s")),
    (r"temperature", ("degc",)),
    (r"current(_[a-z0-9]+)?", ("a",)),
)


@lru_cache(maxsize=4096)
def split_unit(column: str) -> tuple[str, Unit | None]:
    """Split `x_ref_um` into its stem `x_ref` and its unit; the unit is None where none is stated.

    `hall_a` has no unit: the `a` names the probe, not amperes; in `current_a` it is amperes.
    """
    known = bool(quantity(column))
    for parts in (2, 1):
        pieces = column.rsplit("_", parts)
        suffix = "_".join(pieces[1:]).lower()
        whole = len(pieces) == parts + 1 and pieces[0] and suffix in UNITS
        if whole and (not known or UNITS[suffix].si in quantity(pieces[0])):
            return pieces[0], UNITS[suffix]
    return column, None


def quantity(stem: str) -> tuple[str, ...]:
    """Return the SI units that one of hallsym's own stems may have; empty for a foreign stem."""
    return next((units for pattern, units in _QUANTITIES if re.fullmatch(pattern, stem)), ())


def si_name(column: str) -> str:
    """Return the SI name of a column: `x_ref_um` gives `x_ref_m`; without a unit it stays."""
    stem, unit = split_unit(column)
    return f"{stem}_{unit.si}" if unit else column


@lru_cache(maxsize=4096)
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


def with_unit(text: str) -> tuple[float, str] | None:
    """Return the SI value and unit of `0.05um`, or of a plain number with ""; None for any other text."""
    match = re.fullmatch(rf"({_NUMBER})\s*([a-zµ]*)", text.strip())
    unit = UNITS.get(match[2].replace("µ", "u")) if match else None
    if not match or (match[2] and unit is None):
        return None
    value = float(match[1])
    return (value * unit.factor + unit.offset, unit.si) if unit else (value, "")


def read_quantity(text: str, what: str, si: str, example: str) -> float:
    """Return the SI value of a positive number with a unit of `si`; `what` names it in errors."""
    found = with_unit(text)
    if found is None or found[1] != si or not 0 < found[0] < math.inf:
        known = ", ".join(unit.name for unit in UNITS.values() if unit.si == si)
        raise InputError(
            f"{what} must be a positive number with its unit ({known}), such as {example}; instead received "
            f"{text!r}."
        )
    return found[0]


# -- units that people read ------------------------------------------------------------------------------

_LADDERS: dict[str, tuple[tuple[float, str], ...]] = {
    "m": ((1e9, "nm"), (1e6, "um"), (1e3, "mm"), (1.0, "m")),
    "rad": ((1e9, "nrad"), (1e6, "urad"), (1e3, "mrad"), (1.0, "rad")),
    "v": ((1e6, "uV"), (1e3, "mV"), (1.0, "V")),
    "s": ((1e3, "ms"), (1.0, "s")),
    "1": ((1e6, "ppm"), (1.0, "1")),
    "turn": ((1 / _DEGREE, "deg"),),
}
"""SI unit -> factors and units, small to large; "turn" is an angle that goes round."""
_TABLES = {"m": "um", "rad": "urad", "v": "mV", "s": "ms", "turn": "deg"}
"""The step of the ladder that tables of text use, whatever the size of the value."""
_RATES = {"degc": (1.0, "degC"), "m/s": (1e3, "mm/s"), "v/s": (1.0, "V/s"), "rad/s": (30 / math.pi, "rpm")}
_BELOW = {"um": 0.02, "urad": 0.02}
_ABOVE = {"um": 2e3, "urad": 2e4, "mm": 500.0, "mrad": 500.0, "mV": 500.0, "ms": 500.0}
"""A picture steps down where its largest value is below the one, and up where it is above the other."""
_TURNING = re.compile(r"angle\w*")
"""hallsym's own names of angles that go round, for text about a log or a record without a model."""


def si_unit(column: str) -> str:
    """Return the SI unit that a column's name ends with: `x_ref_m` -> "m"; "" where it ends with none."""
    unit = split_unit(column)[1]
    return unit.si if unit else ""


def si_symbol(column: str) -> str:
    """Return the same as it is printed: `col_0_v` -> "V"."""
    return _SYMBOLS.get(si_unit(column), si_unit(column))


def reading_unit(si: str, *, turns: bool = False) -> tuple[float, str]:
    """Return factor and unit in which tables of text show an SI unit; `turns`: an angle that goes round."""
    kind = "turn" if turns and si == "rad" else si
    steps = {unit: factor for factor, unit in _LADDERS.get(kind, ())}
    if kind in _TABLES:
        return steps[_TABLES[kind]], _TABLES[kind]
    return _RATES.get(si, (1.0, si))


def readable(column: str, periodic: Collection[str] | None = None) -> tuple[float, str, str]:
    """Return factor, unit and short name of a column: `x_ref_m` -> 1e6, "um", "x_ref".

    `periodic`: columns that go round, `Model.period`; without a model, hallsym's own names of such columns.
    """
    name, _, si = column.rpartition("_")
    return *reading_unit(si, turns=_goes_round(column, periodic)), name


def scaled(column: str, largest: float, periodic: Collection[str] | None = None) -> tuple[float, str]:
    """Return factor and unit for values of a column up to `largest`: those of text tables if near them."""
    factor, unit, _ = readable(column, periodic)
    kind = "turn" if unit == "deg" else column.rpartition("_")[2]
    ladder = _LADDERS.get(kind, ()) if kind in _TABLES else ()
    if not ladder:
        return factor, unit
    k = ladder.index((factor, unit))
    k -= 0 <= largest * factor <= _BELOW.get(unit, -1.0)
    while largest * ladder[k][0] > _ABOVE.get(ladder[k][1], math.inf):
        k += 1
    return ladder[k]


def fitting(si: str, largest: float, *, turns: bool = False) -> tuple[float, str]:
    """Return factor and the smallest unit in which values up to `largest` stay below 1000."""
    ladder = _LADDERS.get("turn" if turns and si == "rad" else si, ((1.0, si),))
    return next((step for step in ladder if abs(largest) * step[0] < 1000.0), ladder[-1])


def parameter_unit(si: str, *, bare: bool = False) -> tuple[float, str]:
    """Return factor and unit in which a parameter is shown: those of `_PARAMETERS`, others in SI.

    `bare`: nothing stands for the unit of a plain number, else "1".
    """
    if bare and si == "1":
        return 1.0, ""
    return _PARAMETERS.get(si, (1.0, si))


_PARAMETERS = {
    "rad": (1 / _DEGREE, "deg"), "m": (1e3, "mm"), "s": (1e3, "ms"), "m/s": (1e6, "um/s"),
    "m s2/m": (1e6, "um per m/s2"),
}  # fmt: skip
"""Factor and unit of parameters for reading, by their SI unit."""


def typeset(unit: str) -> str:
    """Return a unit as it is printed: `um` -> µm, `degC` -> °C."""
    return re.sub(r"^u(?=m$|rad$|V$)", "µ", unit).replace("degC", "°C")


def _goes_round(column: str, periodic: Collection[str] | None) -> bool:
    if periodic is None:
        return bool(_TURNING.fullmatch(column.rpartition("_")[0]))
    return column in periodic
