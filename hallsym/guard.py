"""Within one command no output takes the place of an input: what is read and written is known here."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from hallsym.errors import InputError, quoted

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
    """Keep the inputs of what runs inside apart from its outputs; outside of a task nothing is refused."""
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
