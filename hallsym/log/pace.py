"""The sample interval of a file, where it states that beside its columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hallsym.log.columns import split_header, unit_of
from hallsym.log.table import TIME, Source, about
from hallsym.units import UNITS, Array, split_unit

_SAMPLING = (
    "(?:sampl(?:e|es|ing)|scan|daq|acquisition|data|log(?:ging)?|record(?:ing)?|abtast|horiz(?:ontal)?"
    "|cycle|zyklus|サンプリング|采样)"
)
_STEP = re.compile(
    rf"d[tx]|delta[tx]|ts|(?:{_SAMPLING}|wf|[tx]|time)(?:inter?vall?|period|step|spacing|inc(?:r|rement)?)"
    rf"|{_SAMPLING}(?:time|zeit|周期|间隔)"
)
_RATE = re.compile(rf"fs|{_SAMPLING}(?:frequency|freq|frequenz|clock)|{_SAMPLING}?rate")
_START = re.compile("wfstartoffset|[tx](?:0|start)")
_VALUE = re.compile(r"\s*([-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)[\s;,]*([^\d\s;,]\S*)?")


class Pace(NamedTuple):
    """The sample interval `step` [s]; the first sample is at `start` [s] from `moment` [ns since 1970]."""

    step: float
    start: float = 0.0
    moment: int | None = None


def pace_in(facts: Mapping[str, Any]) -> Pace | None:
    """Return the sample interval by attributes, lines of a header or scalars; None where none states it.

    >>> pace_in({"Sample Interval": "0,5 ms"}), pace_in({"fs_khz": 2.0}), pace_in({"gain": 3})
    (Pace(step=0.0005, start=0.0, moment=None), Pace(step=0.0005, start=0.0, moment=None), None)
    """
    step, start, moment = 0.0, 0.0, None
    for name, value in facts.items():
        stem, stated = split_header(name)
        stem, unit = (stem, UNITS[stated]) if stated else split_unit(stem)
        plain = re.sub(r"[\W_]", "", stem).lower()
        if isinstance(value, np.datetime64) and plain == "wfstarttime":
            moment = int(value.astype("M8[ns]").astype(np.int64))
        elif (number := _number(value, unit.name if unit else "")) is None:
            continue
        elif number > 0 and (_STEP.fullmatch(plain) or _RATE.fullmatch(plain)):
            step = number if _STEP.fullmatch(plain) else 1 / number
        elif _START.fullmatch(plain):
            start = number
    return Pace(step, start, moment) if step else None


def _number(value: Any, unit: str) -> float | None:
    """Return the number of a fact in SI; its unit may stand behind it."""
    value = value.ravel()[0] if isinstance(value, np.ndarray) and value.size == 1 else value
    match = _VALUE.match(value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value))
    if match is None:
        return None
    own = unit_of(re.sub("(?i)(sa?/s|sps)$", "Hz", match[2])) if match[2] else unit
    return float(match[1].replace(",", ".")) * (UNITS[own].factor if own else 1.0)


class Paced(Source):
    """A source with the times of its samples as a column of its own."""

    def __init__(self, source: Source, pace: Pace, name: str = TIME, without: Sequence[str] = ()) -> None:
        """Take the columns of a source, `without` some; times are called `name`."""
        vars(self).update(about(source))
        self.source, self.pace, self.time = source, pace, name
        self.names = (name, *(own for own in source.names if own not in without))
        self.units, self.since, self.clocks = {**source.units, name: "s"}, "zero", {name: pace}

    def count(self) -> int:
        """Return the number of rows."""
        return self.source.count()

    def texts(self, name: str) -> Sequence[object] | None:
        """Return the cells of a column."""
        return self.source.texts(name)

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most about `size` rows."""
        wanted, row = [name for name in names if name != self.time] or [self.names[1]], 0
        for piece in self.source.chunks(wanted, size):
            rows = len(piece[wanted[0]])
            time = self.pace.start + self.pace.step * np.arange(row, row + rows)
            yield {name: time if name == self.time else piece[name] for name in names}
            row += rows
