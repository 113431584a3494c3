"""Lines split into cells under a delimiter; which lines are names, units and data."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hallsym.errors import InputError
from hallsym.log.text.numbers import is_missing, is_number
from hallsym.log.text.units import is_unit_row

BLANKS = " "
DELIMITERS = ("\t", ";", ",", "|", BLANKS)
_STATED = {
    "tab": "\t",
    "\\t": "\t",
    "blank": BLANKS,
    "blanks": BLANKS,
    "space": BLANKS,
    "comma": ",",
    "semicolon": ";",
}
LOOKED_AT = 200
"""Cells of a row that are looked at to tell data from words."""
STEADY = 5
"""Rows of numbers in a row that show where a table begins, above which there may be words."""
_QUOTED = re.compile(r'"[^"\n]*"')


@dataclass(frozen=True)
class Line:
    """A line that is neither empty nor a comment, with its number in the file."""

    number: int
    text: str


@dataclass(frozen=True)
class Table:
    """Where the table is under one delimiter: the cells of each line; `top`: index of the names, -1 for none.

    `width`: cells that most rows have. `quality`: share of numbers, in [0, 1], in the rows under the names.
    """

    delimiter: str
    rows: list[list[str]]
    width: int
    top: int
    data: int
    quality: float

    @property
    def fits(self) -> bool:
        """Whether there are names, as many as the rows have cells."""
        return self.top >= 0 and len(self.rows[self.top]) in (self.width, self.width - self.trailing)

    @property
    def trailing(self) -> int:
        """1 where every row ends with a delimiter."""
        body = self.rows[self.data :]
        return int(self.width > 1 and bool(body) and all(len(r) == self.width and not r[-1] for r in body))


def stated_delimiter(text: str) -> str:
    """Return the delimiter of an option: one character, or a word for one that cannot be typed."""
    if text.lower() in _STATED:
        return _STATED[text.lower()]
    if len(text) != 1 or not text.isascii() or text.isalnum() or text in '"\r\n.+-':
        raise InputError(
            f"Delimiter must be one character such as ';', or 'tab' or 'blank'; instead received {text!r}."
        )
    return text


def split(text: str, delimiter: str) -> list[str]:
    """Return the cells of a line, without blanks and quotes around them."""
    if delimiter == BLANKS:
        return [cell.strip("\"'") for cell in text.split()]
    if '"' in text and _QUOTED.search(text):
        try:
            cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
        except (csv.Error, StopIteration):
            cells = text.split(delimiter)
    else:
        cells = text.split(delimiter)
    return [cell.strip().strip("\"'").strip() for cell in cells]


def table_under(lines: Sequence[Line], delimiter: str) -> Table:
    """Return where a table would be in `lines` if `delimiter` separates its columns."""
    rows = [split(line.text, delimiter) for line in lines]
    counts = Counter(len(row) for row in rows)
    most = max(counts.values(), default=0)
    width = next((len(row) for row in rows if counts[len(row)] == most), 0)
    numeric = [_numeric(row) for row in rows]
    start = _start(rows, numeric, width)
    top = _top(rows, numeric, width, start)
    if top >= 0 and delimiter == BLANKS and len(rows[top]) > width:
        rows[top] = _glued(rows[top], width)
    data = top + 1 if top >= 0 else start
    body = [k for k in range(data, len(rows)) if len(rows[k]) == width]
    cells = sum(min(width, LOOKED_AT) for _ in body)
    held = sum(numeric[k] + sum(map(is_missing, rows[k][:LOOKED_AT])) for k in body)
    share = len(body) / max(1, len(rows) - data)
    return Table(delimiter, rows, width, top, data, share * held / cells if cells else 0.0)


def _glued(names: list[str], width: int) -> list[str]:
    """Return names with the units that stand in brackets behind them: `Time (s)` was two cells."""
    glued: list[str] = []
    for name in names:
        if glued and name[:1] in "([{<":
            glued[-1] += f" {name}"
        else:
            glued.append(name)
    return glued if len(glued) == width else names


def _numeric(row: list[str]) -> int:
    return sum(map(is_number, row[:LOOKED_AT]))


def _start(rows: list[list[str]], numeric: list[int], width: int) -> int:
    """Return the first of several rows that look like data; where the rows are few, of fewer."""
    data = [len(row) == width and n > 0 for row, n in zip(rows, numeric, strict=True)]
    for steady in (STEADY, 2, 1):
        for k in range(len(rows) - steady + 1):
            if all(data[k : k + steady]):
                return k
    return 0


def _top(rows: list[list[str]], numeric: list[int], width: int, start: int) -> int:
    """Return the index of the names: the last row of words above the data, or the one above its units.

    Damaged rows may stand between names and data. -1: there is no row of words.
    """
    words = [k for k in range(start) if not numeric[k] and abs(len(rows[k]) - width) <= 1]
    words = words or [k for k in range(start) if not numeric[k]]
    if words:
        last = words[-1]
        above = last - 1 in words and len(rows[last - 1]) == len(rows[last])
        return last - 1 if above and is_unit_row(rows[last]) else last
    whole = rows and numeric[0] >= min(len(rows[0]), LOOKED_AT)
    return -1 if whole or not rows else 0
