"""The file formats of a log: to add one, write its file and add a row here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from hallsym.errors import InputError, nearest
from hallsym.log.format_csv import CsvSource, CsvWriter
from hallsym.log.format_hdf5 import Hdf5Source, Hdf5Writer
from hallsym.log.format_mat import MatWriter, open_mat
from hallsym.log.format_parquet import ParquetSource, ParquetWriter
from hallsym.log.table import Source
from hallsym.units import Array


class Writer(Protocol):
    """Writes chunks of columns to one file; `group_rows` is the chunk it likes."""

    group_rows: int

    def write(self, columns: Mapping[str, Array]) -> None:
        """Append rows."""

    def close(self) -> None:
        """Finish the file."""


@dataclass(frozen=True)
class Format:
    """A format's name, the suffixes that mean it, how to open it, what it is called and how to write it."""

    name: str
    suffixes: tuple[str, ...]
    open: Callable[[Path], Source]
    kind: str
    writer: Callable[[Path], Writer]


FORMATS = (
    Format("parquet", (".parquet", ".pq"), ParquetSource, "Parquet", ParquetWriter),
    Format("csv", (".csv", ".txt", ".tsv"), CsvSource, "CSV", CsvWriter),
    Format("hdf5", (".h5", ".hdf5"), Hdf5Source, "HDF5", Hdf5Writer),
    Format("mat", (".mat",), open_mat, "MATLAB", MatWriter),
)


def format_of(path: Path, name: str | None = None) -> Format:
    """Return the format that `name` states or else the path's suffix means."""
    for entry in FORMATS:
        if entry.name == name or (name is None and path.suffix.lower() in entry.suffixes):
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
