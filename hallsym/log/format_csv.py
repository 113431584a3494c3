"""CSV logs as laboratories write them: `hallsym.log.text` recognises what a file is, pyarrow reads it."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import IO

from hallsym.errors import InputError, quoted
from hallsym.log.arrow import Seconds, array_of, name_the_time, said_of_times
from hallsym.log.table import Source, label, load
from hallsym.log.text.cells import MISSING, Convention, as_float
from hallsym.log.text.sniff import Dialect, Encoded, sniffed, split
from hallsym.output import csv_text
from hallsym.units import Array

IN_MEMORY_BYTES = 250_000_000
COMPRESSED = 8
"""What text of numbers becomes larger by when it is decompressed, at most."""
BLOCK = 1 << 19
"""Bytes that pyarrow reads at once: it holds some ten of them."""
_TORN = "The last line of {} does not end with a newline: if the file was cut short, its last value is wrong."


class CsvSource(Source):
    """Columns of one table of text; an empty cell is NaN.

    `file`: what to open where it is not the bytes at `path` but those of a `sheet` of a workbook.
    """

    clocks: dict[str, Seconds]

    def __init__(
        self,
        path: Path,
        delimiter: str | None = None,
        decimal: str | None = None,
        file: Callable[[], IO[bytes]] | None = None,
        sheet: str = "",
    ) -> None:
        self.path, self.where = path, quoted(path)
        self.file = Encoded.of(file or path)
        self.dialect: Dialect = sniffed(self.file, self.where, delimiter, decimal)
        self.call(self.dialect.stems)
        self.times = self.dialect.times
        name_the_time(self, self.times)
        bytes_read = path.stat().st_size * (COMPRESSED if self.file.compressed else 1)
        self.small = file is not None or bytes_read <= IN_MEMORY_BYTES
        self.recognised = self.dialect.said(sheet)
        about = [
            said_of_times(self.dialect.names[at], self.where, form.said) for at, form in self.times.items()
        ]
        if not self.dialect.usual:
            about.append(f"{self.where} is read as {self.recognised}.")
        if self.dialect.torn:
            about.append(_TORN.format(self.where))
        self.notes = tuple(about)
        self.clocks = {}

    def count(self) -> int:
        """Return the number of rows: the lines are counted."""
        if not hasattr(self, "rows"):
            self.rows = sum(piece.count("\n") for piece in self._pieces())
        return self.rows

    def head(self, count: int, most: int) -> list[list[str]]:
        """Return the first rows as the file writes them."""
        return [row[:most] for row in islice(self._cells(), count)]

    def labels(self, name: str) -> list[str]:
        """Return the cells of one column as text, without quotes; numbers as `label` has them."""
        at, found = self.names.index(name), []
        for row in self._cells():
            cell = row[at] if len(row) > at else ""
            number = as_float(cell, self.dialect.numbers) if "." in cell or "," in cell else None
            found.append("" if cell in MISSING else label(number) if number is not None else cell)
        return found

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks."""
        indices = [self.names.index(name) for name in names]
        try:
            for columns in self._arrow(indices):
                yield dict(zip(names, columns, strict=True))
        except ValueError as error:  # pyarrow's ArrowInvalid is one too
            if isinstance(error, InputError | UnicodeDecodeError):
                raise
            raise first_fault(self, indices, error) from error

    def _pieces(self) -> Iterator[str]:
        """Yield the clean lines from the first sample to the last one, in pieces."""
        clean, footer, held = cleaning(self.dialect), self.dialect.footer, ""
        for piece in self.file.pieces(self.where, self.dialect.first - 1):
            cleaned = clean(piece)
            if footer:
                parts = f"{held}{cleaned}".rsplit("\n", footer + 1)
                cleaned = f"{parts[0]}\n" if len(parts) > footer + 1 else ""
                held = "\n".join(parts[1:] if cleaned else parts)
            if cleaned:
                yield cleaned

    def _cells(self) -> Iterator[list[str]]:
        """Yield the rows of the table as text."""
        for piece in self._pieces():
            yield from (split(line, delimiter_of(self.dialect)) for line in piece.split("\n")[:-1])

    def _arrow(self, indices: Sequence[int]) -> Iterator[list[Array]]:
        reader, arrow = load("pyarrow.csv"), load("pyarrow")
        labels = [str(k) for k in range(len(self.names))]
        options = {
            "read_options": reader.ReadOptions(column_names=labels, block_size=max(BLOCK, 100 * len(labels))),
            "parse_options": reader.ParseOptions(
                delimiter=delimiter_of(self.dialect), quote_char='"' if self.dialect.quoted else False
            ),
            "convert_options": reader.ConvertOptions(
                column_types=dict.fromkeys(labels, arrow.float64())
                | {str(k): arrow.string() for k in self.times},
                strings_can_be_null=True,
                include_columns=[str(k) for k in indices],
                null_values=[f"{before}{m}{after}" for m in MISSING for before in BESIDE for after in BESIDE],
                decimal_point=self.dialect.numbers.decimal,
            ),
        }
        for k in (k for k in indices if k in self.times):
            what = f"Column '{self.dialect.names[k]}' of {self.where}"
            self.clocks[self.names[k]] = Seconds(self.times[k], what)
        read = [self.clocks.get(self.names[k], array_of) for k in indices]
        try:
            with reader.open_csv(Stream(self._pieces()), **options) as batches:
                for batch in batches:
                    yield [turn(column) for turn, column in zip(read, batch.columns, strict=True)]
        except arrow.ArrowInvalid as error:
            if "Empty CSV" not in str(error):
                raise


class CsvWriter:
    """Writes full precision: every value reads back to the same bits."""

    group_rows = 16_384

    def __init__(self, path: Path) -> None:
        self._stream = path.open("w", encoding="utf-8", newline="")
        self._delimiter = "\t" if path.suffix == ".tsv" else ","
        self._started = False

    def write(self, columns: Mapping[str, Array]) -> None:
        """Append rows."""
        if not self._started:
            self._stream.write(csv_text([tuple(columns)], self._delimiter))
            self._started = True
        reader, arrow = load("pyarrow.csv"), load("pyarrow")
        options = reader.WriteOptions(include_header=False, delimiter=self._delimiter)
        self._stream.flush()
        reader.write_csv(arrow.table(dict(columns)), self._stream.buffer, options)

    def close(self) -> None:
        """Flush and close."""
        self._stream.close()


def first_fault(source: CsvSource, indices: Sequence[int], error: Exception) -> InputError:
    """Return the error that says where the first bad line or cell of a CSV file is."""
    dialect, clean = source.dialect, cleaning(source.dialect)
    for number, line in enumerate(source.file.lines(source.where), start=1):
        text = clean(f"{line}\n")[:-1] if number >= dialect.first else ""
        if not text:
            continue
        cells = split(text, delimiter_of(dialect))
        if len(cells) != len(dialect.names):
            decimal = dialect.delimiter == "," and len(cells) == 2 * len(dialect.names)
            why = "the file may be cut short or two lines may have run together"
            why = "commas may be decimal signs too: export it with another delimiter" if decimal else why
            return InputError(
                f"Line {number} of {source.where} must have {len(dialect.names)} cells as the header has;"
                f" it has {len(cells)}, so {why}."
            )
        for index in (k for k in indices if k not in source.times):
            if as_float(cells[index], Convention(dialect.numbers.decimal)) is None:
                return _bad_cell(source, number, dialect.names[index], cells[index])
    return InputError(f"{source.where} cannot be read as CSV ({' '.join(str(error).split())[:120]}).")


def _bad_cell(source: CsvSource, number: int, name: str, cell: str) -> InputError:
    decimal, what = source.dialect.numbers.decimal, {",": "comma", ".": "point"}
    other = "," if decimal == "." else "."
    said = remedy = ""
    if as_float(cell, Convention(decimal, other)) is not None:
        remedy = f"; if a {what[other]} separates thousands, state --decimal {decimal}"
    elif as_float(cell, Convention(other)) is not None:
        said = f" with a decimal {what[decimal]}, not a {what[other]}"
        remedy = f": write all numbers alike, or state --decimal {other}"
    return InputError(
        f"Line {number}, column '{name}' of {source.where} must be a number{said}; it is "
        f"'{cell[:40]}'{remedy}."
    )


class Stream(io.IOBase):
    """Pieces of text as a stream of UTF-8, whose reads are only cut short at its end."""

    def __init__(self, pieces: Iterator[str]) -> None:
        """Start before the first piece."""
        self._pieces, self._held = pieces, b""

    def readable(self) -> bool:
        """Say that it can be read."""
        return True

    def read(self, size: int) -> bytes:
        """Return the next bytes."""
        parts = [self._held]
        while sum(map(len, parts)) < size and (piece := next(self._pieces, "")):
            parts.append(piece.encode())
        whole = b"".join(parts)
        self._held = whole[size:]
        return whole[:size]


# -- lines -----------------------------------------------------------------------------------------------


BESIDE = ("", " ")
"""What may stand beside a cell without a value."""
_EMPTY = re.compile(r"^[ \t]*\n", re.MULTILINE)
_BLANK = "\n", " ", "\t"


def delimiter_of(dialect: Dialect) -> str:
    """Return what separates the cells of clean lines."""
    return "\t" if dialect.delimiter == " " else dialect.delimiter


def cleaning(dialect: Dialect) -> Callable[[str], str]:
    r"""Return what takes comments, empty lines, blanks and separators of thousands out of lines.

    Each line ends with \n; what it returns is empty where nothing is left.
    """
    comment = re.compile(rf'^[ \t"]*(?:{"|".join(map(re.escape, dialect.comments))})[^\n]*\n', re.M)
    grouping = dialect.numbers.grouping
    group = re.compile(rf"(?<=\d){re.escape(grouping)}(?=\d{{3}}(?!\d))", re.A)

    def clean(lines: str) -> str:
        if lines.startswith(_BLANK) or any("\n" + first in lines for first in _BLANK):
            lines = _EMPTY.sub("", lines)  # looking for one first is ten times as fast
        if any(mark in lines for mark in dialect.comments):
            lines = comment.sub("", lines)
        if dialect.delimiter == " ":
            lines = re.sub(r"[ \t]+", "\t", re.sub(r"(?m)^[ \t]+|[ \t]+$", "", lines.replace('"', "")))
        if grouping and grouping == dialect.delimiter:  # then numbers with it stand between quotes
            return re.sub(r'"[^"\n]*"', lambda cell: group.sub("", cell[0]), lines)
        return group.sub("", lines) if grouping else lines

    return clean
