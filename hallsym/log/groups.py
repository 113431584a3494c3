"""Groups of channels that were sampled together: clocks, runs, names; one clock at the samples of another."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from hallsym.errors import InputError, counted, nearest, quoted
from hallsym.log.columns import RUN, T, is_time_word
from hallsym.log.pace import Paced
from hallsym.log.table import CHUNK_ROWS, IN_MEMORY_ROWS, TIME, Source, exact, joined
from hallsym.units import UNITS, Array, split_unit

RUN_SPACING_S = 1e6
"""Seconds between runs where a clock starts again in each: longer than any run lasts."""


class Group:
    """Channels that were sampled together: columns of a source, of which that of time is the `clock`.

    `ends`: time of the first and the last sample in seconds, None without a time base; `since`: from what
    time counts, which two clocks must have in common; `moment`: that of its zero [ns since 1970], where it is
    known; `timed`: whether time is one of its columns; `by_run`: whether it starts again in each run.
    """

    def __init__(self, name: str, source: Source, mapped: Mapping[str, str] | None = None) -> None:
        """Look at the names. `mapped`: our names, with their units, of columns that somebody mapped."""
        self.name, self.source = name, source
        self.channels = tuple(c for c in source.names if c != TIME)
        self.shift, self.timed, self.restarts, self.by_run = 0.0, True, False, False
        ours = {c: mapped[c] for c in self.channels if mapped and c in mapped}
        self.units = {**source.units, **{c: u.name for c, n in ours.items() if (u := split_unit(n)[1])}}
        given = [c for c in source.names if c == TIME]
        named = given or [c for c in self.channels if split_unit(ours.get(c, c))[0] == T]
        timed = named or [c for c in self.channels if self.seconds(c)]
        timed = timed or [c for c in self.channels if is_time_word(c) and c not in self.units]
        self.clock = timed[0] if len(timed) == 1 else ""
        if not timed and source.pace:
            self.source, self.clock, self.units[TIME] = Paced(source, source.pace), TIME, "s"
        self.ends, self.since = self.source.ends, self.source.since
        self.moment: int | None = None
        self.step = 0.0

    @cached_property
    def rows(self) -> int:
        """Samples; a file of text is counted when that is asked first."""
        return self.source.count()

    def begin(self) -> None:
        """Read the clock once, where the times of the first and the last sample are not known."""
        if self.clock and not self.source.ends:
            first, last = np.nan, -np.inf
            for piece in self.chunks([TIME], CHUNK_ROWS):
                time = piece[TIME]
                self.restarts |= bool((np.diff(time, prepend=last) < 0).any())
                self.step = self.step or usual_step(time)
                first, last = float(time[0]) if last == -np.inf else first, float(time[-1])
                self.ends = first, last
            self.since = "zero" if self.seconds(self.clock) else "zero, in a unit that is not stated"
        read = self.source.clocks.get(self.clock)
        self.moment = read.moment if read else None
        self.since = self.since if self.moment is None else "a moment"

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of exactly `size` rows, the last may be shorter; also of `TIME`."""
        clock = [self.clock, *([RUN] if self.by_run else [])] if TIME in names else []
        wanted = list(dict.fromkeys([*(name for name in names if name != TIME), *clock]))
        for piece in exact(self.source.chunks(wanted, size), size, wanted):
            yield {name: self._time(piece) if name == TIME else piece[name] for name in names}

    def _time(self, piece: Mapping[str, Array]) -> Array:
        time = piece[self.clock] * (self.seconds(self.clock) or 1.0) + self.shift
        return np.asarray(time + RUN_SPACING_S * piece[RUN] if self.by_run else time)

    def seconds(self, name: str) -> float:
        """Return the seconds of a channel's unit, 0 where it has another unit."""
        unit = UNITS[self.units[name]] if name in self.units else split_unit(name)[1]
        return unit.factor if unit and unit.si == "s" else 0.0

    @property
    def rate(self) -> float:
        """Samples a second on average; 0 where it is not known."""
        first, last = self.ends or (0.0, 0.0)
        return (self.rows - 1) / (last - first) if last > first else 0.0

    def said(self) -> str:
        """Return the group in words: `Hall (4 channels at 10 kHz)`."""
        rate = f" at {hertz(self.rate)}" if self.rate else ""
        return f"{self.name} ({counted(len(self.channels), 'channel')}{rate})"


def on_one_scale(groups: Sequence[Group]) -> None:
    """Let clocks that state a moment count from the earliest one, and those that start again run by run."""
    if all(RUN in g.channels for g in groups):
        for g in groups:
            g.by_run, g.restarts = True, False
            g.begin()
            if g.restarts:
                raise InputError(
                    f"Time of {g.name} must rise in each run, and the numbers of its runs from run to run, to"
                    " be joined with another file: sort it by run and time."
                )
    earliest = min((g.moment for g in groups if g.moment is not None), default=0)
    for g in groups:
        if g.moment is not None and g.ends:
            g.shift = (g.moment - earliest) * 1e-9
            g.ends = g.ends[0] + g.shift, g.ends[1] + g.shift


def read_clock(text: str) -> tuple[str, str]:
    """Read `GROUP:METHOD`: whose samples become the rows, and how other channels are read at them."""
    group, colon, method = text.rpartition(":")
    if not (colon and group) or method not in METHODS:
        raise InputError(
            f"Clock must be GROUP:METHOD with method {' or '.join(METHODS)}, such as Hall:linear; instead"
            f" received {text!r}{nearest(method, list(METHODS))}."
        )
    return group, method


def places(groups: Sequence[Group], by: str = "/") -> tuple[dict[str, tuple[Group, str]], dict[str, str]]:
    """Name channels by themselves where that is unique, else `group/channel`; times that a format gives too.

    `by`: between group and channel. Returns (name -> group and channel, long name -> name).
    """
    ends = Counter(channel for g in groups for channel in g.channels)
    places: dict[str, tuple[Group, str]] = {}
    aliases: dict[str, str] = {}
    clocked: set[tuple[tuple[float, float] | None, int]] = set()
    for g in groups:
        clock = (g.ends, g.rows)
        if g.timed and g.clock == TIME and clock not in clocked:
            name = f"{g.name}{by}{T}" if T in ends or clocked else T
            places[name] = g, TIME
            clocked.add(clock)
        for channel in g.channels:
            long = f"{g.name}{by}{channel}" if g.name else channel
            name = channel if ends[channel] == 1 else long
            places[name] = g, channel
            if name != long:
                aliases[long] = name
    return places, aliases


def runs(groups: Sequence[Group], named: bool = True) -> dict[int, Group]:
    """Return groups of the same channels in the order of their numbers, if they are runs; else none.

    `named`: only groups whose names end in different numbers are runs; others are counted from 0.
    """
    same = len({(*sorted(g.channels), *sorted(g.units.items())) for g in groups}) == 1 and len(groups) > 1
    each = groups[0]  # or a file for each channel
    same &= not (each.clock and each.source.path and len({*each.channels} - {RUN, each.clock}) == 1)
    numbers = [number_of(g.name) for g in groups]
    if -1 in numbers or len(set(numbers)) < len(numbers):
        numbers = [] if named else list(range(len(groups)))
    found = dict(zip(numbers, groups, strict=True)) if same and numbers else {}
    return {k: found[k] for k in sorted(found)}


def number_of(name: str) -> int:
    """Return the number that a name ends in; -1 where there is none."""
    found = re.search(r"(\d+)$", name)
    return int(found[1]) if found else -1


def on_one_clock(groups: Sequence[Group]) -> list[list[Group]]:
    """Return the groups in sets that were sampled together: as many samples from one time to another.

    Without a time base, those of the same length; with a stated rate, also those with a column of times of
    that rate, which may pause between runs.
    """
    sets: list[list[Group]] = []
    for g in sorted(groups, key=lambda g: (not g.ends, isinstance(g.source, Paced))):
        if (home := next((members for members in sets if _together(members[0], g)), None)) is None:
            sets.append([g])
        else:
            home.append(g)
    return sets


def _together(first: Group, g: Group) -> bool:
    if first.rows != g.rows or not g.ends or (g.ends, g.since) == (first.ends, first.since):
        return first.rows == g.rows
    rated = isinstance(g.source, Paced) and not isinstance(first.source, Paced)
    return rated and math.isclose(first.step, g.source.pace.step, rel_tol=UNEVEN)


def hertz(rate: float) -> str:
    """Return a rate in words."""
    if not rate:
        return "without a time base"
    return f"{rate / 1e3:.4g} kHz" if rate >= 1e3 else f"{rate:.4g} Hz"


UNEVEN = 0.01
"""Part by which a rate by a column of times may differ from the stated one."""
SHOWN_GROUPS = 4
"""Groups that a line names."""


class GroupedSource(Source):
    """One table of groups: those of a file, or whole files."""

    def __init__(
        self,
        where: str,
        kind: str,
        groups: Sequence[Group],
        left_out: Mapping[str, str],
        clock: str | None,
        *,
        by: str = "/",
        files: bool = False,
    ) -> None:
        """Arrange groups of a `kind` ("TDMS") of what messages call `where`.

        `by`: as in `places`. `files`: each group is a file; those of the same columns are runs whatever they
        are called, others are read at the samples of the slowest where no `clock` is stated.
        """
        self.where = where
        most = max((g.rows for g in groups), default=0)
        filled = [g for g in groups if g.channels and g.rows > min(most - 1, 1)]
        if not filled:
            said = "".join(f"; {name} is left out: {why}" for name, why in [*left_out.items()][:SHOWN_GROUPS])
            raise InputError(f"Log {where} has no channel of numbers with samples{said}; record it again.")
        self.left_out: dict[str, str] = {**left_out} | {
            g.name or channel: "it holds one sample"
            for g in groups
            if g not in filled
            for channel in g.channels
        }
        stated = None if clock is None else read_clock(clock)
        self.runs = {} if stated else runs(filled, named=not files)
        if not self.runs and len(filled) > 1:
            for g in filled:
                g.begin()
            on_one_scale(filled)
        self.sets = [[next(iter(self.runs.values()))]] if self.runs else on_one_clock(filled)
        if files and not stated and len(self.sets) > 1 and all(m[0].ends for m in self.sets):
            stated = min((m[0] for m in self.sets), key=lambda g: g.rate).name, METHODS[0]
        self.master = self._master(stated[0] if stated else "")
        mine = next(members for members in self.sets if self.master in members)
        self.others = [g for members in self.sets if members is not mine for g in members]
        self.method = stated[1] if stated and self.others else ""
        kept = [self.master, *(g for members in self.sets for g in members if g is not self.master)]
        self._leave_others(kept[1:])
        self.places, self.aliases = places(kept, by)
        found = {name: g.units.get(channel) for name, (g, channel) in self.places.items()}
        self.units = {name: unit for name, unit in found.items() if unit}
        self.numbered = bool(self.runs) and RUN not in self.places
        self.names = (*((RUN,) if self.numbered else ()), *self.places)
        rows = sum(g.rows for g in self.runs.values()) or self.master.rows
        if not self.method:
            self.rows = rows
        self.small = rows <= IN_MEMORY_ROWS
        self.recognised = self._said(kind, filled)
        noted = self.others or (files and len(filled) > 1)
        self.notes = (f"{where} is read as {self.recognised}.",) if noted else ()
        self.unstated = self._ask() if self.others and not self.method else ""

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most `size` rows."""
        if self.runs:
            yield from self._chunks_of_runs(names, size)
        elif self.method:
            yield from self._resampled(names, size)
        else:
            yield from self._joined(names, size)

    def _master(self, stated: str) -> Group:
        """Return the group whose samples are the rows; leave out what has no time base and another length."""
        named = {g.name: g for members in self.sets for g in members}
        if stated and stated not in named:
            raise InputError(
                f"Log {self.where} has no group '{stated}'{nearest(stated, list(named))}; it has"
                f" {', '.join(list(named)[:SHOWN_GROUPS])}."
            )
        timed = [members for members in self.sets if members[0].ends]
        usual = max(timed or self.sets, key=lambda members: sum(len(g.channels) for g in members))
        master = named[stated] if stated else usual[0]
        for g in (g for members in self.sets if master not in members for g in members if not g.ends):
            why = f"it has no time base and {g.rows} values where the others have {master.rows}"
            self.left_out.update(dict.fromkeys(g.channels, why))
        self.sets = [members for members in self.sets if members[0].ends or master in members]
        if stated and not master.ends:
            raise InputError(
                f"Group {master.name} of {self.where} has no time base; its samples cannot be the clock."
            )
        return master

    def _leave_others(self, groups: Sequence[Group]) -> None:
        """Leave out runs and times of other `groups` that the master has; where it is stated, all times."""
        for g in groups:
            dropped = {RUN: "run"} if RUN in self.master.channels else {}
            if self.method if g in self.others else self.master.clock:
                dropped[g.clock], g.timed = "time", False
            for name in [c for c in g.channels if c in dropped]:
                self.left_out[f"{g.name}/{name}"] = f"it is the {dropped[name]} of {g.name}"
            g.channels = tuple(c for c in g.channels if c not in dropped)

    def _said(self, kind: str, groups: Sequence[Group]) -> str:
        named = ", ".join(g.said() for g in groups[:SHOWN_GROUPS])
        more = f" and {len(groups) - SHOWN_GROUPS} more" if len(groups) > SHOWN_GROUPS else ""
        if self.runs:
            counted_from_0 = any(number_of(g.name) != k for k, g in self.runs.items())
            named = ", ".join(f"run {k} is {g.name}" for k, g in list(self.runs.items())[:SHOWN_GROUPS])
            each = f"{named}{more}" if counted_from_0 else f"each as {self.sets[0][0].said()}"
            return f"{kind}: {len(self.runs)} runs, {each}"
        text = f"{kind}: {named}{more}"
        if not self.method:
            return f"{text} on {len(self.sets)} clocks" if self.others else text
        linear = "linear between samples (whole numbers: the nearest)"
        how = "the nearest sample" if self.method == "nearest" else linear
        begin, end = self._shared()
        cut = (begin, end) != self.master.ends
        left = f", from {begin:.6g} to {end:.6g} s, where all were recorded" if cut else ""
        left = ", run by run" if self.master.by_run else left
        return f"{text}, at the samples of {self.master.name}, other groups {how}{left}"

    def _ask(self) -> str:
        clocks = [members[0] for members in self.sets]
        named = ", ".join(f"{g.name} {hertz(g.rate)}" for g in clocks[:SHOWN_GROUPS])
        first = quoted(f"{self.master.name}:linear")
        return (
            f"Log {self.where} has {len(clocks)} clocks ({named}): say whose samples become the rows and how"
            f" the others are read there, linear or nearest, with --clock {first}."
        )

    def _joined(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield columns of groups that have one clock."""
        wanted = _by_group(self.places, names)
        if sum(any(g in members for g in wanted) for members in self.sets) > 1:
            raise InputError(self.unstated)
        streams = [g.chunks([channel for _, channel in asked], size) for g, asked in wanted.items()]
        for pieces in zip(*streams, strict=True):
            parts = zip(wanted.values(), pieces, strict=True)
            yield {name: piece[channel] for asked, piece in parts for name, channel in asked}

    def _chunks_of_runs(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        channels = {name: self.places[name][1] for name in names if name in self.places}
        for run, group in self.runs.items():
            asked = list(channels.values()) or [group.channels[0]]
            for piece in group.chunks(asked, size):
                rows = len(next(iter(piece.values())))
                yield {n: piece[channels[n]] if n in channels else np.full(rows, run) for n in names}

    def _resampled(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield columns at the samples of the master, those between which all groups were recorded."""
        wanted, (begin, end) = _by_group(self.places, names), self._shared()
        turns = {name: self._turn(name) for name in names}
        fastest = max(g.rate for g in self.others)  # a chunk of it is in memory beside ours
        size = max(1, int(size * min(1.0, self.master.rate / fastest))) if fastest else size
        followers = [Follower(g, wanted[g], turns, self.where) for g in self.others if g in wanted]
        read = {name for follower in followers for name, _ in follower.wanted}
        mine = [name for name, (g, _) in self.places.items() if g is self.master]
        own = [name for name in names if name not in read] or mine[:1]
        last = np.empty(0)
        for piece, times in zip(self._joined(own, size), self.master.chunks([TIME], size), strict=True):
            time = times[TIME]
            check_rising(np.concatenate([last, time]), self.master.name, self.where)
            last, inside = time[-1:], (time >= begin) & (time <= end)
            if inside.any():
                found = {name: values[inside] for name, values in piece.items()}
                keep = np.ones(len(time[inside]), bool)
                for follower in followers:
                    found |= follower.at(time[inside], self.method)
                    keep &= ~follower.between
                if keep.any():
                    yield {name: found[name][keep] for name in names}

    def _shared(self) -> tuple[float, float]:
        """Return the times between which all groups were recorded."""
        ends = [g.ends or (0.0, 0.0) for g in (self.master, *self.others)]
        begin, end = max(first for first, _ in ends), min(last for _, last in ends)
        for g, (first, last) in zip(self.others, ends[1:], strict=True):
            if g.since != self.master.since:
                raise InputError(
                    f"Groups {self.master.name} and {g.name} of {self.where} count time from different starts"
                    f" ({self.master.since} and {g.since}); they cannot be put on one clock."
                )
            if begin >= end:
                raise InputError(
                    f"{self.master.name} ({ends[0][0]:.6g} to {ends[0][1]:.6g} s) and {g.name} ({first:.6g}"
                    f" to {last:.6g} s) of {self.where} must overlap in time; count both from one start."
                )
        return begin, end

    def _turn(self, name: str) -> float | None:
        """Return a full turn in the unit of an angle, 0 for another column; None for counts and runs."""
        unit = UNITS[self.units[name]] if name in self.units else split_unit(name)[1]
        if name == RUN or (unit and unit.si == "count"):
            return None
        return 2 * math.pi / unit.factor if unit and unit.si == "rad" else 0.0


def _by_group(
    places: Mapping[str, tuple[Group, str]], names: Sequence[str]
) -> dict[Group, list[tuple[str, str]]]:
    found: dict[Group, list[tuple[str, str]]] = {}
    for name in names:
        found.setdefault(places[name][0], []).append((name, places[name][1]))
    return found


METHODS = ("linear", "nearest")
LONGEST_GAP = 4.0
"""Periods of a channel between two of its samples that are bridged: three lost samples in a row. Within a
longer gap the channel has no value (NaN), so that a pause between runs is no straight line."""
AT_ONCE = 4096
"""Samples of a group that are read ahead."""
FOR_PERIOD = 1000
"""Samples from which the period of a group is taken; a pause between them is not in the median."""


class Follower:
    """One group read along the clock of another; it holds the samples about the rows asked for, no more."""

    def __init__(
        self,
        group: Group,
        wanted: Sequence[tuple[str, str]],
        turns: Mapping[str, float | None],
        where: str,
    ) -> None:
        """Begin a pass for columns and their channels; `between`: which of the last rows no run of it has.

        `turns`: by column a full turn of an angle, 0 for others; None for whole numbers, between which there
        is nothing. Messages call the file `where`.
        """
        self.group, self.wanted, self.turns, self.where = group, list(wanted), turns, where
        self.names = [TIME, *dict.fromkeys(channel for _, channel in wanted)]
        self._pieces = iter(group.chunks(self.names, AT_ONCE))
        self._buffer = {name: np.empty(0, bool) for name in self.names}  # joining keeps the other type
        self._more()
        self.between = np.empty(0, bool)
        self._longest = LONGEST_GAP * usual_step(self._buffer[TIME])

    def at(self, time: Array, method: str) -> dict[str, Array]:
        """Return the columns at rising times, each of shape (times,); NaN where the group has no value."""
        while (not len(self._buffer[TIME]) or self._buffer[TIME][-1] < time[-1]) and self._more():
            pass
        own = self._buffer[TIME]
        keep = max(0, min(int(np.searchsorted(own, time[0], "right")) - 1, len(own) - 2))
        self._buffer = {name: values[keep:] for name, values in self._buffer.items()}
        own = self._buffer[TIME]
        self.between = np.zeros(len(time), bool)
        if len(own) < 2:
            return {column: np.full(len(time), np.nan) for column, _ in self.wanted}
        after = np.searchsorted(own, time, "left").clip(1, len(own) - 1)
        before = after - 1
        left, right = own[before], own[after]
        inside = (time >= left) & (time <= right) & (right - left <= self._longest)
        known = inside | (time == left) | (time == right)
        self.between = ~known & (right - left > RUN_SPACING_S / 2)
        share = np.divide(time - left, right - left, out=np.zeros(len(time)), where=right > left)
        out = {}
        for column, channel in self.wanted:
            values, turn = self._buffer[channel], self.turns[column]
            if method == "nearest" or values.dtype.kind != "f" or turn is None:
                found = values[np.where(share > 0.5, after, before)].astype(np.float64)
            else:
                found = _between(values[before], values[after], share, turn)
            out[column] = np.where(known, found, np.nan)
        return out

    def _more(self) -> bool:
        """Read the next chunk; whether there was one."""
        piece = next(self._pieces, None)
        if piece is None:
            return False
        check_rising(np.r_[self._buffer[TIME][-1:], piece[TIME]], self.group.name, self.where)
        self._buffer = joined([self._buffer, piece], self.names)
        return True


def _between(low: Array, high: Array, share: Array, turn: float) -> Array:
    """Return values at a share of the way from `low` to `high`.

    An angle that wraps takes the short way. It wraps where two samples within one turn of zero differ by more
    than half a turn.
    """
    step = high - low
    if turn:
        again = (np.abs(step) > turn / 2) & (np.abs(low) <= turn) & (np.abs(high) <= turn)
        step = np.where(again, step - turn * np.round(step / turn), step)
    return np.where(share <= 0.5, low + share * step, high - (1 - share) * step)


def usual_step(time: Array) -> float:
    """Return the median step of the first times; infinite where there is none."""
    steps = np.diff(time[:FOR_PERIOD])
    return float(np.median(steps)) if len(steps) else np.inf


def check_rising(time: Array, name: str, where: str) -> None:
    """Refuse a clock that goes back."""
    if len(time) > 1 and not (np.diff(time) >= 0).all():
        at = int(np.argmin(np.diff(time) >= 0))
        raise InputError(
            f"Time of group {name} of {where} must rise; after {time[at]:.9g} s comes {time[at + 1]:.9g} s,"
            " so it cannot be put on one clock with others: split the log there."
        )
