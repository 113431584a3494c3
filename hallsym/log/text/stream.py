"""The table of a file as a stream that pyarrow reads: one line per sample, nothing else."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from typing import Any

from hallsym.log.text.encoding import END, Encoded, whole_lines
from hallsym.log.text.numbers import COMMA, as_float
from hallsym.log.text.sniff import Dialect

INSIDE = "\x1f"
"""Stands for a delimiter within quotes."""
_EMPTY = re.compile(rb"^[ \t]*(?:\n|\Z)", re.MULTILINE)
_BLANK = b"\n", b" ", b"\t"


class Cleaner:
    """Takes out of lines what is no cell: comments, empty lines, quotes, blanks, separators of thousands."""

    def __init__(self, dialect: Dialect) -> None:
        self.steps: list[Callable[[bytes], bytes]] = [_without_empty, *_without_comments(dialect)]
        if dialect.quoted == "inside":
            self.steps.append(_unquoting(dialect))
        elif dialect.quoted:
            self.steps.append(lambda lines: lines.replace(b'"', b""))
        if dialect.delimiter == " ":
            self.steps += [_trimmed, _tabbed]
        elif dialect.padded:
            self.steps.append(_unpadding(dialect.delimiter))
        if dialect.numbers.grouping:
            self.steps.append(_ungrouping(dialect.numbers.grouping))
        self.delimiter = "\t" if dialect.delimiter == " " else dialect.delimiter

    def __call__(self, lines: bytes) -> bytes:
        r"""Return whole lines, separated by \n, as they are read; empty where nothing is left."""
        for step in self.steps:
            lines = step(lines)
        return lines


class TableStream(io.RawIOBase):
    """The lines of the table, clean, as a binary stream."""

    def __init__(self, file: Encoded, dialect: Dialect, where: str, size: int) -> None:
        """Start at the first sample; pieces have about `size` bytes."""
        self._pieces = self.pieces(file, dialect, where, size)
        self._rest = memoryview(b"")

    @staticmethod
    def pieces(file: Encoded, dialect: Dialect, where: str, size: int) -> Iterator[bytes]:
        """Yield the clean lines of the table in pieces that end with a newline."""
        clean = Cleaner(dialect)
        for piece in _table(file, dialect, where, size):
            if cleaned := clean(piece):
                yield cleaned + b"\n"

    def readable(self) -> bool:
        """Say that it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer; 0 at the end."""
        if not self._rest:
            self._rest = memoryview(next(self._pieces, b""))
        count = min(len(buffer), len(self._rest))
        buffer[:count] = self._rest[:count]
        self._rest = self._rest[count:]
        return count


def _table(file: Encoded, dialect: Dialect, where: str, size: int) -> Iterator[bytes]:
    """Yield the lines from the first sample to the last one."""
    above = dialect.first - 1
    waiting: list[bytes] = []  # what may hold lines after the table
    for piece in whole_lines(file.pieces(size), where):
        if above:
            count = piece.count(b"\n") + 1
            if count <= above:
                above -= count
                continue
            piece = piece.split(b"\n", above)[above]
            above = 0
        waiting.append(piece)
        while waiting and (not dialect.footer or sum(map(len, waiting[1:])) > END):
            yield waiting.pop(0)
    last = b"\n".join(waiting)
    if dialect.footer and waiting:
        last = last.rstrip(b"\n")
        for _ in range(dialect.footer):
            last = last.rpartition(b"\n")[0]
    if last:
        yield last


# -- steps -----------------------------------------------------------------------------------------------


def _without_empty(lines: bytes) -> bytes:
    """Take out lines of nothing but blanks, if anything begins as one: that is found ten times as fast."""
    if not lines.startswith(_BLANK) and not any(b"\n" + first in lines for first in _BLANK):
        return lines.removesuffix(b"\n")
    return _EMPTY.sub(b"", lines).removesuffix(b"\n")


def _without_comments(dialect: Dialect) -> Iterator[Callable[[bytes], bytes]]:
    marks = [mark.encode() for mark in dialect.comments]
    pattern = re.compile(
        rb'^[ \t"]*(?:' + b"|".join(map(re.escape, marks)) + rb")[^\n]*(?:\n|\Z)", re.MULTILINE
    )

    def without(lines: bytes) -> bytes:
        if not any(mark in lines for mark in marks):
            return lines
        return pattern.sub(b"", lines).removesuffix(b"\n")

    yield without


def _unquoting(dialect: Dialect) -> Callable[[bytes], bytes]:
    """Take quotes away; a decimal comma between them becomes a point, another delimiter a mark."""
    quotes = re.compile(rb'"([^"\n]*)"')
    comma = dialect.delimiter == "," and dialect.numbers.decimal == ","
    delimiter = dialect.delimiter.encode()

    def bare(match: re.Match[bytes]) -> bytes:
        cell = match[1]
        if comma and as_float(cell.decode("utf-8", "replace").strip(), dialect.numbers) is not None:
            grouping = dialect.numbers.grouping.encode()
            return (cell.replace(grouping, b"") if grouping else cell).replace(b",", b".")
        if dialect.numbers.grouping == dialect.delimiter:
            return (
                cell.replace(delimiter, b"") if as_float(cell.decode(), dialect.numbers) is not None else cell
            )
        return cell.replace(delimiter, INSIDE.encode())

    return lambda lines: quotes.sub(bare, lines)


def _unpadding(delimiter: str) -> Callable[[bytes], bytes]:
    mark = delimiter.encode()
    blank = rb" *" if delimiter == "\t" else rb"[ \t]*"
    pattern = re.compile(blank + re.escape(mark) + blank)
    ends = re.compile(rb"(?m)^ +| +$")
    return lambda lines: ends.sub(b"", pattern.sub(lambda _: mark, lines))


def _trimmed(lines: bytes) -> bytes:
    return re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", lines)


def _tabbed(lines: bytes) -> bytes:
    return re.sub(rb"[ \t]+", b"\t", lines)


def _ungrouping(grouping: str) -> Callable[[bytes], bytes]:
    """Take separators of thousands out of numbers, and out of nothing else."""
    mark = re.escape(grouping.encode())
    pattern = re.compile(rb"(?<=\d)" + mark + rb"(?=\d{3}(?!\d))")
    return lambda lines: pattern.sub(b"", lines)


def decimal_of(dialect: Dialect) -> str:
    """Return the decimal sign that clean lines have."""
    if dialect.delimiter == "," and dialect.numbers.decimal == ",":
        return "."
    return COMMA.decimal if dialect.numbers.decimal == "," else "."
