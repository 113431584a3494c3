"""Vectors by their path in a file of groups or structs: which are one table, runs, or on other clocks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import RUN_WORDS, TIME_WORDS
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import Arrays, Source
from hallsym.log.text.cells import split_header, unit_of
from hallsym.units import UNITS, Array

MOST_COLUMNS = 100
"""Columns that a matrix is taken for at most: a wider one is a picture or a map."""


Opened = Callable[[], AbstractContextManager[Any]]
"""Opens the file that vectors are read from."""


@dataclass(frozen=True)
class Vector:
    """A column of numbers: its length, what reads samples from one on to before another, and its unit."""

    rows: int
    read: Callable[[Any, int, int], Array]
    unit: str | None = None


class Vectors(Source):
    """Vectors of one length, which are read while `opened`."""

    def __init__(self, vectors: Mapping[str, Vector], opened: Opened = nullcontext) -> None:
        self.vectors, self.names, self.opened = dict(vectors), tuple(vectors), opened
        self.rows = next(iter(vectors.values())).rows
        self.units = {name: vector.unit for name, vector in vectors.items() if vector.unit}

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of at most `size` rows."""
        with self.opened() as file:
            for lo in range(0, self.rows, size):
                yield {name: self.vectors[name].read(file, lo, min(lo + size, self.rows)) for name in names}


def columns_of(
    path: str, shape: Sequence[int], kind: str, read: Callable[..., Array], unit: str | None = None
) -> tuple[dict[str, Vector], str]:
    """Return the columns of an array by path, or why there are none ("" for what is no array of numbers).

    `read` takes the opened file and an index of numpy. A matrix becomes a column for each of its rows or
    columns, whichever are fewer, `name_0` to `name_k`; a row or column matrix, MATLAB's vector, is one.
    """
    sizes = [n for n in shape if n != 1] or [1]
    if kind not in "fiub" or (kind == "b" and not shape):
        return {}, ""
    if kind == "b":
        return {}, "it holds booleans, not numbers"
    if len(sizes) > 2 or (len(sizes) == 2 and (min(sizes) > MOST_COLUMNS or len(shape) > 2)):
        return {}, f"it is an array of {' x '.join(map(str, shape))}"
    axis = int(np.argmax(shape)) if shape else -1

    def column(k: int) -> Callable[[Any, int, int], Array]:
        def values(file: Any, lo: int, hi: int) -> Array:
            index = tuple(slice(lo, hi) if n == axis else k for n in range(len(shape)))
            return np.atleast_1d(read(file, index))

        return values

    if len(sizes) == 1:
        return {path: Vector(sizes[0], column(0), unit)}, ""
    stem, own = split_header(path)
    last = path.rpartition("_")[2]
    if own is None and last in UNITS and (len(last) > 1 or last in "msv"):
        stem, own = path.rpartition("_")[0], last
    return {f"{stem}_{k}": Vector(max(sizes), column(k), unit or own) for k in range(min(sizes))}, ""


def unit_in(attributes: Mapping[str, object]) -> str | None:
    """Return the unit that the attributes of a vector state."""
    for key, value in attributes.items():
        if re.fullmatch("units?", key, re.IGNORECASE):
            text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
            return unit_of(text)
    return None


_OF_RUN = re.compile(
    rf"(?:^|[_ ./-])(?:(?:{'|'.join(RUN_WORDS)})[_ .#-]?|#)(\d+)(?=$|[_ ./-])", re.IGNORECASE
)


def side_by_side(source: Source, where: str) -> Source:
    """Return the runs of a table with columns for each run (`hall_a_run0`, `hall_a_run1`) one after another.

    Numbers without the word (`Hall A #1`) are those of runs where each has a time. Any other table, and one
    of which most columns are of no run, is returned as it is. Columns without a run belong to all of them;
    the empty cells that end the columns of a shorter run are left out.
    """
    runs: dict[int, dict[str, str]] = {}
    for name in source.names:
        if match := _OF_RUN.search(name):
            stem = name[: match.start()] + name[match.end() :]
            runs.setdefault(int(match[1]), {})[stem.lstrip("_ ./-")] = name
    of_runs = sum(map(len, runs.values()))
    if len(runs) < 2 or "" in next(iter(runs.values())) or 2 * of_runs <= len(source.names):
        return source
    stems = {stem for columns in runs.values() for stem in columns}
    marks = [m[0].strip("_ ./-") for name in source.names if (m := _OF_RUN.search(name))]
    timed = any(split_header(stem)[0].lower() in TIME_WORDS for stem in stems)
    if not timed and any(mark[0] == "#" for mark in marks):
        return source
    for run, columns in runs.items():
        if lacking := sorted(stems - set(columns)):
            raise InputError(f"Run {run} of {where} must have a column for {lacking[0]} as the others have.")
    left_out, shared = dict(source.left_out), dict[str, Array]()
    for name in source.names:
        if not _OF_RUN.search(name):
            try:
                shared |= source.read([name])
            except InputError:
                left_out[name] = "it holds no numbers"
    data = source.read([name for columns in runs.values() for name in columns.values()])
    groups = []
    for run, columns in runs.items():
        filled = np.any([np.isfinite(data[name]) for name in columns.values()], axis=0)
        rows = int(np.flatnonzero(filled)[-1]) + 1 if filled.any() else 0
        part = Arrays(
            {s: v[:rows] for s, v in {**shared, **{s: data[n] for s, n in columns.items()}}.items()}
        )
        units = {**{name: name for name in shared}, **columns}
        part.units = {stem: source.units[name] for stem, name in units.items() if name in source.units}
        groups.append(Group(f"run{run}", part))
    found = GroupedSource(where, "runs side by side", groups, left_out, None, files=True)
    found.notes = (*source.notes, *found.notes)
    return found


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


def arranged(
    where: str,
    kind: str,
    vectors: Mapping[str, Vector],
    left_out: Mapping[str, str],
    by: str,
    clock: str | None,
    opened: Opened = nullcontext,
) -> Source:
    """Return the table of vectors by path; `by` stands between the parts of a path."""
    runs = runs_of([path.split(by) for path in vectors])
    paths: dict[str, dict[str, Vector]] = {}
    for path, vector in vectors.items():
        parts = path.split(by)
        at = runs or len(parts) - 1
        paths.setdefault(by.join(parts[:at]), {})[by.join(parts[at:])] = vector
    found = []
    for group, own in paths.items():
        sizes = list(dict.fromkeys(vector.rows for vector in own.values()))
        if len(sizes) > 1 and runs:
            raise InputError(
                f"Columns of group '{group}' of {where} must be equally long; they have"
                f" {' and '.join(map(str, sorted(sizes)))} values: the recording of this run broke off."
            )
        for rows in sizes:
            members = {name: vector for name, vector in own.items() if vector.rows == rows}
            found.append(Group(group, Vectors(members, opened)))
    return GroupedSource(where, kind, found, left_out, clock, by=by)
