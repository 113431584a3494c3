"""Reading TOML files that people write: what a key must hold, and one sentence when it does not."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest, quoted, require
from hallsym.files import MOST_NUMBER, read_text, reading
from hallsym.units import UNITS, split_unit


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Return what a TOML file holds; `what` names it in errors, such as "Campaign file"."""
    fault, remedy = "is not valid TOML", "correct that place"
    text = read_text(path, what, fault, remedy, "give the path of a TOML file")
    with reading(path, what, fault, remedy):
        return tomllib.loads(text)


MOST_WHOLE = 2**53


class Table:
    """A table of a file with readers for its keys; `where` is what messages call it.

    Readers take the name of a key and what stands for it where the file does not have it; without such a
    default the key is required.
    """

    def __init__(self, raw: Mapping[str, Any], where: str, keys: Sequence[str] | None = None) -> None:
        """Take a table; a key that is not one of `keys` would be ignored and is refused."""
        self.raw, self.where = raw, where
        self._file, self._path = where, ""
        for key in raw:
            if keys is not None and key not in keys:
                raise InputError(
                    f"Unknown key {key!r} in {where}{nearest(key, list(keys))}; known are {', '.join(keys)}."
                )

    @classmethod
    def read(cls, path: str | Path, what: str, keys: Sequence[str] | None = None) -> Table:
        """Read a file; `what` as in `read_toml`; messages about keys say `campaign file next.toml`."""
        return cls(read_toml(path, what), f"{what.lower()} {quoted(Path(path).name)}", keys)

    def __contains__(self, key: str) -> bool:
        """Return whether the file states this key."""
        return key in self.raw

    def number(self, key: str, default: float | None = None, *, least: float = -np.inf) -> float:
        """Return a finite number, at least `least`."""
        return number(self.raw.get(key, default), key, self.where, least)

    def positive(self, key: str, default: float | None = None) -> float:
        """Return a finite number above 0."""
        return positive(self.raw.get(key, default), key, self.where)

    def whole(self, key: str, default: int | None = None, *, least: int = 1) -> int:
        """Return a whole number, at least `least`."""
        return whole(self.raw.get(key, default), key, self.where, least)

    def numbers(self, key: str, check: Callable[..., float] | None = None) -> list[float]:
        """Return a list of at least one number, each checked by `number` or `positive`."""
        value: Any = self.raw.get(key)
        require(isinstance(value, list) and value, f"'{key}' of {self.where}", "a list of numbers", value)
        return [(check or number)(entry, key, self.where) for entry in value]

    def pair(self, key: str) -> tuple[float, float]:
        """Return `[lowest, highest]`, not inverted."""
        found = self.numbers(key)
        good = len(found) == 2 and found[0] <= found[1]
        require(good, f"'{key}' of {self.where}", "[lowest, highest]", self.raw[key])
        return found[0], found[1]

    def text(self, key: str, default: str | None = None) -> str:
        """Return text that is not empty."""
        value = self.raw.get(key, default)
        text = value.strip() if isinstance(value, str) else ""
        require(text, f"'{key}' of {self.where}", "text", value)
        return text

    def choice(self, key: str, known: Sequence[str], default: str | None = None) -> str:
        """Return one of the `known` words."""
        value = self.raw.get(key, default)
        require(value in known, f"'{key}' of {self.where}", f"one of {', '.join(known)}", value, known)
        return str(value)

    def table(self, key: str, keys: Sequence[str] | None = None, where: str = "") -> Table:
        """Return the `[key]` table, empty where there is none."""
        raw, path = self.raw.get(key, {}), f"{self._path}{key}"
        require(isinstance(raw, Mapping), f"In {self._file}, {key}", f"a table [{path}]", raw)
        found = Table(raw, where or f"[{path}] of {self._file}", keys)
        found._file, found._path = self._file, f"{path}."
        return found

    def tables(self, key: str, keys: Sequence[str] | None = None) -> list[Table]:
        """Return the `[[key]]` tables, none where there are none."""
        raw = self.raw.get(key, [])
        good = isinstance(raw, list) and all(isinstance(entry, Mapping) for entry in raw)
        require(good, f"In {self.where}, {key}", f"[[{key}]] tables", raw)
        return [Table(entry, f"a [[{key}]] of {self.where}", keys) for entry in raw]

    def columns(self, known: Sequence[str], but: Sequence[str] = ()) -> Iterator[tuple[str, str, float]]:
        """Yield each key, but those in `but`, with the column it names in any unit and the factor to SI.

        Refuses a key that is no column of `known` and a column that is given twice.
        """
        found: set[str] = set()
        for key in self.raw:
            if key not in but:
                column, factor = column_of(key, known, self.where)
                if column in found:
                    raise InputError(f"'{key}' of {self.where} is given twice, as {column}; keep one.")
                found.add(column)
                yield key, column, factor


def number(value: Any, key: str, where: str, least: float = -np.inf) -> float:
    """Return a finite number, at least `least`."""
    require(_is_number(value) and abs(value) <= MOST_NUMBER, f"'{key}' of {where}", "a finite number", value)
    require(value >= least, f"'{key}' of {where}", f"a number >= {least:g}", value)
    return float(value)


def positive(value: Any, key: str, where: str) -> float:
    """Return a finite number above 0."""
    good = _is_number(value) and 0 < value <= MOST_NUMBER
    require(good, f"'{key}' of {where}", "a positive number", value)
    return float(value)


def whole(value: Any, key: str, where: str, least: int = 1) -> int:
    """Return a whole number, at least `least`."""
    known = isinstance(value, int | np.integer) and not isinstance(value, bool)
    good = known and least <= value <= MOST_WHOLE
    require(good, f"'{key}' of {where}", f"a whole number, {least} or more", value)
    return int(value)


def column_of(key: str, known: Sequence[str], where: str) -> tuple[str, float]:
    """Return the column that `key` names in any unit, and the factor to SI: `z_um` is `z_m`, 1e-6."""
    stem, unit = split_unit(key)
    for column in known:
        ours, si = split_unit(column)
        if ours == stem:
            if unit is None or si is None or unit.si != si.si:
                raise InputError(f"'{key}' of {where} must end with a unit of {ours!r}, such as {column!r}.")
            return column, unit.factor
    raise InputError(
        f"Unknown key {key!r} in {where}{nearest(key, list(known))}; known are {', '.join(known)} "
        "(in any unit)."
    )


def unit_of(suffix: str, where: str) -> tuple[str, float]:
    """Return SI unit and factor of a key's unit; none is a plain number, `ppm` a millionth of one.

    Temperatures are differences here: no offset.
    """
    if suffix in ("", "1", "ppm", "percent"):
        return "1", {"ppm": 1e-6, "percent": 1e-2}.get(suffix, 1.0)
    if suffix not in UNITS:
        known = [*UNITS, "ppm", "percent"]
        raise InputError(
            f"Unit {suffix!r} of {where} is not known{nearest(suffix, known)}; known are {', '.join(known)}."
        )
    return UNITS[suffix].si, UNITS[suffix].factor


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
