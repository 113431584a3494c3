"""Files: read behind one boundary, written whole or not at all, and never an output in the place of an input.

Every reader opens its file in `reading`, with only calls of libraries inside: their exceptions become one
sentence, and their results are checked outside, so that a defect of hallsym does not look like a damaged
file. A written file appears under its name when it is complete: a reader sees the old one or the new one.
Inputs and outputs of a command are identified by inode (`Task`).
"""

from __future__ import annotations

import errno
import json
import math
import os
import stat
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from decimal import Decimal
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, nearest, quoted, summary

Identity = tuple[int, int]
"""Device and inode: what two names of one file share, through symbolic and hard links."""


class Task:
    """The files of one command, by identity; the values are the names they were given."""

    def __init__(self) -> None:
        """Begin without files."""
        self.inputs: dict[Identity, str] = {}
        self.outputs: dict[Identity, str] = {}


_TASK: ContextVar[Task | None] = ContextVar("hallsym_task", default=None)


@contextmanager
def task() -> Iterator[Task]:
    """Refuse outputs that are inputs of the same task; outside of a task nothing is refused."""
    token = _TASK.set(Task())
    try:
        yield _TASK.get() or Task()
    finally:
        _TASK.reset(token)


def announce(path: str | Path) -> None:
    """Note a file that will be written, so that reading it is refused before anything is computed."""
    known, identity = _TASK.get(), _identity(path)
    if known is not None and identity and not os.path.isdir(path):
        if identity in known.inputs:
            raise _refused(path, known.inputs[identity])
        known.outputs[identity] = str(path)


def note_input(path: str | Path) -> None:
    """Note a file that is read. Raises `InputError` for one that will be written."""
    known, identity = _TASK.get(), _identity(path)
    if known is not None and identity:
        if identity in known.outputs:
            raise _refused(known.outputs[identity], str(path))
        known.inputs[identity] = str(path)


def check_output(path: str | os.PathLike[str]) -> None:
    """Refuse to write `path` where it is an input, or a folder that holds one."""
    known = _TASK.get()
    if known is None:
        return
    identity = _identity(path)
    if identity in known.inputs:
        raise _refused(path, known.inputs[identity])
    if os.path.isdir(path):
        folder = Path(os.path.realpath(path))
        for name in known.inputs.values():
            if folder in Path(os.path.realpath(name)).parents:
                raise InputError(
                    f"Output folder {quoted(path)} holds the input {quoted(name)}, which would be lost; "
                    "give another folder."
                )


def _refused(output: str | os.PathLike[str], source: str) -> InputError:
    return InputError(
        f"Output {quoted(output)} is the input {quoted(source)}, which would be lost; give another name."
    )


def _identity(path: str | os.PathLike[str]) -> Identity | None:
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return (found.st_dev, found.st_ino) if found.st_ino else None


_REASONS = {
    errno.ENOSPC: "the disk is full; free some space or choose another folder",
    errno.EDQUOT: "the disk quota is used up; free some space or choose another folder",
    errno.EACCES: "permission is denied; ask for the right to it, or choose another folder",
    errno.EPERM: "permission is denied; ask for the right to it, or choose another folder",
    errno.EROFS: "the file system is read-only; choose another folder",
    errno.ENOENT: "its folder does not exist; create the folder first",
    errno.ENOTDIR: "its folder is a file; choose another folder",
    errno.EISDIR: "it is a folder; give a file name",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
}
LONGEST_SUFFIX = 16


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it is flushed to disk and renamed to `path`.

    On any failure the temporary is removed and an old file at `path` stays as it was. An `OSError`
    (disk full, permission, missing folder) becomes an `InputError`.
    """
    if not os.fspath(path) or "\0" in os.fspath(path):
        raise InputError("The name of an output must not be empty, nor hold a null character; give a file.")
    check_output(os.fspath(path))
    target = Path(os.path.realpath(path))
    suffix = target.suffix if len(target.suffix) <= LONGEST_SUFFIX else ""
    temporary = target.with_name(f".hallsym-{os.urandom(8).hex()}.tmp{suffix}")
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a directory")
        if target.exists() and not target.is_file():
            raise OSError(0, "it is a device or a pipe, not a file; choose a file name")
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        handle = os.open(temporary, os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
        os.replace(temporary, target)
    except OSError as error:
        raise InputError(f"Cannot write {quoted(path)}: {reason(error)}.") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def atomic_write(path: str | Path, content: bytes | str | Callable[[Path], None]) -> None:
    """Write `content` to `path` through a temporary file in the same folder.

    `content` is bytes, text (stored as UTF-8) or a function that fills the path it is given.
    """
    with replacing(path) as temporary:
        if callable(content):
            content(temporary)
        else:
            data = content.encode() if isinstance(content, str) else content
            with open(temporary, "wb") as stream:
                stream.write(data)


def json_text(record: Any, indent: int | None = 1, **how: Any) -> str:
    """Return a record as JSON (RFC 8259), in ASCII. `how`: further options of `json.dumps`.

    Raises `InputError` that names the first number that is not finite, of which JSON has none.
    """
    try:
        return json.dumps(record, indent=indent, allow_nan=False, **how).replace("\x7f", "\\u007f")
    except ValueError:
        wrong = next(((place, x) for place, x in _numbers(record) if not math.isfinite(x)), None)
        if wrong is None:
            raise
    raise InputError(
        f"Number '{wrong[0]}' of the result must be finite; it is {wrong[1]}: a value of the inputs is far "
        "from what the model expects; look at units and values with 'hallsym info'."
    )


def _numbers(data: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Yield every number of nested data with its place, such as `errors.x_m.1`."""
    if isinstance(data, Mapping | list | tuple):
        for key, value in data.items() if isinstance(data, Mapping) else enumerate(data):
            if not isinstance(value, str | bool) and value is not None:
                yield from _numbers(value, f"{place}.{key}" if place else str(key))
    elif isinstance(data, int | float):
        yield place, data


def write_json(path: str | Path, record: Any) -> None:
    """Write a record as JSON through a temporary file; errors as in `json_text`."""
    atomic_write(path, json_text(record) + "\n")


def reason(error: Exception) -> str:
    """Return in a few words why the system refused to write (or read) a file, on one line."""
    if not isinstance(error, OSError) or not error.strerror:
        return summary(error)  # a name with a null character, say
    return _REASONS.get(error.errno or 0, " ".join(error.strerror.split()).rstrip("."))


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
            raise InputError(f"Cannot read {what.lower()} {quoted(path)}: {reason(error)}.") from error
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
        raise InputError(f"Cannot read {what.lower()} {quoted(path)}: {reason(error)}.") from None
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
        data = json.loads(text, object_pairs_hook=_once)
        wrong = next(((place, x) for place, x in _numbers(data) if not abs(x) <= MOST_NUMBER), None)
    if wrong is not None:
        found = wrong[1] if isinstance(wrong[1], float) else Decimal(wrong[1])  # an integer beyond floats
        raise InputError(
            f"{what} {quoted(path)} must hold numbers of magnitude {MOST_NUMBER:g} at most; '{wrong[0]}' is "
            f"{found:.3g}, so {remedy}."
        )
    return data


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the keys of an object; of one that stands there twice, JSON does not say which is meant."""
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"key {next(key for key in keys if keys.count(key) > 1)!r} is given twice")
    return found


def _neighbour(path: Path) -> str:
    """Return the nearest name in the folder of a file that does not exist."""
    try:
        if not path.parent.is_dir():
            return f"; neither does its folder {quoted(path.parent)}"
        return nearest(path.name, [entry.name for entry in path.parent.iterdir()])
    except OSError:
        return ""
