"""Arrow's columns as arrays; those of times (timestamp, time of day, duration) as seconds."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from hallsym.log.extras import load
from hallsym.units import Array

TIME = "t"
"""What a log calls its time."""
DAY_S = 86_400.0
_TICK_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def is_time(kind: Any) -> bool:
    """Say whether an Arrow type is one of times; a date alone is none."""
    types = load("pyarrow").types
    return bool(types.is_timestamp(kind) or types.is_time(kind) or types.is_duration(kind))


def only_time(names: Sequence[str], times: Iterable[int]) -> int | None:
    """Return the place of the only column of times, where no other is the time of the log by its name."""
    places = list(times)
    others = [name for k, name in enumerate(names) if k not in places]
    if len(places) != 1 or any(re.fullmatch("t(_[a-z]+)?", name) for name in others):
        return None
    return places[0]


def said_of_times(name: str, where: str, form: str) -> str:
    """Return the note on a column of times."""
    return f"Column '{name}' of {where} holds {form}; it is read in seconds from its first sample on."


def first_tick(column: Any) -> int | None:
    """Return the first moment of a column of times in ticks of its type; None without one."""
    known = column.drop_null()
    return int(_ticks(known[:1])[0]) if len(known) else None


def _ticks(column: Any) -> Array:
    arrow = load("pyarrow")
    if arrow.types.is_time32(column.type):
        column = column.cast(arrow.int32())
    return array_of(load("pyarrow.compute").fill_null(column.cast(arrow.int64()), 0))


class Moments:
    """Turns chunks of one column of times into seconds, in the order of the file.

    All count from `origin`, a time of day goes on after midnight. A missing one is nan.
    """

    def __init__(self, kind: Any, origin: int | None) -> None:
        """Begin; `kind`: an Arrow type, `origin`: `first_tick` of the column."""
        types = load("pyarrow").types
        self.tick_s = _TICK_S[kind.unit]
        self.origin = origin or 0
        self._onward = Onward() if types.is_time(kind) else None

    def __call__(self, column: Any) -> Array:
        """Return seconds (samples,) of an Arrow array or of several chunks of one."""
        seconds = (_ticks(column) - self.origin) * self.tick_s
        if column.null_count:
            seconds[array_of(column.is_null().cast("int8")).astype(bool)] = np.nan
        return seconds if self._onward is None else self._onward(seconds)


class Onward:
    """Lets a time of day go on after midnight, chunk by chunk."""

    def __init__(self) -> None:
        self._last, self._days = 0.0, 0.0

    def __call__(self, seconds: Array) -> Array:
        """Return seconds (samples,) that never go back by most of a day."""
        steps = np.diff(seconds, prepend=self._last)
        days = self._days + DAY_S * np.cumsum(np.nan_to_num(steps) < -DAY_S / 2)
        good = np.flatnonzero(np.isfinite(seconds))
        if len(good):
            self._last, self._days = float(seconds[good[-1]]), float(days[-1])
        return np.asarray(seconds + days)


_FLOATS = {"double": "float64", "float": "float32", "halffloat": "float16"}


def is_numeric(kind: Any) -> bool:
    """Say whether an Arrow type is one of numbers; booleans are none."""
    types = load("pyarrow").types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def array_of(column: Any) -> Array:
    """Return a column of numbers, an Arrow array or several chunks of one, of shape (rows,); missing is nan.

    Its buffers are taken as they are: Arrow's own conversion imports pandas wherever that is installed.
    """
    if hasattr(column, "chunks"):
        parts = [array_of(chunk) for chunk in column.chunks]
        return parts[0] if len(parts) == 1 else np.concatenate(parts or [np.empty(0)])
    arrow = load("pyarrow")
    if arrow.types.is_decimal(column.type) or column.null_count:
        column = column.cast(arrow.float64(), safe=False)
    if column.null_count:
        column = load("pyarrow.compute").fill_null(column, float("nan"))
    kind = np.dtype(_FLOATS.get(str(column.type), str(column.type)))
    if not len(column):
        return np.empty(0, kind)
    data = np.frombuffer(column.buffers()[1], kind)
    return data[column.offset : column.offset + len(column)]
