"""What a text file is, recognised from its first and last lines; asked for where it could be two things."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO, cast

from hallsym.errors import InputError
from hallsym.log.arrow import TimeForm, time_form
from hallsym.log.text.cells import (
    MISSING,
    POINT,
    Convention,
    conventions_of,
    is_number,
    is_unit_row,
    split_header,
    unit_of,
)
from hallsym.units import split_unit

BLANKS = " "
DELIMITERS = {"\t": "tab", ";": "semicolon", ",": "comma", "|": "bar", BLANKS: "blank"}
"""What separates columns, and the word for it, which `--delimiter` takes too."""


@dataclass(frozen=True)
class Dialect:
    """Everything that was recognised of a file. Lines are counted from 1.

    `delimiter`: " " stands for any number of blanks and tabs. `stems`: as `stems_of`, one by cell. `header`:
    line of the names; `units_line`: of the units, 0 without one. `first`: line the table begins at. `footer`:
    lines after the table. `quoted`: whether quotes stand around cells. `times`: columns of times as text, and
    how they are written. `above`: lines before the names that are neither empty nor comments. `torn`: whether
    the last line does not end.
    """

    encoding: str
    compressed: bool
    delimiter: str
    stems: dict[str, tuple[str, str | None]]
    header: int
    first: int
    numbers: Convention = POINT
    units_line: int = 0
    comments: tuple[str, ...] = ("#",)
    quoted: bool = False
    footer: int = 0
    footer_text: str = ""
    torn: bool = False
    times: dict[int, TimeForm] = field(default_factory=dict)
    above: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, one by cell."""
        return tuple(self.stems)

    @property
    def usual(self) -> bool:
        """Whether the file is what needs no word: UTF-8, commas or tabs, decimal point, names first."""
        plain = self.encoding in ("utf-8", "utf-8-sig") and self.numbers == POINT
        bare = not (self.units_line or self.footer or self.above)
        return plain and bare and self.delimiter in ",\t"

    def said(self, sheet: str = "") -> str:
        """Return one line that says what was recognised; `sheet`: of a workbook."""
        coding = {"utf-8": "UTF-8", "utf-8-sig": "UTF-8 with a byte order mark"}.get(
            self.encoding, self.encoding.upper().replace("LATIN", "Latin")
        )
        by = f"{DELIMITERS[self.delimiter]}s" if self.delimiter in DELIMITERS else repr(self.delimiter)
        columns = f"columns separated by {by}" if len(self.names) > 1 else "one column"
        text = f"{coding}{', gzip' if self.compressed else ''}, {columns}"
        words = [f"sheet '{sheet}'" if sheet else text]
        group = f" and {self.numbers.grouping!r} between thousands" if self.numbers.grouping else ""
        words.append(f"decimal {'comma' if self.numbers.decimal == ',' else 'point'}{group}")
        units = f" with units in line {self.units_line}" if self.units_line else ""
        words.append(f"names in line {self.header}{units}")
        if self.above:
            words.append(f"{self.above} {'line' if self.above == 1 else 'lines'} above them not used")
        if self.footer:
            what = "the last line" if self.footer == 1 else f"the last {self.footer} lines"
            words.append(f"{what} left out ({repr(self.footer_text[:40]) if self.footer_text else 'empty'})")
        return ", ".join(words)


LOOKED_AT = 200
"""Cells of a row that are looked at to tell data from words."""
STEADY = 5
"""Rows of numbers in a row that show where a table begins, above which there may be words."""
COMMENT = "comment"
"""Last name of LabVIEW's measurement files, under which rows without a comment have no cell."""
_AGAIN = re.compile(r"(.+)\.\d+")
"""A name that pandas has numbered, since another column has it too."""
_QUOTED = re.compile(r'"[^"\n]*"')


@dataclass(frozen=True)
class Line:
    """A line that is not empty, with its number in the file; of a comment, what stands behind its mark."""

    number: int
    text: str
    comment: bool = False


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
    """Return the delimiter of an option: one character, or the word for it."""
    known = {word: delimiter for delimiter, word in DELIMITERS.items()} | {"\\t": "\t", "space": BLANKS}
    if (word := text.lower()) in known or word.removesuffix("s") in known:
        return known.get(word) or known[word.removesuffix("s")]
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
    counts = Counter(len(row) for row, line in zip(rows, lines, strict=True) if not line.comment)
    width = max(counts, key=lambda n: counts[n], default=0)
    rows = [[] if len(r) != width and line.comment else r for r, line in zip(rows, lines, strict=True)]
    numeric = [sum(map(is_number, row[:LOOKED_AT])) for row in rows]
    data = [len(row) == width and n > 0 for row, n in zip(rows, numeric, strict=True)]
    start = next(  # of several rows that look like data; where the rows are few, of fewer
        (k for n in (STEADY, 2, 1) for k in range(len(rows)) if data[k : k + n] == [True] * n), 0
    )
    top = _top(rows, numeric, width, start)
    if top >= 0 and delimiter == BLANKS and len(rows[top]) > width:
        rows[top] = _glued(rows[top], width)
    if top >= 0 and len(rows[top]) == width + 1 and rows[top][-1].lower() == COMMENT:
        del rows[top][-1]
    first = top + 1 if top >= 0 else start
    body = [k for k in range(first, len(rows)) if len(rows[k]) == width]
    cells = sum(min(width, LOOKED_AT) for _ in body)
    held = sum(numeric[k] + sum(cell in MISSING for cell in rows[k][:LOOKED_AT]) for k in body)
    share = len(body) / max(1, len(rows) - first)
    return Table(delimiter, rows, width, top, first, share * held / cells if cells else 0.0)


def _glued(names: list[str], width: int) -> list[str]:
    """Return names with the units that stand in brackets behind them: `Time (s)` was two cells."""
    glued: list[str] = []
    for name in names:
        if glued and name[:1] in "([{<":
            glued[-1] += f" {name}"
        else:
            glued.append(name)
    return glued if len(glued) == width else names


def _top(rows: list[list[str]], numeric: list[int], width: int, start: int) -> int:
    """Return the index of the names: the last row of words above the data, or the one above its units.

    Damaged rows may stand between names and data. -1: there is no row of words.
    """
    words = [k for k in range(start) if not numeric[k] and abs(len(rows[k]) - width) <= 1]
    words = words or [k for k in range(start) if rows[k] and not numeric[k]]
    if words:
        last = words[-1]
        above = last - 1 in words and len(rows[last - 1]) == len(rows[last])
        return last - 1 if above and is_unit_row(rows[last]) else last
    first = next((k for k, row in enumerate(rows) if row), -1)
    return -1 if first < 0 or numeric[first] >= min(len(rows[first]), LOOKED_AT) else first


SAMPLE = 1 << 18
"""Characters of the beginning that are looked at, and more where its lines are long."""
FEW = 12
"""Lines that are looked at at least."""
MOST, NUMBERS = 100, 4000
"""Lines that are looked at at most to find the table, and for how its numbers are written."""
LONGEST_FOOTER = 20
"""Lines after a table that are taken for words about it; more are damage."""
_COMMENTS = ("#", "%", "//", "!")
_SEP = re.compile(r"sep=(.)", re.IGNORECASE)
_WORD = re.compile(r"[^\W\d_]{2,}")


def sniffed(file: Encoded, where: str, delimiter: str | None = None, decimal: str | None = None) -> Dialect:
    """Recognise a file. `where` names it in messages; `delimiter` and `decimal` are what somebody stated.

    Raises `InputError` for what is no table with names, and for numbers that can be read in two ways.
    """
    lines, marks = _sample(file, where)
    if lines and (stated := _SEP.fullmatch(lines[0].text.strip())):
        lines, delimiter = lines[1:], delimiter or stated[1]
    if all(line.comment for line in lines):
        raise InputError(
            f"{where} is empty: it must hold a header line with column names and one line per sample."
        )
    table, names, header = _table(lines[:MOST], delimiter, where)
    first, units_line, units = _units(table, lines)
    stems = _stems(names, units, where)
    below = lines[min(first, len(lines)) :]
    rows = (split(line.text, table.delimiter) for line in below)
    body = [row for row in rows if len(row) == table.width]
    quotes = _quoted(below)
    numbers = _numbers(body, "" if quotes else table.delimiter, decimal, where)
    end = file.end()
    at_end = bool(body) and is_number(body[0][0])  # a first column of words looks like words
    footer = _footer(end, table.delimiter, len(stems), marks) if at_end else (0, "")
    return Dialect(
        file.encoding, file.compressed, table.delimiter, stems, header,
        lines[first].number if first < len(lines) else lines[-1].number + 1,
        numbers, units_line, marks, above=sum(line.number < header and not line.comment for line in lines),
        quoted=quotes, times=_times(body), footer=footer[0], footer_text=footer[1],
        torn=not footer[0] and not end.endswith("\n"),
    )  # fmt: skip


# -- the beginning ---------------------------------------------------------------------------------------


def _sample(file: Encoded, where: str) -> tuple[list[Line], tuple[str, ...]]:
    """Return the first lines, with comments only above the others, and the marks of comments that are used.

    Refuses what is no text.
    """
    lines: list[Line] = []
    marks, length, filled, opened = {"#"}, 0, 0, ""
    for number, text in enumerate(file.lines(where), start=1):
        text = f"{opened} {text}" if opened else text
        opened = text if text.count('"') % 2 and number <= FEW else ""
        if opened:
            continue  # a name with a line break within its quotes
        if "\0" in text and number <= FEW:
            raise InputError(
                f"Line {number} of {where} must hold column names; it is no text, so the file is damaged or "
                "of another format: copy it again, or state its --format."
            )
        length += len(text)
        bare = text.lstrip(' \t"')
        if mark := next((mark for mark in _COMMENTS if bare.startswith(mark)), ""):
            marks.add(mark)
            lines += [] if filled else [Line(number, bare.lstrip("#%/! \t"), True)]
        elif text.strip():
            filled += 1
            lines.append(Line(number, text))
        if (length > SAMPLE and filled >= FEW) or filled >= NUMBERS:
            break
    return lines, tuple(mark for mark in _COMMENTS if mark in marks)


def _table(lines: list[Line], delimiter: str | None, where: str) -> tuple[Table, list[str], int]:
    """Return the table under the delimiter that makes most of the lines numbers, its names and their line."""
    tables = [table_under(lines, d) for d in ((delimiter,) if delimiter else DELIMITERS)]
    several = [t for t in tables if t.fits and t.width > 1 and t.quality > 0]
    single = [t for t in tables if t.fits and t.width == 1 and t.quality > 0.5]
    best = max(several, key=lambda t: (round(t.quality, 2), t.width)) if several else None
    if best is None or (single and best.quality < 0.5):
        best = single[0] if single else best
    if any(t.top < 0 and t.width > 1 and t.quality > (best.quality if best else 0.5) for t in tables):
        best = None  # numbers from the first line on
    chosen = best or max(tables, key=lambda t: (round(t.quality, 2), t.top >= 0, t.width))
    if chosen.top < 0:
        raise InputError(
            f"Line {lines[chosen.data].number} of {where} must hold column names such as hall_a_m; it holds"
            " numbers: write a line of names above them."
        )
    names, number = chosen.rows[chosen.top], lines[chosen.top].number
    text = lines[chosen.top].text
    other = next((d for d in DELIMITERS if d not in (delimiter, BLANKS) and d in text), None)
    if delimiter and chosen.width == 1 and other:  # one column of a line that another one would split
        raise InputError(
            f"Columns of {where} must be separated by {DELIMITERS.get(delimiter, repr(delimiter))}s; line"
            f" {number} looks separated by {DELIMITERS[other]}s: leave --delimiter out, or say"
            f" --delimiter {DELIMITERS[other]} (in Python delimiter={other!r})."
        )
    names = [*names, ""] if len(names) == chosen.width - 1 and chosen.trailing else names
    return chosen, names, number


# -- names and units -------------------------------------------------------------------------------------


def _units(table: Table, lines: list[Line]) -> tuple[int, int, list[str]]:
    """Return the first row of data, the line of the units (0 without one) and the units' cells."""
    first = table.data
    if table.top < 0 or first >= len(table.rows):
        return first, 0, []
    row = table.rows[first]
    if len(row) == len(table.rows[table.top]) and is_unit_row(row):
        return first + 1, lines[first].number, row
    for k in range(table.top - 1, -1, -1):  # a row of a header: its name, then units
        units = [cell for cell in table.rows[k][1:] if cell]
        if 2 * len(units) >= table.width > 1 and all(map(unit_of, units)):
            return first, lines[k].number, ["", *table.rows[k][1:]]
    return first, 0, []


def _stems(names: list[str], units: list[str], where: str) -> dict[str, tuple[str, str | None]]:
    """Return the header's own text and the unit of each column, by its name without the unit."""
    texts = [text or f"(column {k + 1})" for k, text in enumerate(names)]
    bare = [m[1] if (m := _AGAIN.fullmatch(text)) and m[1] in texts else text for text in texts]
    times, same, seen = Counter(bare), Counter(texts), Counter[str]()
    twice = next((name for name in times if times[name] > 1 and (name == "run" or split_unit(name)[1])), None)
    if twice:
        raise InputError(f"Column names of {where} must differ; '{twice}' stands there twice: rename one.")
    paths = [text.rpartition("/") for text in bare]
    groups = Counter(before for before, _, _ in paths if before)
    parts = [split_header(text) for text in bare]
    for k, (before, _, last) in enumerate(paths):
        if groups[before] > 1:  # what several columns have before a slash is a group of channels
            parts[k] = (f"{before}/{split_header(last)[0]}", split_header(last)[1])
        seen[bare[k]] += 1
        if times[bare[k]] > 1:  # columns of one name are numbered
            numbered = f"{bare[k]} {seen[bare[k]]}"
            parts[k] = (f"{parts[k][0]} {seen[bare[k]]}", parts[k][1])
            texts[k] = texts[k] if same[texts[k]] == 1 else numbered
    stems = Counter(stem for stem, _ in parts)
    found: dict[str, tuple[str, str | None]] = {}
    for k, (text, (stem, unit)) in enumerate(zip(texts, parts, strict=True)):
        under = unit_of(units[k]) if k < len(units) else None
        if unit and under and unit != under:
            raise InputError(
                f"The unit of column '{stem}' of {where} must be one; the names say {unit}, the line below"
                f" {under}."
            )
        found[stem if stems[stem] == 1 else text] = (text, unit or under)
    return found


# -- numbers ---------------------------------------------------------------------------------------------


def _numbers(body: list[list[str]], delimiter: str, decimal: str | None, where: str) -> Convention:
    """Return how numbers are written; beside a stated decimal sign the other may separate thousands."""
    found, cell = conventions_of((cell for row in body for cell in row), decimal)
    if len(found) > 1:
        raise InputError(
            f"Numbers such as '{cell}' of {where} can be read in two ways: say --decimal , if the comma is"
            " the decimal sign, or --decimal . if it separates thousands (in Python decimal=',' or '.')."
        )
    other = "," if decimal == "." else "."
    stated = decimal and not found[0].grouping and other != delimiter
    return Convention(found[0].decimal, other) if stated else found[0]


def _quoted(lines: list[Line]) -> bool:
    """Return whether quotes stand around cells: always two in a line."""
    counts = [line.text.count('"') for line in lines]
    return any(counts) and not any(count % 2 for count in counts)


def _times(body: list[list[str]]) -> dict[int, TimeForm]:
    """Return the columns of times as text, and how they are written."""
    found = {}
    for k in range(min(map(len, body), default=0)):
        cells = [cell for row in body if (cell := row[k].strip(' "')) not in MISSING]
        if cells and ":" in cells[0] and (form := time_form(cells)):
            found[k] = form
    return found


# -- the end ---------------------------------------------------------------------------------------------


def _footer(end: str, delimiter: str, width: int, comments: tuple[str, ...]) -> tuple[int, str]:
    """Return how many lines of words, or of empty cells, end a text after its table, and one of words.

    Comments and empty lines do not count.
    """
    lines, said = 0, ""
    for text in reversed(end.rstrip("\n").split("\n")[1:][-LONGEST_FOOTER:]):
        if not text.strip() or text.lstrip(' \t"').startswith(comments):
            continue
        cells = split(text, delimiter)
        words = len(cells) != width and bool(_WORD.match(cells[0])) and not is_number(cells[0])
        if any(cells) and not words:
            break
        lines, said = lines + 1, text.strip() if words else said
    return lines, said


PIECE = 1 << 16
"""Bytes that are read at once: they stay in the processor's cache."""
END = 1 << 16
"""Bytes of the end of a file in which lines after the table are looked for."""
LONGEST_LINE = 10_000_000
"""Characters of a line: 100,000 columns with long names."""
_GZIP = b"\x1f\x8b"
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (codecs.BOM_UTF8, "utf-8-sig"),
)
_WIDE, _NARROW = 0.6, 0.1
"""Share of null bytes at even (odd) places from which on text without a mark is UTF-16; nearly all are."""


@dataclass(frozen=True)
class Encoded:
    """A file of text: its coding, as Python names it, and whether it is compressed.

    `open_raw` opens its bytes; of a file in memory it is not a path that is opened.
    """

    open_raw: Callable[[], IO[bytes]]
    compressed: bool
    encoding: str

    @staticmethod
    def of(source: Path | Callable[[], IO[bytes]]) -> Encoded:
        """Recognise compression and coding by the beginning of the file."""
        open_raw = partial(_open, source) if isinstance(source, Path) else source
        with open_raw() as stream:
            compressed = stream.read(2) == _GZIP
        found = Encoded(open_raw, compressed, "")
        with found.raw() as stream:
            head = stream.read(SAMPLE)
        return Encoded(open_raw, compressed, _encoding(head))

    @contextmanager
    def raw(self) -> Iterator[IO[bytes]]:
        """Open the bytes, decompressed."""
        with self.open_raw() as stream:
            yield cast(IO[bytes], gzip.GzipFile(fileobj=stream, mode="rb")) if self.compressed else stream

    @contextmanager
    def reader(self) -> Iterator[IO[str]]:
        """Open the text; a bad byte of UTF-8 is judged with the cell it stands in."""
        with self.raw() as stream:
            yield io.TextIOWrapper(stream, self.encoding, "replace" if "utf-8" in self.encoding else "strict")

    def pieces(self, where: str, above: int = 0) -> Iterator[str]:
        r"""Yield pieces of whole lines but the first ones `above`; \n ends each line, whatever did.

        `where` names the file in messages. Raises `InputError` for a line that does not end, before it fills
        the memory.
        """
        with self.reader() as reader:
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
        """Yield the lines, without what ends them."""
        for piece in self.pieces(where):
            yield from piece[:-1].split("\n")

    def end(self) -> str:
        """Return the end of the text; all is read where a place in it is none in the file."""
        if self.compressed or self.encoding not in ("utf-8", "utf-8-sig", "latin-1"):
            last = ""
            with self.reader() as reader:
                while text := reader.read(PIECE):
                    last = (last + text)[-END:]
            return last
        with self.raw() as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - END))
            return stream.read().decode(self.encoding, "replace").replace("\r\n", "\n").replace("\r", "\n")


def _open(path: Path) -> IO[bytes]:
    return open(path, "rb")


def _encoding(head: bytes) -> str:
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name
    half = max(1, len(head) // 2)
    for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        if head[first::2].count(0) > _WIDE * half and head[1 - first :: 2].count(0) < _NARROW * half:
            return name
    try:
        codecs.getincrementaldecoder("utf-8")("strict").decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"
