"""CSV logs: one header line with names, one sample per line; `#` comments may come first."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.extras import available, load
from hallsym.log.table import Source, label
from hallsym.units import Array

IN_MEMORY_BYTES = 250_000_000
LONGEST_LINE = 10_000_000
"""Characters of a header: 100,000 columns with long names."""
_TORN = "The last line of {} does not end with a newline: if the file was cut short, its last value is wrong."
_MISSING = ("", "nan", "NaN", "NAN")
_TYPED = {"\t": "$'\\t'"}  # in a shell
_SAY = {"\t": "tabs", ";": "';'", "|": "'|'", ",": "','"}


@dataclass(frozen=True)
class Header:
    """Column names and the number of lines up to and including the header."""

    names: tuple[str, ...]
    lines: int
    delimiter: str


class CsvSource(Source):
    """Columns of one CSV file; an empty cell is NaN. Read by pyarrow where it is installed, else by numpy."""

    def __init__(self, path: Path, delimiter: str | None = None) -> None:
        """Read the header."""
        self.path = path
        self.header = _read_header(path, delimiter)
        self.names = self.header.names
        self.small = path.stat().st_size <= IN_MEMORY_BYTES
        self.notes = () if _ends_with_newline(path) else (_TORN.format(quoted(path)),)
        self._rows: int | None = None

    def count(self) -> int:
        """Return the number of rows; before the first read the lines are counted."""
        if self._rows is None:
            with _lines(self.path) as stream:
                self._rows = sum(1 for line in islice(stream, self.header.lines, None) if line.strip())
        return self._rows

    def read(self, names: Sequence[str]) -> Mapping[str, Array]:
        """Return whole columns."""
        columns = super().read(names)
        self._rows = len(next(iter(columns.values()), ())) if names else self._rows
        return columns

    def labels(self, name: str) -> list[str]:
        """Return the cells of one column as text, without quotes; numbers as `label` has them."""
        at, header = self.names.index(name), self.header
        with _lines(self.path) as stream:
            rows = [
                line.rstrip("\r\n").split(header.delimiter)
                for line in islice(stream, header.lines, None)
                if line.strip()
            ]
        cells = [row[at].strip().strip("\"'").strip() if len(row) > at else "" for row in rows]
        return ["" if c in _MISSING else label(float(c)) if "." in c and _number(c) else c for c in cells]

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks."""
        reader = _arrow_chunks if available("pyarrow.csv") else _numpy_chunks
        indices = [self.names.index(name) for name in names]
        try:
            for columns in reader(self.path, self.header, indices, size):
                yield dict(zip(names, columns, strict=True))
        except ValueError as error:  # pyarrow's ArrowInvalid is one too
            raise first_fault(self.path, self.header, indices, error) from error


class CsvWriter:
    """Writes full precision: every value reads back to the same bits."""

    group_rows = 16_384

    def __init__(self, path: Path) -> None:
        """Open the file for writing."""
        self._stream = open(path, "w", encoding="utf-8", newline="")  # noqa: SIM115 (closed by close)
        self._delimiter = "\t" if path.suffix == ".tsv" else ","
        self._started = False

    def write(self, columns: Mapping[str, Array]) -> None:
        """Append rows."""
        if not self._started:
            self._stream.write(self._delimiter.join(columns) + "\n")
            self._started = True
        if available("pyarrow.csv"):
            self._write_fast(columns)
            return
        texts = [map(repr, values.tolist()) for values in columns.values()]
        self._stream.writelines(self._delimiter.join(row) + "\n" for row in zip(*texts, strict=True))

    def _write_fast(self, columns: Mapping[str, Array]) -> None:
        csv, arrow = load("pyarrow.csv"), load("pyarrow")
        options = csv.WriteOptions(include_header=False, delimiter=self._delimiter)
        self._stream.flush()
        csv.write_csv(arrow.table(dict(columns)), self._stream.buffer, options)

    def close(self) -> None:
        """Flush and close."""
        self._stream.close()


def _lines(path: Path) -> TextIOWrapper:
    return open(path, encoding="utf-8-sig", errors="replace", newline=None)


def _ends_with_newline(path: Path) -> bool:
    with open(path, "rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) in b"\r\n"


def _read_header(path: Path, delimiter: str | None) -> Header:
    with _lines(path) as stream:
        for number, line in enumerate(iter(partial(stream.readline, LONGEST_LINE), ""), start=1):
            if "\0" in line or len(line) == LONGEST_LINE:
                raise InputError(
                    f"Line {number} of {quoted(path)} must hold column names; it is no text, so the file is "
                    "damaged or of another format: copy it again, or state its --format."
                )
            if line.strip() and not line.startswith("#"):
                return _parse_header(path, line.rstrip("\n"), number, delimiter)
    raise InputError(
        f"{path} is empty: it must hold a header line with column names and one line per sample."
    )


def _parse_header(path: Path, line: str, number: int, delimiter: str | None) -> Header:
    tab = path.suffix == ".tsv" or (path.suffix == ".txt" and "\t" in line)
    chosen = delimiter or ("\t" if tab else ",")
    names = tuple(field.strip().strip("\"'").strip() for field in line.split(chosen))
    other = next((d for d in ("\t", ";", "|", ",") if d != chosen and d in line), None)
    if len(names) == 1 and other:
        raise InputError(
            f"Columns of {path} must be separated by {_SAY.get(chosen, repr(chosen))}; line {number} looks"
            f" separated by {_SAY[other]}, so say it with --delimiter {_TYPED.get(other, repr(other))}"
            f" (in Python delimiter={other!r})."
        )
    if all(_number(name) is not None for name in names):
        raise InputError(
            f"Line {number} of {path} must hold column names such as hall_a_m; it holds numbers."
        )
    name, times = Counter(names).most_common(1)[0]
    if times > 1:
        raise InputError(f"Column names of {path} must differ; '{name}' stands there twice.")
    return Header(names, number, chosen)


def _arrow_chunks(path: Path, header: Header, indices: Sequence[int], size: int) -> Iterator[list[Array]]:
    csv, arrow = load("pyarrow.csv"), load("pyarrow")
    labels = [str(i) for i in range(len(header.names))]
    block = max(1 << 16, size * 20 * len(labels))
    options: dict[str, Any] = {
        "read_options": csv.ReadOptions(skip_rows=header.lines, column_names=labels, block_size=block),
        "parse_options": csv.ParseOptions(delimiter=header.delimiter, quote_char=False),
        "convert_options": csv.ConvertOptions(
            column_types=dict.fromkeys(labels, arrow.float64()),
            include_columns=[str(i) for i in indices],
            null_values=list(_MISSING),
        ),
    }
    try:
        with csv.open_csv(path, **options) as reader:
            for batch in reader:
                yield [column.to_numpy(zero_copy_only=False) for column in batch.columns]
    except arrow.ArrowInvalid as error:
        if "Empty CSV" not in str(error):
            raise


def _numpy_chunks(path: Path, header: Header, indices: Sequence[int], size: int) -> Iterator[list[Array]]:
    commas = len(header.names) - 1
    with _lines(path) as stream:
        rows = islice(stream, header.lines, None)
        while batch := list(islice(rows, size)):
            filled = [_fill(line, header.delimiter) for line in batch if line.strip()]
            if any(line.count(header.delimiter) != commas for line in filled):
                raise ValueError("a line has too many or too few cells")
            if filled:
                delimiter = header.delimiter
                values = np.loadtxt(filled, delimiter=delimiter, usecols=indices, ndmin=2, comments=None)
                yield list(np.ascontiguousarray(values.T))


def _fill(line: str, delimiter: str) -> str:
    """Return the line with nan in its empty cells."""
    line = line.rstrip("\r\n")
    if delimiter * 2 in line or line.endswith(delimiter) or line.startswith(delimiter):
        return delimiter.join(cell if cell.strip() else "nan" for cell in line.split(delimiter))
    return line


def first_fault(path: Path, header: Header, indices: Sequence[int], error: Exception) -> InputError:
    """Return the error that says where the first bad line or cell of a CSV file is."""
    with _lines(path) as stream:
        for number, line in enumerate(stream, start=1):
            if number <= header.lines or not line.strip():
                continue
            cells = line.rstrip("\r\n").split(header.delimiter)
            if len(cells) != len(header.names):
                return InputError(
                    f"Line {number} of {path} must have {len(header.names)} cells as the header has;"
                    f" it has {len(cells)}, so the file may be cut short or two lines may have run together."
                )
            for index in indices:
                if cells[index].strip() not in _MISSING and _number(cells[index]) is None:
                    return _bad_cell(path, number, header.names[index], cells[index].strip())
    return InputError(f"{path} cannot be read as CSV ({' '.join(str(error).split())[:120]}).")


def _bad_cell(path: Path, number: int, name: str, cell: str) -> InputError:
    comma = " with a decimal point, not a comma" if re.fullmatch(r"[-+]?\d+,\d+.*", cell) else ""
    return InputError(
        f"Line {number}, column '{name}' of {path} must be a number{comma}; it is '{cell[:40]}'."
    )


def _number(text: str) -> float | None:
    try:
        return float(text) if "_" not in text else None
    except ValueError:
        return None
