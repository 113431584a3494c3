"""A series of any length as a picture needs it: least and greatest value per picture column."""

from collections.abc import Sequence

import numpy as np

COLUMNS = 1000
"""A long trace is drawn with this many to twice this many min-max columns, a shorter one sample by sample."""


class Trace:
    """Least and greatest value of several series per column of a picture, gathered block by block.

    `low`, `high`: (series, columns), nan where no sample was kept; a column holds `width` samples. When the
    columns are used up, neighbours are merged, so a trace never holds more than 2 x `COLUMNS`.
    """

    def __init__(self, series: int) -> None:
        """Start a trace of `series` series."""
        self.count, self.width = 0, 1
        shape = (series, 2 * COLUMNS)
        self._low, self._high = np.full(shape, np.nan), np.full(shape, np.nan)

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
        self.count += n

    def _merge(self) -> None:
        for array, join in ((self._low, np.fmin), (self._high, np.fmax)):
            array[:, :COLUMNS] = join(array[:, ::2], array[:, 1::2])
            array[:, COLUMNS:] = np.nan
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
