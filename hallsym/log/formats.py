"""The file formats of a log: to add one, write its file and add a row here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hallsym.errors import InputError, nearest
from hallsym.log.format_csv import CsvSource
from hallsym.log.format_hdf5 import Hdf5Source
from hallsym.log.format_mat import open_mat
from hallsym.log.format_mcap import open_mcap
from hallsym.log.format_mdf import open_mdf
from hallsym.log.format_parquet import ParquetSource
from hallsym.log.format_tdms import open_tdms
from hallsym.log.format_xlsx import open_workbook
from hallsym.log.table import Source


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
