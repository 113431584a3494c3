"""From raw columns of a file, small or large, to SI columns in memory or in a bounded stream."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, few, nearest
from hallsym.log.columns import RUN, Binding, Foreign, is_ours, is_run_word, numbers_runs
from hallsym.log.text.cells import is_number
from hallsym.units import Array, split_unit

IN_MEMORY_ROWS = 2_000_000
CHUNK_ROWS = 65_536

TIME = "\0time"
"""Name in a source of the time of its samples, in seconds, that its format gives; no column has this name."""
BLOCK = "\0block"
"""Name of the number of the block of rows that a sample is in, of a source with `blocks`."""
Piece = dict[str, Array]
SHOWN_ROWS = 50_000
"""Samples that show what a column is."""
RESTARTED = 0.01
"""Part of the time that has passed within which a clock that starts again is back at its first value; that of
a sample that is late or doubled is not."""


class Source(ABC):
    """A file's columns under their own names; each format has one.

    `small`: whether whole columns may be kept in memory. `left_out`: why a vector cannot be a column, by its
    name. `aliases`: short names by long name, a path in a struct or a group. `units`: stated by the file
    beside a name, by name (`hallsym.units`). `notes` on the file; `recognised`: its format, if that was not
    stated. `read_with`: the options that it was read with, by name. `path`: where the file is on a disk.
    `since`: what the times count from that its format gives. `clocks`: of columns of times, what knows the
    `moment` of their zero [ns since 1970] once they were read. `pace`: the sample interval, if it states one.
    `facts`: what lines above the names say, by name.
    `filled`: whether the file says that no first cell is empty. `typed`: whether its types say that all
    columns hold numbers. `blocks`: whether rows may be divided, which the column `BLOCK` then tells.
    """

    names: tuple[str, ...]
    rows: int
    small: bool
    left_out: Mapping[str, str] = {}
    aliases: Mapping[str, str] = {}
    units: Mapping[str, str] = {}
    recognised: str = ""
    notes: tuple[str, ...] = ()
    read_with: Mapping[str, str] = {}
    path: Path | None = None
    since: str = ""
    clocks: Mapping[str, Any] = {}
    pace: Any = None
    facts: Mapping[str, str] = {}
    filled: bool = False
    typed: bool = False
    blocks: bool = False

    def count(self) -> int:
        """Return the number of rows; where it is not known before, all are read."""
        if not hasattr(self, "rows"):
            return sum(len(piece[self.names[0]]) for piece in self.chunks(self.names[:1], CHUNK_ROWS))
        return self.rows

    def read(self, names: Sequence[str], most: int | None = None) -> Mapping[str, Array]:
        """Return columns, each of shape (rows,), or of the `most` first rows."""
        pieces, rows = list[Mapping[str, Array]](), 0
        for piece in self.chunks(names, most or CHUNK_ROWS) if names else ():
            pieces.append(piece)
            rows += len(piece[names[0]])
            if most and rows >= most:
                break
        return {name: values[:most] for name, values in joined(pieces, names).items()}

    def numbers(self, names: Sequence[str] | None = None, most: int | None = None) -> dict[str, Array]:
        """Return those of some columns (default: all) that hold numbers, of shape (rows,); `most` rows."""
        found, names = dict[str, Array](), self.names if names is None else names
        for some in (names, *([name] for name in names)):
            if some and not found.keys() >= {*some}:
                with suppress(InputError):  # words
                    found |= self.read(some, most)
        return found

    def head(self, count: int, most: int) -> list[list[str]]:
        """Return the first rows as text, of at most `most` columns."""
        names, found = self.names[:most], self.numbers(self.names[:most], count)
        columns = [
            [f"{v:.9g}" if abs(v) < 1e9 else label(v) for v in np.asarray(found[name], float).tolist()]
            if name in found
            else [label(cell) for cell in (self.texts(name) if self.small else None) or ()][:count]
            for name in names
        ]  # fmt: skip
        rows = max(map(len, columns), default=0)
        return [[column[k] if k < len(column) else "" for column in columns] for k in range(rows)]

    def labels(self, name: str) -> list[str]:
        """Return a column of names, as text; whole numbers are names too: 7.0 is "7"."""
        try:
            return [label(value) for value in self.read([name])[name].tolist()]
        except InputError:
            if (texts := self.texts(name)) is None:
                raise
            return list(map(label, texts))

    def texts(self, name: str) -> Sequence[object] | None:
        """Return the cells of a column that holds no numbers; None where a format has no such column."""
        return None

    def run_column(self, taken: Collection[str] = ()) -> tuple[str, bool]:
        """Return the column that numbers or names runs, "" without one, and whether a word calls it so.

        Of columns that are not `taken` and have no unit, it holds what stays and rises, or labels in a row.
        """
        free = [n for n in self.names if not (n in taken or n in self.units or split_unit(n)[1])]
        if own := next((name for name in free if name.lower() == RUN), ""):
            return own, True
        data = self.numbers(free, SHOWN_ROWS)
        texts = [n for n in free if n not in data] if self.small else []
        data |= {n: in_order(self.labels(n)) for n in texts if self.texts(n) is not None}
        counts = {n: len(np.unique(values)) for n, values in data.items() if numbers_runs(values)}
        several = [n for n, count in counts.items() if count > 1]
        best = max(several, key=lambda n: (is_run_word(n), counts[n]), default="")
        return best, is_run_word(best)

    def call(self, columns: Mapping[str, tuple[str, str | None]]) -> None:
        """Take names of columns, each with the file's own text and the unit (`stems_of`)."""
        self.names = tuple(columns)
        self.units = {name: unit for name, (_, unit) in columns.items() if unit}
        self.aliases = {text: name for name, (text, _) in columns.items() if text != name}

    @abstractmethod
    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most about `size` rows."""


def about(source: Source) -> dict[str, Any]:
    """Return what is known of a source before its columns are read."""
    known = {name: getattr(source, name, None) for name in Source.__annotations__}
    return {name: value for name, value in known.items() if value is not None}


def label(value: object) -> str:
    """Return a name as text; a missing one is empty.

    >>> label(7.0), label(" R3-17 "), label(float("nan"))
    ('7', 'R3-17', '')
    """
    if isinstance(value, float):
        return "" if value != value else str(int(value)) if value.is_integer() else repr(value)
    return "" if value is None else str(value).strip()


def in_order(labels: Sequence[str]) -> Array:
    """Return the numbers of names in the order in which they come first, (rows,); nan for what is no name."""
    names = dict.fromkeys(text for text in labels if text and not is_number(text))
    places = {text: k for k, text in enumerate(names)}
    return np.array([places.get(text, np.nan) for text in labels])


def joined(parts: Sequence[Mapping[str, Array]], names: Sequence[str]) -> Piece:
    """Return the columns `names` of consecutive pieces, one after the other."""
    if len(parts) == 1:
        return {name: parts[0][name] for name in names}
    return {name: np.concatenate([p[name] for p in parts] or [np.empty(0)]) for name in names}


def exact(
    pieces: Iterable[Mapping[str, Array]], size: int, names: Sequence[str]
) -> Iterator[Mapping[str, Array]]:
    """Yield pieces of any length in chunks of exactly `size` rows; the last one may be shorter."""
    waiting: list[Mapping[str, Array]] = []
    count = 0
    for piece in pieces:
        waiting.append(piece)
        count += len(piece[names[0]])
        if count < size:
            continue
        whole = joined(waiting, names)
        for lo in range(0, count - size + 1, size):
            yield {name: whole[name][lo : lo + size] for name in names}
        count %= size
        waiting = [{name: whole[name][-count:] for name in names}] if count else []
    if count:
        yield joined(waiting, names)


class Arrays(Source):
    """A source that holds its columns already: each of shape (rows,)."""

    small = True

    def __init__(self, columns: Mapping[str, Array]) -> None:
        self.columns = dict(columns)
        self.names = tuple(self.columns)
        self.rows = len(next(iter(self.columns.values()), ()))

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield everything at once."""
        yield {name: self.columns[name] for name in names}


class Table:
    """SI columns over a source. Small sources are kept in memory, one read per newly asked set of columns."""

    def __init__(self, source: Source, bindings: Mapping[str, Binding], where: str) -> None:
        """Bind SI names to a source that messages call `where`.

        `open`, set later: names of which somebody has yet to choose one in a column file.
        """
        self.source, self.bindings, self.where = source, dict(bindings), where
        self.columns = tuple(self.bindings) if RUN in self.bindings else (RUN, *self.bindings)
        self._cache: Piece = {}
        self.open: tuple[str, ...] = ()

    @property
    def numbered(self) -> bool:
        """Whether runs are those of a column, or all is one, for lack of a clock."""
        return RUN in self.bindings or "t_s" not in self.bindings

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on runs; a table without time has none."""
        said = (
            "No column 'run': a run begins where t_s starts again or text has an empty line or names again."
        )
        return () if self.numbered else (said,)

    @property
    def in_memory(self) -> bool:
        """Whether whole columns are kept; otherwise every pass streams the file again."""
        return self.source.small

    def count(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self._cache.values()))) if self._cache else self.source.count()

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[Piece]:
        """Yield `{column: values}` in consecutive pieces of about `size` rows; in memory it is one."""
        self.require(columns)
        if self.in_memory:
            yield self._hold(columns)
            return
        restarts, sources = Restarts(), self._sources(columns) or [self.source.names[0]]
        for raw in self.source.chunks(sources, size):
            yield self._convert(columns, raw, restarts)

    def require(self, columns: Sequence[str]) -> None:
        """Refuse columns that the log does not have, and say which name is near."""
        for name in columns:
            if name in self.columns:
                continue
            if name in self.source.left_out:
                raise InputError(
                    f"Column {name} of {self.where} cannot be used: {self.source.left_out[name]}."
                )
            if choices := [c for c in self.open if split_unit(c)[0] == split_unit(name)[0]]:
                raise InputError(
                    f"The unit of {split_unit(name)[0]} of {self.where} must be chosen: remove the # before"
                    f" {' or '.join(dict.fromkeys(choices))} in the column file."
                )
            own = {b.source for b in self.bindings.values() if b.asked or is_ours(b.name)}
            free = [c for c in self.source.names if c not in own]  # a column of a kind is meant for no other
            others = free if is_ours(name) else list(self.columns)
            has = few(self.source.names, 20) or "no numeric columns"
            raise InputError(
                f"{self.where} has no column {name}{nearest(name, others)}; it has {has}; a column under "
                f"another name is mapped with --column {name}=ITS_NAME: the ending is the unit it is in."
            )

    @property
    def mapping(self) -> dict[str, Foreign]:
        """The columns that somebody mapped: our name, with the unit where it was stated, and the file's."""
        return {b.asked: b.foreign for b in self.bindings.values() if b.asked}

    def counts_per_turn(self, column: str) -> float | None:
        """Return how many counts of the file make a turn, for an angle in counts."""
        return self.bindings[column].foreign.counts_per_turn if column in self.bindings else None

    def _hold(self, columns: Sequence[str]) -> Piece:
        new = [name for name in columns if name not in self._cache]
        if new:
            converted = self._convert(new, self._read(self._sources(new)), Restarts())
            for values in converted.values():
                values.flags.writeable = False
            self._cache.update(converted)
        return {name: self._cache[name] for name in columns}

    def _sources(self, columns: Sequence[str]) -> list[str]:
        """Return the file's names of the inputs of columns."""
        runs = RUN in columns and not self.numbered
        found = [self.bindings[n].source for n in (*columns, *["t_s"] * runs) if n in self.bindings]
        return [*dict.fromkeys(found), *[BLOCK] * (runs and self.source.blocks)]

    def _read(self, sources: Sequence[str]) -> Mapping[str, Array]:
        """Return whole columns of the file; runs with names are numbered in their order."""
        try:
            return self.source.read(sources) if sources else {}
        except InputError:
            name = self.bindings[RUN].source if RUN in self.bindings else ""
            runs = in_order(self.source.labels(name) if name in sources else [""])
            if np.isnan(runs).any():
                raise
            return {**self._read([s for s in sources if s != name]), name: runs}

    def _convert(self, columns: Sequence[str], raw: Mapping[str, Array], restarts: Restarts) -> Piece:
        rows = len(next(iter(raw.values()))) if raw else self.count()
        found = {c: self.bindings[c].si(raw[self.bindings[c].source]) for c in columns if c in self.bindings}
        if RUN in columns and RUN not in found:
            clock = None if self.numbered else self.bindings["t_s"]
            none = np.zeros(rows, np.int64)
            found[RUN] = restarts(clock.si(raw[clock.source]), raw.get(BLOCK, none)) if clock else none
        return {c: found[c] for c in columns}


class Restarts:
    """Numbers runs along chunks of a clock; one begins with a block, or where time is back at its start."""

    def __init__(self) -> None:
        self._first, self._last, self._run, self._block = np.nan, np.nan, 0, 0

    def __call__(self, t: Array, blocks: Array) -> Array:
        """Return the runs, numbered from 0, of times [s] and numbers of blocks, each (rows,)."""
        if not len(t):
            return np.zeros(0, np.int64)
        self._first = t[0] if np.isnan(self._first) else self._first
        before = np.r_[self._last, t[:-1]]
        back = (t < before) & (t - self._first <= RESTARTED * (before - self._first))
        runs = self._run + np.cumsum(back | (np.diff(blocks, prepend=self._block) > 0))
        self._last, self._run, self._block = t[-1], int(runs[-1]), blocks[-1]
        return np.asarray(runs)


class View:
    """A table whose samples are seen in another way; all else is the table's own."""

    def __init__(self, table: TableLike) -> None:
        self.table = table

    def __getattr__(self, name: str) -> Any:
        """Return what the table itself knows."""
        if name == "table":  # asked for while a copy is made, before it has one
            raise AttributeError(name)
        return getattr(self.table, name)


class Resting(View):
    """A table with further columns of one value each."""

    def __init__(self, table: TableLike, values: Mapping[str, float]) -> None:
        super().__init__(table)
        self.values = dict(values)
        self.columns = (*table.columns, *values)

    def require(self, columns: Sequence[str]) -> None:
        """Refuse columns that neither the log nor the further ones have."""
        self.table.require([name for name in columns if name not in self.values])

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[Piece]:
        """Yield consecutive pieces, as `Table.pieces` does."""
        own = [name for name in columns if name not in self.values] or [RUN]
        for piece in self.table.pieces(own, size):
            rows = len(piece[own[0]])
            yield {n: np.full(rows, self.values[n]) if n in self.values else piece[n] for n in columns}


TableLike = Table | View


_EXTRAS = {
    "h5py": ("hdf5", "HDF5 (and MATLAB v7.3) files", "h5py"),
    "python_calamine": ("xlsx", "Workbook files", "python-calamine"),
    "nptdms": ("tdms", "TDMS files", "npTDMS"),
    "asammdf": ("mdf", "MDF files", "asammdf"),
    "mcap": ("mcap", "MCAP files", "mcap"),
    "mcap_ros2": ("mcap", "MCAP files", "mcap-ros2-support"),
    "serial": ("capture", "Serial ports", "pyserial"),
}
"""Module -> the extra it comes with, what it reads, the name of its package."""


def load(module: str) -> Any:
    """Import a library; where an extra is not installed, say what to install."""
    name = module.partition(".")[0]
    if name not in _EXTRAS:
        return importlib.import_module(module)
    extra, kind, package = _EXTRAS[name]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            f"{kind} need {package}, which is not installed; run: pip install 'hallsym[{extra}]'."
        ) from error
