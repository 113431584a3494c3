"""Parquet logs, through pyarrow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hallsym.errors import InputError
from hallsym.log.arrow import array_of, is_numeric
from hallsym.log.extras import load
from hallsym.log.table import IN_MEMORY_ROWS, Source, label
from hallsym.units import Array

_BUFFER = 1 << 20


class ParquetSource(Source):
    """Columns of one Parquet file; a large one is decoded batch by batch."""

    def __init__(self, path: Path, stream: Callable[[], Any] | None = None) -> None:
        """Read the footer; `stream` opens a file that is not on a disk."""
        self.path, self._stream = path, stream
        with self._opened() as file:
            self.names = tuple(file.schema_arrow.names)
            self.rows = int(file.metadata.num_rows)
        self.small = self.rows <= IN_MEMORY_ROWS

    def read(self, names: Sequence[str]) -> Mapping[str, Array]:
        """Return whole columns."""
        with self._opened() as file:
            table = file.read(columns=list(names))
            return {name: self._numbers(name, table.column(name)) for name in names}

    def labels(self, name: str) -> list[str]:
        """Return one column of text or numbers as text."""
        with self._opened() as file:
            return [label(value) for value in file.read(columns=[name]).column(name).to_pylist()]

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield batches of at most `size` rows."""
        with self._opened(buffer_size=_BUFFER, pre_buffer=False) as file:
            for batch in file.iter_batches(batch_size=size, columns=list(names), use_threads=False):
                yield {name: self._numbers(name, batch.column(name)) for name in names}

    @contextmanager
    def _opened(self, **options: Any) -> Iterator[Any]:
        parquet = load("pyarrow.parquet")
        where = self.path if self._stream is None else self._stream()
        with parquet.ParquetFile(where, page_checksum_verification=True, **options) as file:
            yield file

    def _numbers(self, name: str, column: Any) -> Array:
        if not is_numeric(column.type):
            raise InputError(f"Column '{name}' of {self.path} must hold numbers; it holds {column.type}.")
        return array_of(column)


class ParquetWriter:
    """Writes chunks as row groups, compressed with zstd, with a checksum of each page."""

    group_rows = 131_072

    def __init__(self, path: Path) -> None:
        """Keep the path; the first rows give the schema."""
        self.path = path
        self._arrow, self._parquet = load("pyarrow"), load("pyarrow.parquet")
        self._file: Any = None

    def write(self, columns: Mapping[str, Array]) -> None:
        """Append rows."""
        table = self._arrow.table(dict(columns))
        if self._file is None:
            self._file = self._parquet.ParquetWriter(
                self.path, table.schema, compression="zstd", write_page_checksum=True
            )
        self._file.write_table(table, row_group_size=self.group_rows)

    def close(self) -> None:
        """Write the footer."""
        if self._file is not None:
            self._file.close()
