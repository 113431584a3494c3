"""A part of a long log: whole stretches at the full rate, evenly spread over it.

What is computed of neighbouring samples, such as a rate, is the same in the part as in the log: each stretch
knows the samples beside it.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np

from hallsym.log.core import Block, Log
from hallsym.log.table import CHUNK_ROWS, Piece, joined

LENGTH = 1024
"""Samples of a stretch, or a whole run that is shorter: a correlation of 64 samples shows in it."""


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a run: `data` with the samples beside it, `inner`: where it lies in them.

    `inner` is `slice(None)` for a whole run. `first_s`, `origin_s`: time of the first sample of the run and
    of the log [s]; 0 in a log without time.
    """

    run: int
    data: Piece
    inner: slice
    first_s: float
    origin_s: float

    def block(self, columns: Sequence[str]) -> Block:
        """Return the stretch itself."""
        return Block(self.run, {c: self.data[c][self.inner] for c in columns})


@dataclass(frozen=True, eq=False)
class Part(Log):
    """Some stretches of a log, as a log in memory."""

    windows: tuple[Window, ...] = ()

    def blocks(self, columns: Sequence[str] | None = None, size: int = CHUNK_ROWS) -> Iterator[Block]:
        """Yield the stretches one by one, whatever the `size`."""
        wanted = self.columns if columns is None else tuple(columns)
        return (window.block(wanted) for window in self.windows)


_PARTS: WeakKeyDictionary[Log, Part] = WeakKeyDictionary()


def part_of(log: Log, rows: int, beside: int) -> Part:
    """Return about `rows` samples of a longer log, in stretches.

    `beside`: samples that each stretch knows on either side. One stretch is drawn from each of as many equal
    parts of the log, so that no period of the recording, such as that of the holdout runs, meets another.
    """
    if log not in _PARTS:
        _PARTS[log] = _part(log, rows, beside)
    return _PARTS[log]


def _part(log: Log, rows: int, beside: int) -> Part:
    columns, counts = log.columns, Counter[int]()
    for block in log.blocks(columns[:1]):
        counts[block.run] += len(block.data[columns[0]])
    chosen = _chosen(counts, rows / counts.total())
    data = {stretch: list[Piece]() for of_run in chosen.values() for stretch in of_run}
    first, seen = dict[int, float](), Counter[int]()
    for block in log.blocks(columns):
        low, n = seen[block.run], len(block.data[columns[0]])
        if not low and "t_s" in columns:
            first[block.run] = float(block.data["t_s"][0])
        seen[block.run] += n
        for stretch in chosen[block.run]:
            start, stop = max(stretch[1] - beside - low, 0), min(stretch[2] + beside - low, n)
            if start < stop:
                data[stretch].append({c: v[start:stop].copy() for c, v in block.data.items()})
    origin = next(iter(first.values()), 0.0)
    windows = tuple(
        Window(run, joined(data.pop((run, low, high)), columns), inner, first.get(run, 0.0), origin)
        for run, low, high in list(data)
        for inner in [slice(None) if high - low == counts[run] else _inner(low, high, beside)]
    )
    inside = {c: np.concatenate([w.data[c][w.inner] for w in windows]) for c in columns}
    inside["run"] = inside["run"].astype(int)
    table = Log.from_arrays(inside, log.noise, log.meta, log.name).table
    return Part(table, log.noise, log.meta, log.path, log.notes, log.counted, windows=windows)


def _inner(low: int, high: int, beside: int) -> slice:
    start = min(low, beside)
    return slice(start, start + high - low)


def _chosen(counts: Counter[int], share: float) -> defaultdict[int, list[tuple[int, int, int]]]:
    """Return the (run, start, stop) of a share of all stretches, by run."""
    edges = {run: np.linspace(0, n, 1 + max(1, round(n / LENGTH))).astype(int) for run, n in counts.items()}
    every = [(run, low, high) for run, at in edges.items() for low, high in pairwise(at.tolist())]
    parts = np.linspace(0, len(every), 1 + max(1, round(share * len(every)))).astype(int)
    out = defaultdict[int, list[tuple[int, int, int]]](list)
    for index in np.random.default_rng(0).integers(parts[:-1], parts[1:]).tolist():
        out[every[index][0]].append(every[index])
    return out
