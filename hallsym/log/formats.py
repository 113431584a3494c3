"""The file formats of a log: to add one, write its file and add a row here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, nearest, quoted
from hallsym.log.columns import RUN
from hallsym.log.format_csv import CsvSource
from hallsym.log.format_hdf5 import Hdf5Source
from hallsym.log.format_mat import open_mat
from hallsym.log.format_mcap import open_mcap
from hallsym.log.format_mdf import open_mdf
from hallsym.log.format_parquet import ParquetSource
from hallsym.log.format_tdms import open_tdms
from hallsym.log.format_xlsx import open_workbook
from hallsym.log.table import Source
from hallsym.reading import reading
from hallsym.units import Array


@dataclass(frozen=True)
class Format:
    """A format's name, the suffixes that mean it, how to open it and what it is called.

    `options`: what a reader may be told of it, by the names of `read_log`.
    """

    name: str
    suffixes: tuple[str, ...]
    open: Callable[..., Source]
    kind: str
    options: tuple[str, ...] = ()


FORMATS = (
    Format("parquet", (".parquet", ".pq"), ParquetSource, "Parquet"),
    Format("csv", (".csv", ".txt", ".tsv"), CsvSource, "CSV", ("delimiter", "decimal")),
    Format("hdf5", (".h5", ".hdf5"), Hdf5Source, "HDF5"),
    Format("mat", (".mat",), open_mat, "MATLAB"),
    Format("xlsx", (".xlsx", ".xlsm", ".xls", ".ods"), open_workbook, "workbook", ("sheet", "decimal")),
    Format("tdms", (".tdms",), open_tdms, "TDMS", ("clock",)),
    Format("mdf", (".mf4", ".mdf"), open_mdf, "MDF", ("clock",)),
    Format("mcap", (".mcap",), open_mcap, "MCAP", ("clock",)),
)


COMPRESSED = ".gz"


def format_of(path: Path, name: str | None = None) -> Format:
    """Return the format that `name` states or else the path's suffix means; log.csv.gz is CSV."""
    suffix = path.suffix.lower()
    if suffix == COMPRESSED:
        suffix = Path(path.stem).suffix.lower() or ".csv"
    for entry in FORMATS:
        if entry.name == name or (name is None and suffix in entry.suffixes):
            return entry
    if name is not None:
        known = [entry.name for entry in FORMATS]
        raise InputError(
            f"Format must be one of {', '.join(known)}; instead received '{name}'{nearest(name, known)}."
        )
    suffixes = ", ".join(suffix for entry in FORMATS for suffix in entry.suffixes)
    raise InputError(
        f"File {path} must end with one of {suffixes}, or its format must be stated; it ends '{path.suffix}'."
    )


MOST_ROWS = 1_000_000_000
"""Samples of a log: 8 GB a column, minutes of reading. More is a damaged count, or must be decimated."""


class Guarded(Source):
    """The columns of one file as `open` reads them; each call of the library is inside the boundary."""

    path: Path

    def __init__(self, path: Path, open: Callable[[Path], Source], fault: str) -> None:
        """Open the file: its names, rows and what is left out are known then."""
        self.path, self.fault = path, fault
        with self._reading():
            self.inner = open(path)
            self.names, self.small = tuple(self.inner.names), self.inner.small
        self.left_out, self.aliases = dict(self.inner.left_out), dict(self.inner.aliases)
        self.notes, self.units = self.inner.notes, dict(self.inner.units)
        self.recognised, self.unstated = self.inner.recognised, self.inner.unstated
        self._check_names()

    def count(self) -> int:
        """Return the number of rows."""
        with self._reading():
            rows = self.inner.count()
        return self._possible(rows)

    def read(self, names: Sequence[str]) -> Mapping[str, Array]:
        """Return whole columns, each of shape (rows,)."""
        self._possible(getattr(self.inner, "rows", 0))
        with self._reading():
            columns = self.inner.read(names)
        return self._judged(names, columns)

    def head(self, count: int, most: int) -> list[list[str]]:
        """Return the first rows as text."""
        with self._reading():
            return self.inner.head(count, most)

    def labels(self, name: str) -> list[str]:
        """Return a column of names, as text."""
        self._possible(getattr(self.inner, "rows", 0))
        with self._reading():
            return self.inner.labels(name)

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most about `size` rows."""
        self._possible(getattr(self.inner, "rows", 0))
        pieces = self.inner.chunks(names, size)
        while True:
            with self._reading():
                piece = next(pieces, None)
            if piece is None:
                return
            yield self._judged(names, piece)

    def _reading(self) -> AbstractContextManager[None]:
        return reading(self.path, "Log", self.fault, "copy it again")

    def _check_names(self) -> None:
        known: set[str] = set()
        for name in self.names:
            if name in known:
                raise InputError(
                    f"Columns of {quoted(self.path)} must have different names; '{name}' is twice."
                )
            known.add(name)
        if RUN in self.left_out:
            raise InputError(
                f"Column run of {quoted(self.path)} cannot be used: {self.left_out[RUN]}; write it again."
            )

    def _possible(self, rows: int) -> int:
        if not 0 <= rows <= MOST_ROWS:
            raise InputError(
                f"Log {quoted(self.path)} must have at most {MOST_ROWS} samples; it says {rows}, so it is "
                "damaged or has to be decimated."
            )
        return rows

    def _judged(self, names: Sequence[str], columns: Mapping[str, Array]) -> Mapping[str, Array]:
        """Return columns of numbers of one length; refuse others, which would be cut or taken for numbers."""
        rows = None
        for name in names:
            values = np.asarray(columns[name])
            if values.dtype.kind not in "fiu":
                what = "booleans" if values.dtype.kind == "b" else "other values"
                raise InputError(
                    f"Column '{name}' of {quoted(self.path)} must hold numbers; it holds {what}."
                )
            rows = values.shape if rows is None else rows
            if values.ndim != 1 or values.shape != rows:
                raise InputError(
                    f"Columns of {quoted(self.path)} must be equally long; '{name}' has {values.shape} "
                    f"values, '{names[0]}' {rows}."
                )
        return columns
