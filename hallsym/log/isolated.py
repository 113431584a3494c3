"""Decoding in an isolated process: a damaged file may crash that process, never the caller.

Some libraries in C crash on some damaged files, or take all memory and time. A decoder opens a file and sends
its columns through a pipe; the operating system limits its memory and its time.
"""

from __future__ import annotations

import atexit
import math
import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from hallsym.errors import InputError
from hallsym.log.table import Source, about
from hallsym.units import Array

MEMORY = 3 << 29
"""Bytes that a decoder may map, its libraries (0.7e9) included, beside `EXPANSION` times the file."""
EXPANSION = 8
"""Largest ratio of the content of a file to its size: deflate reaches that on smooth readings."""
SECONDS = 60
"""Processor time for one answer: 65,536 rows, or the whole file."""
_START = "import sys; sys.path[:] = sys.argv[1:]; from hallsym.log.isolated import serve; serve()"

_IDLE: list[Decoder] = []


class Isolated(Source):
    """The columns of a file that a decoder opens with `reader`, a function of a module."""

    def __init__(self, reader: Callable[..., Source], path: Path, **options: str | None) -> None:
        """Open the file."""
        self._file = reader, path.absolute(), tuple(options.items())
        with _decoder() as decoder:
            vars(self).update(decoder.ask("about", self._file))

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most about `size` rows."""
        with _decoder() as decoder:
            piece = decoder.ask("chunks", self._file, names, size)
            try:
                while piece is not None:
                    yield piece
                    piece = decoder.ask("next", self._file)
            finally:
                if piece is not None and decoder.ready:
                    decoder.ask("about", self._file)  # closes what nobody reads on


class Decoder:
    """A process that decodes files, one answer for each question; `ready`: whether all are answered."""

    def __init__(self) -> None:
        """Start the process: a third of a second, as it loads libraries."""
        self._process = subprocess.Popen(
            [sys.executable, "-c", _START, *sys.path],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        self.ready = True

    def ask(self, *question: Any) -> Any:
        """Return the answer to a question.

        Raises what the reader raised; `ValueError` where the decoder died of the file.
        """
        assert self._process.stdin
        assert self._process.stdout
        self.ready = False
        try:
            with suppress(BrokenPipeError):
                pickle.dump(question, self._process.stdin)
                self._process.stdin.flush()
            answer = pickle.load(self._process.stdout)
            self.ready = True
        except (EOFError, pickle.UnpicklingError):
            answer = ValueError(_ended(self._process.wait()))
        if isinstance(answer, Exception):
            raise MemoryError if _scarce() and not isinstance(answer, InputError) else answer
        return answer

    def end(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.communicate()


def _scarce() -> bool:
    """Return whether a decoder may map less than it needs: then libraries fail in every way."""
    with suppress(ImportError):
        import resource

        return 0 <= resource.getrlimit(resource.RLIMIT_AS)[1] < MEMORY
    return False


def _ended(code: int) -> str:
    """Return why a decoder ended, in words."""
    if code == -getattr(signal, "SIGXCPU", 0):
        return f"decoding it takes more than {SECONDS} s"
    return f"decoding it crashed with {signal.Signals(-code).name if code < 0 else f'exit code {code}'}"


@contextmanager
def _decoder() -> Iterator[Decoder]:
    """Lend a decoder that nobody else uses; it is kept for the next file where it still answers."""
    decoder = _IDLE.pop() if _IDLE else Decoder()
    try:
        yield decoder
    finally:
        if decoder.ready:
            _IDLE.append(decoder)
        else:
            decoder.end()


@atexit.register
def end_decoders() -> None:
    """End the processes that wait for a next file."""
    while _IDLE:
        _IDLE.pop().end()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_IDLE.clear)


# -- the other process -----------------------------------------------------------------------------------


def serve() -> None:
    """Answer questions from standard input until it ends; what libraries print goes nowhere."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that asks ends this one
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    pieces: Iterator[Mapping[str, Array]] = iter(())
    with suppress(EOFError):
        while True:
            what, file, *rest = pickle.load(sys.stdin.buffer)
            try:
                state = os.stat(file[1])
                _limit(state.st_size)
                source = _opened(file, state.st_size, state.st_mtime_ns)
                if what in ("chunks", "next"):
                    pieces = source.chunks(*rest) if rest else pieces
                    answer: Any = next(pieces, None)
                else:
                    pieces = iter(())
                    answer = about(source)
            except (InputError, MemoryError, OSError) as error:
                answer = error
            except Exception as error:  # of a class that only the library may know
                answer = ValueError(str(error) or type(error).__name__)
            pickle.dump(answer, answers, 5)
            answers.flush()


def _limit(size: int) -> None:
    """Limit memory and time for an answer on a file of `size` bytes, where the system can."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        for what, limit in (
            (resource.RLIMIT_AS, MEMORY + EXPANSION * size),
            (resource.RLIMIT_CPU, math.ceil(time.process_time()) + SECONDS),
        ):
            resource.setrlimit(what, (limit, resource.getrlimit(what)[1]))


@lru_cache(1)
def _opened(file: tuple[Any, Path, tuple[tuple[str, str], ...]], *state: int) -> Source:
    """Open a file; `state` is another one when it was written again."""
    return file[0](file[1], **dict(file[2]))
