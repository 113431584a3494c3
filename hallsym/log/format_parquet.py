"""Parquet, Feather and lines of JSON, through pyarrow."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, quoted
from hallsym.log.arrow import Memory, Timed, distinct, is_numeric, is_time, source_of
from hallsym.log.columns import stems_of
from hallsym.log.table import CHUNK_ROWS, IN_MEMORY_ROWS, load
from hallsym.log.vectors import MOST_COLUMNS
from hallsym.units import UNITS, Array

_BUFFER = 1 << 20
_THREADS = 131_072
"""Rows above which columns are decoded by several threads: starting them costs more than a shorter file."""


class ParquetSource(Timed):
    """Columns of one Parquet file; a large one is decoded batch by batch."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._opened() as file:
            schema, self.rows = file.schema_arrow, int(file.metadata.num_rows)
        self.small = self.rows <= IN_MEMORY_ROWS
        times = {k: "" for k, kind in enumerate(schema.types) if is_time(kind)}
        self.take(stems_of(distinct(schema.names, quoted(path))), times, quoted(path))
        self._own = dict(zip(self.names, schema, strict=True))

    def texts(self, name: str) -> list[object]:
        """Return the cells of one column."""
        with self._opened() as file:
            return list(file.read([self._own[name].name]).column(0).to_pylist())

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield batches of at most `size` rows; of a small file everything at once."""
        fields = [self._own[name] for name in names]
        for field in fields:
            if not (is_time(field.type) or is_numeric(field.type)):
                raise InputError(
                    f"Column '{field.name}' of {self.path} must hold numbers; it holds {field.type}."
                )
        readers, own = [self.reader(name) for name in names], [field.name for field in fields]
        whole = self.small and size >= CHUNK_ROWS
        with self._opened(buffer_size=0 if whole else _BUFFER) as file:
            batches = [file.read(own, use_threads=self.rows >= _THREADS)] if whole else None
            for batch in batches or file.iter_batches(size, columns=own, use_threads=False):
                yield {
                    name: array(batch.column(column))
                    for name, array, column in zip(names, readers, own, strict=True)
                }

    @contextmanager
    def _opened(self, **options: Any) -> Iterator[Any]:
        parquet = load("pyarrow.parquet")
        options["pre_buffer"] = False  # its threads end the process where there is little memory
        with parquet.ParquetFile(self.path, page_checksum_verification=True, **options) as file:
            yield file


def open_feather(path: Path) -> Memory:
    """Open a file or a stream of Arrow (Feather)."""
    arrow = load("pyarrow")
    stream = arrow.memory_map(str(path))
    try:
        table = load("pyarrow.feather").read_table(stream)
    except arrow.ArrowInvalid:
        stream.seek(0)
        table = load("pyarrow.ipc").open_stream(stream).read_all()
    return source_of(table, quoted(path))


def open_json(path: Path) -> Memory:
    """Open lines of JSON objects with the same keys, a list of them, or one object of lists.

    Of an object, or a list, in an object each entry is a column. A unit behind its name is that of its
    columns: {"hall_um": {"a": 1.5}} is `hall_a_um`, {"hall_um": [1.5]} is `hall_0_um`. What one object holds
    at any depth are columns, those that are as long as the longest.
    """
    arrow = load("pyarrow")
    try:
        whole = json.loads(path.read_bytes())
        table = arrow.Table.from_pylist(whole if isinstance(whole, list) else [whole])
    except json.JSONDecodeError:  # several objects
        table = load("pyarrow.json").read_json(path)
    one = table.num_rows == 1
    named = zip(table.column_names, table.columns, strict=True)
    parts = [part for name, column in named for part in _parts(name, column, one)]
    rows = max((len(column) for _, column in parts), default=0)
    parts = [(name, column) for name, column in parts if len(column) == rows]
    return source_of(arrow.table([c for _, c in parts], [name for name, _ in parts]), quoted(path))


def _parts(name: str, column: Any, one: bool) -> Iterator[tuple[str, Any]]:
    """Yield the columns that a column of objects or lists holds, by name; of one object by their own."""
    types, compute, kind = load("pyarrow").types, load("pyarrow.compute"), column.type
    stem, _, last = name.rpartition("_")
    stem, unit = (stem, f"_{last}") if stem and last in UNITS else (name, "")
    sizes = compute.min_max(compute.list_value_length(column)).as_py() if types.is_list(kind) else {}
    if types.is_list(kind) and one:
        yield from _parts(name, compute.list_flatten(column), one)
    elif types.is_struct(kind):
        for k, field in enumerate(kind):
            under = field.name if one else f"{stem}_{field.name}{unit}"
            yield from _parts(under, compute.struct_field(column, k), one)
    elif sizes.get("max") and sizes["min"] == sizes["max"] <= MOST_COLUMNS:
        for k in range(sizes["max"]):
            yield from _parts(f"{stem}_{k}{unit}", compute.list_element(column, k), one)
    else:
        yield name, column


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
