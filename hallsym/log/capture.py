"""Lines of numbers from a serial port, as a log, with times and the number of lost lines."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted, require, summary
from hallsym.log.table import load
from hallsym.log.write import LogWriter
from hallsym.units import require_unit, si_name

COUNTER, SKIP, TIME = "counter", "skip", "t_s"
"""Names of a column that counts lines, of one that is not kept, and of the time."""
WRAPS = (1 << 8, 1 << 16, 1 << 32)
"""Where counters of whole bytes begin again."""
READ_S = 0.05
"""Longest wait for bytes: how late Ctrl-C and the end of the capture are seen."""
PIECE_S = 0.5
"""Time after which received lines are handed to the writer."""
REPEATS = 10
"""Lines of numbers of another length than named, without any of that length, that are no accident."""
LONGEST = 1 << 16
"""Bytes without an end of line that are no line."""
_LABEL = re.compile(rb"[A-Za-z_][\w ]*[:=]")
"""Labels of serial plotters before a number."""


@dataclass
class Lines:
    """Turns bytes into rows of `width` numbers, and counts them.

    `bad`: lines without such numbers after the first good one, `example` is one. `lost`: lines that column
    `counter` misses. `other`: lengths of lines of numbers that have another one. `seconds` of the capture and
    `fault` of the port are known at its end.
    """

    width: int
    counter: int | None = None
    good: int = 0
    bad: int = 0
    lost: int = 0
    example: str = ""
    seconds: float = 0.0
    fault: str = ""
    other: Counter[int] = field(default_factory=Counter)
    _rest: bytes = b""
    _begun: bool = False
    _last: float | None = None

    def rows(self, data: bytes, most: int | None = None) -> list[list[float]]:
        """Return the rows of numbers that are complete now, until there were `most`.

        The first line is left out: it may be the end of one.
        """
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if len(self._rest) > LONGEST:
            lines, self._rest = [*lines, self._rest], b""
        found = []
        for line in lines:
            begun, self._begun = self._begun, True
            if begun and line.strip() and self.good != most and (row := self._row(line)) is not None:
                found.append(row)
        return found

    def _row(self, line: bytes) -> list[float] | None:
        plain = _LABEL.sub(b" ", line) if b":" in line or b"=" in line else line
        try:
            row = [float(cell) for cell in plain.replace(b",", b" ").replace(b";", b" ").split()]
        except ValueError:
            row = []
        if len(row) == self.width and self._counted(row):
            self.good += 1
            return row
        if row:
            self.other[len(row)] += 1
        self.bad += self.good > 0
        if not self.example or row:
            self.example = line.decode("ascii", "replace").strip()[:60]
        return None

    def _counted(self, row: list[float]) -> bool:
        """Count the lines that are missing before a row; refuse a counter that is no whole number."""
        if self.counter is None:
            return True
        now, last = row[self.counter], self._last
        if not now.is_integer():
            return False
        if last is not None and now != last + 1:
            wrap = next((w for w in WRAPS if w > last), WRAPS[-1]) if now <= last else 0
            missed = int(now - last - 1 + wrap)
            self.lost += missed if not wrap or missed < wrap / 2 else 0  # else the board began anew
        self._last = now
        return True


def open_port(name: str, baud: int) -> Any:
    """Open a serial port. Raises `InputError` with one sentence where that cannot be."""
    serial = load("serial")
    require(0 < baud <= 100_000_000, "--baud", "bits a second, such as 115200", baud)
    try:
        return serial.serial_for_url(name, baudrate=baud, timeout=READ_S, exclusive=True)
    except (ValueError, OSError) as error:  # pyserial's own error is an OSError
        number, why = getattr(error, "errno", None), summary(error)
        if number == 2:
            known = [port.device for port in load("serial.tools.list_ports").comports()]
            there = f"there are {', '.join(known)}" if known else "there is none: connect the board"
            raise InputError(f"Port {quoted(name)} does not exist; {there}.") from error
        if number == 13:
            why = (
                "you may not; on Linux join the group of the device (sudo usermod -aG dialout $USER) and log "
                "in again"
            )
        elif number in (11, 16):
            why = "another program has it; close its monitor"
        raise InputError(f"Port {quoted(name)} cannot be opened at {baud} baud: {why}.") from error


def checked(columns: Sequence[str]) -> tuple[str, ...]:
    """Return names of columns that a log can have; `counter` and `skip` are none of it."""
    kept = [name for name in columns if name not in (COUNTER, SKIP)]
    for name in kept:
        require_unit(name)
    si = [si_name(name) for name in kept]
    good = kept and len(set(si)) == len(si) and columns.count(COUNTER) <= 1
    require(good, "--columns", "different names of readings, one counter at most", ",".join(columns))
    return tuple(columns)


def capture(
    port: Any,
    writer: LogWriter,
    columns: Sequence[str],
    *,
    where: str,
    lines: int | None = None,
    duration_s: float | None = None,
    patience_s: float = 5.0,
    stopped: Callable[[], bool] = lambda: False,
    show: Callable[[str], None] = lambda text: None,
    now: Callable[[], float] = monotonic,
) -> Lines:
    """Write lines of numbers from a port until `lines`, `duration_s` or `stopped()`.

    `port`: a serial port of pyserial, or what has its `read` and `in_waiting`. `columns`: names of the
    numbers of a line, with units (`hallsym.units`), `counter` of one that counts lines, `skip` of one that is
    not kept. Without a column of time, `t_s` is the time of arrival, evenly spread over lines that come
    together. Raises `InputError` where nothing comes for `patience_s`, or no line of that many numbers, and
    `KeyboardInterrupt` where it is stopped before one; nothing is written then.
    """
    names = checked(columns)
    reader = Lines(len(names), names.index(COUNTER) if COUNTER in names else None)
    timed = any(si_name(name) == TIME for name in names)
    begin, handed, last, came = now(), now(), now(), b""
    waiting: list[np.ndarray] = []

    def hand() -> None:
        rows = np.concatenate(waiting) if waiting else np.empty((0, len(names) + 1))
        waiting.clear()
        piece = {} if timed else {TIME: rows[:, -1]}
        piece |= {name: rows[:, k] for k, name in enumerate(names) if name not in (COUNTER, SKIP)}
        if len(rows):
            writer.append(piece)

    while not stopped() and (duration_s is None or now() - begin < duration_s) and reader.good != lines:
        try:
            data = port.read(max(1, port.in_waiting))
        except OSError:
            reader.fault = "it was unplugged, or another program reads it too"
            break
        at, came = now(), came or data
        if found := reader.rows(data, lines):
            arrived = last - begin + (at - last) * np.arange(1, len(found) + 1) / len(found)
            waiting.append(np.column_stack([np.array(found), arrived]))
            last = at
        elif not reader.good and (
            at - begin > patience_s or max(reader.other.values(), default=0) >= REPEATS
        ):
            break
        if at - handed >= PIECE_S:
            hand()
            handed, faults = at, f", {reader.bad} bad" if reader.bad else ""
            faults += f", {reader.lost} lost" if reader.lost else ""
            show(f"capturing, {reader.good} lines, {reader.good / (at - begin):.0f} a second{faults}")
    reader.seconds = now() - begin
    if not reader.good:
        if stopped():
            raise KeyboardInterrupt
        require(not reader.fault, f"Port {where}", "there until a line comes", reader.fault)
        raise InputError(_none(reader, where, came))
    hand()
    return reader


def _none(reader: Lines, where: str, came: bytes) -> str:
    """Return why no line of `came` was accepted."""
    if reader.other:
        return (
            f"Lines from {where} have {reader.other.most_common(1)[0][0]} numbers, such as "
            f"{reader.example!r}, but --columns names {reader.width}; name each, 'skip' for those that are "
            "not wanted."
        )
    if not came:
        return (
            f"Nothing came from {where}: look at the cable, at --baud, and whether the board prints at all; "
            "--wait gives it more seconds."
        )
    shown = reader.example or came[:40].decode("ascii", "replace")
    return f"The data from {where} are no lines of numbers, such as {shown!r}: --baud may be another one."
