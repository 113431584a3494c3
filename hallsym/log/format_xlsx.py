"""Tables of a workbook (.xlsx, .xls, .ods), through python-calamine (an extra)."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, quoted
from hallsym.log.containers import one_of
from hallsym.log.format_csv import CsvSource
from hallsym.log.table import Source, load


def open_workbook(path: Path, sheet: str | None = None, decimal: str | None = None) -> Source:
    """Open one sheet of a workbook, or several as runs (`one_of`).

    Cells are a table as one of text is, with one row a line: lines above it, a row of units and words
    below it are recognised in the same way.
    """
    book = load("python_calamine").CalamineWorkbook.from_path(str(path))
    filled = {name: rows for name in book.sheet_names if (rows := _rows(book, name))}
    tables: dict[str, Source] = {}
    for name, rows in filled.items():
        text = "\n".join("\t".join(map(_text, row)) for row in rows) + "\n"
        try:
            tables[name] = CsvSource(path, "\t", decimal, text.encode(), name)
        except InputError:  # a sheet of remarks, unless it is the one
            if name == sheet or len(filled) == 1:
                raise
    return one_of(quoted(path), "sheet", tables, sheet)


def _rows(book: Any, name: str) -> list[list[Any]]:
    sheet = book.get_sheet_by_name(name)
    found: list[list[Any]] = list(sheet.iter_rows())
    for (top, left), (bottom, right) in sheet.merged_cell_ranges or ():
        for row in found[top : bottom + 1]:  # a run's number beside its rows, a word above its columns
            row[left : right + 1] = [found[top][left]] * len(row[left : right + 1])
    return found if any(cell != "" for row in found for cell in row) else []


def _text(cell: Any) -> str:
    """Return a cell as text that reads back to the same bits."""
    if isinstance(cell, bool):
        return str(cell)
    if isinstance(cell, float):
        return repr(int(cell)) if cell.is_integer() and abs(cell) < 2**53 else repr(cell)
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    return " ".join(str(cell).split())
