"""Groups of channels that were sampled together: clocks, runs, names; one clock at the samples of another."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from hallsym.errors import InputError, counted, few, nearest
from hallsym.log.arrow import DAY_S
from hallsym.log.columns import RUN, T, is_moving, is_time_word
from hallsym.log.pace import Paced
from hallsym.log.table import IN_MEMORY_ROWS, TIME, Source, exact
from hallsym.units import UNITS, Array, Unit, split_unit

RUN_SPACING_S = 1e6
"""Seconds between runs where a clock starts again in each: longer than any run lasts."""
DAY_NS = round(DAY_S * 1e9)
MOTION = {"m", "rad", "v", "t", "count"}
"""SI units of readings and references; rows at the samples of a temperature alone would miss the motion."""


class Group:
    """Channels that were sampled together: columns of a source, of which that of time is the `clock`.

    `timed`: whether time is one of its columns; `moves`: whether a channel follows the motion, 2 by its name,
    1 by its unit alone. Known after `begin`: `time` (rows,) [s], (0,) without a time base; `since`: what it
    counts from, which two clocks must have in common.
    """

    def __init__(self, name: str, source: Source, mapped: Mapping[str, str] | None = None) -> None:
        """Look at the names. `mapped`: our names, with their units, of columns that somebody mapped."""
        self.name, self.source = name, source
        self.channels = tuple(c for c in source.names if c != TIME)
        ours = {c: mapped[c] for c in self.channels if mapped and c in mapped}
        self.units = {**source.units, **{c: u.name for c, n in ours.items() if (u := split_unit(n)[1])}}
        stems = {c: split_unit(ours.get(c, c))[0] for c in self.channels}
        moving = any(is_moving(f"{stem}_{self.unit(c).si}") for c, stem in stems.items())
        self.moves = moving + any(self.unit(c).si in MOTION for c in self.channels)
        named = [c for c in source.names if c == TIME] or [c for c, stem in stems.items() if stem == T]
        timed = named or [c for c in self.channels if self.unit(c).si == "s"]
        timed = timed or [c for c in self.channels if is_time_word(c) and c not in self.units]
        self.clock = timed[0] if len(timed) == 1 else ""
        if not timed and source.pace:
            self.source, self.clock, self.units[TIME] = Paced(source, source.pace), TIME, "s"
        self.timed, self.time, self.since = True, np.empty(0), ""

    @cached_property
    def rows(self) -> int:
        """Samples; a file of text is counted when that is asked first."""
        return self.source.count()

    def unit(self, name: str) -> Unit:
        """Return the unit of a channel; one without a name where none is stated."""
        stated = UNITS[self.units[name]] if name in self.units else split_unit(name)[1]
        return stated or Unit("", "", 1.0)

    def begin(self, by_run: bool) -> int | None:
        """Read the clock, which starts again in each run if `by_run`; return its zero [ns since 1970]."""
        if not self.clock:
            return None
        read, unit = self.source.read([self.clock, *([RUN] if by_run else [])]), self.unit(self.clock)
        self.time = read[self.clock] * unit.factor + (RUN_SPACING_S * read[RUN] if by_run else 0.0)
        known = self.source.clocks.get(self.clock)
        moment = known.moment if known else None
        named = "zero" if unit.si == "s" else "zero, in a unit that is not stated"
        self.since = (self.source.since or named) if moment is None else "a moment"
        return moment

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of exactly `size` rows, the last may be shorter."""
        yield from exact(self.source.chunks(names, size), size, names)

    @property
    def ends(self) -> tuple[float, float]:
        """Time of the first and the last sample [s]; nan without a time base."""
        return (float(self.time[0]), float(self.time[-1])) if len(self.time) else (math.nan, math.nan)

    @property
    def rate(self) -> float:
        """Samples a second on average; 0 where it is not known."""
        first, last = self.ends
        return (self.rows - 1) / (last - first) if last > first else 0.0

    def said(self) -> str:
        """Return the group in words: `Hall (4 channels at 10 kHz)`."""
        rate = f"{self.rate / 1e3:.4g} kHz" if self.rate >= 1e3 else f"{self.rate:.4g} Hz"
        return f"{self.name} ({counted(len(self.channels), 'channel')}{f' at {rate}' if self.rate else ''})"


def on_one_scale(groups: Sequence[Group]) -> bool:
    """Read clocks; those that state a moment count from the earliest one; whether they start again by run.

    A clock with times of day alone is on the day on which it begins nearest to the others.
    """
    by_run = all(RUN in g.channels for g in groups)
    moments = {g: moment for g in groups if (moment := g.begin(by_run)) is not None}
    dated = [moment for moment in moments.values() if moment >= DAY_NS]
    for g in (g for g, moment in moments.items() if dated and moment < DAY_NS):
        moments[g] += DAY_NS * round((min(dated) - moments[g]) / DAY_NS)
    for g, moment in moments.items():
        g.time = g.time + (moment - min(moments.values())) * 1e-9
    return by_run


def places(groups: Sequence[Group], by: str = "/") -> tuple[dict[str, tuple[Group, str]], dict[str, str]]:
    """Name channels by themselves where that is unique, else `group/channel`; times that a format gives too.

    Columns of a matrix are named alike. `by`: between group and channel. Returns (name -> group and channel,
    long name -> name).
    """
    ends = Counter(stem for g in groups for stem in {*map(_stem, g.channels)})
    places: dict[str, tuple[Group, str]] = {}
    aliases: dict[str, str] = {}
    for g in groups:
        if g.timed and g.clock == TIME:
            places[f"{g.name}{by}{T}" if T in ends else T] = g, TIME
        for channel in g.channels:
            long = f"{g.name}{by}{channel}" if g.name else channel
            name = channel if ends[_stem(channel)] == 1 else long
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


def _stem(name: str) -> str:
    """Return the name of a matrix of which a channel is a column: `Data_0` is one of `Data`."""
    return re.sub(r"_\d+$", "", name)


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
    for g in sorted(groups, key=lambda g: (not len(g.time), isinstance(g.source, Paced))):
        if (home := next((members for members in sets if _together(members[0], g)), None)) is None:
            sets.append([g])
        else:
            home.append(g)
    return sets


def _together(first: Group, g: Group) -> bool:
    if first.rows != g.rows or not len(g.time) or (g.ends, g.since) == (first.ends, first.since):
        return first.rows == g.rows
    rated = isinstance(g.source, Paced) and not isinstance(first.source, Paced)
    return rated and math.isclose(usual_step(first.time), g.source.pace.step, rel_tol=UNEVEN)


UNEVEN = 0.01
"""Part by which a rate by a column of times may differ from the stated one."""
SHOWN_GROUPS = 4
"""Groups that a line names."""


class GroupedSource(Source):
    """One table of groups: those of a file, or whole files.

    Groups of the same channels are runs. Others have the rows of one clock, the slowest unless another is
    stated; channels of another clock are read there linearly between two samples.
    """

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

        `clock`: the group whose samples become the rows. `by`: as in `places`. `files`: each group is a file;
        those of the same columns are runs whatever they are called.
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
        self.runs = {} if clock else runs(filled, named=not files)
        self.by_run = not self.runs and len(filled) > 1 and on_one_scale(filled)
        sets = [[next(iter(self.runs.values()))]] if self.runs else on_one_clock(filled)
        self.master = self._master(sets, clock)
        sets = [members for members in sets if len(members[0].time) or self.master in members]
        self.others = [g for members in sets if self.master not in members for g in members]
        kept = [self.master, *(g for members in sets for g in members if g is not self.master)]
        self._leave_others(kept[1:])
        self.places, self.aliases = places(kept, by)
        found = {name: {**g.units, **g.source.units}.get(c) for name, (g, c) in self.places.items()}
        self.units = {name: unit for name, unit in found.items() if unit}
        self.numbered = bool(self.runs) and RUN not in self.places
        self.names = (*((RUN,) if self.numbered else ()), *self.places)
        rows = sum(g.rows for g in self.runs.values()) or self.master.rows
        if not self.others:
            self.rows = rows
        self.small = rows <= IN_MEMORY_ROWS
        self.recognised = self._said(kind, filled)
        noted = self.others or (files and len(filled) > 1)
        self.notes = (f"{where} is read as {self.recognised}.",) if noted else ()

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most `size` rows."""
        if self.runs:
            yield from self._chunks_of_runs(names, size)
        elif self.others:
            yield from self._resampled(names, size)
        else:
            yield from self._joined(names, size)

    def _master(self, sets: Sequence[Sequence[Group]], stated: str | None) -> Group:
        """Return the group whose samples are the rows; leave out what has no time base and another length."""
        named = {g.name: g for members in sets for g in members}
        if stated and stated not in named:
            raise InputError(
                f"Log {self.where} has no group '{stated}'{nearest(stated, list(named))} whose samples become"
                f" the rows; it has {', '.join(list(named)[:SHOWN_GROUPS])}: name one of them with --clock."
            )
        timed = [members for members in sets if len(members[0].time)]
        if timed:  # of those that surely follow the motion, the slowest
            usual = min(timed, key=lambda members: (-max(g.moves for g in members), members[0].rate))[0]
        else:
            usual = max(sets, key=lambda members: sum(len(g.channels) for g in members))[0]
        master = named[stated] if stated else usual
        for g in (g for members in sets if master not in members for g in members if not len(g.time)):
            why = f"it has no time base and {g.rows} values where the others have {master.rows}"
            self.left_out.update(dict.fromkeys(g.channels, why))
        if stated and len(sets) > 1 and not len(master.time):
            raise InputError(
                f"Group {master.name} of {self.where} has no time base; its samples cannot be the clock."
            )
        return master

    def _leave_others(self, groups: Sequence[Group]) -> None:
        """Leave out runs and times of other `groups` that the master has; on other clocks, all times."""
        for g in groups:
            dropped = {RUN: "run"} if RUN in self.master.channels else {}
            if g in self.others or self.master.clock:
                dropped[g.clock], g.timed = "time", False
            for name in [c for c in g.channels if c in dropped]:
                self.left_out[f"{g.name}/{name}"] = f"it is the {dropped[name]} of {g.name}"
            g.channels = tuple(c for c in g.channels if c not in dropped)

    def _said(self, kind: str, groups: Sequence[Group]) -> str:
        if self.runs:
            counted_from_0 = any(number_of(g.name) != k for k, g in self.runs.items())
            named = few([f"run {k} is {g.name}" for k, g in self.runs.items()], SHOWN_GROUPS)
            named = named if counted_from_0 else f"each as {self.master.said()}"
            return f"{kind}: {len(self.runs)} runs, {named}"
        text = f"{kind}: {few([g.said() for g in groups], SHOWN_GROUPS)}"
        if not self.others:
            return text
        begin, end = self._shared()
        cut = (begin, end) != self.master.ends
        left = f", from {begin:.6g} to {end:.6g} s, where all were recorded" if cut else ""
        return (
            f"{text}, at the samples of {self.master.name} (--clock), other groups linear between samples"
            f" (whole numbers: the nearest){', run by run' if self.by_run else left}"
        )

    def _joined(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield columns of groups that have one clock."""
        wanted = _by_group(self.places, names)
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
        wanted, (begin, end), row = _by_group(self.places, names), self._shared(), 0
        others = {g: g.source.read([c for _, c in asked]) for g, asked in wanted.items() if g in self.others}
        mine = [name for name, (g, _) in self.places.items() if g is self.master]
        own = [name for name in names if self.places[name][0] not in others] or mine[:1]
        for piece in self._joined(own, size):
            time = self.master.time[row : row + len(piece[own[0]])]
            row += len(time)
            keep = (time >= begin) & (time <= end)
            found = {n: time if self.places[n][1] == TIME else values for n, values in piece.items()}
            for g, values in others.items():
                turns = {name: (values[channel], self._turn(name)) for name, channel in wanted[g]}
                read, between = read_at(time, g.time, turns)
                found |= read
                keep &= ~between
            if keep.any():
                yield {name: found[name][keep] for name in names}

    def _shared(self) -> tuple[float, float]:
        """Return the times between which all groups were recorded."""
        all_of = (self.master, *self.others)
        for g in all_of:
            self._check_rising(g)
        begin, end = max(g.ends[0] for g in all_of), min(g.ends[1] for g in all_of)
        (first, last), master = self.master.ends, self.master
        for g in self.others:
            if g.since != master.since:
                raise InputError(
                    f"Groups {master.name} and {g.name} of {self.where} count time from different starts"
                    f" ({master.since} and {g.since}); they cannot be put on one clock: state the time of"
                    " each with its unit, such as --column t_ms=ITS_NAME, or count both from one start."
                )
            if begin >= end:
                raise InputError(
                    f"{master.name} ({first:.6g} to {last:.6g} s) and {g.name} ({g.ends[0]:.6g} to"
                    f" {g.ends[1]:.6g} s) of {self.where} must overlap in time; count both from one start: if"
                    f" they began together, add {first - g.ends[0]:.6g} s to the times of {g.name}."
                )
        return begin, end

    def _check_rising(self, g: Group) -> None:
        """Refuse a clock that goes back."""
        rising = np.diff(g.time) >= 0
        if not rising.all():
            at = int(np.argmin(rising))
            by_run = " in each run, and run numbers from run to run" if self.by_run else ""
            raise InputError(
                f"Time of {g.name} of {self.where} must rise{by_run}, to be put on one clock with others; it"
                f" goes back after sample {at + 1}: sort it by time, or split it there."
            )

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


LONGEST_GAP = 4.0
"""Periods of a channel between two of its samples that are bridged: three lost samples in a row. Within a
longer gap the channel has no value (NaN), so that a pause between runs is no straight line."""
FOR_PERIOD = 1000
"""Samples from which the period of a group is taken; a pause between them is not in the median."""


def read_at(
    time: Array, own: Array, columns: Mapping[str, tuple[Array, float | None]]
) -> tuple[dict[str, Array], Array]:
    """Return columns at times, linearly between their samples at the rising times `own`, each (times,).

    Columns have the full turn of an angle, which takes the short way round; 0 for others; None for whole
    numbers, of which the nearest is taken. NaN where there is no value. Also returned: which times lie
    between two runs.
    """
    after = np.searchsorted(own, time, "left").clip(1, len(own) - 1)
    before = after - 1
    left, right = own[before], own[after]
    inside = (time >= left) & (time <= right) & (right - left <= LONGEST_GAP * usual_step(own))
    known = inside | (time == left) | (time == right)
    share = np.divide(time - left, right - left, out=np.zeros(len(time)), where=right > left)
    found = {}
    for name, (values, turn) in columns.items():
        if values.dtype.kind != "f" or turn is None:
            read = values[np.where(share > 0.5, after, before)].astype(np.float64)
        else:
            read = _between(values[before], values[after], share, turn)
        found[name] = np.where(known, read, np.nan)
    return found, ~known & (right - left > RUN_SPACING_S / 2)


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
