"""Arrow's columns and tables in memory as arrays; times, by their type or as text, as seconds."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import T
from hallsym.log.table import Arrays, Source, load
from hallsym.log.text.cells import stems_of
from hallsym.units import Array

DAY_S = 86_400.0
TICK_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def is_time(kind: Any) -> bool:
    """Say whether an Arrow type is one of times; a date alone is none."""
    types = load("pyarrow").types
    return bool(types.is_timestamp(kind) or types.is_time(kind) or types.is_duration(kind))


def name_the_time(source: Source, times: Iterable[int]) -> None:
    """Let the only column of times be the time of the log, in seconds from its first sample.

    It is not where another column is that by its name.
    """
    places = list(times)
    others = [name for k, name in enumerate(source.names) if k not in places]
    if len(places) != 1 or any(re.fullmatch("t(_[a-z]+)?", name) for name in others):
        return
    (at,) = places
    old = source.names[at]
    if old == f"{T}_s":
        return
    source.names = (*source.names[:at], T, *source.names[at + 1 :])
    source.units = {name: unit for name, unit in source.units.items() if name != old} | {T: "s"}
    longer = {long: T if short == old else short for long, short in source.aliases.items()}
    source.aliases = longer | ({old: T} if old != T else {})


def said_of_times(name: str, where: str, form: str) -> str:
    """Return the note on a column of times."""
    return f"Column '{name}' of {where} holds {form}; it is read in seconds from its first sample on."


_CLOCK = r"(?P<hour>\d{1,2}):(?P<min>\d{2}):(?P<sec>\d{2}(?:[.,]\d{1,9})?)"
_ZONE = r"\s*(?P<zone>Z|[+-]\d{2}:?\d{2})"
_DATES = (
    r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})[T ]\s*",
    r"(?P<d>\d{1,2})\.(?P<m>\d{1,2})\.(?P<y>\d{4})[T ]\s*",  # dots: everywhere the day stands first
    r"(?P<a>\d{1,2})[-/](?P<b>\d{1,2})[-/](?P<y>\d{4})[T ]\s*",
)


@dataclass(frozen=True)
class TimeForm:
    """How times are written: a pattern with a group for each part; the day may be `a` or `b`."""

    pattern: str

    @property
    def said(self) -> str:
        """What the form is called."""
        return "dates with times" if "<y>" in self.pattern else "times of day"


def time_form(cells: Sequence[str]) -> TimeForm | None:
    """Return the form that all cells of a column have; None where they are no times."""
    for date in (*_DATES, ""):
        for zone in ("", _ZONE) if date else ("",):
            whole = re.compile(rf"^\s*{date}{_CLOCK}{zone}\s*$")
            if cells and all(whole.fullmatch(cell) for cell in cells):
                return TimeForm(whole.pattern)
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
        daily = "<y>" not in self.form.pattern if self.form else types.is_time(kind)
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
        text, join = cells.cast(arrow.string()), compute.binary_join_element_wise
        found = compute.extract_regex(text, form.pattern)
        odd = text.filter(compute.and_(found.is_null(), text.is_valid())).to_pylist()[:1]
        part = {name: compute.struct_field(found, name) for name in re.findall(r"\?P<(\w+)>", form.pattern)}
        if "a" in part:
            part["d"], part["m"] = (
                part[k] for k in ("ab" if self._day_stands_first(part, compute) else "ba")
            )
        two = {name: compute.utf8_lpad(part[name], 2, "0") for name in ("m", "d", "hour") if name in part}
        day = join(part["y"], two["m"], two["d"], "-") if "y" in part else "1970-01-01"
        clock = join(two["hour"], part["min"], compute.replace_substring(part["sec"], ",", "."), ":")
        try:
            if odd:
                raise arrow.ArrowInvalid(odd[0])
            whole = join(join(day, clock, " "), part.get("zone", ""), "")
            return whole.cast(arrow.timestamp("ns", "UTC" if "zone" in part else None))
        except arrow.ArrowInvalid as error:
            raise InputError(
                f"{self.what} must hold {form.said} written alike in every line; one is not "
                f"({str(error)[:80]}): put it right, or leave the line out."
            ) from error

    def _day_stands_first(self, part: Mapping[str, Any], compute: Any) -> bool:
        """Say which number of a date is the day, where that matters: not while all dates are the same."""
        if self._day_first is None:
            most = [compute.max(part[k].cast("int64")).as_py() or 0 for k in "ab"]
            dates = compute.binary_join_element_wise(part["a"], part["b"], part["y"], "/")
            self._dates |= {date for date in compute.unique(dates).to_pylist() if date}
            if max(most) > 12 and self._first is None:
                self._day_first = most[0] > 12
            elif len(self._dates) > 1:
                raise InputError(
                    f"{self.what} holds dates such as {min(self._dates)}, whose day may stand first or "
                    "second: write the year first, 2026-04-03."
                )
        return bool(self._day_first)


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


def source_of(data: Any, where: str) -> Arrays:
    """Return the columns of numbers of a table: a dict of arrays, or what has `__arrow_c_stream__`.

    A name may state its unit as in a file: `x_ref_um`, `x_ref [um]`. Columns of other things are left out.
    """
    if isinstance(data, Mapping):
        given = {str(name): np.asarray(values) for name, values in data.items()}
    else:
        given = _columns_of(data, where)
    columns: dict[str, Array] = {}
    left_out: dict[str, str] = {}
    clocks: dict[str, Seconds] = {}
    for name, values in given.items():
        if isinstance(values, np.ndarray) and values.dtype.kind in "mM" and values.ndim == 1:
            values = load("pyarrow").array(values.astype(f"{values.dtype.kind}8[ns]"))
        if not isinstance(values, np.ndarray) and is_time(values.type):
            clocks[name] = Seconds()
        if not isinstance(values, np.ndarray) and (name in clocks or is_numeric(values.type)):
            values = clocks.get(name, array_of)(values)
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
            left_out[name] = "it holds no numbers"
            continue
        if values.ndim != 1 or len(values) != len(next(iter(columns.values()), values)):
            raise InputError(
                f"Column {name} of {where} must be a vector as long as the others; it is {values.shape}."
            )
        columns[name] = values
    found = stems_of(columns)
    source = Arrays({})
    source.call(found)
    name_the_time(source, [k for k, name in enumerate(columns) if name in clocks])
    source.columns = dict(zip(source.names, columns.values(), strict=True))
    source.clocks = {o: clocks[text] for o, text in zip(source.names, columns, strict=True) if text in clocks}
    source.rows = len(next(iter(columns.values()), ()))
    source.left_out = left_out
    source.notes = tuple(said_of_times(name, where, "times") for name in clocks)
    return source


def _columns_of(data: Any, where: str) -> dict[str, Any]:
    """Return the columns of a table of Arrow."""
    arrow = load("pyarrow")
    try:
        table = arrow.RecordBatchReader.from_stream(data).read_all()
    except (arrow.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"{where} must be a table of columns; it is none ({error}).") from error
    if len(set(table.column_names)) < len(table.column_names):
        raise InputError(f"Columns of {where} must have different names; one is there twice.")
    return dict(zip(table.column_names, table.columns, strict=True))
