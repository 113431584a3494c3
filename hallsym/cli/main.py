"""The command line: `hallsym fit LOG --model stage31 -o calib.json`."""

import mmap
import os
import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import hallsym
from hallsym.cli import BAD_INPUT, BUG, INTERRUPTED, OK
from hallsym.cli.parser import parser_of
from hallsym.cli.progress import ended
from hallsym.errors import InputError, commanded, one_line, quoted, summary, uncomputable
from hallsym.files import announce, reason, task

DEBUG = "HALLSYM_DEBUG"
"""Environment variable that shows the traceback behind each sentence."""
OUTPUTS = ("output", "plots")
"""Options of all commands that name what is written."""
LEAST_MEMORY = 640 << 20
"""Bytes of address space that the libraries of a fit take at least, with one thread."""
THREAD_MEMORY = 136 << 20
"""Bytes of address space of each further thread of OpenBLAS: 64 MB heap, 8 MB stack, 32 MB in each of two."""


def main(arguments: Sequence[str] | None = None, interrupted: Callable[[], bool] = lambda: False) -> int:
    """Run one command; returns its exit code. Bad input gives one sentence on stderr and 2.

    `interrupted`: whether Ctrl-C was pressed; a library may turn it into another exception.
    """
    if sys.stderr is None:  # closed by the caller, and `print` would write to stdout instead
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    if sys.stdout is None:
        return _said(f"Cannot write to standard output: it is closed; send it to {os.devnull}.", BAD_INPUT)
    try:
        with task(), commanded():
            try:
                return _run(arguments)
            finally:
                ended()
                sys.stdout.flush()
    except InputError as error:
        return _said(str(error), BAD_INPUT, error)
    except BrokenPipeError:
        _silence(sys.stdout)
        return OK
    except OSError as error:
        _silence(sys.stdout)
        what = f"read or write {quoted(error.filename)}" if error.filename else "write to standard output"
        return _said(f"Cannot {what}: {reason(error)}.", BAD_INPUT, error)
    except MemoryError as error:
        return _said(LITTLE_MEMORY, BAD_INPUT, error)
    except (KeyboardInterrupt, Exception) as error:
        if interrupted() or isinstance(error, KeyboardInterrupt):
            return _said("interrupted; nothing was written.", INTERRUPTED)
        if isinstance(error, ImportError) and _limited():  # a library that could not be mapped
            return _said(LITTLE_MEMORY, BAD_INPUT, error)
        if type(error).__name__ == "LinAlgError":  # by name, because a command without numbers has no numpy
            return _said(str(uncomputable(error)), BAD_INPUT, error)
        return _said(_bug(error), BUG, error)


def _run(arguments: Sequence[str] | None) -> int:
    words = sys.argv[1:] if arguments is None else arguments
    called = [word for word in words if not word.startswith("-")][:1]
    if called:
        _check_memory()
    parser = parser_of(called)
    options = parser.parse_args(arguments)
    if options.version:
        print(f"hallsym {hallsym.__version__}")
        return OK
    if options.command is None:
        parser.print_help()
        return OK
    options.typed = ["hallsym", *words]
    _check(options)
    _take_buffers()
    return options.run(options)


LITTLE_MEMORY = "There is not enough memory; use fewer samples or a larger machine."


def _limited() -> bool:
    """Return whether the address space of this process is limited."""
    with suppress(ImportError):
        import resource

        return resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
    return False


def _check_memory() -> None:
    """Raise `MemoryError` where the libraries do not fit: OpenBLAS would ask without end, deaf to Ctrl-C."""
    stated = os.environ.get("OPENBLAS_NUM_THREADS", "")
    threads = int(stated) if stated.isdecimal() else os.cpu_count() or 1
    try:
        mmap.mmap(-1, LEAST_MEMORY + (threads - 1) * THREAD_MEMORY).close()
    except OSError as error:
        raise MemoryError from error


def _take_buffers() -> None:
    """Let each OpenBLAS that is loaded take its buffer while there is memory; it keeps the buffer."""
    if "scipy.linalg" in sys.modules:
        import numpy as np
        from scipy.linalg.lapack import dgetrf

        np.linalg.solve(np.eye(1), np.eye(1))
        dgetrf(np.eye(1))


def _check(options: Namespace) -> None:
    """Refuse empty words, which would be taken for no option, and outputs that are inputs."""
    for name, value in vars(options).items():
        if value == "" or (isinstance(value, list) and "" in value):
            words = pairwise([*options.typed, "-"])
            empty = [
                w.rstrip("=") for w, after in words if w.startswith("-") and (w.endswith("=") or not after)
            ]
            option = empty[0] if empty else name.upper()
            raise InputError(f"{option} must not be empty; give a value or leave it out.")
    for name in OUTPUTS:
        given = getattr(options, name, None) or []
        for path in [given] if isinstance(given, str) else given:
            announce(path)


def _said(sentence: str, code: int, error: BaseException | None = None) -> int:
    """Print one sentence on stderr; with the environment variable `HALLSYM_DEBUG` after the traceback."""
    if error is not None and os.environ.get(DEBUG):
        import traceback

        traceback.print_exception(error)
    try:
        print(f"hallsym: {one_line(sentence)}", file=sys.stderr)
    except OSError:
        _silence(sys.stderr)
    return code


def _bug(error: Exception) -> str:
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    place = f" at {Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno}" if frame else ""
    return (
        f"This is a mistake in hallsym, not in your input: {type(error).__name__} ({summary(error)}){place}; "
        f"please report it with the command and what it prints with {DEBUG}=1."
    )


def _silence(stream: TextIO) -> None:
    """Discard further output, so that nothing is raised when the interpreter ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
