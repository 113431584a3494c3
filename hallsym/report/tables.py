"""Text: aligned tables, values with their uncertainty, columns with their unit."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import zip_longest
from textwrap import wrap
from typing import Any

import numpy as np

from hallsym.output import columns, printable
from hallsym.report.words import name, number
from hallsym.units import parameter_unit, readable

LEAST_WORDS = 20
"""Characters that a column of prose needs beside others."""
GAP = 2


def grid(rows: Sequence[Sequence[str]], *, left: int = 1, words: bool = False) -> str:
    """Return rows as aligned text: the first `left` columns left-aligned, a rule after the header.

    `words`: the last column is prose, outside the rule. In a table that is wider than the terminal headers,
    names and prose are folded; else prose stands below its row; else each row is a list of its cells.
    """
    shown = [[printable(cell) for cell in row] for row in rows]
    limit, below = columns(), shown
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    if limit is not None and _width(widths) > limit:
        found = _folded(shown, left, words, limit)
        if found is None and words:
            shown, words = [row[:-1] for row in shown], False
            found = _folded(shown, left, words, limit)
        if found is None:
            return "\n".join(_listed(below, min(left, len(below[0]) - 1), limit))
        widths = found
    lines = []
    for k, (row, whole) in enumerate(zip(shown, below, strict=True)):
        if k == 1:
            lines.append("-" * _width(widths[:-1] if words else widths))
        cells = [_fold(cell, width) for cell, width in zip(row, widths, strict=True)]
        for parts in zip_longest(*cells, fillvalue=""):
            padded = (
                part.ljust(width) if j < left or (words and j == len(row) - 1) else part.rjust(width)
                for j, (part, width) in enumerate(zip(parts, widths, strict=True))
            )
            lines.append((" " * GAP).join(padded).rstrip())
        lines += _below(whole[len(row) :], limit)
    return "\n".join(lines)


def _folded(rows: Sequence[Sequence[str]], left: int, words: bool, limit: int) -> list[int] | None:
    """Return widths of columns that fit, headers, names and prose folded; None where none do."""
    widths, last = [], len(rows[0]) - 1
    table = list(zip(*rows, strict=True))
    for k, column in enumerate(table):
        prose = words and k == last
        folded = column if prose or k < left else column[:1]
        parts = [word for cell in folded for word in cell.split()]
        least = max(map(len, [*parts, *column[len(folded) :]]), default=0)
        widths.append(min(least, LEAST_WORDS) if prose else least)
    room = limit - _width(widths)
    if room < 0:
        return None
    for k, column in enumerate(table):
        more = min(max(map(len, column)) - widths[k], room)
        widths[k], room = widths[k] + more, room - more
    return widths


def _listed(rows: Sequence[Sequence[str]], left: int, limit: int) -> Iterator[str]:
    """Yield each row as its name, and below it its cells with the headers of their columns."""
    head, *body = rows
    for row in body:
        yield from wrap("  ".join(filter(None, (*head[:left], *row[:left]))), limit)
        for title, cell in zip(head[left:], row[left:], strict=True):
            yield from _below([title, cell], limit) if cell or row is body[0] else ()


def _below(cells: Sequence[str], limit: int | None) -> list[str]:
    said = "  ".join(filter(None, cells))
    return wrap(said, limit or len(said) + GAP, initial_indent="  ", subsequent_indent="    ")


def _width(widths: Sequence[int]) -> int:
    return sum(widths) + GAP * (len(widths) - 1)


def _fold(cell: str, width: int) -> list[str]:
    return wrap(cell, width, break_on_hyphens=False) if len(cell) > width > 0 else [cell]


def concise(value: float, std: float | None) -> str:
    """Return value with its standard uncertainty in parentheses, on the last two digits: `0.86712(41)`."""
    if std is None or not np.isfinite(std) or std <= 0:
        return f"{value:.6g}"
    decimals = 1 - int(np.floor(np.log10(std)))
    if round(std, decimals) >= 10 ** (2 - decimals):  # .0999 rounds up to .10: two digits, not three
        decimals -= 1
    if decimals <= 0:
        return f"{value:.0f}({std:.0f})"
    return f"{value:.{decimals}f}({round(std * 10**decimals):d})"


def in_units(value: float, std: float | None, si: str, *, bare: bool = False) -> tuple[str, str]:
    """Return value and 1 sigma of a parameter or a combination as `concise` does, and their unit."""
    factor, unit = parameter_unit(si, bare=bare)
    return concise(value * factor, None if std is None else std * factor), unit


def heads(columns: Iterable[str], periodic: Collection[str] | None = None, what: str = "") -> list[str]:
    """Return `rmse Rz [urad]` for each column; `periodic` as in `hallsym.units.readable`."""
    shown = ((name(c), readable(c, periodic)[1]) for c in columns)
    return [f"{what} {called} [{unit}]".lstrip() for called, unit in shown]


def cells(
    values: Iterable[float], columns: Iterable[str], periodic: Collection[str] | None = None, digits: int = 3
) -> list[str]:
    """Return values [SI], one of each column, in the units of their `heads`; nothing for none."""
    pairs = zip(values, columns, strict=True)
    return [number(v * readable(c, periodic)[0], digits) for v, c in pairs]


def attributes(entries: Collection[Any], *names: str) -> dict[str, list[Any]]:
    """Return attributes of entries as columns in SI; that of an `interval` is `low_95` and `high_95`."""
    found = {name: [getattr(one, name) for one in entries] for name in names}
    for k, end in enumerate(("low_95", "high_95")) if "interval" in found else ():
        found[end] = [None if span is None else span[k] for span in found["interval"]]
    found.pop("interval", None)
    return found
