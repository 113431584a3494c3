"""TDMS logs of LabVIEW and its kin, through npTDMS (an extra): channels in groups, read chunk by chunk."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, Source, exact, load
from hallsym.log.text.cells import stems_of, unit_of
from hallsym.units import Array

_STEP, _START, _OFFSET = "wf_increment", "wf_start_time", "wf_start_offset"
"""Properties of a channel that was sampled by a clock: seconds, moment, seconds."""
_NANOSECOND = np.timedelta64(1, "ns")
_UNITS = ("unit_string", "NI_UnitDescription")
"""Properties that state a unit, the more usual one first."""


def open_tdms(path: Path, clock: str | None = None) -> GroupedSource:
    """Open a TDMS file; `clock`: as `GroupedSource` reads it."""
    where = quoted(path)
    with _opened(path) as file:
        if file.file_status.incomplete_final_segment:
            raise InputError(f"Log {where} must be a complete TDMS file; its last segment is cut short.")
        left_out: dict[str, str] = {}
        clocks: dict[str, list[Any]] = {}
        for group in file.groups():
            own: dict[tuple[Any, ...], list[Any]] = {}
            for channel in group.channels():
                if len(channel) == 0 or channel.dtype.kind not in "fiuM":
                    left_out[channel.name] = "it holds no numbers"
                    continue
                stated = [str(channel.properties.get(key)) for key in (_STEP, _START, _OFFSET)]
                own.setdefault((len(channel), *stated), []).append(channel)
            several = len(own) > 1
            clocks |= {f"{group.name}/{m[0].name}" if several else group.name: m for m in own.values()}
        starts = [_start(channels[0]) for channels in clocks.values()]
        origin = min((start for start in starts if start is not None), default=None)
        groups = [Group(name, Channels(path, name, members, origin)) for name, members in clocks.items()]
    return GroupedSource(where, "TDMS", groups, left_out, clock)


def _start(channel: Any) -> Any:
    """Return the moment of a channel's first sample, None where it states none."""
    return channel.properties.get(_START) if channel.properties.get(_STEP) else None


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    library = load("nptdms")
    load("nptdms.log").log_manager.set_level(logging.CRITICAL)  # what it warns of is raised here
    with open(path, "rb") as stream, library.TdmsFile.open(stream) as file:
        yield file


class Channels(Source):
    """Channels of one TDMS group with one clock: increment, start and length; or a channel of moments."""

    path: Path

    def __init__(self, path: Path, name: str, channels: Sequence[Any], origin: Any) -> None:
        """Take the channels of numbers of a group, which share the clock of the first.

        Time counts from `origin`, a moment; where no channel states one, from its own zero.
        """
        self.path, self.name, self.group = path, name, channels[0].group_name
        numbers = {c.name: _unit(c) for c in channels if c.dtype.kind in "fiu"}
        self.call(stems_of(numbers, numbers))
        self.own = dict(zip(self.names, numbers, strict=True))
        self.rows, properties, start = len(channels[0]), channels[0].properties, _start(channels[0])
        self.step, self.offset = (float(properties.get(key) or 0.0) for key in (_STEP, _OFFSET))
        moments = None if self.step else next((c for c in channels if c.dtype.kind == "M"), None)
        self.moments = moments.name if moments else ""
        self.since = "a moment" if start is not None or moments else "zero"
        if self.step:
            self.offset += 0.0 if start is None else float((start - origin) / _NANOSECOND) * 1e-9
            self.ends = self.offset, self.offset + self.step * (self.rows - 1)
        elif moments:
            self.origin = moments[0] if origin is None else origin
            self.ends = float(self._seconds(moments[0])), float(self._seconds(moments[-1]))
        if self.step or moments:
            self.names, self.units = (*self.names, TIME), {**self.units, TIME: "s"}

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
        return (moments - self.origin) / _NANOSECOND * 1e-9


def _unit(channel: Any) -> str | None:
    texts = [channel.properties.get(key) for key in _UNITS]
    return next((unit_of(str(text)) for text in texts if text), None)
