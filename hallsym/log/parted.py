"""One table that holds several: runs or clocks side by side, channels in their own rows, a row per value."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import (
    RUN,
    RUN_WORDS,
    WORDS,
    T,
    is_run_word,
    is_time_word,
    split_header,
    stems_of,
    unit_of,
)
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.pace import Paced
from hallsym.log.table import Arrays, Source
from hallsym.log.text.cells import MISSING, POINT, as_float, is_number, is_unit_row
from hallsym.units import UNITS, Array, split_unit

_FEW = 50
"""Rows that show which columns hold words, and which are filled in the same ones."""
Parts = Mapping[str, Mapping[str, tuple[str, Array]]]
"""By the name of a part its columns: by their name there the source's own, and its samples."""


def _parted(
    source: Source, where: str, kind: str, parts: Parts, left_out: Mapping[str, str] | None = None
) -> Source:
    """Return the parts of a table as files are read: as runs, on one clock, or at the samples of another."""
    groups = []
    for name, columns in parts.items():
        part = Arrays({own: values for own, (_, values) in columns.items()})
        part.units = {own: source.units[n] for own, (n, _) in columns.items() if n in source.units}
        part.pace = source.pace
        groups.append(Group(name, part))
    found = GroupedSource(where, kind, groups, left_out or source.left_out, None, files=True)
    found.notes = (*source.notes, *found.notes)
    return found


def _is_clock(source: Source, name: str) -> bool:
    """Say whether a column is a time by its unit or by its name."""
    stem, unit = split_unit(split_header(name)[0])
    stated = UNITS[source.units[name]] if name in source.units else unit
    return stated.si == "s" if stated else is_time_word(stem)


def paced(source: Source, where: str) -> Source:
    """Return a table that states its sample interval with the times of samples, where it has no others."""
    head = _head(source) if source.pace else {}
    clocks = [name for name in source.names if _is_clock(source, name)]
    if not head or any(cell not in MISSING for name in clocks for cell in head[name]):
        return source
    return Paced(source, source.pace, T, without=clocks)


_STAMP = re.compile(r"(.*?)[\W_]*?(?:(s|secs?|seconds?)|(n(?:ano)?s(?:ecs?|econds?)?))", re.I)
"""A part of a stamp of ROS: `header.stamp.sec`, `header.stamp.nanosec`."""


def stamped(source: Source, where: str) -> Source:
    """Return a table with one time for the two columns of a stamp, seconds and nanoseconds."""
    found = defaultdict[str, dict[bool, str]](dict)
    for match in filter(None, map(_STAMP.fullmatch, source.names)):
        found[match[1]][bool(match[3])] = match[0]
    stems = [stem for stem, parts in found.items() if len(parts) == 2]
    data = source.numbers() if len(stems) == 1 else {}
    if not data or not {*(parts := found[stems[0]]).values()} <= {*data}:
        return source
    seconds, rest = (data.pop(parts[k]) for k in (False, True))
    time = seconds - seconds[0] + 1e-9 * rest  # the digits are for what follows the first sample
    source.units = {**source.units, parts[False]: "s"}
    columns = {stems[0] or T: (parts[False], time)} | {name: (name, x) for name, x in data.items()}
    words = {name: "it holds words" for name in source.names if name not in (*data, *parts.values())}
    return _parted(source, where, "text", {"": columns}, {**source.left_out, **words})


_OF_RUN = re.compile(
    rf"(?:^|[_ ./-])(?:(?:{'|'.join(RUN_WORDS)})[_ .#-]?|#)(\d+)(?=$|[_ ./-])", re.IGNORECASE
)


def side_by_side(source: Source, where: str) -> Source:
    """Return the runs of a table with columns for each run (`hall_a_run0`, `hall_a_run1`) one after another.

    Numbers without the word (`Hall A #1`) are those of runs where each has a time. Any other table, and one
    of which most columns are of no run, is returned as it is. Columns without a run belong to all of them;
    the empty cells that end the columns of a shorter run are left out.
    """
    marked = {name: match for name in source.names if (match := _OF_RUN.search(name))}
    runs: dict[int, dict[str, str]] = {}
    for name, match in marked.items():
        stem = name[: match.start()] + name[match.end() :]
        runs.setdefault(int(match[1]), {})[stem.lstrip("_ ./-")] = name
    stems = {stem for columns in runs.values() for stem in columns}
    if len(runs) < 2 or "" in stems or 2 * len(marked) <= len(source.names):
        return source
    timed = any(is_time_word(split_header(stem)[0]) for stem in stems)
    if not timed and any(match[0].strip("_ ./-")[0] == "#" for match in marked.values()):
        return source
    for run, columns in runs.items():
        if lacking := sorted(stems - set(columns)):
            raise InputError(f"Run {run} of {where} must have a column for {lacking[0]} as the others have.")
    others = [name for name in source.names if name not in marked]
    shared = source.numbers(others)
    left_out = {**source.left_out, **{n: "it holds no numbers" for n in others if n not in shared}}
    data = {**shared, **source.read([*marked])}
    parts = {}
    for run, columns in runs.items():
        filled = np.any([np.isfinite(data[name]) for name in columns.values()], axis=0)
        rows = int(np.flatnonzero(filled)[-1]) + 1 if filled.any() else 0
        own = {**{name: name for name in shared}, **columns}
        parts[f"run{run}"] = {stem: (name, data[name][:rows]) for stem, name in own.items()}
    return _parted(source, where, "runs side by side", parts, left_out)


_NUMBERED = re.compile(r"(.+) \d+")
"""A name that stands in the file more than once."""


def by_clock(source: Source, where: str) -> Source:
    """Return the blocks of a table that begin with a time of their own each: `t, Hall A, t, Laser X`.

    The times are columns that are such by their names, or of the name of the first column. Any other table,
    and one whose times do not rise, is returned as it is.
    """
    again = {name: match[1] for name in source.names if (match := _NUMBERED.fullmatch(name))}
    first = source.names[0] if source.names else ""
    called, same = _is_clock(source, first), again.get(first, first)
    clocks = [n for n in source.names if (_is_clock(source, n) if called else again.get(n, n) == same)]
    starts = [*map(source.names.index, clocks), len(source.names)]
    if len(clocks) < 2 or (np.diff(starts) < 2).any():
        return source
    data = source.numbers()
    filled = {name: np.flatnonzero(np.isfinite(data[name])) for name in clocks if name in data}
    rising = [len(at) > 0 and bool((np.diff(data[name][at]) > 0).all()) for name, at in filled.items()]
    if len(filled) < len(clocks) or not all(rising):
        return source
    if not set(clocks) <= {first, *again} and len({len(at) for at in filled.values()}) == 1:
        return source  # two clocks of one logger
    names = {name: again.get(name, name) if called or name not in clocks else T for name in source.names}
    parts = {}
    for k, (clock, (start, stop)) in enumerate(zip(clocks, pairwise(starts), strict=True), 1):
        rows = filled[clock][-1] + 1
        block = [n for n in source.names[start:stop] if n in data and np.isfinite(data[n][:rows]).any()]
        parts[f"block {k}"] = {names[name]: (name, data[name][:rows]) for name in block}
    return _parted(source, where, "blocks side by side", parts)


def _head(source: Source, count: int = _FEW) -> dict[str, tuple[str, ...]]:
    """Return the first cells of each column."""
    rows = [row for row in source.head(count, len(source.names)) if len(row) == len(source.names)]
    return dict(zip(source.names, zip(*rows, strict=True), strict=False))


def by_rows(source: Source, where: str) -> Source:
    """Return the channels of a table that are never filled in the same row, as a merged bus log has them.

    Columns that are filled in every row, time and run, belong to all. Any other table is returned as it is.
    """
    columns = {} if source.filled else _head(source)
    rows = {n: frozenset(k for k, c in enumerate(cells) if c not in MISSING) for n, cells in columns.items()}
    every = [name for name, filled in rows.items() if len(filled) == len(columns[name])]
    kinds = defaultdict[frozenset[int], list[str]](list)
    for name, filled in rows.items():
        if filled and name not in every:
            kinds[filled].append(name)
    separate = sum(map(len, kinds)) == len(frozenset().union(*kinds)) and all(len(kind) > 1 for kind in kinds)
    if len(kinds) < 2 or not separate or not any(_is_clock(source, name) for name in every):
        return source
    data = source.numbers()
    parts = {}
    if any(name not in data for names in kinds.values() for name in names):
        return source
    for names in kinds.values():
        mine = np.any([np.isfinite(data[name]) for name in names], axis=0)
        parts[names[0]] = {
            RUN if name in every and name.lower() in RUN_WORDS else name: (name, data[name][mine])
            for name in (*every, *names)
            if name in data
        }
    return _parted(source, where, "channels in rows of their own", parts)


MOST_NAMES = 40
"""Columns of a table with a row per value at most: time, run, name, value, what a device or database adds."""
LOOKED_AT = 1000
"""Rows that are looked at to see which columns vary."""
LABELS = re.compile("ch|chan|channel|kanal|sensor|probe|id|name|signal|variable|tag|address")
"""Words for a column that says whose the values are; whole numbers are names there."""
VALUES = re.compile("value|reading|wert|messwert|result|measurement")
"""Words for a column of values among other numbers."""


def by_signal(source: Source, where: str) -> Source:
    """Return the signals of a table with a row per value (time, name or channel, value) as columns.

    Columns that are the same throughout, or for each name, are left out; one of these may state units. Of
    several times that with most values is kept. Any other table is returned as it is: one with columns of
    names that do not go together, or of numbers beside time, run and a count of rows where none is called a
    value.
    """
    if not (2 if source.pace else 3) <= len(source.names) <= MOST_NAMES:
        return source
    words = {name: [w.lower() for w in WORDS.findall(split_header(name)[0])] for name in source.names}
    numeric = source.typed or all(any(map(is_number, cells)) for cells in _head(source).values())
    if numeric and not any(LABELS.fullmatch(word) for own in words.values() for word in own):
        return source  # without more rows: no column can be one of names
    head = _head(source, LOOKED_AT)
    kinds = {name: len(set(cells)) for name, cells in head.items()}
    stamps = sorted((n for n in head if kinds[n] > 1 and _is_clock(source, n)), key=lambda n: -kinds[n])
    texts = [n for n, cells in head.items() if n not in stamps and not any(map(is_number, cells))]
    runs = [n for n in head if is_run_word(n) and n not in (*texts, *stamps)][:1]
    others = [n for n in head if kinds[n] > 1 and n not in (*texts, *stamps, *runs)]
    free = [n for n in others if not (_steps(head[n]) == 1).all()]  # no number of the row
    said = [n for n in free if any(map(LABELS.fullmatch, words[n]))]
    names = [n for n in head if kinds[n] > 1 and n in (*texts, *said)]
    if not names and (len(free) == 1 or any(VALUES.fullmatch(word) for n in free for word in words[n])):
        whole = {n: tuple(source.labels(n)) for n in texts}  # one signal after the other
        kinds |= {n: len(set(cells)) for n, cells in whole.items()}
        names = [n for n in texts if kinds[n] > 1]
        head = {n: whole.get(n) or tuple(source.labels(n)) for n in head} if names else head
    if not names:
        return source
    stamps = stamps or [n for n in free if (_steps(head[n]) >= 0).all()][:1]
    of_units = next((n for n in texts if "unit" in n.lower() and is_unit_row([*{*head[n]}])), None)
    names = sorted((n for n in names if n != of_units), key=lambda n: (n not in texts, -kinds[n])) or names
    keys = names[:1]
    for n in names[1:]:  # device and axis: words that go with a name, or each of which has them all
        both = Counter(zip(*(head[key] for key in (*keys, n)), strict=True))
        varies = len(both) > _pairs(head, keys)
        if varies and max(both.values()) - min(both.values()) > 1:
            return source
        keys += [n] if varies or n in texts else []
    seen = _pairs(head, keys)
    varying = [n for n in head if _pairs(head, [*keys, n]) > seen]
    numbers = [n for n in varying if n in free and n not in (*keys, *stamps)]
    numbers = [n for n in numbers if len(numbers) == 1 or any(map(VALUES.fullmatch, words[n]))]
    numbers = [n for n in numbers if (_steps(head[n]) % 1 != 0).any()] or numbers  # beside raw values
    if len(numbers) != 1:
        return source
    named = zip(*(source.labels(n) for n in head if n in keys), strict=True)
    labels, (value,) = np.array([" ".join(filter(None, row)) for row in named]), numbers
    unit, signals = source.units.get(value) or split_unit(value)[1], list(dict.fromkeys(labels))
    one_quantity = unit and not (stamps and any(map(LABELS.fullmatch, words[keys[0]])))
    if not 2 <= len(signals) <= len(labels) / 2 or one_quantity:
        return source
    beside = {n: n if _is_clock(source, n) else T for n in stamps[:1]} | dict.fromkeys(runs, RUN)
    data, mine = source.read([*beside, value]), {label: labels == label for label in signals}
    times = [data[stamps[0]][own] for own in mine.values() if own.sum() > 1] if stamps else []
    if times and max(map(np.min, times)) > min(map(np.max, times)):
        return source  # devices one after the other
    cells = source.texts(of_units) if of_units and of_units not in varying else None
    units = {s: u for s, cell in zip(labels, cells or (), strict=False) if (u := unit_of(str(cell)))}
    called = [label if keys[0] in texts else f"{keys[0]} {label}" for label in signals]
    found = stems_of(called, [units.get(label, source.units.get(value)) for label in signals], where)
    parts = dict[str, dict[str, tuple[str, Array]]]()
    for (stem, (_, unit)), own in zip(found.items(), mine.values(), strict=True):
        parts[stem] = {stem: (stem, data[value][own]), **{k: (n, data[n][own]) for n, k in beside.items()}}
        source.units = {**source.units, **({stem: unit} if unit else {})}
    made = _parted(source, where, "a row per value", parts)
    made.aliases = {**made.aliases, **{n: own for n, own in beside.items() if n != own}}
    return made


def _pairs(head: Mapping[str, Sequence[str]], names: Sequence[str]) -> int:
    """Return how many different rows columns have together."""
    return len({*zip(*(head[n] for n in names), strict=True)})


def _steps(cells: Sequence[str]) -> Array:
    """Return the steps between a column's first numbers, nan beside other cells."""
    return np.diff(np.array([as_float(cell, POINT) for cell in cells], float))
