"""MDF logs (ASAM MDF 3 and 4), through asammdf (an extra): channel groups, each with its own clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import quoted
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, Source, load
from hallsym.log.text.cells import split_header, stems_of, unit_of
from hallsym.units import Array


def open_mdf(path: Path, clock: str | None = None) -> GroupedSource:
    """Open an MDF file; `clock`: as `GroupedSource` reads it."""
    left_out: dict[str, str] = {}
    with _opened(path) as file:
        filled = [k for k, g in enumerate(file.groups) if g.channel_group.cycles_nr > 0]
        stated = [(getattr(file.groups[k].channel_group, "acq_name", "") or "").strip() for k in filled]
        titles = [title or f"group {k}" for title, k in zip(stated, filled, strict=True)]
        names = [t if titles.count(t) == 1 else f"{t} {k}" for t, k in zip(titles, filled, strict=True)]
        sources = [ChannelGroup(path, name, k, file, left_out) for name, k in zip(names, filled, strict=True)]
    groups = [Group(source.name, source) for source in sources]
    return GroupedSource(quoted(path), "MDF", groups, left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with open(path, "rb") as stream, closing(load("asammdf").MDF(stream)) as file:
        yield file


class ChannelGroup(Source):
    """One channel group; its master channel is the time."""

    path: Path

    def __init__(self, path: Path, name: str, index: int, file: Any, left_out: dict[str, str]) -> None:
        """Look at the first record: which channels hold numbers, and in what unit."""
        self.path, self.name, self.index = path, name, index
        group, master = file.groups[index], file.masters_db.get(index)
        self.rows = int(group.channel_group.cycles_nr)
        found, stated = dict[str, int](), dict[str, str | None]()
        for k, channel in enumerate(group.channels):
            signal = None if k == master else self._read(file, [k], 0, 1)[0]
            if signal is not None and (signal.samples.dtype.kind not in "fiu" or signal.samples.ndim != 1):
                left_out[split_header(channel.name)[0]] = "it holds no numbers"
            elif signal is not None and channel.name not in found:
                found[channel.name], stated[channel.name] = k, unit_of(signal.unit or "")
        self.call(stems_of(found, stated))
        self.own = dict(zip(self.names, found.values(), strict=True))
        if master is not None and found:
            self.since = "the start of the measurement"
            one = [*self.own.values()][:1]
            first, last = (self._read(file, one, row, 1)[0].timestamps[0] for row in (0, self.rows - 1))
            self.ends = float(first), float(last)
            self.names, self.units = (*self.names, TIME), {**self.units, TIME: "s"}

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of `size` rows."""
        asked = [self.own[name] for name in names if name != TIME] or [*self.own.values()][:1]
        with _opened(self.path) as file:
            for lo in range(0, self.rows, size):
                count = min(size, self.rows - lo)
                signals = dict(zip(asked, self._read(file, asked, lo, count), strict=True))
                if any(len(s.samples) != count for s in signals.values()):
                    held = lo + min(len(s.samples) for s in signals.values())
                    raise ValueError(f"group '{self.name}' has {held} of its {self.rows} samples")
                time = next(iter(signals.values())).timestamps.astype(np.float64)
                yield {n: time if n == TIME else _valid(signals[self.own[n]]) for n in names}

    def _read(self, file: Any, channels: Sequence[int], lo: int, count: int) -> list[Any]:
        wanted = [(None, self.index, k) for k in channels]
        return file.select(wanted, record_offset=lo, record_count=count, copy_master=False)


def _valid(signal: Any) -> Array:
    """Return a channel's values; what the recorder marked as invalid is no number (NaN)."""
    invalid = signal.invalidation_bits
    if invalid is None or not np.any(invalid):
        return np.asarray(signal.samples)
    return np.where(np.asarray(invalid, bool), np.nan, signal.samples)
