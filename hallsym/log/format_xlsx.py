"""Tables of a workbook (.xlsx, .xls, .ods), through python-calamine (an extra)."""

from __future__ import annotations

import io
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, nearest, quoted
from hallsym.log.format_csv import CsvSource
from hallsym.log.table import Source, load


def open_workbook(path: Path, sheet: str | None = None, decimal: str | None = None) -> Source:
    """Open one sheet of a workbook: the one that holds cells, or the one that is named.

    Its cells are a table as one of text is, with one row a line: lines above it, a row of units and words
    below it are recognised in the same way.
    """
    book = load("python_calamine").CalamineWorkbook.from_path(str(path))
    filled = {name: rows for name in book.sheet_names if (rows := _rows(book, name))}
    if sheet is not None and sheet not in filled:
        raise InputError(
            f"{quoted(path)} has no sheet '{sheet}' with cells{nearest(sheet, list(filled))}; it has "
            f"{', '.join(filled) or 'none'}."
        )
    if not filled:
        raise InputError(
            f"{quoted(path)} is empty: it must hold a row of column names and one row per sample."
        )
    if sheet is None and len(filled) > 1:
        raise InputError(
            f"{quoted(path)} has {len(filled)} sheets with cells ({', '.join(filled)}): say which one holds"
            f" the log with --sheet {quoted(next(iter(filled)))} (in Python sheet=...)."
        )
    chosen = sheet or next(iter(filled))
    text = "\n".join("\t".join(map(_text, row)) for row in filled[chosen]) + "\n"
    data = text.encode()
    return CsvSource(path, "\t", decimal, lambda: io.BytesIO(data), chosen)


def _rows(book: Any, name: str) -> list[list[Any]]:
    rows: Iterator[list[Any]] = book.get_sheet_by_name(name).iter_rows()
    found = list(rows)
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
