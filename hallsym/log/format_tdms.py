"""TDMS logs of LabVIEW and its kin, through npTDMS (an extra): channels in groups, read chunk by chunk."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.groups import Group, GroupedSource, exact
from hallsym.log.table import TIME, Source, load
from hallsym.log.text.cells import stems_of, unit_of
from hallsym.units import Array

_STEP, _START, _OFFSET = "wf_increment", "wf_start_time", "wf_start_offset"
"""Properties of a channel that was sampled by a clock: seconds, moment, seconds."""
_UNITS = ("unit_string", "NI_UnitDescription")
"""Properties that state a unit, the more usual one first."""


def open_tdms(path: Path, clock: str | None = None) -> GroupedSource:
    """Open a TDMS file; `clock`: as `GroupedSource` reads it."""
    where = quoted(path)
    with _opened(path) as file:
        if file.file_status.incomplete_final_segment:
            raise InputError(f"Log {where} must be a complete TDMS file; its last segment is cut short.")
        found: list[Channels] = []
        left_out: dict[str, str] = {}
        for group in file.groups():
            found += _split(path, group, left_out)
        origin = min((c.start for c in found if c.start is not None), default=None)
        for channels in found:
            channels.count_from(origin, file)
    return GroupedSource(where, "TDMS", [Group(c.name, c) for c in found], left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    library = load("nptdms")
    load("nptdms.log").log_manager.set_level(logging.CRITICAL)  # what it warns of is raised here
    with open(path, "rb") as stream, library.TdmsFile.open(stream) as file:
        yield file


class Channels(Source):
    """Channels of one TDMS group with one clock: increment, start and length; or a channel of moments."""

    path: Path

    def __init__(self, path: Path, name: str, group: str, channels: Sequence[Any]) -> None:
        """Take the channels of numbers of `group`, which share the clock of the first."""
        self.path, self.name, self.group = path, name, group
        numbers = {c.name: _unit(c) for c in channels if c.dtype.kind in "fiu"}
        self.call(stems_of(numbers, numbers))
        self.own = dict(zip(self.names, numbers, strict=True))
        self.rows, properties = len(channels[0]), channels[0].properties
        self.step = float(properties.get(_STEP) or 0.0)
        self.offset = float(properties.get(_OFFSET) or 0.0)
        self.start = properties.get(_START) if self.step else None
        self.moments = "" if self.step else next((c.name for c in channels if c.dtype.kind == "M"), "")
        if self.step or self.moments:
            self.names, self.units = (*self.names, TIME), {**self.units, TIME: "s"}

    def count_from(self, origin: Any, file: Any) -> None:
        """Let time count from `origin`, a moment; where no channel states one, from its own zero."""
        self.origin = origin
        if self.start is not None:
            self.offset += float((self.start - origin) / np.timedelta64(1, "ns")) * 1e-9
        self.since = "a moment" if self.start is not None or self.moments else "zero"
        if self.step:
            self.ends = self.offset, self.offset + self.step * (self.rows - 1)
        elif self.moments:
            first, last = (file[self.group][self.moments][k] for k in (0, -1))
            self.origin = first if origin is None else origin
            self.ends = float(self._seconds(first)), float(self._seconds(last))

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of `size` rows."""
        with _opened(self.path) as file:
            pieces = {name: exact(self._pieces(file, name, size), size, [name]) for name in names}
            for parts in zip(*pieces.values(), strict=True):
                yield {name: part[name] for name, part in zip(pieces, parts, strict=True)}

    def _pieces(self, file: Any, name: str, size: int) -> Iterator[Mapping[str, Array]]:
        """Yield a channel in the chunks of the file; `size`: of those of a time that is none."""
        if name == TIME and self.step:
            for lo in range(0, self.rows, size):
                yield {name: self.offset + self.step * np.arange(lo, min(lo + size, self.rows))}
            return
        rows, channel = 0, file[self.group][self.moments if name == TIME else self.own[name]]
        for chunk in channel.data_chunks():
            values = np.asarray(chunk[:])
            rows += len(values)
            yield {name: self._seconds(values) if name == TIME else values}
        if rows != self.rows:
            raise ValueError(f"channel '{channel.name}' has {rows} of its {self.rows} values")

    def _seconds(self, moments: Any) -> Any:
        return (moments - self.origin) / np.timedelta64(1, "ns") * 1e-9


def _split(path: Path, group: Any, left_out: dict[str, str]) -> list[Channels]:
    """Return the channels of a TDMS group by clock; a clock is named by the group where it has only one."""
    clocks: dict[tuple[Any, ...], list[Any]] = {}
    for channel in group.channels():
        if len(channel) == 0 or channel.dtype.kind not in "fiuM":
            left_out[channel.name] = "it holds no numbers"
            continue
        properties = channel.properties
        key = (len(channel), properties.get(_STEP), str(properties.get(_START)), properties.get(_OFFSET))
        clocks.setdefault(key, []).append(channel)
    names = [group.name if len(clocks) == 1 else f"{group.name}/{m[0].name}" for m in clocks.values()]
    return [Channels(path, n, group.name, m) for n, m in zip(names, clocks.values(), strict=True)]


def _unit(channel: Any) -> str | None:
    texts = [channel.properties.get(key) for key in _UNITS]
    return next((unit_of(str(text)) for text in texts if text), None)
