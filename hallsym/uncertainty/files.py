"""Read a budget from TOML: one `[[source]]` table per input, the unit of a number in its key."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.toml import known, number, read_toml, tables
from hallsym.uncertainty.gum import DIVISORS, Budget, Source
from hallsym.units import UNITS

WIDTHS = tuple(DIVISORS)
SIZES = ("std", "expanded", "half_width", "full_width", "resolution", "readings", "scatter")
"""How large a source is: exactly one of these per source, with its unit (`half_width_nm`)."""
TOP = ("quantity", "unit", "coverage_factor", "level", "source", "correlation")
OTHERS = ("name", "distribution", "coverage_factor", "n", "degrees_of_freedom")


def read_budget(path: str | Path) -> tuple[Budget, str | None]:
    """Read a stand-alone budget; returns it in SI and the unit in which the file wants it read.

    Raises `InputError` for a missing file, unknown keys, distributions and units, and impossible numbers.
    """
    path = Path(path)
    raw, where = read_toml(path, "Budget file"), f"budget {path.name}"
    known(raw, TOP, where)
    entries = tables(raw.get("source", []), "source", where)
    if not entries:
        raise InputError(f"In {where} at least one [[source]] is needed; there is none.")
    made = [_source(entry, where) for entry in entries]
    names = [source.name for source, _, _ in made]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"In {where} two sources are called {twice[0]!r}; give each its own name.")
    results = {result for _, result, _ in made}
    if len(results) > 1:
        raise InputError(
            f"Sources of {where} must all act on one result; these act on {' and '.join(sorted(results))}: "
            "give 'sensitivity_nm_per_urad = ...' where a source has another unit than the result."
        )
    if "coverage_factor" in raw and "level" in raw:
        raise InputError(f"In {where} give 'coverage_factor' or 'level', not both.")
    unit, shown = results.pop(), _shown(raw, [asked for _, _, asked in made], where)
    if shown is not None and unit_of(shown, where)[0] != unit:
        raise InputError(f"'unit' of {where} must be a unit of the result ({unit}); it is {shown!r}.")
    budget = Budget(
        quantity=text(raw.get("quantity", path.stem), "quantity", where),
        unit=unit,
        sources=tuple(source for source, _, _ in made),
        coverage=number(raw.get("coverage_factor", 2.0), "coverage_factor", where),
        level=None if "level" not in raw else number(raw["level"], "level", where),
        correlation=_correlation(raw.get("correlation", []), names, where),
    )
    return budget, shown


def _shown(raw: Mapping[str, Any], asked: Sequence[str], where: str) -> str | None:
    """Unit for reading: as stated, else the one that all sources use."""
    if "unit" in raw:
        return text(raw["unit"], "unit", where)
    return asked[0] if len(set(asked)) == 1 else None


def _source(raw: Mapping[str, Any], where: str) -> tuple[Source, str, str]:
    """Return a source in SI, the SI unit of the result it acts on, and the unit its result is given in."""
    if "name" not in raw:
        raise InputError(f"Every [[source]] of {where} needs a 'name'; one has none.")
    name = text(raw["name"], "name", where)
    where = f"source {name!r} of {where}"
    sizes = {key: _size(key) for key in raw}
    stated = [key for key, size in sizes.items() if size]
    sensitivity = [key for key in raw if key.split("_")[0] == "sensitivity"]
    known(
        {key: raw[key] for key in raw if key not in stated + sensitivity},
        (*OTHERS, *(f"{size}_nm" for size in SIZES), "sensitivity"),
        where,
    )
    if len(stated) != 1 or len(sensitivity) > 1:
        what = "one sensitivity at most" if len(stated) == 1 else f"one of {', '.join(SIZES)} with its unit"
        raise InputError(f"A {where} must have {what}, such as half_width_nm; it has {len(stated)} sizes.")
    kind, suffix = sizes[stated[0]] or ("", "")
    unit, factor = unit_of(suffix, where)
    slope, result, asked = _sensitivity(raw, sensitivity, unit, suffix, where)
    more: dict[str, Any] = {"sensitivity": slope}
    if "degrees_of_freedom" in raw:
        more["degrees_of_freedom"] = number(raw["degrees_of_freedom"], "degrees_of_freedom", where)
    source = _KINDS[kind](raw, kind, raw[stated[0]], factor, name, unit, more, where)
    return source, result, asked


def _size(key: str) -> tuple[str, str] | None:
    """`half_width_nm` -> ("half_width", "nm"); `std` is a plain number; None for any other key."""
    for kind in SIZES:
        if key == kind or (key.startswith(f"{kind}_") and key not in SIZES):
            return kind, key[len(kind) + 1 :]
    return None


def _sensitivity(
    raw: Mapping[str, Any], keys: Sequence[str], unit: str, suffix: str, where: str
) -> tuple[float, str, str]:
    """Slope in SI per SI, SI unit of the result and its unit as asked for."""
    if not keys or keys[0] == "sensitivity":
        return number(raw.get("sensitivity", 1.0), "sensitivity", where), unit, suffix
    match = re.fullmatch(r"sensitivity_(\w+)_per_(\w+)", keys[0])
    if not match:
        raise InputError(
            f"{keys[0]!r} of {where} must be 'sensitivity' or 'sensitivity_RESULT_per_INPUT', "
            "such as sensitivity_nm_per_urad."
        )
    (result, up), (given, down) = unit_of(match[1], where), unit_of(match[2], where)
    if given != unit:
        raise InputError(f"{keys[0]!r} of {where} must be per unit of the source ({unit}), not per {given}.")
    return number(raw[keys[0]], keys[0], where) * up / down, result, match[1]


def _normal(
    raw: Mapping[str, Any], kind: str, value: Any, factor: float, name: str, unit: str, more: dict, where: str
) -> Source:
    _only(raw, ("normal", "student"), ("coverage_factor",) if kind == "expanded" else (), where)
    if kind == "expanded" and "coverage_factor" not in raw:
        raise InputError(f"An expanded uncertainty of {where} needs its 'coverage_factor'.")
    k = number(raw.get("coverage_factor", 1.0), "coverage_factor", where)
    if raw.get("distribution") == "student":
        if "degrees_of_freedom" not in more:
            raise InputError(f"Student's distribution of {where} needs 'degrees_of_freedom'.")
        return Source(name, size(value, kind, where) * factor / k, unit, "student", **more)
    return Source.normal(name, size(value, kind, where) * factor, unit, k, **more)


def _width(
    raw: Mapping[str, Any], kind: str, value: Any, factor: float, name: str, unit: str, more: dict, where: str
) -> Source:
    allowed = ("rectangular",) if kind == "resolution" else WIDTHS
    _only(raw, allowed, (), where)
    make: Callable[..., Source] = getattr(Source, raw.get("distribution", "rectangular"))
    half = size(value, kind, where) * factor * (1.0 if kind == "half_width" else 0.5)
    return make(name, half, unit, **more)


def _repeated(
    raw: Mapping[str, Any], kind: str, value: Any, factor: float, name: str, unit: str, more: dict, where: str
) -> Source:
    _only(raw, ("student",), ("n",) if kind == "scatter" else (), where)
    if kind == "readings":
        if not isinstance(value, list):
            raise InputError(f"'readings' of {where} must be a list of numbers; instead received {value!r}.")
        values = [number(v, "readings", where) * factor for v in value]
        return Source.readings(name, values, unit, **more)
    n = raw.get("n")
    if isinstance(n, bool) or not isinstance(n, int):
        raise InputError(f"A 'scatter' of {where} needs 'n', the whole number of readings averaged.")
    return Source.scatter(name, size(value, kind, where) * factor, n, unit, **more)


_KINDS: dict[str, Callable[..., Source]] = {
    "std": _normal, "expanded": _normal,
    "half_width": _width, "full_width": _width, "resolution": _width,
    "readings": _repeated, "scatter": _repeated,
}  # fmt: skip


def _only(raw: Mapping[str, Any], distributions: Sequence[str], extra: Sequence[str], where: str) -> None:
    """Refuse a distribution that does not belong to the size, and keys that would be ignored."""
    asked = raw.get("distribution", distributions[0])
    if asked not in distributions:
        raise InputError(
            f"'distribution' of {where} must be {' or '.join(distributions)} for what is stated; "
            f"instead received {asked!r}{nearest(str(asked), [*distributions])}."
        )
    for key in ("coverage_factor", "n"):
        if key in raw and key not in extra:
            raise InputError(f"'{key}' of {where} has no effect there; take it out.")


def _correlation(raw: Any, names: Sequence[str], where: str) -> np.ndarray | None:
    entries = tables(raw, "correlation", where)
    if not entries:
        return None
    matrix = np.eye(len(names))
    for entry in entries:
        known(entry, ("between", "coefficient"), f"a [[correlation]] of {where}")
        pair = entry.get("between")
        if not (isinstance(pair, list) and len(pair) == 2 and pair[0] != pair[1]):
            raise InputError(
                f"'between' of a [[correlation]] of {where} must name two sources; instead received {pair!r}."
            )
        for name in pair:
            if name not in names:
                raise InputError(
                    f"A [[correlation]] of {where} names {name!r}, which is no source"
                    f"{nearest(str(name), list(names))}."
                )
        i, j = (names.index(name) for name in pair)
        matrix[i, j] = matrix[j, i] = number(entry.get("coefficient"), "coefficient", where)
    return matrix


# -- shared with the settings of a position budget -------------------------------------------------------


def unit_of(suffix: str, where: str) -> tuple[str, float]:
    """Return SI unit and factor of a key's unit; none is a plain number, `ppm` a millionth of one.

    Temperatures are differences here: no offset.
    """
    if suffix in ("", "1", "ppm", "percent"):
        return "1", {"ppm": 1e-6, "percent": 1e-2}.get(suffix, 1.0)
    if suffix not in UNITS:
        known_units = [*UNITS, "ppm", "percent"]
        raise InputError(
            f"Unit {suffix!r} of {where} is not known{nearest(suffix, known_units)}; "
            f"known are {', '.join(known_units)}."
        )
    return UNITS[suffix].si, UNITS[suffix].factor


def size(value: Any, key: str, where: str) -> float:
    """Return a number >= 0."""
    if number(value, key, where) < 0:
        raise InputError(f"'{key}' of {where} must be a number >= 0; instead received {value!r}.")
    return float(value)


def text(value: Any, key: str, where: str) -> str:
    """Return text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"'{key}' of {where} must be text; instead received {value!r}.")
    return value.strip()
