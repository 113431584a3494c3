"""Results as plain numbers for JSON, and JSON data as the records that they must be."""

import json
import re
from collections.abc import Iterable
from typing import Any, TypeVar

import numpy as np

from hallsym.errors import InputError, nearest

Kind = TypeVar("Kind")
DIALECT = "https://json-schema.org/draft/2020-12/schema"
"""Of JSON Schemas."""


def named(names: Iterable[str], values: Any) -> dict[str, Any]:
    """Return `{name: value}` of an array: numbers, or nested lists where it has more than one axis.

    >>> named(("x_m", "y_m"), np.array([1e-6, 2e-6]))
    {'x_m': 1e-06, 'y_m': 2e-06}
    """
    return dict(zip(names, np.asarray(values, dtype=float).tolist(), strict=True))


def plain(record: Any) -> Any:
    """Return a record as plain JSON data; a number that is not finite becomes None.

    >>> plain({"x": (np.float64(1.0), np.nan)})
    {'x': [1.0, None]}
    """
    import msgspec  # here, because most commands read and write no record

    return msgspec.json.decode(msgspec.json.encode(record, enc_hook=_builtin))


def builtins(record: Any) -> Any:
    """Return a record as plain JSON data; a number that is not finite stays, for `json_text` to refuse."""
    import msgspec

    return json.loads(json.dumps(msgspec.to_builtins(record, str_keys=True, enc_hook=_builtin)))


def _builtin(value: Any) -> Any:
    return str(value) if isinstance(value, str) else value.item()  # a finding, a number of NumPy


def structured(raw: Any, kind: type[Kind], where: str, remedy: str) -> Kind:
    """Return JSON data as `kind`, a `msgspec.Struct`: every key known, every value of its type and range.

    Raises `InputError` that names the place, for a key that is not known with the nearest one that is.
    """
    import msgspec

    try:
        return msgspec.convert(raw, kind, str_keys=True)
    except msgspec.ValidationError as error:
        what, _, path = str(error).partition(" - at `$")
        place = _place(raw, kind, path.rstrip("`"))
    raise InputError(f"{_sentence(what, place, where, raw, kind)}; {remedy}.")


def schema_of(kind: type, title: str) -> dict[str, Any]:
    """Return the JSON Schema of the files that hold a `kind`, from the types that validate them."""
    import msgspec

    return {"$schema": DIALECT, "title": title, **msgspec.json.schema(kind)}


def schemas_of(kinds: Iterable[type]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the JSON Schema of each type, as references, and what they refer to by name."""
    import msgspec

    found, defined = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    return list(found), defined


_TYPES = {
    "array": "a list", "object": "a table of keys", "float": "a number", "int": "a whole number",
    "str": "text", "bool": "true or false", "null": "null",
}  # fmt: skip


def _sentence(what: str, place: list[str], where: str, raw: Any, kind: type) -> str:
    """Say in hallsym's words what msgspec says of a value that cannot be."""
    import msgspec

    here = f"Key '{'.'.join(place)}' of {where}" if place else f"{where[:1].upper()}{where[1:]}"
    if found := re.search("unknown field `(.*)`", what):
        near = nearest(found[1], _keys(msgspec.json.schema(kind)))
        return f"{here} has the unknown key {found[1]!r}{near}"
    if found := re.search("missing required field `(.*)`", what):
        return f"{here} is incomplete: '{found[1]}' is missing"
    if found := re.match("Expected `([^`]*)`(.*)", what):
        wanted = " or ".join(_TYPES.get(name, name) for name in found[1].split(" | "))
        limit = "" if found[2].startswith(", got") else found[2]
        return f"{here} must be {wanted}{limit}; instead received {repr(_at(raw, place))[:60]}"
    return f"{here} cannot be: {what[:1].lower()}{what[1:].replace('`', chr(39))}"


def _place(raw: Any, kind: type, place: str) -> list[str]:
    """Return a path such as parameters, eta_A, value; msgspec leaves out which key of a mapping it was."""
    import msgspec

    found: list[str] = []
    for part in re.findall(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]", place):
        key = part[0] or part[1]
        at = _at(raw, found)
        if key == "..." and isinstance(at, dict):
            for name in at:
                try:
                    msgspec.convert(_with(raw, found, {name: at[name]}), kind, str_keys=True)
                except msgspec.ValidationError as error:
                    if str(error).rpartition("$")[2].rstrip("`") == place:
                        key = name
                        break
        found.append(key)
    return found


def _at(raw: Any, path: list[str]) -> Any:
    for key in path:
        raw = raw[int(key)] if isinstance(raw, list) else raw[key] if isinstance(raw, dict) else None
    return raw


def _with(raw: Any, path: list[str], value: Any) -> Any:
    """Return a copy of nested data with another value at a path."""
    if not path:
        return value
    key: Any = int(path[0]) if isinstance(raw, list) else path[0]
    copy = raw.copy()
    copy[key] = _with(raw[key], path[1:], value)
    return copy


def _keys(schema: Any) -> list[str]:
    """Return every key that a JSON Schema names."""
    if isinstance(schema, list):
        return [key for entry in schema for key in _keys(entry)]
    if not isinstance(schema, dict):
        return []
    own = list(schema.get("properties", {}))
    return list(dict.fromkeys([*own, *(key for entry in schema.values() for key in _keys(entry))]))
