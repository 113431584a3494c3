"""Parquet, Feather and lines of JSON, through pyarrow."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, quoted
from hallsym.log.arrow import (
    Seconds,
    array_of,
    is_numeric,
    is_time,
    name_the_time,
    said_of_times,
    source_of,
)
from hallsym.log.table import IN_MEMORY_ROWS, Arrays, Source, label, load
from hallsym.units import UNITS, Array

_BUFFER = 1 << 20
_THREADS = 131_072
"""Rows from which on columns are decoded by several threads: starting them costs more than a shorter file."""


class ParquetSource(Source):
    """Columns of one Parquet file; a large one is decoded batch by batch. Times are in seconds."""

    clocks: dict[str, Seconds]

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._opened() as file:
            schema, self.rows = file.schema_arrow, int(file.metadata.num_rows)
        times = [k for k, kind in enumerate(schema.types) if is_time(kind)]
        self.small = self.rows <= IN_MEMORY_ROWS
        self.notes = tuple(said_of_times(schema.names[k], quoted(path), "times") for k in times)
        self.names = tuple(schema.names)
        name_the_time(self, times)
        self._own = dict(zip(self.names, schema, strict=True))
        self.clocks = {}

    def read(self, names: Sequence[str]) -> Mapping[str, Array]:
        """Return whole columns."""
        asked = self._asked(names)
        with self._opened() as file:
            table = file.read(columns=[own for own, _ in asked.values()], use_threads=self.rows >= _THREADS)
            return {name: made(table.column(own)) for name, (own, made) in asked.items()}

    def labels(self, name: str) -> list[str]:
        """Return one column of text or numbers as text."""
        with self._opened() as file:
            own = self._own[name].name
            return [label(value) for value in file.read(columns=[own]).column(own).to_pylist()]

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield batches of at most `size` rows."""
        asked = self._asked(names)
        with self._opened(buffer_size=_BUFFER) as file:
            columns = [own for own, _ in asked.values()]
            for batch in file.iter_batches(batch_size=size, columns=columns, use_threads=False):
                yield {name: made(batch.column(own)) for name, (own, made) in asked.items()}

    @contextmanager
    def _opened(self, **options: Any) -> Iterator[Any]:
        parquet = load("pyarrow.parquet")
        options["pre_buffer"] = False  # its threads end the process where there is little memory
        with parquet.ParquetFile(self.path, page_checksum_verification=True, **options) as file:
            yield file

    def _asked(self, names: Sequence[str]) -> dict[str, tuple[str, Callable[[Any], Array]]]:
        """Return the file's name of each column, and what makes an array of its chunks in one pass."""
        for field in (self._own[name] for name in names):
            if not (is_time(field.type) or is_numeric(field.type)):
                raise InputError(
                    f"Column '{field.name}' of {self.path} must hold numbers; it holds {field.type}."
                )
        self.clocks |= {name: Seconds() for name in names if is_time(self._own[name].type)}
        return {name: (self._own[name].name, self.clocks.get(name, array_of)) for name in names}


def open_feather(path: Path) -> Arrays:
    """Open a file or a stream of Arrow (Feather)."""
    arrow = load("pyarrow")
    stream = arrow.memory_map(str(path))
    try:
        table = load("pyarrow.feather").read_table(stream)
    except arrow.ArrowInvalid:
        stream.seek(0)
        table = load("pyarrow.ipc").open_stream(stream).read_all()
    return source_of(table, quoted(path))


def open_json(path: Path) -> Arrays:
    """Open lines of JSON objects with the same keys, a list of them, or one object of lists.

    Of an object in an object each entry is a column. A unit behind the name of an object is that of its
    columns: {"hall_um": {"a": 1.5}} is `hall_a_um`.
    """
    arrow = load("pyarrow")
    try:
        whole = json.loads(path.read_bytes())
    except json.JSONDecodeError:  # several objects
        table = load("pyarrow.json").read_json(path)
    else:
        lists = {k: v for k, v in whole.items() if isinstance(v, list)} if isinstance(whole, dict) else {}
        rows = whole if isinstance(whole, list) else [whole]
        table = arrow.table(lists) if lists else arrow.Table.from_pylist(rows)
    names = list(table.column_names)
    while any(arrow.types.is_struct(kind) for kind in table.schema.types):
        names = [name for k, column in enumerate(names) for name in _within(column, table.schema.types[k])]
        table = table.flatten()
    return source_of(table.rename_columns(names), quoted(path))


def _within(name: str, kind: Any) -> list[str]:
    """Return the names of the columns that an object holds; of a column, its own."""
    if not load("pyarrow").types.is_struct(kind):
        return [name]
    stem, _, last = name.rpartition("_")
    unit = f"_{last}" if stem and last in UNITS else ""
    return [f"{stem if unit else name}_{field.name}{unit}" for field in kind]


class ParquetWriter:
    """Writes chunks as row groups, compressed with zstd, with a checksum of each page.

    The bytes of floats are split by their place: measured numbers hardly repeat, and a dictionary of them
    makes a file 40 % larger and twice as slow to read.
    """

    group_rows = 131_072

    def __init__(self, path: Path) -> None:
        self.path = path
        self._arrow, self._parquet = load("pyarrow"), load("pyarrow.parquet")
        self._file: Any = None

    def write(self, columns: Mapping[str, Array]) -> None:
        """Append rows."""
        table = self._arrow.table(dict(columns))
        if self._file is None:
            floats = [f.name for f in table.schema if self._arrow.types.is_floating(f.type)]
            others = [name for name in table.column_names if name not in floats]
            self._file = self._parquet.ParquetWriter(
                self.path, table.schema, compression="zstd", write_page_checksum=True,
                use_dictionary=others, use_byte_stream_split=floats,
            )  # fmt: skip
        self._file.write_table(table, row_group_size=self.group_rows)

    def close(self) -> None:
        """Write the footer."""
        if self._file is not None:
            self._file.close()
