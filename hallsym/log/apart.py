"""Decoding in a process of its own: a damaged file may crash that process, never the one that asks.

Some libraries in C crash on some damaged files, or take all memory and time. A decoder opens a file and sends
its columns through a pipe; the operating system limits its memory and its time.
"""

from __future__ import annotations

import atexit
import importlib
import json
import math
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.table import Source
from hallsym.units import Array

MEMORY = 3 << 29
"""Bytes that a decoder may map, its libraries (0.7e9) included, beside `EXPANSION` times the file."""
EXPANSION = 8
"""How many times larger than its file what it holds may be: deflate reaches that on smooth readings."""
SECONDS = 60
"""Of the processor for one answer: 65,536 rows, or what the file holds."""
ABOUT = ("names", "rows", "small", "left_out", "aliases", "units", "notes", "recognised", "unstated")
"""What a decoder says of a source."""
_START = "import sys; sys.path[:] = sys.argv[1:]; from hallsym.log.apart import serve; serve()"

_IDLE: list[Decoder] = []


class Apart(Source):
    """The columns of a file that a decoder opens with `reader`, a function of a module."""

    def __init__(self, reader: Callable[..., Source], path: Path, **options: str | None) -> None:
        """Open the file."""
        self._file = [reader.__module__, reader.__qualname__, str(path.absolute()), options]
        with _decoder() as decoder:
            for name, value in decoder.ask("about", self._file)[0].items():
                setattr(self, name, value)

    def count(self) -> int:
        """Return the number of rows."""
        with _decoder() as decoder:
            return int(decoder.ask("count", self._file)[0])

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most about `size` rows."""
        with _decoder() as decoder:
            more, piece = decoder.ask("chunks", self._file, list(names), size)
            try:
                while more:
                    yield piece
                    more, piece = decoder.ask("next")
            finally:
                if more and decoder.ready:  # the file is closed where nobody reads on
                    decoder.ask("stop", self._file)


class Decoder:
    """A process that decodes files, one answer for each question."""

    def __init__(self) -> None:
        """Start the process: a third of a second, as it loads libraries."""
        self._process = subprocess.Popen(
            [sys.executable, "-c", _START, *sys.path],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        self.ready = True

    def ask(self, *question: Any) -> tuple[Any, dict[str, Array]]:
        """Return the answer to a question and the columns that go with it.

        Raises what the reader raised; `ValueError` where the decoder died of the file.
        """
        assert self._process.stdin
        assert self._process.stdout
        self.ready = False
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(question).encode() + b"\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        whole = line.endswith(b"\n")
        answer = json.loads(line) if whole else {}
        columns = {name: np.empty(rows, kind) for name, kind, rows in answer.get("columns", ())}
        for values in columns.values():
            whole = whole and self._process.stdout.readinto(values.view(np.uint8)) == values.nbytes
        if not whole:
            raise ValueError(_ended(self._process.wait()))
        self.ready = True
        if "raised" in answer:
            raise _RAISED.get(answer["raised"], ValueError)(*answer["with"])
        return answer["said"], columns

    def end(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.communicate()


_RAISED = {kind.__name__: kind for kind in (InputError, MemoryError, OSError)}


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
    os.register_at_fork(after_in_child=lambda: _IDLE.clear())


# -- the other process -----------------------------------------------------------------------------------


def serve() -> None:
    """Answer questions from standard input until it ends; what libraries print goes nowhere."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that asks ends this one
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    pieces: Iterator[Mapping[str, Array]] = iter(())
    file: list[Any] = []
    for line in sys.stdin.buffer:
        what, *rest = json.loads(line)
        piece: Mapping[str, Array] | None = {}
        try:
            file, pieces = (file, pieces) if what == "next" else (rest[0], iter(()))
            size, changed = os.path.getsize(file[2]), os.stat(file[2]).st_mtime_ns
            _limit(size)
            source = _opened(json.dumps(file), size, changed)
            said: Any = True
            if what == "about":
                said = {name: getattr(source, name) for name in ABOUT}
            elif what == "count":
                said = source.count()
            else:
                pieces = source.chunks(*rest[1:]) if what == "chunks" else pieces
                piece = next(pieces, None)
                said = piece is not None
        except Exception as error:
            named = next((name for name, kind in _RAISED.items() if isinstance(error, kind)), "")
            stated = [error.errno, error.strerror] if isinstance(error, OSError) and error.errno else []
            _answer(answers, {"raised": named, "with": stated or [str(error) or type(error).__name__]}, {})
            continue
        _answer(answers, {"said": said}, piece or {})


def _answer(stream: IO[bytes], answer: Mapping[str, Any], columns: Mapping[str, Array]) -> None:
    shapes = [(name, values.dtype.str, len(values)) for name, values in columns.items()]
    stream.write(json.dumps({**answer, "columns": shapes}).encode() + b"\n")
    for values in columns.values():
        stream.write(np.ascontiguousarray(values).view(np.uint8))
    stream.flush()


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
def _opened(file: str, *state: int) -> Source:
    """Open the file of a question; `state` is another one when it was written again."""
    module, function, path, options = json.loads(file)
    return getattr(importlib.import_module(module), function)(Path(path), **options)  # type: ignore[no-any-return]
