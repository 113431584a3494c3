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
from hallsym.log.format_mcap import open_mcap
from hallsym.log.format_mdf import open_mdf
from hallsym.log.format_parquet import ParquetSource, ParquetWriter
from hallsym.log.format_tdms import open_tdms
from hallsym.log.format_xlsx import open_workbook
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
    """A format's name, the suffixes that mean it, how to open it, what it is called and how to write it.

    `options`: what a reader may be told of it, by the names of `read_log`. `writer`: None for a format that
    is only read.
    """

    name: str
    suffixes: tuple[str, ...]
    open: Callable[..., Source]
    kind: str
    writer: Callable[[Path], Writer] | None
    options: tuple[str, ...] = ()


FORMATS = (
    Format("parquet", (".parquet", ".pq"), ParquetSource, "Parquet", ParquetWriter),
    Format("csv", (".csv", ".txt", ".tsv"), CsvSource, "CSV", CsvWriter, ("delimiter", "decimal")),
    Format("hdf5", (".h5", ".hdf5"), Hdf5Source, "HDF5", Hdf5Writer),
    Format("mat", (".mat",), open_mat, "MATLAB", MatWriter),
    Format(
        "xlsx",
        (".xlsx", ".xlsm", ".xls", ".ods"),
        open_workbook,
        "workbook",
        None,
        ("sheet", "decimal"),
    ),
    Format("tdms", (".tdms",), open_tdms, "TDMS", None, ("clock",)),
    Format("mdf", (".mf4", ".mdf"), open_mdf, "MDF", None, ("clock",)),
    Format("mcap", (".mcap",), open_mcap, "MCAP", None, ("clock",)),
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
