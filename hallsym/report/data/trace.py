"""A series of any length as a picture needs it: least, greatest and mean square value per picture column."""

from collections.abc import Sequence

import numpy as np

COLUMNS = 1000
"""A long trace is drawn with this many to twice this many min-max columns, a shorter one sample by sample."""


class Trace:
    """Least and greatest value of several series per column of a picture, gathered block by block.

    `low`, `high`: (series, columns), nan where no sample was kept; a column holds `width` samples. When the
    columns are used up, neighbours are merged, so a trace never holds more than 2 x `COLUMNS`.
    """

    def __init__(self, series: int, *, squares: bool = False) -> None:
        """Start a trace of `series` series; `squares`: gather for `cells` too."""
        self.count, self.width = 0, 1
        shape = (series, 2 * COLUMNS)
        self._low, self._high = np.full(shape, np.nan), np.full(shape, np.nan)
        self._squares: np.ndarray | None = np.zeros(shape) if squares else None
        self._kept: np.ndarray | None = np.zeros(shape) if squares else None

    def add(self, values: np.ndarray) -> None:
        """Append samples, shape (series, samples); nan marks what is left out."""
        n = values.shape[1]
        while self.count + n > self.width * 2 * COLUMNS:
            self._merge()
        column = (self.count + np.arange(n)) // self.width
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        at = slice(int(column[0]), int(column[-1]) + 1)
        self._low[:, at] = np.fmin(self._low[:, at], np.fmin.reduceat(values, starts, axis=1))
        self._high[:, at] = np.fmax(self._high[:, at], np.fmax.reduceat(values, starts, axis=1))
        if self._squares is not None and self._kept is not None:
            kept = np.isfinite(values)
            self._squares[:, at] += np.add.reduceat(np.where(kept, values, 0.0) ** 2, starts, axis=1)
            self._kept[:, at] += np.add.reduceat(kept.astype(float), starts, axis=1)
        self.count += n

    def _merge(self) -> None:
        for array, join, empty in (
            (self._low, np.fmin, np.nan),
            (self._high, np.fmax, np.nan),
            (self._squares, np.add, 0.0),
            (self._kept, np.add, 0.0),
        ):
            if array is not None:
                array[:, :COLUMNS] = join(array[:, ::2], array[:, 1::2])
                array[:, COLUMNS:] = empty
        self.width *= 2

    @property
    def low(self) -> np.ndarray:
        """Least value per column, shape (series, columns)."""
        return self._low[:, : -(-self.count // self.width)]

    @property
    def high(self) -> np.ndarray:
        """Greatest value per column, shape (series, columns)."""
        return self._high[:, : -(-self.count // self.width)]

    @property
    def samples(self) -> np.ndarray:
        """Sample number in the middle of each column."""
        return (np.arange(self.low.shape[1]) + 0.5) * self.width - 0.5

    def line(
        self, series: int, x: np.ndarray, breaks: Sequence[int] | np.ndarray = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return `(x, y)` of a line from least to greatest value, interrupted before samples in `breaks`."""
        y = self.low[series]
        if self.width > 1:
            x, y = np.repeat(x, 2), np.column_stack([y, self.high[series]]).ravel()
        at = [(2 if self.width > 1 else 1) * (sample // self.width) for sample in breaks]
        return np.insert(x, at, x[at]), np.insert(y, at, np.nan)

    def cells(self, most: int) -> tuple[int, np.ndarray, np.ndarray]:
        """Return columns per cell, and per cell the extent (greatest less least) and the rms.

        Cells are neighbouring columns taken together, so that there are at most `most`; extent and rms have
        shape (series, cells), nan where no sample was kept. The trace must have been made with `squares`.
        """
        if self._squares is None or self._kept is None:
            raise ValueError("Input squares of Trace must be True for cells; instead received False.")
        columns = self.low.shape[1]
        per_cell = max(1, -(-columns // most))
        starts = np.arange(0, columns, per_cell)
        extent = np.fmax.reduceat(self.high, starts, axis=1) - np.fmin.reduceat(self.low, starts, axis=1)
        squares = np.add.reduceat(self._squares[:, :columns], starts, axis=1)
        kept = np.add.reduceat(self._kept[:, :columns], starts, axis=1)
        return (
            per_cell,
            extent,
            np.sqrt(np.divide(squares, kept, out=np.full_like(kept, np.nan), where=kept > 0)),
        )
