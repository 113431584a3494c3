"""Channels of one clock at the samples of another: the nearest sample, or linear between two; streamed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import RUN
from hallsym.units import Array

METHODS = ("linear", "nearest")
LONGEST_GAP = 4.0
"""Periods of a channel between two of its samples that are bridged: three lost samples in a row. Within a
longer gap the channel has no value (NaN), so that a pause between runs is no straight line."""

Piece = Mapping[str, Array]
Stream = Callable[[Sequence[str], int], Iterator[tuple[Array, Piece]]]


@dataclass(frozen=True)
class Wanted:
    """A column and the channel that it is; `turn`: a full turn in the unit of an angle, 0 for others."""

    column: str
    channel: str
    turn: float = 0.0


class Follower:
    """One group read along the clock of another; it holds the samples about the rows asked for, no more."""

    def __init__(self, name: str, rate: float, stream: Stream, wanted: Sequence[Wanted]) -> None:
        """Read channels of a group with `rate` samples a second."""
        self.name, self.rate, self.stream, self.wanted = name, rate, stream, list(wanted)
        self.channels = list(dict.fromkeys(w.channel for w in wanted))

    def start(self, size: int, where: str) -> None:
        """Begin a pass with chunks of `size` samples; messages call the file `where`."""
        self._where = where
        self._pieces = self.stream(self.channels, size)
        self._time = np.empty(0)
        self._held: dict[str, Array] = {}
        self._longest = np.inf
        self._ended = not self._more()
        if len(self._time) > 1:
            self._longest = LONGEST_GAP * float(np.median(np.diff(self._time)))

    def at(self, time: Array, method: str) -> dict[str, Array]:
        """Return the columns at rising times, each of shape (times,); NaN where the group has no value."""
        while not self._ended and not (len(self._time) and self._time[-1] >= time[-1]):
            self._ended = not self._more()
        keep = max(0, int(np.searchsorted(self._time, time[0], "right")) - 1)
        self._time = self._time[keep:]
        self._held = {name: values[keep:] for name, values in self._held.items()}
        if len(self._time) < 2:
            return {w.column: np.full(len(time), np.nan) for w in self.wanted}
        after = np.searchsorted(self._time, time, "left").clip(1, len(self._time) - 1)
        before = after - 1
        left, right = self._time[before], self._time[after]
        inside = (time >= left) & (time <= right) & (right - left <= self._longest)
        known = inside | (time == left) | (time == right)
        share = np.divide(time - left, right - left, out=np.zeros(len(time)), where=right > left)
        out = {}
        for w in self.wanted:
            values = self._held[w.channel]
            if method == "nearest" or values.dtype.kind != "f" or w.column == RUN:
                found = values[np.where(share > 0.5, after, before)].astype(np.float64)
            else:
                found = _between(values[before], values[after], share, w.turn)
            out[w.column] = np.where(known, found, np.nan)
        return out

    def _more(self) -> bool:
        """Read the next chunk; whether there was one."""
        found = next(self._pieces, None)
        if found is None:
            return False
        time, piece = found
        joined = np.concatenate([self._time, time])
        check_rising(joined[max(0, len(self._time) - 1) :], self.name, self._where)
        self._time = joined
        self._held = {
            c: np.concatenate([self._held[c], piece[c]]) if c in self._held else piece[c]
            for c in self.channels
        }
        return True


def _between(low: Array, high: Array, share: Array, turn: float) -> Array:
    """Return values at a share of the way from `low` to `high`.

    An angle that begins again takes the short way. It begins again where two samples within one turn of zero
    are more than half a turn apart.
    """
    step = high - low
    if turn:
        again = (np.abs(step) > turn / 2) & (np.abs(low) <= turn) & (np.abs(high) <= turn)
        step = np.where(again, step - turn * np.round(step / turn), step)
    return np.where(share <= 0.5, low + share * step, high - (1 - share) * step)


def check_rising(time: Array, name: str, where: str) -> None:
    """Refuse a clock that goes back."""
    if len(time) > 1 and not (np.diff(time) >= 0).all():
        at = int(np.argmin(np.diff(time) >= 0))
        raise InputError(
            f"Time of group {name} of {where} must rise; after {time[at]:.9g} s comes {time[at + 1]:.9g} s,"
            " so it cannot be put on one clock with others: split the log there."
        )


def resampled(
    rows: Iterator[tuple[Array, Piece]],
    followers: Sequence[Follower],
    method: str,
    ends: tuple[float, float],
    names: Sequence[str],
    size: int,
    where: str,
) -> Iterator[Piece]:
    """Yield the columns `names` at the rows of a clock; those outside `ends` are left out.

    A fast follower of a slow clock is read in few rows at a time, so that it never holds more than about
    `size` samples.
    """
    asked = [f for f in followers if f.wanted]
    for follower in asked:
        follower.start(size, where)
    last = np.empty(0)
    for time, own in rows:
        check_rising(np.concatenate([last, time]), "the clock", where)
        last = time[-1:]
        inside = (time >= ends[0]) & (time <= ends[1])
        if not inside.any():
            continue
        when = time[inside]
        found = _read(asked, when, method, size)
        kept = {name: values[inside] for name, values in own.items()}
        yield {name: found[name] if name in found else kept[name] for name in names}


def _read(followers: Sequence[Follower], time: Array, method: str, size: int) -> dict[str, Array]:
    """Return all columns of the followers at `time`, in steps that hold about `size` of their samples."""
    out: dict[str, Array] = {}
    for follower in followers:
        need = (time[-1] - time[0]) * follower.rate / size
        parts = [p for p in np.array_split(time, max(1, min(len(time), int(np.ceil(need))))) if len(p)]
        found = [follower.at(part, method) for part in parts]
        out |= {name: np.concatenate([piece[name] for piece in found]) for name in found[0]}
    return out
