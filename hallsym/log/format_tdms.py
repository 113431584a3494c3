"""TDMS logs of LabVIEW and its kin, through npTDMS (an extra): channels in groups, read in pieces."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.groups import TIME, Group, GroupedSource
from hallsym.log.table import load
from hallsym.log.text.cells import split_header, unit_of
from hallsym.units import Array

_STEP, _START, _OFFSET = "wf_increment", "wf_start_time", "wf_start_offset"
"""Properties of a channel that was sampled by a clock: seconds, moment, seconds."""
LONG = 1 << 20
"""Bytes of a stretch from which on it is read in part; shorter ones are read whole."""
Starts = dict[int, tuple[int, int]]
_UNITS = ("unit_string", "NI_UnitDescription")
"""Properties that state a unit, the more usual one first."""


def open_tdms(path: Path, clock: str | None = None) -> GroupedSource:
    """Open a TDMS file; `clock`: as `GroupedSource` reads it."""
    where = quoted(path)
    with _opened(path) as (file, window):
        if file.file_status.incomplete_final_segment:
            raise InputError(f"Log {where} must be a complete TDMS file; its last segment is cut short.")
        found: list[TdmsGroup] = []
        left_out: dict[str, str] = {}
        for group in file.groups():
            found += _split(path, group, left_out)
        origin = min((g.start for g in found if g.start is not None), default=None)
        for member in found:
            member.count_from(origin, file, window)
    return GroupedSource(where, "TDMS", found, left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, _Window]]:
    library = load("nptdms")
    load("nptdms.log").log_manager.set_level(logging.CRITICAL)  # what it warns of is raised here
    with open(path, "rb") as stream:
        window = _Window(stream)
        with library.TdmsFile.open(window) as file:
            yield file, window


class _Window:
    """A file of which long stretches are read in part: npTDMS reads every chunk whole and then cuts it.

    A file that was written at once, or defragmented, is one chunk. `wanted`: samples of the channel that is
    read; `starts`: first sample and number of samples of its long chunks, by their place in the file. `seen`:
    places of stretches while they are only counted, None while they are read. What is not read is zero.
    """

    def __init__(self, stream: BufferedReader) -> None:
        self.stream = stream
        self.read, self.seek, self.tell, self.close = stream.read, stream.seek, stream.tell, stream.close
        self.wanted = (0, 0)
        self.starts: Starts = {}
        self.seen: list[int] | None = None

    def readinto(self, buffer: Any) -> int:
        """Fill `buffer`, or what is wanted of it, and return its length."""
        place, size = self.tell(), len(buffer)
        if self.seen is not None and size:
            self.seen.append(place)
            return self.seek(place + size) - place
        if size <= LONG or place not in self.starts:
            return self.stream.readinto(buffer)
        first, count = self.starts[place]
        ends = [min(max(sample - first, 0), count) * (size // count) for sample in self.wanted]
        self.seek(place + ends[0])
        self.stream.readinto(memoryview(buffer)[ends[0] : ends[1]])
        return self.seek(place + size) - place


class TdmsGroup(Group):
    """Channels of one TDMS group that have one clock: increment, start and length; or a channel of times."""

    def __init__(self, path: Path, name: str, group: str, channels: Sequence[Any]) -> None:
        """Take the channels of numbers of `group`, which share the clock of the first."""
        self.path, self.name, self.group = path, name, group
        self.starts: dict[str, Starts] = {}
        parts = {c.name: split_header(c.name) for c in channels if c.dtype.kind in "fiu"}
        stems = [stem for stem, _ in parts.values()]
        self.own = {s if stems.count(s) == 1 else n: n for n, (s, _) in parts.items()}
        self.channels = tuple(self.own)
        stated = {c.name: _unit(c) for c in channels}
        found = {name: stated[own] or parts[own][1] for name, own in self.own.items()}
        self.units = {name: unit for name, unit in found.items() if unit}
        self.rows = len(channels[0])
        properties = channels[0].properties
        self.step = float(properties.get(_STEP) or 0.0)
        self.offset = float(properties.get(_OFFSET) or 0.0)
        self.start = properties.get(_START) if self.step else None
        moments = [c.name for c in channels if c.dtype.kind == "M"]
        timed = [name for name in self.channels if self.seconds(name)]
        self.moments = moments[0] if moments and not self.step else ""
        self.clock = timed[0] if timed and not self.step and not moments else ""

    def count_from(self, origin: Any, file: Any, window: _Window) -> None:
        """Let time count from `origin`, a moment; where no channel states one, from its own zero."""
        self.origin = origin
        if self.step and self.start is not None:
            self.offset += float((self.start - origin) / np.timedelta64(1, "ns")) * 1e-9
        if not (self.step or self.clock or self.moments):
            return
        self.since = "a moment" if self.start is not None or self.moments else "zero"
        ends = [self._times(file, window, lo, lo + 1) for lo in (0, self.rows - 1)]
        self.first, self.last = (float(end[0]) for end in ends)

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of exactly `size` rows, the last one of what is left; also of `TIME`."""
        with _opened(self.path) as (file, window):
            for lo in range(0, self.rows, size):
                hi = min(lo + size, self.rows)
                yield {
                    name: self._times(file, window, lo, hi)
                    if name == TIME
                    else self._read(file, window, self.own[name], lo, hi)
                    for name in names
                }

    def _read(self, file: Any, window: _Window, channel: str, lo: int, hi: int) -> Array:
        window.wanted, window.starts = (lo, hi), self._long_chunks(file, window, channel)
        values = np.asarray(file[self.group][channel][lo:hi])
        if len(values) != hi - lo:
            raise ValueError(f"channel '{channel}' has {lo + len(values)} of its {self.rows} values")
        return values

    def _long_chunks(self, file: Any, window: _Window, channel: str) -> Starts:
        """Return first sample and number of samples of a channel's chunks by place; none of a short one."""
        if self.rows * file[self.group][channel].dtype.itemsize <= LONG:
            return {}
        if channel not in self.starts:
            found = self.starts[channel] = {}
            window.seen = []
            for chunk in file[self.group][channel].data_chunks():
                if len(window.seen) == 1 and len(chunk):
                    found[window.seen[0]] = (chunk.offset, len(chunk))
                window.seen = []
            window.seen = None
        return self.starts[channel]

    def _times(self, file: Any, window: _Window, lo: int, hi: int) -> Array:
        if self.step:
            return self.offset + self.step * np.arange(lo, hi)
        if self.moments:
            moments = self._read(file, window, self.moments, lo, hi)
            if self.origin is None:
                self.origin = self._read(file, window, self.moments, 0, 1)[0]
            return (moments - self.origin) / np.timedelta64(1, "ns") * 1e-9
        return self._read(file, window, self.own[self.clock], lo, hi) * self.seconds(self.clock)


def _split(path: Path, group: Any, left_out: dict[str, str]) -> list[TdmsGroup]:
    """Return the channels of a TDMS group by clock; a clock is named by the group where it has only one."""
    clocks: dict[tuple[Any, ...], list[Any]] = {}
    for channel in group.channels():
        if len(channel) == 0 or channel.dtype.kind not in "fiuM":
            left_out[channel.name] = "it holds no numbers"
            continue
        properties = channel.properties
        key = (len(channel), properties.get(_STEP), str(properties.get(_START)), properties.get(_OFFSET))
        clocks.setdefault(key, []).append(channel)
    if len(clocks) == 1:
        return [TdmsGroup(path, group.name, group.name, members) for members in clocks.values()]
    return [
        TdmsGroup(path, f"{group.name}/{members[0].name}", group.name, members) for members in clocks.values()
    ]


def _unit(channel: Any) -> str | None:
    texts = [channel.properties.get(key) for key in _UNITS]
    return next((unit_of(str(text)) for text in texts if text), None)
