"""CSV logs as laboratories write them: `hallsym.log.text` recognises what a file is, pyarrow reads it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.arrow import Timed
from hallsym.log.columns import SHORTEST_RUN
from hallsym.log.pace import pace_in
from hallsym.log.table import BLOCK, load
from hallsym.log.text.cells import MISSING, Convention, as_float, is_number
from hallsym.log.text.sniff import Dialect, Encoded, is_remark, sniffed, split
from hallsym.output import csv_text
from hallsym.units import Array

IN_MEMORY_BYTES = 250_000_000
COMPRESSED = 8
"""Largest ratio of text of numbers to its compressed size."""
AT_ONCE = 16
"""Pieces of text that pyarrow reads at once."""
_TORN = "The last line of {} does not end with a newline: if the file was cut short, its last value is wrong."


class CsvSource(Timed):
    """Columns of one table of text; an empty cell is NaN.

    `data`: the text of a `sheet` of a workbook, in the place of that at `path`. Empty lines and repeated
    names divide rows into blocks, where those above them are as many as a run has.
    """

    blocks = True

    def __init__(
        self,
        path: Path,
        delimiter: str | None = None,
        decimal: str | None = None,
        data: bytes | None = None,
        sheet: str = "",
    ) -> None:
        self.path, self.where = path, quoted(path)
        text = Encoded(path if data is None else data)
        self.dialect = dialect = sniffed(text, self.where, delimiter, decimal, sheet)
        self.text = dialect.text
        self.take(dialect.stems, dialect.times, self.where)
        bytes_read = path.stat().st_size * (COMPRESSED if text.compressed else 1)
        self.small = data is not None or bytes_read <= IN_MEMORY_BYTES
        self.recognised, self.facts, self.pace = dialect.said, dialect.facts, pace_in(dialect.facts)
        odd = [] if dialect.usual else [f"{self.where} is read as {self.recognised}."]
        self.notes += (*odd, *([_TORN.format(self.where)] if dialect.torn else []))

    def count(self) -> int:
        """Return the number of rows: the lines are counted."""
        if not hasattr(self, "rows"):
            self.rows = sum(piece.count("\n") for piece, _ in self._pieces())
        return self.rows

    def head(self, count: int, most: int) -> list[list[str]]:
        """Return the first rows as the file writes them."""
        return [row[:most] for row in islice(self._cells(), count)]

    def texts(self, name: str) -> list[str]:
        """Return the cells of one column, without quotes."""
        at = self.names.index(name)
        cells = (row[at] if len(row) > at else "" for row in self._cells())
        return ["" if cell in MISSING else cell for cell in cells]

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks."""
        csv, arrow, dialect = load("pyarrow.csv"), load("pyarrow"), self.dialect
        asked, labels = [n for n in names if n != BLOCK], [*map(str, range(len(self.names)))]
        places = [str(self.names.index(name)) for name in asked]
        parse = csv.ParseOptions(
            delimiter=dialect.sign,
            quote_char='"' if dialect.quoted else False,
        )
        convert = csv.ConvertOptions(
            column_types=dict.fromkeys(labels, arrow.float64())
            | {str(k): arrow.string() for k in dialect.times},
            strings_can_be_null=True,
            include_columns=places,
            null_values=[f"{before}{m}{after}" for m in MISSING for before in BESIDE for after in BESIDE],
            decimal_point=dialect.numbers.decimal,
        )
        readers, pieces, block, above = [self.reader(name) for name in asked], self._pieces(), 0, 0
        while some := [*islice(pieces, AT_ONCE)]:
            text, blocks = "".join(piece for piece, _ in some).encode(), []
            for rows, divided in ((piece.count("\n"), new) for piece, new in some if BLOCK in names):
                block += divided and above >= SHORTEST_RUN
                above = rows if divided else above + rows
                blocks.append(np.full(rows, block))
            whole = csv.ReadOptions(column_names=labels, block_size=len(text), use_threads=False)
            try:
                table = csv.read_csv(arrow.BufferReader(text), whole, parse, convert)
            except arrow.ArrowInvalid as error:
                raise first_fault(self, [*map(int, places)], error) from error
            columns = zip(asked, readers, table.columns, strict=True)
            found = {name: array(column) for name, array, column in columns}
            yield {**found, BLOCK: np.concatenate(blocks)} if blocks else found

    def _pieces(self) -> Iterator[tuple[str, bool]]:
        """Yield the clean lines from the first sample to the last one in pieces, and which begin a block."""
        divide, clean, divided = dividing(self.dialect), cleaning(self.dialect), False
        for piece in self.text.pieces(self.where, self.dialect.first - 1):
            for k, part in enumerate(divide(piece)):
                divided |= k > 0
                if cleaned := clean(part):
                    yield cleaned, divided
                    divided = False

    def _cells(self) -> Iterator[list[str]]:
        """Yield the rows of the table as text."""
        for piece, _ in self._pieces():
            yield from (split(line, self.dialect.sign) for line in piece.split("\n")[:-1])


def csv_writer(stream: IO[bytes], schema: Any, suffix: str) -> Any:
    """Return pyarrow's writer of tables to a stream; every value reads back to the same bits."""
    csv, delimiter = load("pyarrow.csv"), "\t" if suffix == ".tsv" else ","
    stream.write(csv_text([schema.names], delimiter).encode())
    options = csv.WriteOptions(include_header=False, delimiter=delimiter)
    return csv.CSVWriter(stream, schema, write_options=options)


def first_fault(source: CsvSource, indices: Sequence[int], error: Exception) -> InputError:
    """Return the error that says where the first bad line or cell of a CSV file is."""
    dialect, divide, clean = source.dialect, dividing(source.dialect), cleaning(source.dialect)
    known = {text for text, _ in dialect.stems.values()}
    for number, line in enumerate(source.text.lines(source.where), start=1):
        text = clean("".join(divide(f"{line}\n")))[:-1] if number >= dialect.first else ""
        cells = split(line, dialect.delimiter) if number >= dialect.first else []
        if line not in dialect.repeated and known & {*cells} and not any(map(is_number, cells)):
            return InputError(
                f"Line {number} of {source.where} names the columns anew, and others or in another order:"
                " cut the file into two there and give both."
            )
        if not text:
            continue
        cells = split(text, dialect.sign)
        if len(cells) != len(source.names):
            decimal = dialect.delimiter == "," and len(cells) == 2 * len(source.names)
            why = "the file may be cut short or two lines may have run together"
            why = "commas may be decimal signs too: export it with another delimiter" if decimal else why
            return InputError(
                f"Line {number} of {source.where} must have {len(source.names)} cells as the header has;"
                f" it has {len(cells)}, so {why}."
            )
        for index in (k for k in indices if k not in dialect.times):
            if as_float(cells[index], Convention(dialect.numbers.decimal)) is None:
                return _bad_cell(source, number, list(dialect.stems)[index], cells[index])
    return InputError(f"{source.where} cannot be read as CSV ({' '.join(str(error).split())[:120]}).")


def _bad_cell(source: CsvSource, number: int, name: str, cell: str) -> InputError:
    decimal, what = source.dialect.numbers.decimal, {",": "comma", ".": "point"}
    other = "," if decimal == "." else "."
    said = remedy = ""
    if as_float(cell, Convention(decimal, other)) is not None:
        remedy = f"; if a {what[other]} separates thousands, state --decimal {decimal}"
    elif as_float(cell, Convention(other)) is not None:
        said = f" with a decimal {what[decimal]}, not a {what[other]}"
        remedy = f": write all numbers in one form, or state --decimal {other}"
    return InputError(
        f"Line {number}, column '{name}' of {source.where} must be a number{said}; it is "
        f"'{cell[:40]}'{remedy}."
    )


# -- lines -----------------------------------------------------------------------------------------------


BESIDE = ("", " ")
"""Characters that may stand beside a cell without a value."""


def dividing(dialect: Dialect) -> Callable[[str], list[str]]:
    """Return the division of lines at empty ones and at repeated names, which are left out."""
    empty = rf"[ \t{re.escape(dialect.delimiter)}]*\n"  # a line of empty cells is empty too
    first, inside, names = re.compile(empty), re.compile(f"\n{empty}"), dialect.repeated
    each = re.compile("^(?:{})".format("|".join([empty, *(f"{re.escape(line)}\n" for line in names)])), re.M)

    def divide(lines: str) -> list[str]:
        any_of = first.match(lines) or inside.search(lines) or any(line in lines for line in names)
        return each.split(lines) if any_of else [lines]  # looking for one first is ten times as fast

    return divide


def cleaning(dialect: Dialect) -> Callable[[str], str]:
    r"""Return the removal of comments, blanks, words and separators from lines.

    Numbers in another notation become usual ones. Each line ends with \n; the result is empty
    where nothing is left.
    """
    comment = re.compile(rf'^[ \t"]*(?:{"|".join(map(re.escape, dialect.comments))})[^\n]*\n', re.M)
    grouping = dialect.numbers.grouping
    group = re.compile(rf"(?<=\d){re.escape(grouping)}(?=\d{{3}}(?!\d))", re.A)

    sign = dialect.sign
    beside = re.compile(rf'"[ ]*{re.escape(sign)}[ ]*"')

    def words(line: str) -> bool:
        return is_remark(line, sign, len(dialect.stems), dialect.heads)

    def clean(lines: str) -> str:
        if any(mark in lines for mark in dialect.comments):
            lines = comment.sub("", lines)
        if dialect.remarks:
            lines = "".join(line for line in lines.splitlines(True) if not words(line.rstrip("\n")))
        for spelling in dialect.spelled:
            lines = spelling(lines)
        if dialect.quoted and (f'{sign} "' in lines or f'" {sign}' in lines):
            lines = beside.sub(f'"{sign}"', lines)
        if dialect.delimiter == " ":
            lines = re.sub(r"[ \t]+", "\t", re.sub(r"(?m)^[ \t]+|[ \t]+$", "", lines.replace('"', "")))
        if grouping and grouping == dialect.delimiter:  # then numbers with it stand between quotes
            return re.sub(r'"[^"\n]*"', lambda cell: group.sub("", cell[0]), lines)
        return group.sub("", lines) if grouping else lines

    return clean
