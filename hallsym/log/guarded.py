"""A log's file behind the boundary: what a library raises is one sentence, what it returns is judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.columns import RUN
from hallsym.log.table import Source
from hallsym.reading import reading
from hallsym.units import Array

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
