"""Progress of long work on stderr: one line that is redrawn on a terminal; elsewhere nothing unless asked."""

import os
import sys
from collections.abc import Callable
from threading import Event, RLock, Thread
from time import monotonic
from typing import TextIO

from hallsym.output import Step, columns, printable, said_time

ASKED = "HALLSYM_PROGRESS"
"""Environment variable that asks for a line now and then where there is no terminal."""
EVERY_S = 5.0
"""Seconds between such lines: some hundreds of them in an hour."""
REDRAWN_S = 0.1
"""Seconds between two drawings of the line on a terminal."""
SURE = 0.02
"""Share of the work above which the remaining time is extrapolated from the time it took."""
LEAST_S = 1.0
"""Time that work takes at least before it is said how long it took; seconds between drawings on a terminal of
work that says nothing meanwhile."""

_SHOWN: list["Meter"] = []


class Meter:
    """Shows the current step, and the time that remains or passed; `end` removes the line.

    A step that takes long is shown again by a thread, with its time.
    """

    def __init__(self, stream: TextIO | None = None, now: Callable[[], float] = monotonic) -> None:
        """Begin the clock; `stream` is stderr by default."""
        self._stream = stream or sys.stderr
        self._now = now
        self._redrawn = self._stream.isatty()
        self._silent = not (self._redrawn or os.environ.get(ASKED))
        self._text, self._began, self._shown = "", now(), now()
        self._lock, self._ended = RLock(), Event()
        _SHOWN.append(self)

    def __call__(self, text: str) -> None:
        """Show a text; the share of a `Step` that is done gives the remaining time."""
        if self._silent:
            return
        with self._lock:
            now, before = self._now(), self._text
            again = isinstance(text, Step) and isinstance(before, Step) and text.share < before.share
            if _head(text) != _head(before) or again:
                self._began = now
            self._text = text
            if self._redrawn and not before:
                self.draw()
            self._draw_after(REDRAWN_S if self._redrawn else EVERY_S)
        if not before:
            Thread(target=self._tick, daemon=True).start()

    def _draw_after(self, seconds: float) -> None:
        with self._lock:
            if self._now() - self._shown >= seconds and not self._ended.is_set():
                self.draw()

    def _tick(self) -> None:
        seconds = LEAST_S if self._redrawn else EVERY_S
        while not self._ended.wait(seconds):
            self._draw_after(seconds)

    def draw(self) -> None:
        """Show the line as it is now."""
        self._shown = self._now()
        line = ", ".join(filter(None, (printable(self._text), self._time(self._shown - self._began))))
        if self._redrawn:
            most = (columns() or len(line) + 1) - 1
            line = line if len(line) <= most else f"{line[: most - 3]}..."
            print(f"\r\033[K{line}", end="", file=self._stream, flush=True)
        else:
            print(f"hallsym: {line}", file=self._stream, flush=True)

    def end(self) -> None:
        """Show nothing more; what follows begins on an empty line."""
        with self._lock:
            self._ended.set()
        if self._redrawn and self._text:
            print("\r\033[K", end="", file=self._stream, flush=True)

    def _time(self, taken: float) -> str:
        if isinstance(self._text, Step) and self._text.share >= SURE:
            return f"{said_time(taken * (1 / min(self._text.share, 1.0) - 1))} left"
        return f"{said_time(taken)} so far" if taken >= LEAST_S else ""


def ended() -> None:
    """End what is shown of every work: the command is done, was refused or interrupted."""
    while _SHOWN:
        _SHOWN.pop().end()


def _head(text: str) -> str:
    return text.partition(",")[0]
