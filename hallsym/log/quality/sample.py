"""A thinned copy of a log: what distributions and gains can be judged from in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hallsym.log.columns import RUN
from hallsym.log.core import Log
from hallsym.log.table import Piece
from hallsym.units import Array

ENOUGH = 8192
"""Samples that are kept at least where a log has them; at most twice as many. 0.5 % of them are 40."""
WHOLE_ROWS = 2_000_000
"""Samples up to which a second look reads whole columns."""


class Sample:
    """Every n-th sample of a log, n a power of two that grows along the pass."""

    def __init__(self, columns: Sequence[str]) -> None:
        """Keep samples of `columns`."""
        self.columns = tuple(columns)
        self.stride = 1
        self._parts: list[tuple[Array, Array, Array]] = []
        self._count = 0

    def add(self, piece: Piece, row: int) -> None:
        """Take a piece that begins at `row` of the log."""
        here = slice(-row % self.stride, None, self.stride)
        rows = np.arange(row + here.start, row + len(piece[RUN]), self.stride)
        values = np.array([piece[name][here] for name in self.columns]).reshape(len(self.columns), len(rows))
        self._parts.append((rows, piece[RUN][here].copy(), values))  # a view would keep the whole piece
        self._count += len(rows)
        while self._count > 2 * ENOUGH:
            self._thin()

    def _thin(self) -> None:
        self.stride *= 2
        kept = [(part, part[0] % self.stride == 0) for part in self._parts]
        self._parts = [(rows[keep], run[keep], values[:, keep]) for (rows, run, values), keep in kept]
        self._count = sum(len(part[0]) for part in self._parts)

    @cached_property
    def whole(self) -> Whole:
        """The kept samples, at the end of the pass."""
        _, run, values = (np.concatenate(parts, axis=-1) for parts in zip(*self._parts, strict=True))
        return Whole(run, dict(zip(self.columns, values, strict=True)))


@dataclass(frozen=True, eq=False)
class Whole:
    """Columns of a log side by side, or those of its thinned copy: `run` and `data[column]`, (n,) each."""

    run: Array
    data: dict[str, Array]

    @cached_property
    def _ordered(self) -> dict[str, Array]:
        return {}

    def ordered(self, name: str) -> Array:
        """Return the samples of a column by size, (n,)."""
        if name not in self._ordered:
            self._ordered[name] = np.sort(self.data[name])
        return self._ordered[name]

    @staticmethod
    def of(log: Log, columns: Sequence[str]) -> Whole:
        """Read whole columns of a log, of its first `WHOLE_ROWS` samples at most."""
        parts: list[dict[str, Array]] = []
        count = 0
        for block in log.blocks((RUN, *columns)):
            parts.append(block.data)
            count += len(block.data[RUN])
            if count >= WHOLE_ROWS:
                break
        data = {name: np.concatenate([part[name] for part in parts]) for name in (RUN, *columns)}
        return Whole(data.pop(RUN).astype(np.int64), data)
