"""Vectors by their path in a file of groups or structs: grouped as one table, runs, or other clocks."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hallsym.errors import InputError
from hallsym.log.arrow import MOST_COLUMNS, Seconds, time_form
from hallsym.log.columns import split_header, stems_of, unit_of
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.pace import Pace, pace_in
from hallsym.log.table import TIME, Source, load
from hallsym.log.text.cells import is_unit_row
from hallsym.units import UNITS, Array

Opened = Callable[[], AbstractContextManager[Any]]
"""Opens the file that vectors are read from."""


class Stored(NamedTuple):
    """An array in a file, with named fields perhaps: its shape and type, unit and pace that the file states.

    `find` takes the opened file and a field, "" without one, and returns what indices of numpy read. `fault`:
    why it cannot be used. `texts`: lists of words that stand with it, as names of columns of a matrix do.
    `unpacked`: makes values of what is stored, where the file states a scale.
    """

    shape: tuple[int, ...]
    dtype: Any
    find: Callable[[Any, str], Any]
    unit: str | None = None
    pace: Pace | None = None
    fault: str = ""
    texts: tuple[tuple[str, ...], ...] = ()
    unpacked: Callable[[Array], Array] | None = None


class Vector(NamedTuple):
    """A column of numbers: its length, what reads samples from one on to before another, unit and pace.

    `moments`: whether they are moments [ns since 1970].
    """

    rows: int
    read: Callable[[Any, int, int], Array]
    unit: str | None
    pace: Pace | None = None
    moments: bool = False


class Vectors(Source):
    """Vectors of one length, by name with their units, that `read` takes from a file while it is `opened`."""

    def __init__(
        self,
        units: Mapping[str, str | None],
        rows: int,
        read: Callable[[Any, Sequence[str], int, int], Sequence[Array]],
        opened: Opened = nullcontext,
    ) -> None:
        """Take the names. `read` returns samples from one on to before another, asked for in their order.

        `TIME` may be one of the names, of a time that the format gives.
        """
        self.call(stems_of([*units], [*units.values()]))
        self.own = dict(zip(self.names, units, strict=True))
        self.rows, self.take, self.opened = rows, read, opened

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most `size` rows."""
        with self.opened() as file:
            for lo in range(0, self.rows, size):
                hi = min(lo + size, self.rows)
                part = dict(zip(names, self.take(file, [self.own[n] for n in names], lo, hi), strict=True))
                if short := next((name for name, values in part.items() if len(values) < hi - lo), None):
                    stored = lo + len(part[short])
                    raise ValueError(f"channel '{short}' has {stored} of its {self.rows} values")
                yield part


def columns_of(path: str, array: Stored, field: str, by: str) -> tuple[dict[str, Vector], str]:
    """Return the columns of a field of an array by path, or why there are none ("": it is none of numbers).

    A matrix becomes a column for each of its rows or columns, whichever are fewer, by the names that stand
    with it or `name_0` to `name_k`; a row or column matrix, MATLAB's vector, is one.
    """
    shape, kind = array.shape, (array.dtype[field] if field else array.dtype).kind
    sizes = [n for n in shape if n != 1] or [1]
    if kind not in "fiubM" or (kind == "b" and not shape):
        return {}, ""
    if kind == "b":
        return {}, "it holds booleans, not numbers"
    if len(sizes) > 2 or (len(sizes) == 2 and (min(sizes) > MOST_COLUMNS or len(shape) > 2)):
        return {}, f"it is an array of {' x '.join(map(str, shape))}"
    if array.fault:
        return {}, array.fault
    axis = int(np.argmax(shape)) if shape else -1

    def column(k: int, unit: str | None) -> Vector:
        def read(file: Any, lo: int, hi: int) -> Array:
            index = tuple(slice(lo, hi) if n == axis else k for n in range(len(shape)))
            found = np.atleast_1d(array.find(file, field)[index if len(index) != 1 else index[0]])
            found = array.unpacked(found) if array.unpacked else found
            return found.astype("M8[ns]").astype(np.int64) if kind == "M" else found

        return Vector(max(sizes), read, unit, array.pace, kind == "M")

    if len(sizes) == 1:
        return {path: column(0, array.unit)}, ""
    stem, own = split_header(path)
    last = path.rpartition("_")[2]
    if own is None and last in UNITS and (len(last) > 1 or last in "msv"):
        stem, own = path.rpartition("_")[0], last
    count, names, units = range(min(sizes)), list[str](), [array.unit or own] * min(sizes)
    before = path[: len(path) - len(path.split(by)[-1])]
    for words in (list(texts) for texts in array.texts if len(texts) == len(count)):
        if is_unit_row(words):
            units = [unit_of(word) for word in words]
        elif len(set(words)) == len(words):
            names = names or [before + word for word in words]
    return {name: column(k, units[k]) for k, name in enumerate(names or [f"{stem}_{k}" for k in count])}, ""


def words_of(values: Any) -> tuple[str, ...]:
    """Return a list of words as text; () of anything else."""
    found = np.asarray(values)
    texts = [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in found.ravel().tolist()]
    return tuple(texts) if texts and all(isinstance(text, str) for text in texts) else ()


def _called(
    vectors: Mapping[str, Vector], arrays: Mapping[str, Stored], by: str, opened: Opened
) -> dict[str, Vector]:
    """Return vectors that lie alone in a group beside their name and unit as words, by that name.

    So are those of one stem a group: `block1_values` is called as `block1_items` says.
    """
    said, lengths = defaultdict[str, dict[str, str]](dict), defaultdict[str, list[int]](list)
    with opened() as file:
        for path, array in arrays.items():
            if math.prod(array.shape) == 1 and array.dtype.kind in "SUO":
                for group, _, key in (path.rpartition(by), path.rpartition("_")):
                    said[group][key.lower()] = "".join(words_of(array.find(file, "")[()]))
    for path, vector in vectors.items():
        lengths[path.rpartition(by)[0]].append(vector.rows)
    found = dict[str, Vector]()
    for path, vector in vectors.items():
        group, rows = path.rpartition(by)[0], vector.rows
        alone = rows == max(lengths[group]) > 1 == lengths[group].count(rows)
        known = said[group] if alone else said[path.rpartition("_")[0]]
        name = next((known[key] for key in ("label", "name", "items") if known.get(key)), "")
        if known:
            above = group.rpartition(by)[0] if alone else group
            path = by.join(filter(None, (above, name))) if name else path
            vector = vector._replace(unit=vector.unit or unit_in(known))
        found[path] = vector
    return found


def unit_in(attributes: Mapping[Any, object]) -> str | None:
    """Return the unit that the attributes of a vector state."""
    for fact in attributes.items():
        key, text = (v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in fact)
        if re.fullmatch("(NI_)?unit(s|_string|Description)?", key, re.IGNORECASE):
            return unit_of(text)
    return None


def unpacked_by(attributes: Mapping[str, Any]) -> Callable[[Array], Array] | None:
    """Return what makes values of stored numbers by the attributes of CF (section 8.1), None without them."""
    scale, offset = (np.ravel(attributes.get(k, x))[0] for k, x in (("scale_factor", 1), ("add_offset", 0)))
    lost = np.ravel(attributes.get("_FillValue", np.nan))[0]
    if (scale, offset) == (1, 0):
        return None
    return lambda stored: np.where(stored == lost, np.nan, stored * float(scale) + float(offset))


def runs_of(paths: Sequence[Sequence[str]]) -> int:
    """Return how many parts of each path name its run; 0 where groups are no runs.

    Groups of the same vectors whose names end in a number are runs, whatever groups they hold themselves.
    """
    for depth in range(1, min(map(len, paths), default=0)):
        runs: dict[tuple[str, ...], set[tuple[str, ...]]] = {}
        for path in paths:
            runs.setdefault(tuple(path[:depth]), set()).add(tuple(path[depth:]))
        numbered = all(re.search(r"\d$", run[-1]) for run in runs)
        if numbered and len(runs) > 1 and len(set(map(frozenset, runs.values()))) == 1:
            return depth
    return 0


def _moments(texts: Sequence[str], form: str) -> Stored:
    """Return times that stand in a file as text of a form (`time_form`)."""
    seconds = Seconds(form, "A column of times")
    from_first = seconds(load("pyarrow").array(texts))
    found = (np.round(from_first * 1e9).astype(np.int64) + (seconds.moment or 0)).astype("M8[ns]")
    return Stored(found.shape, found.dtype, lambda file, field: found)


def _by_run(path: str, array: Stored, by: str) -> Iterator[tuple[str, Stored]]:
    """Yield the matrix of each run of an array of runs, whose longest axis is that of samples."""
    shape = array.shape
    runs = len(shape) == 3 and max(shape) > shape[0] > 1 and min(shape[1:]) <= MOST_COLUMNS
    if not runs or array.dtype.kind not in "fiu":
        yield path, array
        return
    for k in range(shape[0]):
        find = partial(lambda k, file, field: array.find(file, field)[k], k)
        yield by.join((path, f"run{k}", path.split(by)[-1])), array._replace(shape=shape[1:], find=find)


def arranged(
    where: str,
    kind: str,
    arrays: Mapping[str, Stored],
    left_out: Mapping[str, str],
    by: str,
    clock: str | None,
    opened: Opened = nullcontext,
) -> Source:
    """Return the table of arrays by path; `by` stands between the parts of a path."""
    vectors, left_out = dict[str, Vector](), dict(left_out)
    arrays = {under: one for path, array in arrays.items() for under, one in _by_run(path, array, by)}
    matrices = {p.split(by)[-1]: a for p, a in arrays.items() if a.dtype.kind in "fiu" and len(a.shape) == 2}
    widths = [min(matrix.shape) for matrix in matrices.values()]  # once where each run has it
    with opened() as file:
        words = {p: words_of(a.find(file, "")[()]) for p, a in arrays.items() if a.dtype.kind in "SUO"}
    texts = [own for own in words.values() if 1 < len(own) <= MOST_COLUMNS]
    arrays |= {path: _moments(own, form) for path, own in words.items() if (form := time_form(own))}
    arrays = {
        path: array._replace(texts=(*array.texts, *(t for t in texts if widths.count(len(t)) == 1)))
        for path, array in arrays.items()
    }
    for path, array in arrays.items():
        for field in array.dtype.names or ("",):
            columns, why = columns_of(f"{path}{by}{field}" if field else path, array, field, by)
            vectors |= columns
            left_out |= {path.rpartition(by)[2]: why} if why else {}
    vectors = _called(vectors, arrays, by, opened)
    with opened() as file:
        scalars = {p: v.read(file, 0, 1)[0] for p, v in vectors.items() if v.rows == 1 and not v.moments}
    runs = runs_of([path.split(by) for path in vectors])
    paths: dict[str, dict[str, Vector]] = {}
    for path, vector in vectors.items():
        parts = path.split(by)
        at = runs or len(parts) - 1
        paths.setdefault(by.join(parts[:at]), {})[by.join(parts[at:])] = vector
    found = []
    for group, own in paths.items():
        above = {path.rpartition(by): value for path, value in scalars.items()}
        mine = {p[2]: v for p, v in above.items() if not runs or f"{group}{by}".startswith(p[0] + p[1])}
        stated = pace_in(mine)
        if runs and max(vector.rows for vector in own.values()) > 1:  # one is a setting of the run, no sample
            left_out |= {name: "it holds one value" for name, vector in own.items() if vector.rows == 1}
            own = {name: vector for name, vector in own.items() if vector.rows > 1}
        clocks = defaultdict[tuple[int, Pace | None], dict[str, Vector]](dict)
        for name, vector in own.items():
            clocks[vector.rows, vector.pace or stated][name] = vector
        if runs and len({pace for _, pace in clocks}) < len(clocks):
            raise InputError(
                f"Columns of group '{group}' of {where} must be equally long; they have"
                f" {' and '.join(map(str, sorted(rows for rows, _ in clocks)))} values: the recording of this"
                " run broke off."
            )
        for (rows, pace), members in clocks.items():
            several = pace and sum(count > 1 for count, _ in clocks) > 1
            name = by.join(filter(None, (group, next(iter(members))))) if several else group
            found.append(Group(name, _timed(members, rows, pace, opened)))
    return GroupedSource(where, kind, found, left_out, clock, by=by)


def _timed(own: Mapping[str, Vector], rows: int, pace: Pace | None, opened: Opened) -> Vectors:
    """Return vectors of one length, moments in seconds from the first; the only one of these is the time."""
    moments = [name for name, vector in own.items() if vector.moments]
    if len(moments) == 1:
        own = {TIME if vector.moments else name: vector for name, vector in own.items()}
    first = dict[str, int]()
    if moments:
        with opened() as file:
            first = {name: int(v.read(file, 0, 1)[0]) for name, v in own.items() if v.moments}

    def read(file: Any, names: Sequence[str], lo: int, hi: int) -> list[Array]:
        parts = {name: own[name].read(file, lo, hi) for name in names}
        return [(part - first[name]) * 1e-9 if name in first else part for name, part in parts.items()]

    source = Vectors({n: "s" if n in first else vector.unit for n, vector in own.items()}, rows, read, opened)
    source.pace = pace
    source.clocks = {name: Pace(0.0, 0.0, at) for name, at in first.items() if name == TIME}
    return source
