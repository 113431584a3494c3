"""The one boundary through which files are read: whatever a library raises becomes one sentence.

Every reader opens its file in `reading`, and only calls of libraries stand inside; what they return is judged
outside, so that a mistake of ours is not taken for a damaged file.
"""

from __future__ import annotations

import json
import os
import stat
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, nearest, quoted, summary
from hallsym.files import reason
from hallsym.guard import note_input

NO_JSON = "cannot be read as JSON"
MOST_NUMBER = 1e50
"""Magnitude of a number in any file: powers up to the sixth of it are still numbers."""
MOST_TEXT_BYTES = 256_000_000
"""Bytes of a file that is read whole as text: a calibration of 10,000 runs has 2e6."""


@contextmanager
def reading(path: str | Path, what: str, fault: str, remedy: str = "copy it again") -> Iterator[None]:
    """Turn whatever is raised inside into an `InputError`, and keep warnings of libraries quiet.

    `what` names the file in messages ("Calibration"), `fault` is what is wrong with one that cannot be read
    ("is not valid TOML"), `remedy` what to do. An `InputError` passes through.
    """
    name = f"{what} {quoted(path)}"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{name} needs more memory than there is; make it smaller, or {remedy}.") from error
    except RecursionError as error:
        raise InputError(f"{name} {fault} (it is nested too deeply); {remedy}.") from error
    except Exception as error:
        if isinstance(error, OSError) and error.errno:
            raise InputError(
                f"Cannot read {what.lower()} {quoted(path)}: {reason(error, reading=True)}."
            ) from error
        raise InputError(f"{name} {fault} ({summary(error)}); {remedy}.") from error


def regular(path: str | Path, what: str, make: str = "") -> Path:
    """Return the path of a regular file; refuse one that is missing, a folder, a pipe or a device.

    `make`: how such a file is made, for one that is missing. The file becomes an input of the command, which
    no output may replace.
    """
    name = f"{what} {quoted(path)}"
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        raise InputError(f"{name} does not exist{_neighbour(Path(path))}{make and f'; {make}'}.") from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"Cannot read {what.lower()} {quoted(path)}: {reason(error, reading=True)}."
        ) from None
    if stat.S_ISDIR(mode):
        raise InputError(f"{name} is a folder; give the path of a file.")
    if not stat.S_ISREG(mode):
        raise InputError(f"{name} is a pipe or a device; give the path of a file (write the data to one).")
    note_input(path)
    return Path(path)


def read_text(path: str | Path, what: str, fault: str, remedy: str, make: str = "") -> str:
    """Return the text of a small UTF-8 file; `make` as in `regular`, the rest as in `reading`."""
    file = regular(path, what, make)
    with reading(path, what, fault, remedy):
        if file.stat().st_size > MOST_TEXT_BYTES:
            raise InputError(
                f"{what} {quoted(path)} must have at most {MOST_TEXT_BYTES} bytes of text; it has "
                f"{file.stat().st_size}, so it is something else: give another file."
            )
        return file.read_text(encoding="utf-8-sig")


def read_json(path: str | Path, what: str, remedy: str, make: str = "") -> Any:
    """Return what a JSON file holds; NaN, infinities and numbers beyond `MOST_NUMBER` are refused."""
    text = read_text(path, what, NO_JSON, remedy, make)
    with reading(path, what, NO_JSON, remedy):
        data = json.loads(text, object_pairs_hook=_once, parse_constant=_no_number)
    place = _too_large(data)
    if place is not None:
        raise InputError(
            f"{what} {quoted(path)} must hold numbers of magnitude {MOST_NUMBER:g} at most; "
            f"'{place.lstrip('.')}' is larger, so {remedy}."
        )
    return data


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the keys of an object; of one that stands there twice, JSON does not say which is meant."""
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"key {next(key for key in keys if keys.count(key) > 1)!r} is given twice")
    return found


def _no_number(text: str) -> Any:
    raise ValueError(f"{text} is no number")


def _too_large(data: Any) -> str | None:
    """Return the place of a number whose square is none any more; None where there is no such number."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            if isinstance(value, str | bool) or value is None:
                continue
            if (place := _too_large(value)) is not None:
                return f".{key}{place}"
    elif isinstance(data, int | float) and abs(data) > MOST_NUMBER:
        return ""
    return None


def _neighbour(path: Path) -> str:
    """Return the nearest name in the folder of a file that does not exist."""
    try:
        if not path.parent.is_dir():
            return f"; neither does its folder {quoted(path.parent)}"
        return nearest(path.name, [entry.name for entry in path.parent.iterdir()])
    except OSError:
        return ""
