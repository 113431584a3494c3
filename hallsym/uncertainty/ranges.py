"""Tolerances: range and distribution of each parameter about its nominal value."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest, require
from hallsym.files import MOST_NUMBER
from hallsym.model import Model, Parameter
from hallsym.toml import Table, positive
from hallsym.uncertainty.gum import DIVISORS, QUANTILES
from hallsym.units import UNITS

EXACT, USUAL = "exact", "usual"
OTHERS = ("bounds", EXACT)


@dataclass(frozen=True)
class Tolerance:
    """Range of one parameter, in its SI unit.

    `width`: half width (rectangular, triangular, arcsine) or 1 sigma (normal); 0 for an exact parameter.
    `centre` is the nominal value unless the range was given by its limits. `source`: "bounds" of the model,
    "usual" of the family, or "given".
    """

    name: str
    unit: str
    nominal: float
    centre: float
    width: float
    distribution: str = "rectangular"
    source: str = "given"

    @property
    def std(self) -> float:
        """Standard uncertainty of the parameter."""
        return self.width / DIVISORS.get(self.distribution, 1.0)

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the values at probabilities `u` in [0, 1): the inverse of the distribution function."""
        return self.centre + self.width * QUANTILES[self.distribution](u)


def default_tolerances(model: Model) -> tuple[Tolerance, ...]:
    """Return the usual tolerances of the family; else nominal value +- half the width of its bounds.

    Table 3's intervals for H and theta lie about Table 1's values; those for eta do not (1 is outside), but
    a tolerance is a deviation from the design: its width is Table 3's, its centre the nominal value.
    A fixed parameter is exact. Raises `InputError` for infinite bounds.
    """
    out = []
    for p in model.parameters:
        usual = _usual(model, p)
        if usual is None and not np.isfinite(p.width):
            raise InputError(
                f"Parameter {p.name} of {model.name} has no finite bounds to take a tolerance from; give one."
            )
        out.append(usual or Tolerance(p.name, p.unit, p.nominal, p.nominal, p.width / 2, source="bounds"))
    return tuple(out)


def _usual(model: Model, parameter: Parameter) -> Tolerance | None:
    """Return the tolerance that the family states for a parameter; one without width stays exact."""
    if parameter.width == 0:
        return None
    keys = [parameter.name, *(f"{parameter.name}_{suffix}" for suffix in units_of(parameter) if suffix)]
    for lines in model.family.tolerances.values():
        for pattern, value in lines.items():
            key = next((k for k in keys if fnmatchcase(k, pattern)), None)
            if key is not None:
                found = _tolerance(model, key, value, f"the usual tolerances of {model.family}")
                return replace(found, source=USUAL)
    return None


def given_tolerances(
    model: Model, ranges: Mapping[str, Any], others: str = "bounds", where: str = "'ranges'"
) -> tuple[Tolerance, ...]:
    """Return one tolerance per parameter from `{"H1x_um": 20, "theta_A_deg": {"std": 0.1}}`.

    A number is a rectangular half width; `{"half_width": h, "distribution": "triangular"}` another one
    (as in a budget: rectangular, triangular, arcsine), `{"std": s}` normal; `[low, high]` are limits, "exact"
    is no tolerance. The key ends with the unit: a unit of the parameter, `percent` of its nominal value (of 1
    where that is 0), `per_m` for 1/m. `others`: tolerance of parameters that are not named, "bounds" or
    "exact".
    """
    require(others in OTHERS, f"'others' in {where}", '"bounds" or "exact"', others)
    found: dict[str, Tolerance] = {}
    for key, value in ranges.items():
        tolerance = _tolerance(model, key, value, where)
        if tolerance.name in found:
            raise InputError(f"Parameter {tolerance.name} has two tolerances in {where}; keep one.")
        found[tolerance.name] = tolerance
    exact = found if others == "bounds" else model.names  # bounds of those that are found do not matter
    rest = model.with_parameters({n: {"lower": 0.0, "upper": 0.0} for n in exact})
    return tuple(found.get(t.name, t) for t in default_tolerances(rest))


def read_tolerances(path: str | Path, model: Model) -> tuple[Tolerance, ...]:
    """Read `[tolerance]` with one line per parameter and, optionally, `others` from TOML.

    Raises `InputError` for a missing or invalid file and for whatever would be ignored.
    """
    file = Table.read(path, "Tolerance file", ("tolerance", "others"))
    if not isinstance(file.raw.get("tolerance"), dict):
        raise InputError(
            f"Tolerance file {path} must hold a table [tolerance] with lines such as H1x_um = 20."
        )
    return given_tolerances(model, file.raw["tolerance"], file.raw.get("others", "bounds"), file.where)


def _tolerance(model: Model, key: str, value: Any, where: str) -> Tolerance:
    parameter, suffix = _split(model, key, where)
    at = parameter.nominal
    whole = Tolerance(parameter.name, parameter.unit, at, at, 0.0)
    if value == EXACT:
        return whole
    factor = _factor(parameter, suffix, key, where)
    if isinstance(value, list):
        limits, wanted = Table({key: value}, where).numbers(key), "[low, high], low < high"
        require(len(limits) == 2 and limits[0] < limits[1], f"Limits of {key} in {where}", wanted, value)
        low, high = limits
        return replace(whole, centre=(low + high) * factor / 2, width=(high - low) * factor / 2)
    size, distribution = value, "rectangular"
    if isinstance(value, Mapping):
        entry = Table(value, f"tolerance {key} of {where}", ("half_width", "std", "distribution"))
        sizes = [name for name in ("half_width", "std") if name in entry]
        if len(sizes) != 1:
            raise InputError(f"Tolerance {key} in {where} must have half_width or std, one of them.")
        allowed = ("normal",) if sizes[0] == "std" else tuple(DIVISORS)
        size, distribution = value[sizes[0]], entry.choice("distribution", allowed, allowed[0])
    return replace(whole, width=positive(size, key, where) * factor, distribution=distribution)


def read_value(model: Model, text: str, where: str) -> tuple[str, float]:
    """Return parameter and SI value of `gain_0=0.01` or `gain_0_percent=1`; the unit may be left out if SI.

    `percent` is of the nominal value, of 1 where that is 0. Raises `InputError`.
    """
    key, _, said = text.partition("=")
    parameter, suffix = _split(model, key, where, "Key")
    factor = _factor(parameter, suffix, key, where, "Key") if suffix else 1.0
    try:
        value = float(said)
    except ValueError:
        value = np.nan
    require(abs(value) <= MOST_NUMBER, where, f"NAME=VALUE with a number, such as {key}=0.01", text)
    return parameter.name, value * factor


def _split(model: Model, key: str, where: str, what: str = "Tolerance") -> tuple[Parameter, str]:
    """The parameter that a key names, and what follows its name."""
    hits = [p for p in model.parameters if key == p.name or key.startswith(f"{p.name}_")]
    if not hits:
        guess = nearest(key, [_example(p) for p in model.parameters])
        raise InputError(
            f"{what} {key!r} in {where} names no parameter of {model.name}{guess}; known are "
            f"{', '.join(model.names)}, each followed by its unit."
        )
    parameter = max(hits, key=lambda p: len(p.name))
    return parameter, key[len(parameter.name) + 1 :]


def units_of(parameter: Parameter) -> dict[str, float]:
    """Return the unit suffixes that a key of this parameter may have, with their factors to SI."""
    unit, inverse = parameter.unit, parameter.unit.startswith("1/")
    base = unit.removeprefix("1/")
    known = {name: u.factor for name, u in UNITS.items() if u.si == base.lower() and u.offset == 0}
    suffixes = {f"per_{name}": 1 / factor for name, factor in known.items()} if inverse else known
    if unit == "1":
        suffixes = {"": 1.0, "percent": 0.01}
    if parameter.nominal != 0:
        suffixes = {**suffixes, "percent": abs(parameter.nominal) / 100}
    return suffixes


def _example(parameter: Parameter) -> str:
    """A key in its usual unit."""
    return f"{parameter.name}_" + {"m": "um", "rad": "deg", "1": "percent", "1/m": "per_m"}.get(
        parameter.unit, next(iter(units_of(parameter)))
    )


def _factor(parameter: Parameter, suffix: str, key: str, where: str, what: str = "Tolerance") -> float:
    known = units_of(parameter)
    if suffix not in known:
        listed = ", ".join(f"{parameter.name}_{s}" if s else parameter.name for s in known)
        raise InputError(
            f"{what} {key!r} in {where} must end with a unit of {parameter.name}: one of {listed}."
        )
    return known[suffix]
