"""Recognise the form of a text file from its first and last lines; an ambiguous one must be stated."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import os
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, NamedTuple

from hallsym.errors import InputError
from hallsym.log.arrow import time_form
from hallsym.log.columns import split_header, stems_of, unit_of
from hallsym.log.text.cells import (
    ARRIVED,
    LABELS,
    MISSING,
    POINT,
    Convention,
    Spelling,
    conventions_of,
    is_number,
    is_unit_row,
    labels_of,
    spellings_of,
    unit_behind,
)
from hallsym.units import quantity, split_unit

BLANKS = " "
DELIMITERS = {"\t": "tab", ";": "semicolon", ",": "comma", "|": "bar", BLANKS: "blank"}
"""Separators of columns, with their words for `--delimiter`."""


@dataclass(frozen=True)
class Dialect:
    """The recognised form of a text.

    `text`: its bytes; transposed where a line is a channel. `delimiter`: " " stands for any number of
    blanks and tabs. `stems`: as `stems_of`, one by cell. `first`: line the table begins at, from 1.
    `remarks`: whether lines of words stand between or after the rows.
    `quoted`: whether quotes stand around cells. `times`: columns of times as text, and how they are written
    (`time_form`). `torn`: whether the last line does not end. `spelled`: how numbers are written otherwise.
    `repeated`: the lines of names and units, which come again where files were put one behind another;
    `heads`: the first cells of lines above them, no names, which come again with other values.
    `facts`: what the lines above say, by name. `said`: one line on all of it; `usual`: whether it needs no
    word.
    """

    text: Encoded
    delimiter: str
    stems: dict[str, tuple[str, str | None]]
    first: int
    numbers: Convention
    comments: tuple[str, ...]
    quoted: bool
    remarks: bool
    torn: bool
    times: dict[int, str]
    spelled: tuple[Spelling, ...]
    repeated: frozenset[str]
    heads: frozenset[str]
    facts: dict[str, str]
    said: str
    usual: bool

    @property
    def sign(self) -> str:
        """What separates the cells of clean lines."""
        return "\t" if self.delimiter == BLANKS else self.delimiter


def stated_delimiter(text: str) -> str:
    """Return the delimiter of an option: one character, or the word for it."""
    known = {word: delimiter for delimiter, word in DELIMITERS.items()} | {"\\t": "\t", "space": BLANKS}
    delimiter = known.get(text.lower().removesuffix("s"), text)
    if len(delimiter) != 1 or not delimiter.isascii() or delimiter.isalnum() or delimiter in '"\r\n.+-':
        raise InputError(
            f"Delimiter must be one character such as ';', or 'tab' or 'blank'; instead received {text!r}."
        )
    return delimiter


_QUOTED = re.compile(r'"[^"\n]*"')
_BETWEEN_BLANKS = re.compile(r"\w\S*(?:\s+[(\[{<]\S*)?|\S+")
"""A cell between blanks; a unit in brackets belongs to the name before it: `Time (s)` is one cell."""


def split(text: str, delimiter: str) -> list[str]:
    """Return the cells of a line, without blanks and quotes around them."""
    if delimiter == BLANKS:
        return [cell.strip("\"'") for cell in _BETWEEN_BLANKS.findall(text)]
    cells = text.split(delimiter)
    if '"' in text and _QUOTED.search(text):
        cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), cells)
    return [cell.strip().strip("\"'").strip() for cell in cells]


# -- where the table is ----------------------------------------------------------------------------------


LOOKED_AT = 200
"""Cells of a row that are looked at to tell data from words."""
STEADY = 5
"""Rows of numbers in a row that show where a table begins, above which there may be words."""


class Line(NamedTuple):
    """A line that is not empty, with its number in the file; of a comment, the text behind its mark."""

    number: int
    text: str
    comment: bool = False


class Split:
    """Lines split by one delimiter, and the table in them.

    `rows`: the cells of each line; `width`: how many most rows have. `top`: index of the names, -1 for none;
    `data`: of the first row under them. `quality`: share of numbers, in [0, 1], in the rows from there on.
    """

    def __init__(self, lines: Sequence[Line], delimiter: str) -> None:
        self.delimiter = delimiter
        rows = [split(line.text, delimiter) for line in lines]
        counts = Counter(len(row) for row, line in zip(rows, lines, strict=True) if not line.comment)
        self.width = max(counts, key=lambda n: counts[n], default=0)
        for k, row in enumerate(rows):
            if lines[k].comment:
                rows[k] = row if len(row) == self.width else []
        self.rows = rows
        numeric = [sum(map(is_number, row[:LOOKED_AT])) for row in self.rows]
        self.top, self.data = self._top(numeric)
        below = [k for k in range(self.data, len(rows)) if len(self.rows[k]) == self.width]
        filled = sum(numeric[k] + sum(cell in MISSING for cell in self.rows[k][:LOOKED_AT]) for k in below)
        cells = min(self.width, LOOKED_AT) * (len(rows) - self.data)
        self.quality = filled / cells if cells else 0.0

    def _top(self, numeric: Sequence[int]) -> tuple[int, int]:
        """Return the index of the names and of the first row of data under them.

        The names are those words above the data, no units, that differ most from each other; of several such
        rows those with most units, then the last.
        """
        count, width = len(self.rows), self.width
        usual = sorted(n for row, n in zip(self.rows, numeric, strict=True) if len(row) == width and n)
        half = usual[len(usual) // 2] / 2 if usual else 0.0  # a row of settings has fewer numbers
        data = [len(row) == width and n > half for row, n in zip(self.rows, numeric, strict=True)]
        start = next(  # of several rows that look like data; where the rows are few, of fewer
            (k for n in (STEADY, 2, 1) for k in range(count) if data[k : k + n] == [True] * n), 0
        )
        least = min(width, 2)  # cells: a title names no columns
        words = [k for k in range(start) if len(self.rows[k]) >= least and not numeric[k]]
        words = [k for k in words if abs(len(self.rows[k]) - width) <= 1] or words[-1:]
        if words:
            names = [k for k in words if not is_unit_row(self.rows[k])] or words
            units = {k: sum(bool(split_header(cell)[1]) for cell in self.rows[k]) for k in names}
            differ = {k: min(len({*self.rows[k]} - {""}), width) for k in names}
            return max(names, key=lambda k: (differ[k], units[k], k)), words[-1] + 1
        first = next((k for k, row in enumerate(self.rows) if row), -1)
        if first < 0 or self._is_data(*self.rows[first : first + 2]):
            return -1, 0
        return (first, first + 1) if len(self.rows[first]) >= least else (-1, start)

    @staticmethod
    def _is_data(row: Sequence[str], below: Sequence[str] = ()) -> bool:
        """Say whether a row holds numbers wherever the one below it does; those that count are names."""
        here, under = ([*map(is_number, cells[:LOOKED_AT])] for cells in (row, below))
        numbers = [cell for cell in row[:LOOKED_AT] if is_number(cell)]
        counted = numbers in ([str(k + first) for k in range(len(numbers))] for first in (0, 1))
        return all(here) or (any(here) and here == under and not counted)

    @property
    def groups(self) -> list[str]:
        """What each name is one of, by a row above the names in which the same words stand side by side."""
        row = self.rows[self.top - 1] if self.top > 0 else []
        spans = [word for word, _ in groupby(row)]
        side = any(word and word == after for word, after in pairwise(row))
        several = side and len({*spans} - {""}) > 1 and len({*spans}) == len(spans) and len(row) == self.width
        return [] if not several or any(map(is_number, row)) or is_unit_row(row) else row

    def is_transposed(self, rows: Sequence[Sequence[str]]) -> bool:
        """Say whether each row holds a channel: its name, perhaps its unit, then numbers, more than rows."""
        first = rows[0] if rows and len(rows[0]) == self.width else []
        words = next((k for k, cell in enumerate(first) if is_number(cell)), 0)
        names = [row[0] for row in rows]
        return (
            0 < words < 3
            and 1 < len(rows) == len({*names} - {""}) < self.width - words
            and not time_form(names)
            and all(len(row) == self.width and not any(map(is_number, row[:words])) for row in rows)
            and all(is_number(cell) for row in rows for cell in row[words:LOOKED_AT])
        )

    @property
    def spare(self) -> int | None:
        """Place of the column that needs no name: rows begin with their number, begin or end with nothing."""
        rows = [row for row in self.rows[self.data :] if len(row) == self.width > 1]
        first, last = ([row[k] for row in rows] for k in (0, -1))
        counted = first in ([str(k + zero) for k in range(len(rows))] for zero in (0, 1))
        empty = [k for k, cells in ((0, first), (self.width - 1, last)) if not any(cells)]
        return None if not rows else 0 if counted else max(empty, default=None)

    @property
    def names(self) -> list[str]:
        """The cells of the line of names."""
        return self.rows[self.top] if self.top >= 0 else []

    @property
    def fit(self) -> tuple[bool, bool, float, int]:
        """How well the delimiter fits, best where names and rows have as many cells, which are numbers.

        Several columns go before one: 0,5 is a number too.
        """
        fits = len(self.names) == self.width and self.quality > 0
        several = self.width > 1 and self.quality >= 0.5
        return fits or self.top < 0, several, round(self.quality, 2), self.width

    def units(self, lines: Sequence[Line]) -> tuple[int, int, list[str]]:
        """Return the first row of data, the line of the units (0 without one) and the units' cells."""
        below = self.rows[self.data + 1 : self.data + 1 + STEADY]
        for k in range(self.top + 1, min(self.data + 1, len(self.rows))):
            row = self.rows[k]  # of which a column without samples may hold a number
            shown = [c for j, c in enumerate(row) if k < self.data or any(j < len(r) and r[j] for r in below)]
            if len(row) == len(self.names) and is_unit_row(shown):
                return max(self.data, k + 1), lines[k].number, row
        for k in range(self.data - 1, -1, -1):  # a row of a header: its name, then units
            cells = split(lines[k].text, self.delimiter)
            units = [cell for cell in cells[1:] if cell]
            if len(units) > 1 and 3 * len(units) >= self.width and all(map(unit_of, units)):
                behind = len(cells) > self.width  # a word of its own, which stands over no column
                return self.data, lines[k].number, cells[1:] if behind else ["", *cells[1:]]
        return self.data, 0, []


SAMPLE = 1 << 18
"""Characters of the beginning that are looked at, and more where its lines are long."""
FEW = 12
"""Lines that are looked at at least."""
MOST, NUMBERS = 100, 4000
"""Lines that are looked at at most to find the table, and for how its numbers are written."""
LAST = 20
"""Lines at the end of a text that are looked at for words about the table."""
_COMMENTS = ("#", "%", "//", "!")
_WORD = re.compile(r"[^\W\d_][\w ]")
_BEGINS = re.compile(rf"[\s\"',;|]*(?:{_WORD.pattern}|\*)")


def sniffed(
    text: Encoded, where: str, delimiter: str | None = None, decimal: str | None = None, sheet: str = ""
) -> Dialect:
    """Recognise a text. `where` names it in messages; `delimiter` and `decimal` are what somebody stated.

    `sheet`: of a workbook. Raises `InputError` for what is no table with names, and for numbers that can be
    read in two ways.
    """
    lines, marks = _sample(text, where)
    if all(line.comment for line in lines):
        raise InputError(
            f"{where} is empty: it must hold a header line with column names and one line per sample."
        )
    spelled, written = spellings_of([line.text for line in lines]), lines
    for spelling, at in spelled.items():
        at = 0 if spelling in (ARRIVED, LABELS) and spelling.pattern.search(lines[0].text) else at
        if spelling is LABELS:
            lines = written = [*lines[:at], lines[at]._replace(text=labels_of(lines[at].text)), *lines[at:]]
            at += 1
        lines = [*lines[:at], *(line._replace(text=spelling(line.text)) for line in lines[at:])]
    table = _table(lines[:MOST], delimiter, where)
    at = next((k for k, row in enumerate(table.rows) if any(map(is_number, row[:LOOKED_AT]))), 0)
    if table.is_transposed(table.rows[at:]):
        channels = [split(line, table.delimiter) for line in text.lines(where) if line.strip()][at:]
        if table.is_transposed(channels):
            head = [line.text for line in lines[:at]]
            rewritten = "\n".join([*head, *map("\t".join, zip(*channels, strict=True)), ""])
            found = sniffed(Encoded(rewritten.encode()), f"{where}, transposed", "\t", decimal, sheet)
            return replace(found, said=f"a channel in each line, transposed: {found.said}", usual=False)
    if table.top < 0 or not -1 <= len(table.names) - table.width <= 0:
        lines = _with_names(lines, table)
        written, table = lines, _table(lines[:MOST], table.delimiter, where)
    first, units_line, units = table.units(lines)
    if not units and first < len(lines):
        units = [unit_behind(cell) or "" for cell in split(written[first].text, table.delimiter)]
    names = table.names[: table.width]  # LabVIEW's last one stands over no cells
    if table.width - len(names) == 1 and table.spare is not None:
        names.insert(table.spare, "")
    for k, group in enumerate(table.groups):
        names[k] = f"{group} {names[k]}" if group and not quantity(split_unit(names[k])[0]) else names[k]
    stems = stems_of(names, list(map(unit_of, units)), where)
    header, repeated = lines[table.top].number, frozenset(line.text for line in lines[table.top : first])
    heads = frozenset(row[0] for row in table.rows[: table.top] if row) - {*names}
    below = [line for line in lines[first:] if line.text not in repeated]
    body = [row for line in below if len(row := split(line.text, table.delimiter)) == table.width]
    counts = [line.text.count('"') for line in below]
    quoted = any(counts) and not any(count % 2 for count in counts)  # quotes around cells are two in a line
    numbers = _numbers(body, "" if quoted else table.delimiter, decimal, where)
    remarks = []
    times = _times(body)
    begin = [is_number(next(filter(None, row), "")) for row in body]
    if 0 in times or 2 * sum(begin) > len(body):  # else all rows look so
        ends = text.end.rstrip("\n").split("\n")[1:][-LAST:]
        seen = [
            line
            for line in (*(line.text for line in below), *ends)
            if not line.lstrip(' \t"').startswith(marks)
        ]
        remarks = [line.strip() for line in seen if is_remark(line, table.delimiter, len(stems), heads)]
    above = sum(line.number < header and not line.comment for line in lines)
    group = f" and {numbers.grouping!r} between thousands" if numbers.grouping else ""
    by = DELIMITERS.get(table.delimiter, repr(table.delimiter))
    cells = f"columns separated by {by}s" if table.width > 1 else "one column"
    said = [
        f"sheet '{sheet}'" if sheet else f"{text.said}, {cells}",
        f"decimal {'comma' if numbers.decimal == ',' else 'point'}{group}",
        *(spelling.said for spelling in spelled),
        f"names in line {header}{f' with units in line {units_line}' if units_line else ''}",
        *([f"{above} {'line' if above == 1 else 'lines'} above them not used"] if above else ()),
    ]
    if remarks:
        said.append(f"lines of words among the numbers left out ({remarks[0][:40]!r})")
    plain = text.encoding == "utf-8" and numbers == POINT and table.delimiter in ",\t"
    return Dialect(
        text, table.delimiter, stems, below[0].number if below else lines[-1].number + 1, numbers, marks,
        quoted, bool(remarks),
        not text.end.endswith("\n") and text.end.strip().rpartition("\n")[2] not in remarks,
        times, tuple(spelled), repeated, heads, _facts(lines[:first]),
        ", ".join(said), usual=plain and not (units_line or remarks or above or spelled),
    )  # fmt: skip


def _sample(text: Encoded, where: str) -> tuple[list[Line], tuple[str, ...]]:
    """Return the first lines, with comments only above the others, and the marks of comments that are used.

    Refuses what is no text.
    """
    lines: list[Line] = []
    marks, length, filled, opened = {"#"}, 0, 0, ""
    for number, line in enumerate(text.lines(where), start=1):
        line = f"{opened} {line}" if opened else line
        opened = line if line.count('"') % 2 and number <= FEW else ""
        if opened:
            continue  # a name with a line break within its quotes
        if "\0" in line and number <= FEW:
            raise InputError(
                f"Line {number} of {where} must hold column names; it is no text, so the file is damaged or "
                "of another format: copy it again, or state its --format."
            )
        length += len(line)
        bare = line.lstrip(' \t"')
        if mark := next((mark for mark in _COMMENTS if bare.startswith(mark)), ""):
            marks.add(mark)
            lines += [] if filled else [Line(number, bare.lstrip("#%/! \t"), True)]
        elif line.strip():
            filled += 1
            lines.append(Line(number, line))
        if (length > SAMPLE and filled >= FEW) or filled >= NUMBERS:
            break
    return lines, tuple(mark for mark in _COMMENTS if mark in marks)


def _table(lines: Sequence[Line], delimiter: str | None, where: str) -> Split:
    """Return the table under the delimiter that fits best."""
    table = max((Split(lines, d) for d in ((delimiter,) if delimiter else DELIMITERS)), key=lambda t: t.fit)
    number, text = lines[table.top].number, lines[table.top].text
    other = next((d for d in DELIMITERS if d not in (delimiter, BLANKS) and d in text), None)
    if delimiter and table.width == 1 and other:  # one column of a line that another one would split
        raise InputError(
            f"Columns of {where} must be separated by {DELIMITERS.get(delimiter, repr(delimiter))}s; line"
            f" {number} looks separated by {DELIMITERS[other]}s: leave --delimiter out, or say"
            f" --delimiter {DELIMITERS[other]}."
        )
    return table


def _with_names(lines: Sequence[Line], table: Split) -> list[Line]:
    """Return lines of numbers below one of names that stand in a line each, `# NAME0 = Hall A (um)`, or in
    one whose cells are separated otherwise: `# columns: t, x, y`.

    Numbers below no names at all are `unnamed_0` to `unnamed_k`.
    """
    at = next(k for k, line in enumerate(lines) if k >= table.data and not line.comment)
    series = defaultdict[str, list[str]](list)
    for name, value in _facts(lines[:at]).items():
        series[re.sub(r"\d+", "", name)].append(re.sub(r"\s+(?![(\[])", "_", value))
    for line, by in ((line.text, by) for line in reversed(lines[:at]) for by in DELIMITERS):
        cells = [re.split(r"[:\t]\s*", cell)[-1] for cell in split(line, by)]
        series[f"{by}{line}"] = cells[not cells[0] :]  # behind a word
    widths = {table.width, table.width - (table.spare is not None)} - {0, 1}
    rows = (own for own in series.values() if len(own) in widths and not is_unit_row(own))
    names = next((own for own in rows if len(own) == len({*own})), [])
    if not names or any(map(is_number, names)):
        if table.top >= 0:
            return [*lines]
        names = [f"unnamed_{k}" for k in range(table.width)]
    return [*lines[:at], Line(lines[at].number - 1, table.delimiter.join(names)), *lines[at:]]


def _numbers(body: list[list[str]], delimiter: str, decimal: str | None, where: str) -> Convention:
    """Return how numbers are written; beside a stated decimal sign the other may separate thousands."""
    found, cell = conventions_of((cell for row in body for cell in row), decimal)
    if len(found) > 1:
        raise InputError(
            f"Numbers such as '{cell}' of {where} can be read in two ways: say --decimal , if the comma is"
            " the decimal sign, or --decimal . if it separates thousands."
        )
    other = "," if decimal == "." else "."
    stated = decimal and not found[0].grouping and other != delimiter
    return Convention(found[0].decimal, other) if stated else found[0]


def _times(body: list[list[str]]) -> dict[int, str]:
    """Return the columns of times as text, and how they are written."""
    found = {}
    for k, column in enumerate(zip(*body, strict=True)):
        cells = [cell for cell in column if cell not in MISSING]
        if cells and ":" in cells[0] and (form := time_form(cells)):
            found[k] = form
    return found


_FACT = re.compile(r"\W*(\w[^:=,;\t]*?)\s*(?:[:=,;\t]|\s(?=[-+.\d]))\s*(.*)")


def _facts(lines: Sequence[Line]) -> dict[str, str]:
    """Return what lines say, the last one of a name: `Sample Interval, 0.001`, `# fs = 2000 Hz`."""
    return {match[1]: match[2].strip(' "') for line in lines if (match := _FACT.match(line.text))}


def is_remark(line: str, delimiter: str, width: int, heads: Collection[str]) -> bool:
    """Say whether a line begins with a word, where rows begin with a number, and is no row of names.

    It has another number of cells than the table, numbers behind its word (`Mean,0.5,1.2`), or begins as a
    line above the names does, of `heads`.
    """
    if not _BEGINS.match(line):
        return False
    first, *others = split(line.lstrip(f" {delimiter}"), delimiter) or [""]
    if first in MISSING or is_number(first) or first in heads:
        return first in heads
    numbers = all(cell in MISSING or is_number(cell) for cell in others)
    return bool(_WORD.match(first)) and (len(others) + 1 != width or numbers)


# -- bytes -----------------------------------------------------------------------------------------------


PIECE = 1 << 16
"""Bytes that are read at once: they stay in the processor's cache."""
END = 1 << 16
"""Bytes of the end of a file in which lines after the table are looked for."""
LONGEST_LINE = 10_000_000
"""Characters of a line: 100,000 columns with long names."""
_GZIP = b"\x1f\x8b"
_MARK = "\ufeff"
_LATIN = re.compile(
    rb"[\x80-\xa0]|(?<=[a-z])[\xa1-\xfe]+(?=[a-z])|(?<![\xa1-\xfe])(?:[\xa1-\xfe]{2})*[\xa1-\xfe](?![\xa1-\xfe])"
)
"""Bytes that Chinese characters do not have, which come in pairs and in no word: a letter alone, `Größe`."""
_KANA = re.compile(rb"(?:\x82[\x9f-\xf1]|\x83[\x40-\x96]|\x81\x5b){2}")
"""Two characters of Japanese in a row, also the mark of a long vowel; others have no bytes of these."""
_WIDE, _NARROW = 0.6, 0.1
"""Share of null bytes at even (odd) places above which text is UTF-16; nearly all are."""


class Encoded:
    """A text as bytes, on a disk or in memory: its coding, as Python names it; whether it is compressed."""

    def __init__(self, source: Path | bytes) -> None:
        """Recognise compression and coding by the beginning."""
        self.source, self.compressed = source, False
        with self.raw() as stream:
            self.compressed = stream.read(2) == _GZIP
        with self.raw() as stream:
            self.encoding = _encoding(stream.read(SAMPLE))

    def raw(self) -> Any:
        """Open its bytes, decompressed."""
        if isinstance(self.source, bytes):
            return io.BytesIO(self.source)
        return gzip.open(self.source) if self.compressed else open(self.source, "rb")

    @property
    def said(self) -> str:
        """The coding in words."""
        return f"{self.encoding.upper().replace('LATIN', 'Latin')}{', gzip' * self.compressed}"

    def pieces(self, where: str, above: int = 0) -> Iterator[str]:
        r"""Yield pieces of whole lines but the first ones `above`; \n ends each line, whatever did.

        A bad byte of UTF-8 is judged with the cell it stands in. `where` names the file in messages. Raises
        `InputError` for a line that does not end, before it fills the memory.
        """
        errors = "replace" if self.encoding in ("utf-8", "gb18030", "cp932") else "strict"
        with io.TextIOWrapper(self.raw(), self.encoding, errors) as reader:
            for _ in range(above):
                reader.readline(LONGEST_LINE)
            while text := reader.read(PIECE):
                rest = "" if text.endswith("\n") else reader.readline(LONGEST_LINE + 1)
                if len(rest) > LONGEST_LINE:
                    raise InputError(
                        f"{where} must be text in lines of at most {LONGEST_LINE} characters; it is no text,"
                        " so the file is damaged or of another format: copy it again, or state its --format."
                    )
                yield f"{text}{rest}" if (rest or text).endswith("\n") else f"{text}{rest}\n"

    def lines(self, where: str) -> Iterator[str]:
        """Yield the lines, without line ends and a byte order mark."""
        for piece in self.pieces(where):
            yield from piece[:-1].removeprefix(_MARK).split("\n")

    @cached_property
    def end(self) -> str:
        """The end of the text."""
        with self.raw() as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - END))
            text = stream.read().decode(self.encoding, "replace")
        return text.replace("\r\n", "\n").replace("\r", "\n")


def _encoding(head: bytes) -> str:
    half = max(1, len(head) // 2)
    for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        if head[first::2].count(0) > _WIDE * half and head[1 - first :: 2].count(0) < _NARROW * half:
            return name
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
        return "utf-8"
    except UnicodeDecodeError:
        pass
    whole = head[: head.rfind(b"\n")]
    return "cp932" if _KANA.search(whole) else "latin-1" if _LATIN.search(whole) else "gb18030"
