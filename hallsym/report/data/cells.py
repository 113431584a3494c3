"""Median and rms of errors in cells of a coordinate, from one pass over a log of any length."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

STEP, HALF = 0.02, 520
"""Bins are equally wide in arcsinh(error / fine): 2 % of a large error, `STEP` x fine of a small one; the
outermost begin at sinh(STEP x HALF) = 16 000 x fine."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Errors of the decoded pose by cell, in SI.

    `by`: what the cells are along, with the unit of `edges`. `median`, `rms`: (n_pose, cells), nan in an
    empty cell; `count`: (cells,). Cells have `edges` (cells + 1,) or, where they are no numbers, `labels`;
    `marked` are held out. Over two coordinates `across` holds the edges of the second, `up` its name, and
    cell `i + columns * j` lies at column i, row j. `turning`: coordinates that go round, see
    `hallsym.units.readable`.
    """

    by: str
    pose: tuple[str, ...]
    count: np.ndarray
    median: np.ndarray
    rms: np.ndarray
    edges: Sequence[float] | np.ndarray = ()
    labels: tuple[str, ...] = ()
    marked: tuple[int, ...] = ()
    up: str = ""
    across: Sequence[float] | np.ndarray = ()
    turning: Collection[str] | None = None


class Tally:
    """Histogram of each series in each cell, from which medians are read; memory is (series, cells, bins)."""

    def __init__(self, cells: int, fine: np.ndarray) -> None:
        """Start a tally of `cells` cells; `fine`: (series,) error [SI] that is fine enough to tell apart."""
        self.fine = np.maximum(np.asarray(fine, dtype=float), 1e-300)
        self.count = np.zeros(cells, dtype=np.int64)
        self.squares = np.zeros((len(self.fine), cells))
        self.bins = np.zeros((len(self.fine), cells, 2 * HALF), dtype=np.int32)

    def bin_of(self, errors: np.ndarray) -> np.ndarray:
        """Return the bin of each error, (series, samples); it is the same for tallies of equal `fine`."""
        at = np.floor(np.arcsinh(errors / self.fine[:, None]) / STEP) + HALF
        return np.clip(np.nan_to_num(at), 0, 2 * HALF - 1).astype(np.int64)

    def add(self, cell: np.ndarray, errors: np.ndarray, bin_of: np.ndarray | None = None) -> None:
        """Add samples: `cell` (samples,), negative for none of the cells; `errors` (series, samples).

        An error that is nan takes no part. `bin_of(errors)` may be given where it is known.
        """
        at = self.bin_of(errors) if bin_of is None else bin_of
        inside = (cell >= 0) & np.isfinite(errors).all(axis=0)
        if not inside.all():
            cell, errors, at = cell[inside], errors[:, inside], at[:, inside]
        self.count += np.bincount(cell, minlength=len(self.count))
        for squares, bins, where, error in zip(self.squares, self.bins, at, errors, strict=True):
            squares += np.bincount(cell, weights=error**2, minlength=len(squares))
            np.add.at(bins.reshape(-1), cell * (2 * HALF) + where, 1)

    @property
    def rms(self) -> np.ndarray:
        """Root mean square, (series, cells); nan in an empty cell."""
        return np.sqrt(self.squares / np.where(self.count > 0, self.count, np.nan))

    @property
    def median(self) -> np.ndarray:
        """Median to within one bin, (series, cells); nan in an empty cell."""
        up = np.cumsum(self.bins, axis=2)
        half = 0.5 * self.count[:, None]
        at = np.argmax(up >= np.maximum(half, 0.5), axis=2)
        before = np.take_along_axis(up - self.bins, at[..., None], axis=2)[..., 0]
        inside = np.take_along_axis(self.bins, at[..., None], axis=2)[..., 0]
        part = (half[:, 0] - before) / np.maximum(inside, 1)
        value = self.fine[:, None] * np.sinh(STEP * (at - HALF + part))
        return np.where(self.count > 0, value, np.nan)
