"""Read a budget from TOML: one `[[source]]` table per input, the unit of a number in its key."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.toml import Table, number, unit_of
from hallsym.uncertainty.gum import DIVISORS, Budget, Source
from hallsym.uncertainty.settings import coverage_of

SIZES = ("std", "expanded", "half_width", "full_width", "resolution", "readings", "scatter")
"""How large a source is: exactly one of these per source, with its unit (`half_width_nm`)."""
TOP = ("quantity", "unit", "coverage_factor", "level", "source", "correlation")
OTHERS = ("name", "distribution", "coverage_factor", "n", "degrees_of_freedom")


def read_budget(path: str | Path) -> tuple[Budget, str | None]:
    """Read a stand-alone budget; returns it in SI and the unit in which the file wants it read.

    Raises `InputError` for a missing file, unknown keys, distributions and units, and impossible numbers.
    """
    file = Table.read(path, "Budget file", TOP)
    made = [_source(entry) for entry in file.tables("source")]
    if not made:
        raise InputError(f"In {file.where} at least one [[source]] is needed; there is none.")
    names = [source.name for source, _, _ in made]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"In {file.where} two sources are called {twice[0]!r}; give each its own name.")
    results = {result for _, result, _ in made}
    if len(results) > 1:
        raise InputError(
            f"Sources of {file.where} must all act on one result; these act on "
            f"{' and '.join(sorted(results))}: give 'sensitivity_nm_per_urad = ...' where a source has "
            "another unit than the result."
        )
    coverage, level = coverage_of(file)
    unit, asked = results.pop(), {asked for _, _, asked in made}
    shown = file.text("unit") if "unit" in file else asked.pop() if len(asked) == 1 else None
    if shown is not None and unit_of(shown, file.where)[0] != unit:
        raise InputError(f"'unit' of {file.where} must be a unit of the result ({unit}); it is {shown!r}.")
    budget = Budget(
        quantity=file.text("quantity", Path(path).stem),
        unit=unit,
        sources=tuple(source for source, _, _ in made),
        coverage=coverage,
        level=level,
        correlation=_correlation(file, names),
    )
    return budget, shown


def _source(entry: Table) -> tuple[Source, str, str]:
    """Return a source in SI, the SI unit of the result it acts on, and the unit its result is given in."""
    if "name" not in entry:
        raise InputError(f"Every [[source]] needs a 'name'; {entry.where} has none.")
    name = entry.text("name")
    where = f"source {name!r} ({entry.where})"
    sizes = {key: size for key in entry.raw if (size := _size(key))}
    slopes = [key for key in entry.raw if key.split("_")[0] == "sensitivity"]
    others = {key: value for key, value in entry.raw.items() if key not in (*sizes, *slopes)}
    Table(others, where, (*OTHERS, *(f"{size}_nm" for size in SIZES), "sensitivity"))
    if len(sizes) != 1 or len(slopes) > 1:
        what = "one sensitivity at most" if len(sizes) == 1 else f"one of {', '.join(SIZES)} with its unit"
        raise InputError(f"A {where} must have {what}, such as half_width_nm; it has {len(sizes)} sizes.")
    ((key, (kind, suffix)),) = sizes.items()
    unit, factor = unit_of(suffix, where)
    entry = Table({**others, **{k: entry.raw[k] for k in slopes}, kind: entry.raw[key]}, where)
    slope, result, asked = _sensitivity(entry, slopes, unit, suffix)
    more: dict[str, Any] = {"sensitivity": slope}
    if "degrees_of_freedom" in entry:
        more["degrees_of_freedom"] = entry.number("degrees_of_freedom")
    return _made(entry, name, kind, factor, unit, more), result, asked


def _size(key: str) -> tuple[str, str] | None:
    """`half_width_nm` -> ("half_width", "nm"); `std` is a plain number; None for any other key."""
    for kind in SIZES:
        if key == kind or (key.startswith(f"{kind}_") and key not in SIZES):
            return kind, key[len(kind) + 1 :]
    return None


def _sensitivity(entry: Table, keys: Sequence[str], unit: str, suffix: str) -> tuple[float, str, str]:
    """Slope in SI per SI, SI unit of the result and its unit as asked for."""
    if not keys or keys[0] == "sensitivity":
        return entry.number("sensitivity", 1.0), unit, suffix
    key, where = keys[0], entry.where
    match = re.fullmatch(r"sensitivity_(\w+)_per_(\w+)", key)
    if not match:
        raise InputError(
            f"{key!r} of {where} must be 'sensitivity' or 'sensitivity_RESULT_per_INPUT', "
            "such as sensitivity_nm_per_urad."
        )
    (result, up), (given, down) = unit_of(match[1], where), unit_of(match[2], where)
    if given != unit:
        raise InputError(f"{key!r} of {where} must be per unit of the source ({unit}), not per {given}.")
    return entry.number(key) * up / down, result, match[1]


def _made(entry: Table, name: str, kind: str, factor: float, unit: str, more: dict[str, Any]) -> Source:
    """Return the source whose size stands under `kind`, `factor` times SI; `more`: what every kind takes."""
    if kind in ("std", "expanded"):
        asked = _only(entry, ("normal", "student"), "coverage_factor" if kind == "expanded" else "")
        if kind == "expanded" and "coverage_factor" not in entry:
            raise InputError(f"An expanded uncertainty of {entry.where} needs its 'coverage_factor'.")
        k, size = entry.number("coverage_factor", 1.0), entry.number(kind, least=0.0) * factor
        if asked == "normal":
            return Source.normal(name, size, unit, k, **more)
        if "degrees_of_freedom" not in more:
            raise InputError(f"Student's distribution of {entry.where} needs 'degrees_of_freedom'.")
        return Source(name, size / k, unit, "student", **more)
    if kind in ("half_width", "full_width", "resolution"):
        asked = _only(entry, ("rectangular",) if kind == "resolution" else tuple(DIVISORS))
        half = entry.number(kind, least=0.0) * factor * (1.0 if kind == "half_width" else 0.5)
        return getattr(Source, asked)(name, half, unit, **more)
    _only(entry, ("student",), "n" if kind == "scatter" else "")
    if kind == "readings":
        if not isinstance(entry.raw[kind], list):
            raise InputError(
                f"'readings' of {entry.where} must be a list of numbers; instead received "
                f"{entry.raw[kind]!r}."
            )
        values = [number(v, kind, entry.where) * factor for v in entry.raw[kind]]
        return Source.readings(name, values, unit, **more)
    n = entry.raw.get("n")
    if isinstance(n, bool) or not isinstance(n, int):
        raise InputError(f"A 'scatter' of {entry.where} needs 'n', the whole number of readings averaged.")
    return Source.scatter(name, entry.number(kind, least=0.0) * factor, n, unit, **more)


def _only(entry: Table, distributions: Sequence[str], extra: str = "") -> str:
    """Return the distribution; refuse one that does not belong to the size, and keys without effect."""
    asked = entry.raw.get("distribution", distributions[0])
    if asked not in distributions:
        raise InputError(
            f"'distribution' of {entry.where} must be {' or '.join(distributions)} for what is stated; "
            f"instead received {asked!r}{nearest(str(asked), [*distributions])}."
        )
    for key in ("coverage_factor", "n"):
        if key in entry and key != extra:
            raise InputError(f"'{key}' of {entry.where} has no effect there; take it out.")
    return str(asked)


def _correlation(file: Table, names: Sequence[str]) -> np.ndarray | None:
    entries = file.tables("correlation", ("between", "coefficient"))
    matrix = np.eye(len(names))
    for entry in entries:
        pair = entry.raw.get("between")
        if not (isinstance(pair, list) and len(pair) == 2 and pair[0] != pair[1]):
            raise InputError(f"'between' of {entry.where} must name two sources; instead received {pair!r}.")
        for name in pair:
            if name not in names:
                raise InputError(
                    f"{entry.where.capitalize()} names {name!r}, which is no source"
                    f"{nearest(str(name), list(names))}."
                )
        i, j = (names.index(name) for name in pair)
        matrix[i, j] = matrix[j, i] = entry.number("coefficient")
    return matrix if entries else None
