"""Write a log, whole or piece by piece, so that a failure leaves the old file as it was."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted, require
from hallsym.files import reason, replacing
from hallsym.log.columns import RUN
from hallsym.log.core import Log
from hallsym.log.format_csv import csv_writer
from hallsym.log.format_parquet import parquet_writer
from hallsym.log.formats import COMPRESSED, format_of
from hallsym.log.table import joined, load
from hallsym.units import Array, si_name, to_si

WRITERS = {"csv": csv_writer, "parquet": parquet_writer}
GROUP_ROWS = 131_072
"""Rows that are written at once."""


class LogWriter:
    """Write a log in pieces; the format follows from the suffix, units are SI.

    >>> with LogWriter("log.parquet") as writer:          # doctest: +SKIP
    ...     writer.append({"run": run, "t_s": t, "hall_a_um": readings})

    The file appears under its name when the block ends without an error, and not before.
    """

    def __init__(self, path: str | Path) -> None:
        """Choose the format; nothing is written before the `with` block."""
        self.path = Path(path)
        name = format_of(self.path).name
        if name not in WRITERS or self.path.suffix == COMPRESSED:
            raise InputError(
                f"Logs are not written as {self.path.suffix}; end {quoted(self.path)} with .parquet or .csv."
            )
        self._make = WRITERS[name]
        self._writer: Any = None
        self._waiting: list[dict[str, Array]] = []
        self._rows = 0
        self._names: tuple[str, ...] | None = None

    def __enter__(self) -> LogWriter:
        """Open a temporary file beside the target."""
        with ExitStack() as stack:
            path = stack.enter_context(replacing(self.path))
            self._stream = stack.enter_context(path.open("wb"))
            self._target = stack.pop_all()
        return self

    def append(self, columns: Mapping[str, Array]) -> None:
        """Add samples: arrays of equal length; a name in another unit (`hall_a_um`) is converted to SI."""
        chunk = {si_name(name): _values(name, values) for name, values in columns.items()}
        lengths = {len(values) for values in chunk.values()}
        require(len(lengths) == 1, f"Columns written to {self.path}", "equally long", sorted(lengths))
        if self._names is None:
            wrong = next((name for name in chunk if not name.isprintable()), "")
            require(
                not wrong, f"A column written to {quoted(self.path)}", "named in printable characters", wrong
            )
            self._names = tuple(chunk)
        if set(chunk) != set(self._names):
            raise InputError(
                f"Every piece written to {self.path} must have the columns {', '.join(self._names)}."
            )
        self._waiting.append({name: chunk[name] for name in self._names})
        self._rows += lengths.pop()
        if self._rows >= GROUP_ROWS:
            self._drain()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish and rename, or remove the temporary file."""
        if error is not None:
            with suppress(Exception):  # whatever failed, it says itself
                self._target.__exit__(GeneratorExit, GeneratorExit(), None)
            return
        with self._target:
            if self._names is None:
                raise InputError(
                    f"Nothing was written to {self.path}: a log needs at least one piece of samples."
                )
            self._drain()

    def _drain(self) -> None:
        if self._waiting and self._names:
            table = load("pyarrow").table(joined(self._waiting, self._names))
            try:
                if self._writer is None:
                    self._writer = self._make(self._stream, table.schema, self.path.suffix)
                    self._target.callback(self._writer.close)
                self._writer.write_table(table, GROUP_ROWS)
            except OSError as error:
                raise InputError(f"Cannot write {self.path}: {reason(error)}.") from error
            self._waiting, self._rows = [], 0


def write_log(log: Log | Mapping[str, Array], path: str | Path) -> None:
    """Write a log or a dict of arrays to `path`, in the format of its suffix, in bounded memory."""
    with LogWriter(path) as writer:
        if isinstance(log, Log):
            for block in log.blocks():
                writer.append(block.data)
        else:
            writer.append(log)


def _values(name: str, values: Array) -> Array:
    array = np.asarray(values)
    require(array.ndim == 1, f"Column {name}", "a vector", f"shape {array.shape}")
    if name == RUN:
        if not np.array_equal(array, array.astype(np.int64)):
            raise InputError("Column run must hold whole numbers.")
        return array.astype(np.int64)
    return to_si(name, array)
