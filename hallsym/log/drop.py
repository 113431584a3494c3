"""Which samples to leave out, and the filter that does it along a pass."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from hallsym.log.columns import RUN
from hallsym.log.core import Log
from hallsym.log.table import Filtered, Piece
from hallsym.units import Array


@dataclass(frozen=True)
class Drop:
    """Samples to leave out: not finite in a column, with time that does not advance, of a run.

    `between`: columns with the values that samples to keep lie between; `rows`: (start, stop) in the log.
    """

    finite: tuple[str, ...] = ()
    forward: bool = False
    between: tuple[tuple[str, float, float], ...] = ()
    runs: frozenset[int] = field(default_factory=frozenset)
    rows: tuple[tuple[int, int], ...] = ()

    def __or__(self, other: Drop) -> Drop:
        """Leave out what either leaves out."""
        return Drop(
            tuple(dict.fromkeys(self.finite + other.finite)),
            self.forward or other.forward,
            self.between + other.between,
            self.runs | other.runs,
            self.rows + other.rows,
        )

    def __bool__(self) -> bool:
        """Say whether anything is left out."""
        return bool(self.finite or self.forward or self.between or self.runs or self.rows)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that decide."""
        time = ("t_s",) if self.forward else ()
        return tuple(dict.fromkeys((RUN, *self.finite, *time, *(name for name, _, _ in self.between))))


class Keep:
    """The filter of one pass: returns the rows of a piece to keep; remembers how far time has come."""

    def __init__(self, drop: Drop) -> None:
        self.drop = drop
        self._run: int | None = None
        self._latest = -np.inf
        self._row = 0

    def __call__(self, piece: Piece) -> Array:
        """Return a boolean mask of shape (rows,)."""
        keep = np.ones(len(piece[RUN]), bool)
        for name in self.drop.finite:
            keep &= np.isfinite(piece[name])
        for name, low, high in self.drop.between:
            keep &= (piece[name] > low) & (piece[name] < high)
        for start, stop in self.drop.rows:
            keep[max(0, start - self._row) : max(0, stop - self._row)] = False
        self._row += len(keep)
        if self.drop.runs:
            keep &= ~np.isin(piece[RUN], list(self.drop.runs))
        if self.drop.forward:
            keep &= self._advances(piece["t_s"], piece[RUN], keep)
        return keep

    def _advances(self, t: Array, run: Array, keep: Array) -> Array:
        """Return where time is later than at every kept sample before, within each run."""
        usable = np.where(keep & ~np.isnan(t), t, -np.inf)
        result = np.zeros(len(t), bool)
        edges = [0, *(np.flatnonzero(run[1:] != run[:-1]) + 1).tolist(), len(run)]
        for start, stop in pairwise(edges):
            if stop > start and run[start] != self._run:
                self._run, self._latest = int(run[start]), -np.inf
            latest = np.maximum.accumulate(np.r_[self._latest, usable[start:stop]])
            result[start:stop] = usable[start:stop] > latest[:-1]
            self._latest = float(latest[-1])
        return result


def without(log: Log, drop: Drop) -> Log:
    """Return the log without the samples that `drop` names; a stream stays a stream."""
    table = Filtered(log.table, drop.columns, partial(Keep, drop))
    recording = without(log.recording, drop) if log.recording else None
    return Log(table, log.noise, log.meta, log.path, log.notes, log.counted, recording)
