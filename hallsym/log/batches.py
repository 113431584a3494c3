"""Consecutive blocks of a log side by side, so that short runs do not cost a call each."""

from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np

from hallsym.log.columns import RUN
from hallsym.log.core import Block, Log, RunOrder
from hallsym.log.table import joined

SIZE = 8192
"""Samples handled at once: many short runs or a piece of a long one; the working set stays in cache."""

PADDED = 1.25
"""Length that blocks laid side by side may take, over that of the blocks."""

Weigh = Callable[[Block], np.ndarray]
"""Weight of each sample of a block: 1, or 0 for one that is left out."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Blocks side by side: block k is of run `runs[k]` and lies at `edges[k]` to `edges[k + 1]` of `data`."""

    runs: tuple[int, ...]
    data: dict[str, np.ndarray]
    edges: tuple[int, ...]

    def __len__(self) -> int:
        """Samples in the batch."""
        return self.edges[-1]

    def parts(self) -> Iterator[tuple[int, slice]]:
        """Yield the run of each block and its place in the batch."""
        yield from zip(self.runs, (slice(a, b) for a, b in pairwise(self.edges)), strict=True)

    @property
    def blocks(self) -> Iterator[Block]:
        """The blocks by themselves."""
        return (Block(run, {c: v[at] for c, v in self.data.items()}) for run, at in self.parts())

    def of_runs(self, runs: Collection[int]) -> "Batch":
        """Return the blocks of some runs."""
        some = [(run, at) for run, at in self.parts() if run in runs]
        if len(some) == len(self.runs):
            return self
        edges = np.cumsum([0, *(at.stop - at.start for _, at in some)]).tolist()
        parts = [{c: values[at] for c, values in self.data.items()} for _, at in some or [(0, slice(0))]]
        data = joined(parts, tuple(self.data))
        return Batch(tuple(run for run, _ in some), data, tuple(edges))

    def pieces(self, most: int) -> Iterator[tuple["Batch", slice]]:
        """Yield the batch in parts of at most `most` samples, with their place; blocks may be cut."""
        for low in range(0, len(self), most):
            part = slice(low, min(low + most, len(self)))
            cuts = [(r, max(at.start, low) - low, min(at.stop, part.stop) - low) for r, at in self.parts()]
            inside = [(run, stop) for run, first, stop in cuts if first < stop]
            data = {c: values[part] for c, values in self.data.items()}
            yield Batch(tuple(r for r, _ in inside), data, (0, *(stop for _, stop in inside))), part

    def cut(self, length: int, seen: int = 0) -> "Batch":
        """Return the same samples in blocks that end at every `length` samples of a run.

        `seen`: samples of the first block's run that lie before this batch.
        """
        runs, edges = list[int](), [0]
        for run, part in self.parts():
            if runs and run != runs[-1]:
                seen = 0
            n = part.stop - part.start
            stops = [*range(length - seen % length, n, length), n]
            runs += [run] * len(stops)
            edges += [part.start + stop for stop in stops]
            seen += n
        return Batch(tuple(runs), self.data, tuple(edges))

    def groups(self, most: int) -> Iterator[tuple[int, int]]:
        """Yield first and last (exclusive) block of groups of at most `most`, all of nearly one length."""
        lengths = np.diff(self.edges)
        first = 0
        for k in range(1, len(lengths) + 1):
            if k < len(lengths) and k - first < most:
                longest = lengths[first : k + 1].max()
                if longest * (k + 1 - first) <= PADDED * lengths[first : k + 1].sum():
                    continue
            yield first, k
            first = k

    def layout(self, first: int, last: int) -> Callable[[np.ndarray], np.ndarray]:
        """Return the map (..., samples) to (..., blocks, longest); ends are padded by 0."""
        edges = self.edges[first : last + 1]
        lengths = np.diff(edges)
        longest = int(lengths.max())

        def lay(values: np.ndarray) -> np.ndarray:
            here = values[..., edges[0] : edges[-1]]
            if (lengths == longest).all():
                return here.reshape(*values.shape[:-1], len(lengths), longest)
            out = np.zeros((*values.shape[:-1], len(lengths), longest))
            for k, n in enumerate(lengths):
                out[..., k, :n] = values[..., edges[k] : edges[k] + n]
            return out

        return lay

    def columns(self, names: Sequence[str]) -> list[np.ndarray]:
        """Return several columns, each of shape (samples,)."""
        return [self.data[name] for name in names]

    def offsets(self, by_run: Mapping[int, np.ndarray], count: int) -> np.ndarray:
        """Return the `count` offsets of each sample's run, 0 where it has none, (count, samples)."""
        own = np.array([by_run.get(run, np.zeros(count)) for run in self.runs])
        return np.repeat(own.reshape(len(self.runs), count).T, np.diff(self.edges), axis=1)

    def weights(self, weigh: Weigh | None) -> np.ndarray | None:
        """Return the weight of every sample, or None where all count fully."""
        return None if weigh is None else np.concatenate([weigh(block) for block in self.blocks])


REMEMBERED = 4_000_000
"""Samples whose weights are kept: 32 MB."""


def remembered(weigh: Weigh, rows: int, columns: Sequence[str] | None = None) -> Weigh:
    """Return the same weights, computed once per block where a log of `rows` samples is not too long.

    A block is known by its run and its numbers: those of `columns`, which are all that `weigh` looks at (all
    of the block's by default).
    """
    if rows > REMEMBERED:
        return weigh
    known: dict[tuple, np.ndarray] = {}

    def weights(block: Block) -> np.ndarray:
        names = block.data if columns is None else columns
        key = (block.run, *((name, hash(block.data[name].tobytes())) for name in names))
        if key not in known:
            known[key] = weigh(block)
            known[key].flags.writeable = False
        return known[key]

    return weights


CACHED_ROWS = 250_000
"""Samples of a log in memory whose batches are kept for the next pass: 2 MB for each column."""


_Cached = dict[str, tuple[Hashable, list[Batch]]]
_CACHE: WeakKeyDictionary[Log, _Cached] = WeakKeyDictionary()
"""By log and column its identity and the batches of it: a computed column at other values takes its place."""


def batches(
    log: Log, columns: Sequence[str], on_rows: Callable[[int], None] | None = None
) -> Iterator[Batch]:
    """Yield the log in batches of whole blocks, about `SIZE` samples each.

    Of a log in memory that is not too long each column is read once. `on_rows(samples so far)` is called
    after each batch.
    """
    done = 0
    for batch in _cached(log, columns) if is_cached(log) else _read(log, columns):
        yield batch
        done += len(batch)
        if on_rows:
            on_rows(done)


def is_cached(log: Log) -> bool:
    """Return whether the batches of a log, and results computed from them, are cached.

    Those of a view of a log with other numbers, which is read once, are not.
    """
    return isinstance(log.source, Log) and log.table.in_memory and log.rows <= CACHED_ROWS


def forget(log: Log, but: Collection[str]) -> None:
    """Drop the cached batches of all columns of a log but some: many models read more than the log holds."""
    known = _CACHE.get(log.source, {})
    for name in known.keys() - set(but):
        del known[name]


def _cached(log: Log, columns: Sequence[str]) -> Iterator[Batch]:
    cached = _CACHE.setdefault(log.source, {})
    keys = {name: log.identity(name) for name in columns}
    if missing := [name for name, key in keys.items() if name not in cached or cached[name][0] != key]:
        cached |= {name: (keys[name], []) for name in missing}
        # computed columns in one piece each: memory that thousands of small ones leave serves no large one
        whole, end = {name: np.empty(log.rows) for name in missing if keys[name] != name}, 0
        for batch in _read(log, missing):
            start, end = end, end + len(batch)
            for name in missing:
                values = batch.data[name]
                if name in whole:
                    whole[name][start:end] = values
                    values = whole[name][start:end]
                values.flags.writeable = False
                cached[name][1].append(Batch(batch.runs, {name: values}, batch.edges))
    for parts in zip(*(cached[name][1] for name in keys), strict=True):
        data = {name: next(iter(part.data.values())) for name, part in zip(keys, parts, strict=True)}
        yield Batch(parts[0].runs, data, parts[0].edges)


def _read(log: Log, columns: Sequence[str]) -> Iterator[Batch]:
    if type(log) is Log and log.table.in_memory:
        yield from _parts(log, columns)
        return
    waiting: list[Block] = []
    count = 0
    for block in log.blocks(columns, size=SIZE):
        waiting.append(block)
        count += len(block.data[columns[0]])
        if count >= SIZE:
            yield _batch(waiting, columns)
            waiting, count = [], 0
    if waiting:
        yield _batch(waiting, columns)


def _parts(log: Log, columns: Sequence[str]) -> Iterator[Batch]:
    """Yield the same batches of a log in memory as parts of its columns, which are not copied."""
    (piece,) = log.table.pieces(tuple(dict.fromkeys((RUN, *columns))), SIZE)
    data = {name: piece[name].astype(float, copy=False) for name in columns}
    runs, edges = list[int](), [0]
    for run, start, stop in RunOrder(log.name).segments(piece[RUN]):
        for end in (*range(start + SIZE, stop, SIZE), stop):
            runs.append(run)
            edges.append(end)
            if end - edges[0] >= SIZE or end == len(piece[RUN]):
                own = {name: values[edges[0] : end] for name, values in data.items()}
                yield Batch(tuple(runs), own, tuple(edge - edges[0] for edge in edges))
                runs, edges = [], [end]


def _batch(blocks: list[Block], columns: Sequence[str]) -> Batch:
    lengths = [len(block.data[columns[0]]) for block in blocks]
    data = joined([block.data for block in blocks], columns)
    return Batch(tuple(block.run for block in blocks), data, tuple(np.cumsum([0, *lengths]).tolist()))
