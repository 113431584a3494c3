"""The log: named SI channels, split into runs, with their noise."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, few
from hallsym.log.arrow import source_of
from hallsym.log.columns import RUN, bind
from hallsym.log.meta import Meta, Noise
from hallsym.log.table import CHUNK_ROWS, Piece, Table, TableLike, View, exact, joined
from hallsym.units import Array

_LONGEST_NAME = 60
"""Characters of a log's name that a sentence has room for: with them it stays below 300."""


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive samples of one run: `data[column]` is float64 of shape (samples,), in SI units."""

    run: int
    data: dict[str, Array]


@dataclass(frozen=True, eq=False)
class Log:
    """Recorded samples. Make one with `read_log` or `Log.from_arrays`; arrays are read-only views.

    `notes` states assumptions of reading; `path` is the data file (None for arrays). `counted`: `t_s` is no
    clock but a counter of samples. `recording`: the samples as recorded, where the runs are pieces of them;
    checks use it.
    """

    table: TableLike
    noise: Noise = field(default_factory=Noise)
    meta: Meta = field(default_factory=Meta)
    path: Path | None = None
    notes: tuple[str, ...] = ()
    counted: bool = False
    recording: Log | None = None

    @staticmethod
    def from_arrays(
        columns: Mapping[str, Array],
        noise: Noise | None = None,
        meta: Meta | None = None,
        name: str = "The log",
    ) -> Log:
        """Build a log from arrays of equal length; a name such as `hall_a_um` states the unit it is in."""
        source = source_of(columns, name)
        table = Table(source, bind(source.names, {}, name, units=source.units)[0], name)
        known = replace(meta or Meta(), columns=table.columns)
        return Log(table, noise or Noise(), known, notes=(*table.notes, *source.notes))

    @property
    def columns(self) -> tuple[str, ...]:
        """SI column names, `run` included."""
        return self.table.columns

    @property
    def name(self) -> str:
        """Name of this log in messages: its path, or the one given to `from_arrays`."""
        return self.table.where

    @property
    def short_name(self) -> str:
        """Name in a sentence; a long path keeps its end."""
        return self.name if len(self.name) <= _LONGEST_NAME else f"...{self.name[3 - _LONGEST_NAME :]}"

    @property
    def described(self) -> Meta:
        """What it states of its machine, with the samples that tell what is not stated."""
        return replace(self.meta, column=self.array)

    @property
    def timed(self) -> bool:
        """Whether the log holds time."""
        return "t_s" in self.columns and not self.counted

    @property
    def source(self) -> Log:
        """The log whose samples these are: itself; a log with derived columns returns the one it extends."""
        return self

    def identity(self, column: str) -> Hashable:
        """Return a key that distinguishes a column from others of its name in logs of the same `source`."""
        return column

    @cached_property
    def rows(self) -> int:
        """Number of samples."""
        return self.table.count()

    @cached_property
    def runs(self) -> tuple[int, ...]:
        """Run ids in the order of recording."""
        order = RunOrder(self.name)
        found = (order.segments(piece[RUN]) for piece in self.table.pieces((RUN,), CHUNK_ROWS))
        return tuple(dict.fromkeys(run for segments in found for run, _, _ in segments))

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the data file; of the columns where it is not one. Computed on first use."""
        if self.path is not None and self.path.is_file():
            with open(self.path, "rb") as stream:
                return hashlib.file_digest(stream, "sha256").hexdigest()
        digest = hashlib.sha256()
        for block in self.blocks():
            for name, values in block.data.items():
                digest.update(f"{name}:{block.run}:".encode())
                digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()

    def blocks(self, columns: Sequence[str] | None = None, size: int = CHUNK_ROWS) -> Iterator[Block]:
        """Yield consecutive blocks of one run each, of at most `size` samples, with `columns` (or all).

        A run is cut every `size` samples from its own beginning, wherever it stands in the log: what is
        computed block by block does not depend on what was recorded before.
        A run must be contiguous: an id that comes back after another run is an `InputError`.
        """
        wanted = self.columns if columns is None else tuple(columns)
        asked = tuple(dict.fromkeys((RUN, *wanted)))
        runs = RunOrder(self.name)

        def stretches() -> Iterator[tuple[int, Piece]]:
            for piece in self.table.pieces(asked, size):
                floats = {
                    RUN: piece[RUN],
                    **{name: piece[name].astype(np.float64, copy=False) for name in wanted},
                }
                for run, start, stop in runs.segments(piece[RUN]):
                    yield run, {name: values[start:stop] for name, values in floats.items()}

        for run, parts in groupby(stretches(), key=lambda stretch: stretch[0]):
            for data in exact((piece for _, piece in parts), size, asked):
                yield Block(run, {name: data[name] for name in wanted})

    def run(self, run: int, columns: Sequence[str] | None = None) -> Piece:
        """Return one run's columns, each float64 of shape (samples of that run,)."""
        wanted = self.columns if columns is None else tuple(columns)
        parts = [block.data for block in self.blocks(wanted) if block.run == run]
        if not parts:
            raise InputError(f"{self.name} has no run {run}; it has runs {few([*map(str, self.runs)], 12)}.")
        return joined(parts, wanted)

    def array(self, column: str) -> Array:
        """Return one whole column, float64 of shape (rows,)."""
        values = joined(list(self.table.pieces((column,), CHUNK_ROWS)), (column,))[column]
        return values.astype(np.float64, copy=False)


def edges_of(run: Array) -> list[int]:
    """Return where the runs of samples (n,) begin, and where the last one ends."""
    return [0, *(np.flatnonzero(run[1:] != run[:-1]) + 1).tolist(), len(run)]


class RunOrder:
    """Splits run columns into runs along one pass and refuses a run that comes back."""

    def __init__(self, where: str) -> None:
        self.where = where
        self._seen: dict[int, None] = {}

    def segments(self, run: Array) -> list[tuple[int, int, int]]:
        """Return (run id, start, stop) of the consecutive stretches of an integer array of shape (rows,)."""
        if not len(run):
            return []
        edges = edges_of(run)
        found = list(zip(run[edges[:-1]].tolist(), edges[:-1], edges[1:], strict=True))
        for ident, _, _ in found:
            current = next(reversed(self._seen), None)
            if ident != current and ident in self._seen:
                raise InputError(
                    f"Run {ident} of {self.where} must be contiguous; it comes back after run {current},"
                    " so sort the log by run or give each stretch its own number."
                )
            self._seen[ident] = None
        return found


@dataclass(frozen=True)
class Drop:
    """Samples to leave out: not finite in a column, with time that does not advance, of a run.

    `rows`: (start, stop) in the log.
    """

    finite: tuple[str, ...] = ()
    forward: bool = False
    runs: frozenset[int] = field(default_factory=frozenset)
    rows: tuple[tuple[int, int], ...] = ()

    def __or__(self, other: Drop) -> Drop:
        """Return the union of both."""
        return Drop(
            tuple(dict.fromkeys(self.finite + other.finite)),
            self.forward or other.forward,
            self.runs | other.runs,
            self.rows + other.rows,
        )

    def __bool__(self) -> bool:
        """Say whether anything is left out."""
        return bool(self.finite or self.forward or self.runs or self.rows)


class Filtered(View):
    """A table without the samples that `drop` names."""

    def __init__(self, table: TableLike, drop: Drop) -> None:
        super().__init__(table)
        self.drop = drop

    def count(self) -> int:
        """Return the number of rows that are kept."""
        return sum(len(piece[RUN]) for piece in self.pieces((RUN,), CHUNK_ROWS))

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[Piece]:
        """Yield the kept rows, as `Table.pieces` does."""
        row, run, latest = 0, None, -np.inf
        deciding = (RUN, *self.drop.finite, *(["t_s"] if self.drop.forward else []))
        for piece in self.table.pieces(tuple(dict.fromkeys((*columns, *deciding))), size):
            keep = np.ones(len(piece[RUN]), bool)
            for name in self.drop.finite:
                keep &= np.isfinite(piece[name])
            for start, stop in self.drop.rows:
                keep[max(0, start - row) : max(0, stop - row)] = False
            row += len(keep)
            if self.drop.runs:
                keep &= ~np.isin(piece[RUN], list(self.drop.runs))
            if self.drop.forward:  # later than every kept sample before, within each run
                time = np.where(keep & ~np.isnan(piece["t_s"]), piece["t_s"], -np.inf)
                for start, stop in pairwise(edges_of(piece[RUN])):
                    if stop > start and piece[RUN][start] != run:
                        run, latest = piece[RUN][start], -np.inf
                    so_far = np.maximum.accumulate(np.r_[latest, time[start:stop]])
                    keep[start:stop] &= time[start:stop] > so_far[:-1]
                    latest = so_far[-1]
            if keep.any() or self.in_memory:
                yield {name: piece[name] if keep.all() else piece[name][keep] for name in columns}


def without(log: Log, drop: Drop) -> Log:
    """Return the log without the samples that `drop` names; a stream stays a stream."""
    table = Filtered(log.table, drop)
    recording = without(log.recording, drop) if log.recording else None
    return Log(table, log.noise, log.meta, log.path, log.notes, log.counted, recording)
