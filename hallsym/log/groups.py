"""Groups of channels that were sampled together: which share a clock, which are runs, names of columns."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hallsym.errors import InputError, counted, nearest
from hallsym.log.resample import METHODS
from hallsym.log.table import CHUNK_ROWS
from hallsym.units import Array

TIME = "\0time"
"""What `Group.chunks` calls the time of its samples, seconds; no channel has this name."""
OWN_TIME = "t"
"""Name of the column for a time that the format gives and no channel holds."""


class Group(ABC):
    """Channels of a file that were sampled together.

    `name`: as the file has it; `rows`: samples; `channels`: names of the channels of numbers; `units`: what
    the file states of them; `first`, `last`: time of the first and the last sample in seconds, None without a
    time base; `since`: from what time counts, which two clocks must have in common; `clock`: the channel that
    is the time base, "" where the format gives it.
    """

    name: str
    rows: int
    channels: tuple[str, ...]
    units: dict[str, str]
    first: float | None = None
    last: float | None = None
    since: str = ""
    clock: str = ""

    @abstractmethod
    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of exactly `size` rows, the last one of what is left; also of `TIME`."""

    @property
    def rate(self) -> float:
        """Samples a second on average; 0 where it is not known."""
        if self.first is None or self.last is None or not self.last > self.first:
            return 0.0
        return (self.rows - 1) / (self.last - self.first)

    def said(self) -> str:
        """Return the group in words: `Hall (4 channels at 10 kHz)`."""
        rate = f" at {hertz(self.rate)}" if self.rate else ""
        return f"{self.name} ({counted(len(self.channels), 'channel')}{rate})"


@dataclass(frozen=True)
class Clock:
    """Whose samples become the rows, and how other channels are read at them."""

    group: str
    method: str

    @staticmethod
    def read(text: str) -> Clock:
        """Read `GROUP:METHOD`."""
        group, colon, method = text.rpartition(":")
        if not (colon and group) or method not in METHODS:
            raise InputError(
                f"Clock must be GROUP:METHOD with method {' or '.join(METHODS)}, such as Hall:linear; instead"
                f" received {text!r}{nearest(method, list(METHODS))}."
            )
        return Clock(group, method)


@dataclass(frozen=True)
class Place:
    """Where a column is: its group and the name it has there."""

    group: Group
    channel: str


def places(groups: Sequence[Group]) -> tuple[dict[str, Place], dict[str, str]]:
    """Name channels by themselves where that is unique, else `group/channel`; times that a format gives too.

    Returns (name -> place, long name -> name).
    """
    ends = Counter(channel for g in groups for channel in g.channels)
    places: dict[str, Place] = {}
    aliases: dict[str, str] = {}
    clocked: set[tuple[float | None, float | None, int]] = set()
    for g in groups:
        clock = (g.first, g.last, g.rows)
        if g.first is not None and not g.clock and clock not in clocked:
            long = f"{g.name}/{OWN_TIME}"
            name = long if OWN_TIME in ends or clocked else OWN_TIME
            places[name] = Place(g, TIME)
            clocked.add(clock)
        for channel in g.channels:
            long = f"{g.name}/{channel}"
            name = channel if ends[channel] == 1 else long
            places[name] = Place(g, channel)
            if name != long:
                aliases[long] = name
    return places, aliases


def runs(groups: Sequence[Group]) -> list[Group]:
    """Return the groups in the order of their numbers, if they are runs; else none."""
    same = len({g.channels for g in groups}) == 1 and len(groups) > 1
    numbered = same and all(re.search(r"\d$", g.name) for g in groups)
    numbers = [number_of(g.name) for g in groups] if numbered else []
    if not numbers or len(set(numbers)) < len(numbers) or len({tuple(g.units.items()) for g in groups}) > 1:
        return []
    return sorted(groups, key=lambda g: number_of(g.name))


def number_of(name: str) -> int:
    """Return the number that a name ends in."""
    found = re.search(r"(\d+)$", name)
    return int(found[1]) if found else 0


def on_one_clock(groups: Sequence[Group]) -> list[list[Group]]:
    """Return the groups in sets that were sampled together; without a time base, those of the same length."""
    sets: list[list[Group]] = []
    for g in [*(g for g in groups if g.first is not None), *(g for g in groups if g.first is None)]:
        home = next((members for members in sets if _together(members[0], g)), None)
        if home is None:
            sets.append([g])
        else:
            home.append(g)
    return sets


def _together(a: Group, b: Group) -> bool:
    if a.rows != b.rows:
        return False
    if b.first is None:
        return True
    if a.since != b.since or (a.first, a.last) != (b.first, b.last):
        return False
    both = zip(a.chunks([TIME], CHUNK_ROWS), b.chunks([TIME], CHUNK_ROWS), strict=True)
    return all(np.array_equal(x[TIME], y[TIME]) for x, y in both)


def hertz(rate: float) -> str:
    """Return a rate in words."""
    if not rate:
        return "without a time base"
    return f"{rate / 1e3:.4g} kHz" if rate >= 1e3 else f"{rate:.4g} Hz"


def exact(
    pieces: Iterator[Mapping[str, Array]], size: int, names: Sequence[str]
) -> Iterator[Mapping[str, Array]]:
    """Yield pieces of any length in chunks of exactly `size` rows, the last one of what is left."""
    held: list[Mapping[str, Array]] = []
    count = 0
    for piece in pieces:
        held.append(piece)
        count += len(piece[names[0]])
        if count < size:
            continue
        whole = {name: np.concatenate([p[name] for p in held]) for name in names}
        edges = range(0, count + 1, size)
        for lo, hi in pairwise(edges):
            yield {name: whole[name][lo:hi] for name in names}
        held = [{name: whole[name][edges[-1] :] for name in names}]
        count -= edges[-1]
    if count:
        yield {name: np.concatenate([p[name] for p in held]) for name in names}
