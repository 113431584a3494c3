"""Arrow's columns and tables in memory as arrays; times, by their type or as text, as seconds."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import RUN, T, is_run_word, is_time_word, stems_of
from hallsym.log.table import Arrays, Source, label, load
from hallsym.units import UNITS, Array, split_unit

HOUR_S, DAY_S = 3600.0, 86_400.0
TICK_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}


def is_time(kind: Any) -> bool:
    """Say whether an Arrow type is one of times; a date alone is none."""
    types = load("pyarrow").types
    return bool(types.is_timestamp(kind) or types.is_time(kind) or types.is_duration(kind))


class Timed(Source):
    """Columns as Arrow gives them, some of which are times: they are read in seconds from the first one."""

    def take(
        self, columns: Mapping[str, tuple[str, str | None]], times: Mapping[int, str], where: str
    ) -> None:
        """Take names (`stems_of`), and which columns are times: as text (`time_form`), or by their type ("").

        The only one is the time of the log, where no other column is that by its name.
        """
        names = list(columns)
        others = [name for k, name in enumerate(names) if k not in times]
        said = {k: f"Column '{names[k]}' of {where}" for k in times}
        if len(times) == 1 and not any(re.fullmatch("t(_[a-z]+)?", name) for name in others):
            (at,) = times
            names[at] = names[at] if names[at] == f"{T}_s" else T
        found = enumerate(zip(names, columns.values(), strict=True))
        in_s = {k for k in times if names[k] == T}
        self.call({name: (text, "s" if k in in_s else unit) for k, (name, (text, unit)) in found})
        self.clocks: dict[str, Seconds] = {}
        self.forms = {names[k]: (form, said[k]) for k, form in times.items()}
        self.notes = tuple(
            f"{what} holds {_called(form)}; it is read in seconds from its first sample on."
            for form, what in self.forms.values()
        )

    def reader(self, name: str) -> Callable[[Any], Array]:
        """Return a function from the chunks of a column to arrays in one pass."""
        if name not in self.forms:
            return array_of
        self.clocks[name] = Seconds(*self.forms[name])
        return self.clocks[name]


_CLOCK = r"(?:\d+ days?,? )?(?P<hour>\d{1,2}):(?P<min>\d{2}):(?P<sec>\d{2}(?:[.,]\d{1,9}|:\d{3})?)"
_MINUTES = r"(?P<min>\d{1,2}):(?P<sec>\d{2}[.,]\d{1,9})"
_ZONE = r"\s*(?P<zone>Z|[+-]\d{2}:?\d{2})"
_DATES = (
    r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})[T ]\s*",
    r"(?P<d>\d{1,2})\.(?P<m>\d{1,2})\.(?P<y>\d{4})[T ]\s*",  # dots: everywhere the day stands first
    r"(?P<a>\d{1,2})[-/](?P<b>\d{1,2})[-/](?P<y>\d{4})[T ]\s*",
)


def time_form(cells: Sequence[str]) -> str | None:
    """Return how all cells of a column are written: a pattern with a group for each part of a time.

    The day may be `a` or `b`. None where they are no times.
    """
    clocks = [f"{date}{_CLOCK}{zone}" for date in _DATES for zone in ("", _ZONE)]
    forms = (re.compile(rf"^\s*{clock}\s*$") for clock in (*clocks, _CLOCK, _MINUTES))
    return next((form.pattern for form in forms if cells and all(map(form.fullmatch, cells))), None)


def _called(form: str) -> str:
    """Return what a form (`time_form`) is called; "" is that of a column whose type says it."""
    return "times" if not form else "dates with times" if "<y>" in form else "times of day"


class Seconds:
    """Turns chunks of one column of times into seconds from its first one, in the order of the file.

    A time of day goes on after midnight, a missing one is nan. `moment`: the first one [ns since 1970],
    of a time of day since midnight; None before it was read, and of durations.
    """

    def __init__(self, form: str = "", what: str = "") -> None:
        """Begin. `form`: of times as text, in a column that messages call `what`."""
        self.form, self.what = form, what
        self.moment: int | None = None
        self._day_first: bool | None = None
        self._first: int | None = None
        self._last, self._days = 0.0, 0.0
        self._dates: set[str] = set()

    def __call__(self, column: Any) -> Array:
        """Return seconds (samples,) of an Arrow array or of several chunks of one."""
        arrow, missing = load("pyarrow"), array_of(column.is_null().cast("int8")).astype(bool)
        column = self._read(column) if self.form else column
        types, kind = arrow.types, column.type
        if types.is_time32(kind):
            column = column.cast(arrow.int32())
        ticks = array_of(load("pyarrow.compute").fill_null(column.cast(arrow.int64()), 0))
        if self._first is None and not missing.all():
            self._first = int(ticks[~missing][0])
            self.moment = None if types.is_duration(kind) else self._first * TICK_NS[kind.unit]
        seconds = (ticks - (self._first or 0)) * (TICK_NS[kind.unit] * 1e-9)
        seconds[missing] = np.nan
        daily = "<y>" not in self.form if self.form else types.is_time(kind)
        return self._onward(seconds) if daily else seconds

    def _onward(self, seconds: Array) -> Array:
        """Return times of day (of an hour, without hours) that never go back by most of it."""
        whole = HOUR_S if self.form and "<hour>" not in self.form else DAY_S
        steps = np.diff(seconds, prepend=self._last)
        days = self._days + whole * np.cumsum(np.nan_to_num(steps) < -whole / 2)
        good = np.flatnonzero(np.isfinite(seconds))
        if len(good):
            self._last, self._days = float(seconds[good[-1]]), float(days[-1])
        return np.asarray(seconds + days)

    def _read(self, cells: Any) -> Any:
        """Return the times of an Arrow array of strings."""
        arrow, compute = load("pyarrow"), load("pyarrow.compute")
        text, join = cells.cast(arrow.string()), compute.binary_join_element_wise
        found = compute.extract_regex(text, self.form)
        odd = text.filter(compute.and_(found.is_null(), text.is_valid())).to_pylist()[:1]
        part = {name: compute.struct_field(found, name) for name in re.findall(r"\?P<(\w+)>", self.form)}
        if "a" in part:
            part["d"], part["m"] = (
                part[k] for k in ("ab" if self._day_stands_first(part, compute) else "ba")
            )
        two = {k: compute.utf8_lpad(v, 2, "0") for k, v in part.items() if k in ("m", "d", "hour", "min")}
        day = join(part["y"], two["m"], two["d"], "-") if "y" in part else "1970-01-01"
        seconds = compute.replace_substring_regex(part["sec"], "[,:]", ".")
        clock = join(two.get("hour", "00"), two["min"], seconds, ":")
        try:
            if odd:
                raise arrow.ArrowInvalid(odd[0])
            whole = join(join(day, clock, " "), part.get("zone", ""), "")
            return whole.cast(arrow.timestamp("ns", "UTC" if "zone" in part else None))
        except arrow.ArrowInvalid as error:
            raise InputError(
                f"{self.what} must hold {_called(self.form)} in one form in every line; one is not "
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


class Memory(Arrays, Timed):
    """A table in memory; columns of `words` may name runs."""

    words: Mapping[str, Any] = {}

    def texts(self, name: str) -> list[object] | None:
        """Return the cells of a column of words."""
        return self.words[name].to_pylist() if name in self.words else None

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield everything at once."""
        if word := next((name for name in names if name in self.words), None):
            raise InputError(f"Column '{word}' must hold numbers; it holds words.")
        yield from super().chunks(names, size)


def source_of(data: Any, where: str) -> Memory:
    """Return the columns of numbers of a table: a dict of arrays, or what has `__arrow_c_stream__`.

    A name may state its unit as in a file: `x_ref_um`, `x_ref [um]`. Columns of other things are left out.
    """
    given: dict[str, Any] = {}
    for name, values in data.items() if isinstance(data, Mapping) else _columns_of(data, where):
        array = np.asarray(values) if isinstance(data, Mapping) else values
        kind = array.dtype.kind if isinstance(array, np.ndarray) and array.ndim == 1 else ""
        if kind in ("m", "M"):
            array = load("pyarrow").array(array.astype(f"{kind}8[ns]"))
        elif kind in ("U", "O") and all(isinstance(first, str) for first in array[:1]):
            array = load("pyarrow").array([*map(label, array.tolist())], "string")
        given[str(name)] = array
    typed = {name: values.type for name, values in given.items() if not isinstance(values, np.ndarray)}
    timed = {
        name: form
        for name, kind in typed.items()
        if (form := "" if is_time(kind) else _form_of(given[name])) is not None
    }
    words = {name for name, kind in typed.items() if _is_text(kind) and name not in timed}
    kept = [
        name
        for name, values in given.items()
        if (is_numeric(typed[name]) or name in timed if name in typed else values.dtype.kind in "fiu")
        or name in words
    ]
    source = Memory({})
    source.take(stems_of(kept), {k: timed[name] for k, name in enumerate(kept) if name in timed}, where)
    source.words = {n: given[text] for n, text in zip(source.names, kept, strict=True) if text in words}
    for name, text in zip(source.names, kept, strict=True):
        if name in source.words:
            continue
        values = source.reader(name)(given[text]) if text in typed else given[text]
        if values.ndim != 1 or len(values) != len(next(iter(source.columns.values()), values)):
            raise InputError(
                f"Column {text} of {where} must be a vector as long as the others; it is {values.shape}."
            )
        source.columns[name] = values
    source.rows = len(next(iter(source.columns.values()), ()))
    source.left_out = {name: "it holds no numbers" for name in given if name not in kept}
    return source


def _form_of(cells: Any) -> str | None:
    """Return how a column of text writes times; None for any other column."""
    words = _is_text(cells.type)
    return time_form([cell for cell in cells[:_FEW].to_pylist() if cell]) if words else None


def _is_text(kind: Any) -> bool:
    types = load("pyarrow").types
    return bool(types.is_string(kind) or types.is_large_string(kind))


_FEW = 1000
"""Cells that are looked at to see whether text holds times."""


def _columns_of(data: Any, where: str) -> Iterator[tuple[str, Any]]:
    """Return the columns of a table of Arrow."""
    arrow = load("pyarrow")
    try:
        table = arrow.RecordBatchReader.from_stream(data).read_all()
    except (arrow.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"{where} must be a table of columns; it is none ({error}).") from error
    types, columns = arrow.types, dict(zip(distinct(table.column_names, where), table.columns, strict=True))
    for name in [name for name, column in columns.items() if types.is_dictionary(column.type)]:  # categories
        columns[name] = columns[name].cast(columns[name].type.value_type)
    if not any(types.is_nested(column.type) for column in columns.values()):
        return iter(columns.items())
    one = table.num_rows == 1
    if not one:  # lists of samples may stand within records
        columns = dict(_samples(dict(_entries(columns, one, lists=False)), table.num_rows))
    parts = [*_entries(columns, one)]
    rows = max((len(column) for _, column in parts), default=0)
    return iter([(name, column) for name, column in parts if len(column) == rows])


MOST_COLUMNS = 100
"""Columns that a matrix is taken for at most: a wider one is a picture or a map."""


def _lengths(column: Any) -> Array | None:
    """Return how long the lists of a column are, (rows,); None of a column without lists."""
    types, kind = load("pyarrow").types, column.type
    if not (types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)):
        return None
    return array_of(load("pyarrow.compute").fill_null(load("pyarrow.compute").list_value_length(column), 0))


def _samples(columns: Mapping[str, Any], rows: int) -> Iterator[tuple[str, Any]]:
    """Yield columns with a row per sample, where each row holds lists of samples, as those of a run.

    Lists are samples where they are of several lengths, too long for columns, or one of them is the time.
    """
    lists = {name: own for name, column in columns.items() if (own := _lengths(column)) is not None}
    shared = next(iter(lists.values()), np.zeros(rows, int))
    timed = any(is_time_word(split_unit(name)[0]) for name in lists)
    long = timed or len(set(shared)) > 1 or max(shared, default=0) > MOST_COLUMNS
    if not long or not all(np.array_equal(own, shared) for own in lists.values()):
        yield from columns.items()
        return
    each = np.repeat(np.arange(rows), shared)
    for name, column in columns.items():
        yield name, load("pyarrow.compute").list_flatten(column) if name in lists else column.take(each)
    if len(lists) > 1 and not any(is_run_word(name) for name in columns):
        yield RUN, load("pyarrow").chunked_array([each])


def _entries(columns: Mapping[str, Any], one: bool, lists: bool = True) -> Iterator[tuple[str, Any]]:
    """Yield the columns that columns of records and lists hold, by names that are joined.

    A unit behind a name is that of its columns: {"hall_um": {"a": 1.5}} is `hall_a_um`, {"hall_um": [1.5]}
    is `hall_0_um`. What a name says already, and the only record with lists, is not put before it:
    {"data": {"x": [1, 2]}} is `x`. In `one` row lists are samples; without `lists`, a list stays one column.
    """
    types, compute = load("pyarrow").types, load("pyarrow.compute")
    holding = [name for name, column in columns.items() if _holds_lists(column.type)]
    for name, column in columns.items():
        lengths, kind = _lengths(column), column.type
        stem, _, last = name.rpartition("_")
        stem, unit = (stem, f"_{last}") if stem and last in UNITS else (name, "")
        nested = dict[str, Any]()
        if types.is_struct(kind):
            for k, under in enumerate(field.name for field in kind):
                said = holding == [name] or stem.lower() in re.split(r"[\W_]", under.lower())
                nested[under if said else f"{stem}_{under}{unit}"] = compute.struct_field(column, k)
        elif lengths is not None and one and lists:
            nested = {name: compute.list_flatten(column)}
        elif lists and lengths is not None and len(set(lengths)) == 1 and 0 < lengths[0] <= MOST_COLUMNS:
            nested = {f"{stem}_{k}{unit}": compute.list_element(column, k) for k in range(int(lengths[0]))}
        else:
            yield name, column
        if nested:
            yield from _entries(nested, one, lists)


def _holds_lists(kind: Any) -> bool:
    types = load("pyarrow").types
    return any(_holds_lists(f.type) for f in kind) if types.is_struct(kind) else types.is_nested(kind)


def distinct(names: Sequence[str], where: str) -> Sequence[str]:
    """Return names of columns; refuse one that is there twice."""
    if twice := next((name for name, times in Counter(names).items() if times > 1), None):
        raise InputError(f"Columns of {where} must have different names; '{twice}' is twice.")
    return names
