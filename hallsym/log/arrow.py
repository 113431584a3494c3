"""Arrow's columns and tables in memory as arrays; times, by their type or as text, as seconds."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.table import Arrays, Source, load
from hallsym.log.text.cells import stems_of
from hallsym.units import Array

TIME = "t"
"""What a log calls its time."""
DAY_S = 86_400.0
TICK_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


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


def name_the_time(source: Source, times: Iterable[int]) -> None:
    """Let the only column of times be the time of the log, in seconds from its first sample."""
    at = only_time(source.names, times)
    if at is None or source.names[at] == f"{TIME}_s":
        return
    old = source.names[at]
    source.names = (*source.names[:at], TIME, *source.names[at + 1 :])
    source.units = {name: unit for name, unit in source.units.items() if name != old} | {TIME: "s"}
    longer = {long: TIME if short == old else short for long, short in source.aliases.items()}
    source.aliases = longer | ({old: TIME} if old != TIME else {})


def said_of_times(name: str, where: str, form: str) -> str:
    """Return the note on a column of times."""
    return f"Column '{name}' of {where} holds {form}; it is read in seconds from its first sample on."


_CLOCK = r"\d{1,2}:\d{2}:\d{2}(?:[.,]\d{1,9})?"
_ZONE = r"(?:Z|[+-]\d{2}:?\d{2})"
_DATES = {
    "year first": r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}",
    "day.month": r"\d{1,2}\.\d{1,2}\.\d{4}",  # dots: everywhere the day stands first
    "open": r"\d{1,2}[-/]\d{1,2}[-/]\d{4}",
}


@dataclass(frozen=True)
class TimeForm:
    """How times are written: `date` as in `_DATES`, "" for a time of day alone; whether a zone is stated."""

    date: str
    zoned: bool

    @property
    def said(self) -> str:
        """What the form is called."""
        return "dates with times" if self.date else "times of day"


def time_form(cells: Sequence[str]) -> TimeForm | None:
    """Return the form that all cells of a column have; None where they are no times."""
    if not cells:
        return None
    for date, pattern in {**_DATES, "": ""}.items():
        start = rf"{pattern}[T ]\s*" if pattern else ""
        for zone in ("", rf"\s*{_ZONE}") if date else ("",):
            whole = re.compile(rf"\s*{start}{_CLOCK}{zone}\s*")
            if all(whole.fullmatch(cell) for cell in cells):
                return TimeForm(date, bool(zone))
    return None


class Seconds:
    """Turns chunks of one column of times into seconds from its first one, in the order of the file.

    A time of day goes on after midnight, a missing one is nan. `epoch`: the first moment in seconds from
    1970, of a time of day from midnight; None before it was read, and of durations.
    """

    def __init__(self, form: TimeForm | None = None, what: str = "") -> None:
        """Begin. `form`: of times as text, in a column that messages call `what`."""
        self.form, self.what = form, what
        self.epoch: float | None = None
        self._day_first: bool | None = None
        self._first: int | None = None
        self._last, self._days = 0.0, 0.0
        self._dates: set[str] = set()

    def __call__(self, column: Any) -> Array:
        """Return seconds (samples,) of an Arrow array or of several chunks of one."""
        arrow, missing = load("pyarrow"), array_of(column.is_null().cast("int8")).astype(bool)
        column = self._read(column, self.form) if self.form else column
        types, kind = arrow.types, column.type
        if types.is_time32(kind):
            column = column.cast(arrow.int32())
        ticks = array_of(load("pyarrow.compute").fill_null(column.cast(arrow.int64()), 0))
        if self._first is None and not missing.all():
            self._first = int(ticks[~missing][0])
            self.epoch = None if types.is_duration(kind) else self._first * TICK_S[kind.unit]
        seconds = (ticks - (self._first or 0)) * TICK_S[kind.unit]
        seconds[missing] = np.nan
        daily = not self.form.date if self.form else types.is_time(kind)
        return self._onward(seconds) if daily else seconds

    def _onward(self, seconds: Array) -> Array:
        """Return times of day that never go back by most of a day."""
        steps = np.diff(seconds, prepend=self._last)
        days = self._days + DAY_S * np.cumsum(np.nan_to_num(steps) < -DAY_S / 2)
        good = np.flatnonzero(np.isfinite(seconds))
        if len(good):
            self._last, self._days = float(seconds[good[-1]]), float(days[-1])
        return np.asarray(seconds + days)

    def _read(self, cells: Any, form: TimeForm) -> Any:
        """Return the times of an Arrow array of strings."""
        arrow, compute = load("pyarrow"), load("pyarrow.compute")
        text = compute.utf8_trim_whitespace(cells.cast(arrow.string()))
        text = compute.replace_substring_regex(text, ",", ".")
        if form.date == "open":
            self._decide(text, compute)
        for pattern, plain in self._steps(form):
            text = compute.replace_substring_regex(text, pattern, plain)
        try:
            return text.cast(arrow.timestamp("ns", "UTC" if form.zoned else None))
        except arrow.ArrowInvalid as error:
            raise InputError(
                f"{self.what} must hold {form.said} written alike in every line; one is not "
                f"({str(error)[:80]}): put it right, or leave the line out."
            ) from error

    def _decide(self, text: Any, compute: Any) -> None:
        """Find which number of a date is the day, where that matters: not while all dates are the same."""
        if self._day_first is not None:
            return
        dates = compute.unique(compute.replace_substring_regex(text, r"[-/](\d{4})\s.*$", r"/\1")).to_pylist()
        pairs = [re.split("[-/]", date)[:2] for date in dates if date]
        first, second = (max((int(pair[k]) for pair in pairs), default=0) for k in (0, 1))
        self._dates |= {date for date in dates if date}
        if max(first, second) > 12 and self._first is None:
            self._day_first = first > 12
        elif len(self._dates) > 1:
            raise InputError(
                f"{self.what} holds dates such as {min(self._dates)}, whose day may stand first or second: "
                "write the year first, 2026-04-03."
            )

    def _steps(self, form: TimeForm) -> list[tuple[str, str]]:
        """Return the replacements that make ISO 8601 of a time."""
        pad = (r"(^|[-/. T])(\d)([-/.:])", r"\1" + r"0\2\3")
        day, month = (r"\2", r"\1") if not self._day_first else (r"\1", r"\2")
        swaps = {
            "": [("^", "1970-01-01 ")],
            "year first": [(r"^(\d{4})[-/.](\d\d)[-/.](\d\d)", r"\1-\2-\3")],
            "day.month": [(r"^(\d\d)\.(\d\d)\.(\d{4})", r"\3-\2-\1")],
            "open": [(r"^(\d\d)[-/](\d\d)[-/](\d{4})", rf"\3-{month}-{day}")],
        }[form.date]
        return [pad, pad, *swaps, (r"\s+", " "), (r" ?([+-]\d\d):?(\d\d)$", r"\1:\2"), (r" Z$", "Z")]


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


def is_table(data: Any) -> bool:
    """Say whether something is a table in memory and not the name of a file."""
    return isinstance(data, Mapping) or hasattr(data, "__arrow_c_stream__")


def source_of(data: Any, where: str) -> Arrays:
    """Return the columns of numbers of a table: a dict of arrays, or what has `__arrow_c_stream__`.

    A name may state its unit as in a file: `x_ref_um`, `x_ref [um]`. Columns of other things are left out.
    """
    columns, left_out, times = (_of_mapping if isinstance(data, Mapping) else _of_arrow)(data, where)
    found = stems_of(columns)
    source = Arrays({})
    source.call(found)
    name_the_time(source, [k for k, name in enumerate(columns) if name in times])
    source.columns = dict(zip(source.names, columns.values(), strict=True))
    source.epochs = {ours: times.get(text) for ours, text in zip(source.names, columns, strict=True)}
    source.rows = len(next(iter(columns.values()), ()))
    source.left_out = left_out
    source.notes = tuple(said_of_times(name, where, "times") for name in times)
    return source


Columns = tuple[dict[str, Array], dict[str, str], dict[str, float | None]]
"""Columns, why others are left out, and of the columns of times the moments of their zero."""


def _of_mapping(data: Mapping[Any, Any], where: str) -> Columns:
    columns: dict[str, Array] = {}
    left_out: dict[str, str] = {}
    times: dict[str, float | None] = {}
    for name, given in data.items():
        values = np.asarray(given)
        if values.dtype.kind in "mM" and values.ndim == 1:
            seconds = Seconds()
            values = seconds(load("pyarrow").array(values.astype(f"{values.dtype.kind}8[ns]")))
            times[str(name)] = seconds.epoch
        if values.dtype.kind not in "fiu":
            left_out[str(name)] = "it holds no numbers"
            continue
        first = next(iter(columns.values()), values)
        if values.ndim != 1 or len(values) != len(first):
            raise InputError(
                f"Column {name} of {where} must be a vector as long as the others; it is {values.shape}."
            )
        columns[str(name)] = values
    return columns, left_out, times


def _of_arrow(data: Any, where: str) -> Columns:
    arrow = load("pyarrow")
    try:
        table = arrow.RecordBatchReader.from_stream(data).read_all()
    except (arrow.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"{where} must be a table of columns; it is none ({error}).") from error
    if len(set(table.column_names)) < len(table.column_names):
        raise InputError(f"Columns of {where} must have different names; one is there twice.")
    times = {field.name: Seconds() for field in table.schema if is_time(field.type)}
    held = [field.name for field in table.schema if field.name in times or is_numeric(field.type)]
    columns = {name: times.get(name, array_of)(table.column(name)) for name in held}
    left_out = {name: "it holds no numbers" for name in table.column_names if name not in columns}
    return columns, left_out, {name: seconds.epoch for name, seconds in times.items()}
