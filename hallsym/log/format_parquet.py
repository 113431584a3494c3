"""Parquet, Feather and lines of JSON, through pyarrow."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from hallsym.errors import InputError, quoted
from hallsym.log.arrow import Memory, Timed, distinct, is_numeric, is_time, source_of
from hallsym.log.columns import stems_of
from hallsym.log.pace import pace_in
from hallsym.log.table import CHUNK_ROWS, IN_MEMORY_ROWS, Source, load
from hallsym.log.vectors import unit_in
from hallsym.units import Array

_BUFFER = 1 << 20
_THREADS = 131_072
"""Rows above which columns are decoded by several threads: starting them costs more than a shorter file."""


class ParquetSource(Timed):
    """Columns of one Parquet file; a large one is decoded batch by batch."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._opened() as file:
            schema, self.rows = file.schema_arrow, int(file.metadata.num_rows)
            group = file.metadata.row_group(0) if file.metadata.num_row_groups else None
            known = [group.column(k).statistics for k in range(group.num_columns)] if group else []
        self.filled = all(one is not None and one.null_count == 0 for one in known)
        self.typed = self.filled and all(map(is_numeric, schema.types))
        self.small = self.rows <= IN_MEMORY_ROWS
        times = {k: "" for k, kind in enumerate(schema.types) if is_time(kind)}
        stated = [unit_in(field.metadata or {}) for field in schema]
        self.take(stems_of(distinct(schema.names, quoted(path)), stated), times, quoted(path))
        self.fields, self._own = list(schema), dict(zip(self.names, schema, strict=True))

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


def open_parquet(path: Path) -> Source:
    """Open a Parquet file; one whose columns hold lists, records or categories is read whole."""
    source, types = ParquetSource(path), load("pyarrow").types
    kinds = [field.type for field in source.fields]
    if not source.small or not any(types.is_nested(kind) or types.is_dictionary(kind) for kind in kinds):
        return source
    whole = source_of(load("pyarrow.parquet").read_table(path), quoted(path))
    whole.units = {**{n: u for n, u in source.units.items() if n in whole.names}, **whole.units}
    return whole


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
    """Open lines of JSON objects with the same keys, a list of them, or one object of lists or of a matrix.

    What one object holds at any depth are columns, those that are as long as the longest. Objects that hold
    lists of samples are runs: in a list, or with the same keys under names of their own.
    """
    arrow, facts = load("pyarrow"), dict[str, Any]()
    with arrow.input_stream(str(path)) as stream:  # which may be compressed
        text = stream.read()
    try:
        whole, facts = _rows(json.loads(text, object_hook=_listed))
        table = arrow.Table.from_pylist(whole if isinstance(whole, list) else [whole])
    except json.JSONDecodeError:  # several objects
        table = load("pyarrow.json").read_json(arrow.BufferReader(text))
    source = source_of(table, quoted(path))
    source.pace = pace_in(facts)
    return source


def _listed(whole: dict[str, Any]) -> Any:
    """Return a list in the place of an object whose keys count, as pandas writes a column."""
    return [*whole.values()] if len(whole) > 1 and all(map(str.isdecimal, whole)) else whole


def _rows(whole: Any) -> tuple[Any, dict[str, Any]]:
    """Return the object that holds the samples, or a list of them, and the numbers and words beside it."""
    if not isinstance(whole, dict):
        return whole, {}
    facts, parts = _facts(whole), [own for own in whole.values() if isinstance(own, list | dict) and own]
    parts = [own for own in parts if isinstance(own, list) or len(_facts(own)) < len(own)]
    lists = [own for own in parts if isinstance(own, list)]
    for names in (own for own in lists if all(isinstance(name, str) for name in own)):
        for rows in lists:  # as pandas writes a matrix
            if all(isinstance(row, list) and len(row) == len(names) for row in rows):
                return [dict(zip(names, row, strict=True)) for row in rows], facts
    if len(parts) == 1 and lists and all(isinstance(row, dict) for row in lists[0]):
        return lists[0], facts
    runs = len(parts) > 1 and not lists and len({frozenset(own) for own in parts}) == 1
    return parts if runs else whole, facts


def _facts(whole: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers and words of an object, and of those in it that hold nothing else."""
    inner = [_facts(own) for own in whole.values() if isinstance(own, dict)]
    own = {name: value for name, value in whole.items() if isinstance(value, int | float | str)}
    return {name: value for facts in (*inner, own) for name, value in facts.items()}


def parquet_writer(stream: IO[bytes], schema: Any, suffix: str) -> Any:
    """Return pyarrow's writer of tables to a stream, compressed with zstd, with a checksum of each page.

    The bytes of floats are split by their place: measured numbers hardly repeat, and a dictionary of them
    makes a file 40 % larger and twice as slow to read.
    """
    floats = [f.name for f in schema if load("pyarrow").types.is_floating(f.type)]
    return load("pyarrow.parquet").ParquetWriter(
        stream, schema, compression="zstd", write_page_checksum=True,
        use_dictionary=[name for name in schema.names if name not in floats], use_byte_stream_split=floats,
    )  # fmt: skip
