"""A log with derived columns: served beside the logged ones, run by run.

They are computed from blocks that overlap at their edges, so memory does not grow with the log.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from hallsym.log.core import Block, Log
from hallsym.log.part import Window
from hallsym.log.table import joined
from hallsym.model import Model
from hallsym.model.derived import HALVES, Computed, Stretch

HALO = 4 * HALVES[-1]
"""Samples of context on either side of a block."""
_WINDOWS: WeakKeyDictionary[Log, dict[tuple, dict[str, tuple[int, int]]]] = WeakKeyDictionary()
"""Smoothing windows by log and run: chosen once, on the first stretch of a size."""


class ExtendedLog:
    """A log that also serves computed columns; everything else is the log's own."""

    def __init__(self, log: Log, computed: Sequence[Computed], sigma: Mapping[str, float]) -> None:
        """Serve `computed` beside the columns of `log`; `sigma`: noise by column."""
        self.log, self.sigma = log, dict(sigma)
        self.computed = {c.name: c for c in computed}
        self._origin: float | None = None

    def __getattr__(self, name: str) -> Any:
        """Everything that is not about columns comes from the log itself."""
        return getattr(self.log, name)

    @property
    def columns(self) -> tuple[str, ...]:
        """Logged and computed columns."""
        return (*self.log.columns, *self.computed)

    @property
    def source(self) -> Log:
        """The log that is extended."""
        return self.log

    def identity(self, column: str) -> Hashable:
        """Return the column's name; of a computed one also its distinguishing key."""
        made = self.computed.get(column)
        return (made.name, made.key) if made else column

    def blocks(self, columns: Sequence[str] | None = None, size: int = 1 << 16) -> Iterator[Block]:
        """Yield consecutive blocks of one run each, of at most `size` samples, with `columns` (or all).

        `size`: as many as the context of a block at least.
        """
        wanted = self.columns if columns is None else tuple(columns)
        made = [self.computed[c] for c in wanted if c in self.computed]
        if not made:
            yield from self.log.blocks(wanted, size)
            return
        raw = dict.fromkeys(c for c in wanted if c not in self.computed)
        raw |= dict.fromkeys(c for m in made for c in m.needs) | {"t_s": None}
        whole: list[Stretch] = []
        for stretch, inner in self._stretches(tuple(raw), size):
            if inner == slice(None):  # runs that are shorter than a block share their calls
                whole.append(stretch)
                if sum(len(s.data["t_s"]) for s in whole) < size:
                    continue
            yield from self._blocks(whole, wanted)
            whole = []
            if inner != slice(None):
                yield Block(int(stretch.run), {c: v[inner] for c, v in self._data(stretch, wanted).items()})
        yield from self._blocks(whole, wanted)

    def _blocks(self, runs: Sequence[Stretch], columns: Sequence[str]) -> Iterator[Block]:
        """Yield a block for each of several whole runs."""
        if runs:
            stretch = runs[0] if len(runs) == 1 else Stretch.of(runs)
            data = self._data(stretch, columns)
            for run, (low, high) in zip(runs, pairwise(stretch.edges), strict=True):
                yield Block(int(run.run), {c: v[low:high] for c, v in data.items()})

    def _data(self, stretch: Stretch, columns: Sequence[str]) -> dict[str, np.ndarray]:
        """Return logged and computed columns of a stretch."""
        made = {
            c: np.nan_to_num(np.asarray(self.computed[c].rule(stretch), float), posinf=0.0, neginf=0.0)
            for c in columns
            if c in self.computed
        }
        return {c: made[c] if c in made else stretch.data[c] for c in columns}

    def _stretches(self, columns: tuple[str, ...], size: int) -> Iterator[tuple[Stretch, slice]]:
        """Yield blocks with up to HALO samples of context on either side, and where the block itself lies."""
        windows = _WINDOWS.setdefault(self.log, {})
        sigma = tuple(sorted(self.sigma.items()))
        known: Sequence[Window] = getattr(self.log, "windows", ())
        for w in known:
            chosen = windows.setdefault((w.run, w.first_s, size, sigma), {})
            data = {c: w.data[c] for c in columns}
            yield Stretch(w.run, data, w.first_s, known[0].origin_s, self.sigma, chosen), w.inner
        if known:
            return
        before: Block | None = None
        for block, after in pairwise(chain(self.log.blocks(columns, max(size, HALO)), [None])):
            assert block is not None
            if before is None or before.run != block.run:
                before, first = None, float(block.data["t_s"][0])
                self._origin = origin = first if self._origin is None else self._origin
                chosen = windows.setdefault((block.run, first, size, sigma), {})
            after = after if after is not None and after.run == block.run else None
            parts = [{c: v[-HALO:] for c, v in before.data.items()}] if before else []
            parts += [block.data, *([{c: v[:HALO] for c, v in after.data.items()}] if after else [])]
            stretch = Stretch(block.run, joined(parts, columns), first, origin, self.sigma, chosen)
            start = len(parts[0]["t_s"]) if before else 0
            whole = before is None and after is None
            yield stretch, slice(None) if whole else slice(start, start + len(block.data["t_s"]))
            before = block


def extended(
    log: Log,
    model: Model,
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
) -> Any:
    """Return the log with the computed columns of `model`; the log itself if there are none.

    `sigma`: noise by column, the log's own where not given. `values`: parameters by name, for columns that
    depend on some (nominal where not given).
    """
    if not model.computed:
        return log
    known = log.noise.std | dict(sigma or {})
    return ExtendedLog(log, [c.at(values) if c.at and values else c for c in model.computed], known)


def share_windows(log: Log, other: Log) -> None:
    """Smooth the columns of `other`, the same log with other noise, with the windows of `log`."""
    _WINDOWS[other] = _WINDOWS.setdefault(log, {})
