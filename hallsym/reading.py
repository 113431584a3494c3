"""The one boundary through which files are read: whatever a library raises becomes one sentence.

Every reader opens its file in `reading`, and only calls of libraries stand inside; what they return is judged
outside, so that a mistake of ours is not taken for a damaged file.
"""

from __future__ import annotations

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

MOST_TEXT_BYTES = 256_000_000
"""Bytes of a file that is read whole as text: a calibration of 10,000 runs has 2e6."""


@contextmanager
def reading(path: str | Path, what: str, expected: str, remedy: str = "copy it again") -> Iterator[None]:
    """Turn whatever is raised inside into an `InputError`, and keep warnings of libraries quiet.

    `what` names the file in messages ("Calibration"), `expected` is what it must be ("a JSON file"), `remedy`
    what to do. An `InputError` passes through.
    """
    name = f"{what} {quoted(path)}"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{name} needs more memory than there is; split it, or {remedy}.") from error
    except RecursionError as error:
        raise InputError(f"{name} must be {expected}; it is nested too deeply, so {remedy}.") from error
    except Exception as error:
        if isinstance(error, OSError) and error.errno:
            raise InputError(f"{name} cannot be read: {reason(error)}.") from error
        raise InputError(
            f"{name} must be {expected}; it is cut short or damaged, so {remedy} ({summary(error)})."
        ) from error


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
        raise InputError(f"{name} cannot be read: {reason(error)}.") from None
    if stat.S_ISDIR(mode):
        raise InputError(f"{name} is a folder; give the path of a file.")
    if not stat.S_ISREG(mode):
        raise InputError(f"{name} is a pipe or a device; give the path of a file (write the data to one).")
    note_input(path)
    return Path(path)


def read_text(path: str | Path, what: str, expected: str, remedy: str, make: str = "") -> str:
    """Return the text of a small UTF-8 file; `make` as in `regular`, the rest as in `reading`."""
    file = regular(path, what, make)
    with reading(path, what, expected, remedy):
        if file.stat().st_size > MOST_TEXT_BYTES:
            raise InputError(
                f"{what} {quoted(path)} has {file.stat().st_size} bytes; {expected} of at most "
                f"{MOST_TEXT_BYTES} is expected, so {remedy}."
            )
        return file.read_text(encoding="utf-8-sig")


def read_json(path: str | Path, what: str, remedy: str, make: str = "") -> Any:
    """Return what a JSON file holds; NaN, infinities and numbers beyond a double's range are refused."""
    text = read_text(path, what, "a JSON file", remedy, make)
    with reading(path, what, "a JSON file", remedy):
        import msgspec  # here, because not every command reads JSON

        return msgspec.json.decode(text)


def _neighbour(path: Path) -> str:
    """Return the nearest name in the folder of a file that does not exist."""
    try:
        if not path.parent.is_dir():
            return f"; neither does its folder {quoted(path.parent)}"
        return nearest(path.name, [entry.name for entry in path.parent.iterdir()])
    except OSError:
        return ""
