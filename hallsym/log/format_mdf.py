"""MDF logs (ASAM MDF 3 and 4), through asammdf (an extra): channel groups, each with its own clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import quoted
from hallsym.log.groups import TIME, Group, GroupedSource
from hallsym.log.table import load
from hallsym.log.text.cells import split_header, unit_of
from hallsym.units import Array


def open_mdf(path: Path, clock: str | None = None) -> GroupedSource:
    """Open an MDF file; `clock`: as `GroupedSource` reads it."""
    left_out: dict[str, str] = {}
    with _opened(path) as file:
        filled = [k for k, g in enumerate(file.groups) if g.channel_group.cycles_nr > 0]
        titles = [_title(file.groups[k], k) for k in filled]
        names = [t if titles.count(t) == 1 else f"{t} {k}" for t, k in zip(titles, filled, strict=True)]
        groups = [MdfGroup(path, name, k, file, left_out) for name, k in zip(names, filled, strict=True)]
    return GroupedSource(quoted(path), "MDF", groups, left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with open(path, "rb") as stream, closing(load("asammdf").MDF(stream)) as file:
        yield file


def _title(group: Any, index: int) -> str:
    """Return what a channel group is called by its acquisition, its comment or its number."""
    inner = group.channel_group
    text = getattr(inner, "acq_name", "") or ""
    return text.strip() or f"group {index}"


class MdfGroup(Group):
    """One channel group; its master channel is the clock."""

    def __init__(self, path: Path, name: str, index: int, file: Any, left_out: dict[str, str]) -> None:
        """Look at the first record: which channels hold numbers, and in what unit."""
        self.path, self.name, self.index = path, name, index
        group = file.groups[index]
        self.rows = int(group.channel_group.cycles_nr)
        master = file.masters_db.get(index)
        self.master = master
        self.own: dict[str, int] = {}
        self.units = {}
        for k, channel in enumerate(group.channels):
            if k == master:
                continue
            signal = self._read(file, [k], 0, 1)[0]
            stem, unit = split_header(channel.name)
            unit = unit_of(signal.unit or "") or unit
            if signal.samples.dtype.kind not in "fiu" or signal.samples.ndim != 1:
                left_out[stem] = "it holds no numbers"
                continue
            own = stem if stem not in self.own else channel.name
            self.own[own] = k
            self.units.update({own: unit} if unit else {})
        self.channels = tuple(self.own)
        if master is not None and self.own:
            self.since = "the start of the measurement"
            self.first, self.last = (float(self._times(file, lo, lo + 1)[0]) for lo in (0, self.rows - 1))

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of exactly `size` rows, the last one of what is left; also of `TIME`."""
        asked = [self.own[name] for name in names if name != TIME] or [next(iter(self.own.values()))]
        with _opened(self.path) as file:
            for lo in range(0, self.rows, size):
                count = min(size, self.rows - lo)
                signals = dict(zip(asked, self._read(file, asked, lo, count), strict=True))
                if any(len(s.samples) != count for s in signals.values()):
                    held = lo + min(len(s.samples) for s in signals.values())
                    raise ValueError(f"group '{self.name}' has {held} of its {self.rows} samples")
                yield {
                    name: next(iter(signals.values())).timestamps.astype(np.float64)
                    if name == TIME
                    else _valid(signals[self.own[name]])
                    for name in names
                }

    def _read(self, file: Any, channels: Sequence[int], lo: int, count: int) -> list[Any]:
        wanted = [(None, self.index, k) for k in channels]
        return file.select(wanted, record_offset=lo, record_count=count, copy_master=False)

    def _times(self, file: Any, lo: int, hi: int) -> Array:
        return self._read(file, [next(iter(self.own.values()))], lo, hi - lo)[0].timestamps


def _valid(signal: Any) -> Array:
    """Return a channel's values; what the recorder marked as invalid is no number (NaN)."""
    invalid = signal.invalidation_bits
    if invalid is None or not np.any(invalid):
        return np.asarray(signal.samples)
    return np.where(np.asarray(invalid, bool), np.nan, signal.samples)
