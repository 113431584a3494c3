"""TDMS logs of LabVIEW and its kin, through npTDMS (an extra): channels in groups, read chunk by chunk."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.columns import unit_of
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, load
from hallsym.log.vectors import Opened, Vectors
from hallsym.units import Array

_STEP, _START, _OFFSET = "wf_increment", "wf_start_time", "wf_start_offset"
"""Properties of a channel that was sampled by a clock: seconds, moment, seconds."""
_UNITS = ("unit_string", "NI_UnitDescription")
"""Properties that state a unit, the more usual one first."""


def open_tdms(path: Path, clock: str | None = None) -> GroupedSource:
    """Open a TDMS file; `clock`: as `GroupedSource` reads it."""
    where, opened = quoted(path), partial(_opened, path)
    with opened() as file:
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
        groups = [Group(name, _channels(own, origin, opened, file)) for name, own in clocks.items()]
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


def _channels(channels: Sequence[Any], origin: Any, opened: Opened, file: Any) -> Vectors:
    """Return channels of a group that share the clock of the first: its increment and start, or moments.

    Time counts from `origin`, a moment; where no channel states one, from its own zero.
    """
    first, group, start = channels[0], channels[0].group_name, _start(channels[0])
    step, offset = (float(first.properties.get(key) or 0.0) for key in (_STEP, _OFFSET))
    offset += 0.0 if start is None else _seconds(start, origin)
    units = {c.name: _unit(c) for c in channels if c.dtype.kind in "fiu"}
    moments = None if step else next((c for c in channels if c.dtype.kind == "M"), None)
    clock = moments.name if moments else ""
    zero = moments[0] if moments and origin is None else origin

    def read(file: Any, names: Sequence[str], lo: int, hi: int) -> list[Array]:
        return [time(file, lo, hi) if n == TIME else np.asarray(file[group][n][lo:hi]) for n in names]

    def time(file: Any, lo: int, hi: int) -> Array:
        return offset + step * np.arange(lo, hi) if step else _seconds(file[group][clock][lo:hi], zero)

    ends = None
    if step or moments:
        units[TIME] = "s"
        ends = float(time(file, 0, 1)[0]), float(time(file, len(first) - 1, len(first))[0])
    since = "a moment" if start is not None or moments else "zero"
    return Vectors(units, len(first), read, opened, ends, since)


def _seconds(moments: Any, zero: Any) -> Any:
    return (moments - zero) / np.timedelta64(1, "ns") * 1e-9


def _unit(channel: Any) -> str | None:
    texts = [channel.properties.get(key) for key in _UNITS]
    return next((unit_of(str(text)) for text in texts if text), None)
