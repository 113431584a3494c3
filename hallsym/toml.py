"""Reading TOML files that people write: what a key must hold, and one sentence when it does not."""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.files import reason


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return what a TOML file holds; `what` names it in errors, such as "Campaign file"."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{what} {path} does not exist; give the path of a TOML file.") from None
    except OSError as error:
        raise InputError(f"{what} {path} cannot be read: {reason(error)}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{what} {path} is not valid TOML: {' '.join(str(error).split())}.") from None


def tables(raw: Any, key: str, where: str) -> list[Mapping[str, Any]]:
    """Return the `[[key]]` tables of a file."""
    if not isinstance(raw, list) or not all(isinstance(entry, Mapping) for entry in raw):
        raise InputError(f"In {where}, {key} must be [[{key}]] tables; instead received {raw!r}.")
    return raw


def table(raw: Any, key: str, where: str) -> Mapping[str, Any]:
    """Return the `[key]` table of a file."""
    if not isinstance(raw, Mapping):
        raise InputError(f"In {where}, {key} must be a table, [{key}]; instead received {raw!r}.")
    return raw


def numbers(value: Any, key: str, where: str, check: Callable[..., float] | None = None) -> list[float]:
    """Return a list of at least one number, each checked by `number` or `positive`."""
    if not isinstance(value, list) or not value:
        raise InputError(f"'{key}' of {where} must be a list of numbers; instead received {value!r}.")
    return [(check or number)(entry, key, where) for entry in value]


def known(raw: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    """Refuse a table with a key that would be ignored."""
    for key in raw:
        if key not in keys:
            raise InputError(
                f"Unknown key {key!r} in {where}{nearest(key, list(keys))}; known are {', '.join(keys)}."
            )


def number(value: Any, key: str, where: str, least: float = -np.inf) -> float:
    """Return a finite number, at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < np.inf:
        wanted = "a finite number" if least == -np.inf else f"a number >= {least:g}"
        raise InputError(f"'{key}' of {where} must be {wanted}; instead received {value!r}.")
    if value == -np.inf:
        raise InputError(f"'{key}' of {where} must be a finite number; instead received {value!r}.")
    return float(value)


def positive(value: Any, key: str, where: str) -> float:
    """Return a finite number above 0."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise InputError(f"'{key}' of {where} must be a positive number; instead received {value!r}.")
    return float(value)
