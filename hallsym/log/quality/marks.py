"""Rows that are told by their own samples, so that a stretch that occurs twice is met again in one pass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from hallsym.log.limits import is_reading
from hallsym.log.table import Piece
from hallsym.units import Array

MOST = 32_768
"""Marked rows that are kept; where a log has more, every second kind of mark is forgotten."""
_ONE_IN = 4
"""Bits of a row's hash that must be 0 for the row to be marked: one row in 16."""
_MIX = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio: Knuth's multiplicative hashing
FEWEST = 5
"""Marked rows that must be met again at the same distance: about 80 rows."""


class Marks:
    """Hashes of the readings in the rows that the hashes themselves choose, in any pieces the same."""

    def __init__(self, columns: Sequence[str]) -> None:
        """Watch the readings among `columns`."""
        self.columns = tuple(filter(is_reading, columns))
        self._bits = _ONE_IN
        self._parts: list[tuple[Array, Array]] = []
        self._count = 0

    def add(self, piece: Piece, row: int) -> None:
        """Take a piece that begins at `row` of the log."""
        if not self.columns:
            return
        hashed = np.zeros(len(piece[self.columns[0]]), np.uint64)
        for name in self.columns:
            hashed *= _MIX
            hashed += piece[name].view(np.uint64)
        hashed *= _MIX
        at = np.flatnonzero(hashed < np.uint64(1 << (64 - self._bits)))
        self._parts.append((hashed[at], row + at))
        self._count += len(at)
        while self._count > MOST:
            self._bits += 1
            kept = [(h, r, h < np.uint64(1 << (64 - self._bits))) for h, r in self._parts]
            self._parts = [(h[keep], r[keep]) for h, r, keep in kept]
            self._count = sum(len(h) for h, _ in self._parts)

    def distance(self) -> int | None:
        """Return the distance in rows at which marked rows are met again most often; None if hardly any.

        Rows in which nothing moves are met again everywhere: only the next of the same hash counts, and one
        that is not the next row.
        """
        if not self._parts:
            return None
        hashed, rows = (np.concatenate(parts) for parts in zip(*self._parts, strict=True))
        order = np.argsort(hashed, kind="stable")
        same = np.diff(hashed[order]) == 0
        apart = np.diff(rows[order])[same]
        apart = apart[apart > 1]
        if len(apart) < FEWEST:
            return None
        distance, often = Counter(apart.tolist()).most_common(1)[0]
        return int(distance) if often >= FEWEST else None
