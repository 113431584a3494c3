"""Files that hold several tables: sheets, tables of a database, files of an archive."""

from __future__ import annotations

import sqlite3
import tempfile
import zipfile
from collections import defaultdict
from collections.abc import Mapping
from contextlib import closing
from functools import lru_cache
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, few, nearest, quoted
from hallsym.log.arrow import source_of
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import Source, load
from hallsym.log.text.cells import is_number


def one_of(where: str, kind: str, tables: Mapping[str, Source], chosen: str | None = None) -> Source:
    """Return the table that is `chosen`, the only one with numbers, or those of the same columns as runs.

    `kind`: what a table is called, "sheet". Raises `InputError` where one has to be chosen.
    """
    if chosen is not None:
        if chosen not in tables:
            raise InputError(
                f"{where} has no {kind} '{chosen}' with cells{nearest(chosen, list(tables))}; it has "
                f"{', '.join(tables) or 'none'}."
            )
        return tables[chosen]
    filled = {
        name: source
        for name, source in tables.items()
        if np.mean([is_number(cell) for row in source.head(_FEW, 100) for cell in row] or [False]) > 0.5
    } or tables
    if not filled:
        raise InputError(f"{where} is empty: it must hold a row of column names and one row per sample.")
    same = defaultdict[frozenset[str], list[str]](list)
    for name, source in filled.items():
        same[frozenset(source.names)].append(name)
    runs = max(same.values(), key=lambda own: (len(own), len(tables[own[0]].names)))
    if len(runs) == 1 < len(filled):
        raise InputError(
            f"{where} has {len(filled)} {kind}s with cells ({few(list(filled), 20)}): say which one holds "
            f"the log with --sheet {quoted(runs[0])}."
        )
    found = filled[runs[0]]
    if len(runs) > 1:
        groups = [Group(name, filled[name]) for name in runs]
        found = GroupedSource(where, f"{kind}s", groups, {}, None, files=True)
    others = [name for name in tables if name not in runs]
    left = (f"Of {where} {kind} {few(others, 20)} is not read.",) if others else ()
    found.notes = (*found.notes, *left)
    return found


_FEW = 5
"""Rows that are looked at for numbers, which most cells of a log are."""


def open_sqlite(path: Path, sheet: str | None = None) -> Source:
    """Open the tables of an SQLite database, as sheets of a workbook are."""
    arrow = load("pyarrow")
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as base:
        asked = "select name from sqlite_master where type in ('table', 'view') and name not like 'sqlite_%'"
        found = {}
        for (name,) in base.execute(asked).fetchall():
            own = name.replace('"', '""')
            rows = base.execute(f'select * from "{own}"')
            names = [column[0] for column in rows.description]
            values = zip(*rows.fetchall(), strict=True)
            columns = dict(zip(names, map(list, values), strict=False))
            if columns:
                found[name] = source_of(arrow.table(columns), quoted(path))
    return one_of(quoted(path), "table", found, sheet)


# -- an archive --------------------------------------------------------------------------------------------

MOST_BYTES = 10_000_000_000
"""Largest content of an archive; the user unpacks a larger one."""


@lru_cache(maxsize=16)
def unpacked(path: Path, suffixes: tuple[str, ...], written: int) -> Path:
    """Return a folder, which ends with the process, of the files of a zip archive that have a suffix.

    `written`: when the archive was; another time is another archive.
    """
    with zipfile.ZipFile(path) as archive:
        members = [
            member for member in archive.infolist()
            if Path(member.filename).suffix.lower() in suffixes and Path(member.filename).name[0] != "."
        ]  # fmt: skip
        size = sum(member.file_size for member in members)
        if not members:
            raise InputError(f"Archive {quoted(path)} must hold a log or files that are runs; it holds none.")
        if size > MOST_BYTES:
            raise InputError(f"Archive {quoted(path)} holds {size / 1e9:.0f} GB; unpack it first.")
        unpacked = tempfile.TemporaryDirectory(prefix="hallsym-")
        _UNPACKED.append(unpacked)
        folder = Path(unpacked.name) / path.name
        archive.extractall(folder, members)  # which lets no name lead outside the folder
    while len(inside := [*folder.iterdir()]) == 1 and inside[0].is_dir():
        folder = inside[0]
    return folder


_UNPACKED: list[tempfile.TemporaryDirectory[str]] = []
