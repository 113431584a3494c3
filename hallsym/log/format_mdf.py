"""MDF logs (ASAM MDF 3 and 4), through asammdf (an extra): channel groups, each with its own clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import quoted
from hallsym.log.columns import split_header, unit_of
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, load
from hallsym.log.vectors import Vectors
from hallsym.units import Array


def open_mdf(path: Path, clock: str | None = None) -> GroupedSource:
    """Open an MDF file; `clock`: as `GroupedSource` reads it."""
    left_out: dict[str, str] = {}
    with _opened(path) as file:
        filled = [k for k, g in enumerate(file.groups) if g.channel_group.cycles_nr > 0]
        stated = [(getattr(file.groups[k].channel_group, "acq_name", "") or "").strip() for k in filled]
        titles = [title or f"group {k}" for title, k in zip(stated, filled, strict=True)]
        names = [t if titles.count(t) == 1 else f"{t} {k}" for t, k in zip(titles, filled, strict=True)]
        sources = [_channels(path, k, file, left_out) for k in filled]
    groups = [Group(name, source) for name, source in zip(names, sources, strict=True)]
    return GroupedSource(quoted(path), "MDF", groups, left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with open(path, "rb") as stream, closing(load("asammdf").MDF(stream)) as file:
        yield file


def _channels(path: Path, index: int, file: Any, left_out: dict[str, str]) -> Vectors:
    """Return one channel group; its master channel is the time. What holds numbers shows the first record."""

    def read(file: Any, names: Sequence[str], lo: int, hi: int) -> list[Array]:
        signals = select(file, [places[name] for name in names], lo, hi - lo)
        return [
            np.asarray(s.timestamps, float) if name == TIME else _valid(s)
            for name, s in zip(names, signals, strict=True)
        ]

    def select(file: Any, channels: Sequence[int], lo: int, count: int) -> list[Any]:
        wanted = [(None, index, k) for k in channels]
        return file.select(wanted, record_offset=lo, record_count=count, copy_master=False)

    group, master = file.groups[index], file.masters_db.get(index)
    places, units = dict[str, int](), dict[str, str | None]()
    for k, channel in enumerate(group.channels):
        signal = None if k == master else select(file, [k], 0, 1)[0]
        if signal is not None and (signal.samples.dtype.kind not in "fiu" or signal.samples.ndim != 1):
            left_out[split_header(channel.name)[0]] = "it holds no numbers"
        elif signal is not None and channel.name not in places:
            places[channel.name], units[channel.name] = k, unit_of(signal.unit or "")
    if master is not None and places:
        places[TIME], units[TIME] = next(iter(places.values())), "s"
    source = Vectors(units, int(group.channel_group.cycles_nr), read, partial(_opened, path))
    source.since = "the start of the measurement"
    return source


def _valid(signal: Any) -> Array:
    """Return a channel's values; what the recorder marked as invalid is no number (NaN)."""
    invalid = signal.invalidation_bits
    if invalid is None or not np.any(invalid):
        return np.asarray(signal.samples)
    return np.where(np.asarray(invalid, bool), np.nan, signal.samples)
