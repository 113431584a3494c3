"""Writing files so that a reader sees the old one or the new one, never half of one."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, quoted, summary
from hallsym.guard import check_output

_REASONS = {
    errno.ENOSPC: "the disk is full; free some space or choose another folder",
    errno.EDQUOT: "the disk quota is used up; free some space or choose another folder",
    errno.EACCES: "permission is denied; choose a folder you may write to",
    errno.EPERM: "permission is denied; choose a folder you may write to",
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


def write_json(path: str | Path, record: Any) -> None:
    """Write a record as JSON through a temporary file; it holds no number that is not finite."""
    atomic_write(path, json.dumps(record, indent=1, allow_nan=False) + "\n")


_READING = {
    errno.EACCES: "permission is denied; ask for the right to read it",
    errno.EPERM: "permission is denied; ask for the right to read it",
}


def reason(error: Exception, *, reading: bool = False) -> str:
    """Return in a few words why the system refused to write (or read) a file, on one line."""
    if not isinstance(error, OSError) or not error.strerror:
        return summary(error)  # a name with a null character, say
    known = _REASONS | _READING if reading else _REASONS
    return known.get(error.errno or 0, " ".join(error.strerror.split()).rstrip("."))
