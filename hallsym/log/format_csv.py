"""CSV logs as laboratories write them: `hallsym.log.text` recognises what a file is, pyarrow reads it."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from hallsym.errors import InputError, quoted
from hallsym.log.arrow import Seconds, array_of, name_the_time, said_of_times
from hallsym.log.table import Source, label, load
from hallsym.log.text.cells import COMMA, MISSING, Convention, as_float
from hallsym.log.text.sniff import END, Dialect, Encoded, end_of, sniffed, whole_lines
from hallsym.units import Array

IN_MEMORY_BYTES = 250_000_000
COMPRESSED = 8
"""What text of numbers becomes larger by when it is decompressed, at most."""
BLOCK = 1 << 19
"""Bytes that pyarrow reads at once: it holds some ten of them."""
BEGINNING = 100
"""Rows among which the first moment of a column of times is."""
_TORN = "The last line of {} does not end with a newline: if the file was cut short, its last value is wrong."


class CsvSource(Source):
    """Columns of one table of text; an empty cell is NaN.

    `file`: what to open where it is not the bytes at `path` but those of a `sheet` of a workbook.
    """

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
        self.names, self.units, self.aliases = self.dialect.names, self.dialect.units, self.dialect.aliases
        self.times = {self.names.index(name): form for name, form in self.dialect.times.items()}
        name_the_time(self, self.times)
        bytes_read = path.stat().st_size * (COMPRESSED if self.file.compressed else 1)
        self.small = file is not None or bytes_read <= IN_MEMORY_BYTES
        self.recognised = self.dialect.said(sheet)
        about = [
            said_of_times(self.dialect.names[at], self.where, form.said) for at, form in self.times.items()
        ]
        if not self.dialect.usual:
            about.append(f"{self.where} is read as {self.recognised}.")
        if not (self.dialect.footer or end_of(self.file, 8).endswith(("\n", "\r"))):
            about.append(_TORN.format(self.where))
        self.notes = tuple(about)
        self._rows: int | None = None

    def count(self) -> int:
        """Return the number of rows; before the first read the lines are counted."""
        if self._rows is None:
            self._rows = sum(piece.count(b"\n") for piece in self._pieces())
        return self._rows

    def read(self, names: Sequence[str]) -> Mapping[str, Array]:
        """Return whole columns."""
        columns = super().read(names)
        self._rows = len(next(iter(columns.values()), ())) if names else self._rows
        return columns

    def epoch(self, name: str) -> float | None:
        """Return the moment of the first cell of a column of times."""
        at = self.names.index(name)
        if at not in self.times:
            return None
        seconds = Seconds(self.times[at], f"Column '{name}' of {self.where}")
        seconds(load("pyarrow").array([row[at] for row in self.head(BEGINNING, at + 1) if len(row) > at]))
        return seconds.epoch

    def head(self, count: int, most: int) -> list[list[str]]:
        """Return the first rows as the file writes them."""
        piece = next(self._pieces(), b"").decode("utf-8", "replace")
        delimiter = Cleaner(self.dialect).delimiter
        rows = [line.split(delimiter)[:most] for line in piece.split("\n")[:count] if line]
        return [[cell.strip().replace(INSIDE, delimiter) for cell in row] for row in rows]

    def labels(self, name: str) -> list[str]:
        """Return the cells of one column as text, without quotes; numbers as `label` has them."""
        at, delimiter = self.names.index(name), Cleaner(self.dialect).delimiter
        found = []
        for piece in self._pieces():
            for line in piece.decode("utf-8", "replace").rstrip("\n").split("\n"):
                row = line.split(delimiter)
                cell = (
                    row[at].strip().strip("\"'").strip().replace(INSIDE, delimiter) if len(row) > at else ""
                )
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

    def _pieces(self) -> Iterator[bytes]:
        return clean_pieces(self.file, self.dialect, self.where, BLOCK)

    def _arrow(self, indices: Sequence[int]) -> Iterator[list[Array]]:
        csv, arrow = load("pyarrow.csv"), load("pyarrow")
        labels = [str(k) for k in range(len(self.names))]
        options = {
            "read_options": csv.ReadOptions(column_names=labels, block_size=max(BLOCK, 100 * len(labels))),
            "parse_options": csv.ParseOptions(delimiter=Cleaner(self.dialect).delimiter, quote_char=False),
            "convert_options": csv.ConvertOptions(
                column_types=dict.fromkeys(labels, arrow.float64())
                | {str(k): arrow.string() for k in self.times},
                strings_can_be_null=True,
                include_columns=[str(k) for k in indices],
                null_values=list(MISSING),
                decimal_point=decimal_of(self.dialect),
            ),
        }
        stream = TableStream(self.file, self.dialect, self.where, BLOCK)
        seconds = {
            k: Seconds(self.times[k], f"Column '{self.dialect.names[k]}' of {self.where}")
            for k in indices
            if k in self.times
        }
        try:
            with csv.open_csv(stream, **options) as reader:
                for batch in reader:
                    columns = zip(indices, batch.columns, strict=True)
                    yield [seconds[k](c) if k in seconds else array_of(c) for k, c in columns]
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
            self._stream.write(self._delimiter.join(columns) + "\n")
            self._started = True
        csv, arrow = load("pyarrow.csv"), load("pyarrow")
        options = csv.WriteOptions(include_header=False, delimiter=self._delimiter)
        self._stream.flush()
        csv.write_csv(arrow.table(dict(columns)), self._stream.buffer, options)

    def close(self) -> None:
        """Flush and close."""
        self._stream.close()


def first_fault(source: CsvSource, indices: Sequence[int], error: Exception) -> InputError:
    """Return the error that says where the first bad line or cell of a CSV file is."""
    dialect, clean = source.dialect, Cleaner(source.dialect)
    for number, line in enumerate(source.file.lines(source.where), start=1):
        text = clean(line.encode()).decode() if number >= dialect.first else ""
        if not text:
            continue
        cells = text.split(clean.delimiter)
        if len(cells) != len(dialect.names):
            decimal = clean.delimiter == "," and len(cells) == 2 * len(dialect.names)
            why = "the file may be cut short or two lines may have run together"
            why = "commas may be decimal signs too: export it with another delimiter" if decimal else why
            return InputError(
                f"Line {number} of {source.where} must have {len(dialect.names)} cells as the header has;"
                f" it has {len(cells)}, so {why}."
            )
        for index in (k for k in indices if k not in source.times):
            cell = cells[index].strip()
            if as_float(cell, Convention(decimal_of(dialect))) is None:
                return _bad_cell(source, number, dialect.names[index], cell)
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


INSIDE = "\x1f"
"""Stands for a delimiter within quotes."""
_EMPTY = re.compile(rb"^[ \t]*(?:\n|\Z)", re.MULTILINE)
_BLANK = b"\n", b" ", b"\t"


class Cleaner:
    """Takes out of lines what is no cell: comments, empty lines, quotes, blanks, separators of thousands."""

    def __init__(self, dialect: Dialect) -> None:
        self.steps: list[Callable[[bytes], bytes]] = [_without_empty, _without_comments(dialect)]
        if dialect.quoted == "inside":
            self.steps.append(_unquoting(dialect))
        elif dialect.quoted:
            self.steps.append(lambda lines: lines.replace(b'"', b""))
        if dialect.delimiter == " ":
            self.steps.append(lambda lines: re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", lines))
            self.steps.append(lambda lines: re.sub(rb"[ \t]+", b"\t", lines))
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
        self._pieces = clean_pieces(file, dialect, where, size)
        self._rest = memoryview(b"")

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


def clean_pieces(file: Encoded, dialect: Dialect, where: str, size: int) -> Iterator[bytes]:
    """Yield the clean lines of the table in pieces that end with a newline."""
    clean = Cleaner(dialect)
    for piece in _table(file, dialect, where, size):
        if cleaned := clean(piece):
            yield cleaned + b"\n"


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


def _without_comments(dialect: Dialect) -> Callable[[bytes], bytes]:
    marks = [mark.encode() for mark in dialect.comments]
    pattern = re.compile(
        rb'^[ \t"]*(?:' + b"|".join(map(re.escape, marks)) + rb")[^\n]*(?:\n|\Z)", re.MULTILINE
    )

    def without(lines: bytes) -> bytes:
        held = any(mark in lines for mark in marks)
        return pattern.sub(b"", lines).removesuffix(b"\n") if held else lines

    return without


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
        if dialect.numbers.grouping != dialect.delimiter:
            return cell.replace(delimiter, INSIDE.encode())
        return cell if as_float(cell.decode(), dialect.numbers) is None else cell.replace(delimiter, b"")

    return lambda lines: quotes.sub(bare, lines)


def _unpadding(delimiter: str) -> Callable[[bytes], bytes]:
    mark = delimiter.encode()
    blank = rb" *" if delimiter == "\t" else rb"[ \t]*"
    pattern = re.compile(blank + re.escape(mark) + blank)
    ends = re.compile(rb"(?m)^ +| +$")
    return lambda lines: ends.sub(b"", pattern.sub(lambda _: mark, lines))


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
