"""Text: aligned tables, values with their uncertainty, columns with their unit."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from textwrap import fill, wrap

import numpy as np

from hallsym.output import columns, printable
from hallsym.report.words import name, number
from hallsym.units import parameter_unit, readable

LEAST_WORDS = 20
"""Characters that a column of words needs beside others; where there are fewer, it stands below the table."""
GAP = 2


def grid(rows: Sequence[Sequence[str]], *, left: int = 1, rule_after: int = 1, words: bool = False) -> str:
    """Return rows as aligned text: the first `left` columns left-aligned, a rule after the header.

    `words`: the last column is prose, outside the rule. A table that is wider than the terminal has folded
    headers, then folded words or words below it, then its columns in blocks, one below the other.
    """
    shown = [[printable(cell) for cell in row] for row in rows]
    table, limit = _Table(shown, left, rule_after, words), columns()
    fits = limit is None or _width(table.natural) <= limit
    return "\n".join(table.drawn(table.natural) if fits else table.lines(limit or 0))


@dataclass(frozen=True)
class _Table:
    """Cells of a table; `head` rows are its header."""

    rows: Sequence[Sequence[str]]
    left: int
    head: int
    words: bool

    @property
    def natural(self) -> list[int]:
        """The width of each column where it does not matter."""
        return [max(map(len, column)) for column in zip(*self.rows, strict=True)]

    def lines(self, limit: int) -> list[str]:
        """Return the lines of the table in a width that is less than its own."""
        if not self.words:
            widths = self._widths(limit)
            return self.drawn(widths) if widths else self._blocks(limit)
        numbers = _Table([row[:-1] for row in self.rows], self.left, self.head, False)
        widths = numbers._widths(limit - LEAST_WORDS - GAP)
        if widths:
            return self.drawn([*widths, limit - sum(widths) - GAP * len(widths)])
        named = (" ".join([*row[: self.left], row[-1]]) for row in self.rows)
        return [*numbers.lines(limit), "", *(fill(line, limit) for line in named)]

    def _widths(self, limit: int) -> list[int] | None:
        """Return widths of the columns that fit, headers folded, and names where they must be; else None."""
        natural = self.natural
        widths = [self._narrowest(k) for k in range(len(natural))]
        room = limit - _width(widths)
        if room < 0:
            return None
        for k, wanted in enumerate(natural):
            more = min(wanted - widths[k], room)
            widths[k], room = widths[k] + more, room - more
        return widths

    def _narrowest(self, k: int) -> int:
        """Return the least width of a column: words of its header may stand in lines of their own."""
        folded = self.rows if k < self.left else self.rows[: self.head]
        words = [word for row in folded for word in row[k].split()]
        return max(map(len, [*words, *(row[k] for row in self.rows[len(folded) :]), ""]))

    def drawn(self, widths: Sequence[int]) -> list[str]:
        """Return the lines of the table whose columns have these widths."""
        lines = []
        for k, row in enumerate(self.rows):
            if k == self.head:
                lines.append("-" * _width(widths[:-1] if self.words else widths))
            cells = [_fold(cell, width) for cell, width in zip(row, widths, strict=True)]
            for parts in zip_longest(*cells, fillvalue=""):
                lines.append((" " * GAP).join(map(self._aligned, range(len(row)), parts, widths)).rstrip())
        return lines

    def _aligned(self, k: int, cell: str, width: int) -> str:
        prose = self.words and k == len(self.rows[0]) - 1
        return cell.ljust(width) if k < self.left or prose else cell.rjust(width)

    def _blocks(self, limit: int) -> list[str]:
        """Return the columns in blocks, each begun by the first ones, which name the rows."""
        count = len(self.rows[0])
        left = self.left if self.left < count else 1  # all of them: the first one names the rows
        narrow, groups = [self._narrowest(k) for k in range(count)], [[*range(left)]]
        for k in range(left, count):
            if len(groups[-1]) > left and _width([narrow[j] for j in (*groups[-1], k)]) > limit:
                groups.append([*range(left)])
            groups[-1].append(k)
        lines: list[str] = []
        for group in groups:
            block = [[row[j] for j in group] for row in self.rows]
            part = _Table(block, left if left == self.left else len(group), self.head, False)
            narrowest = [part._narrowest(j) for j in range(len(group))]
            lines += ["", *part.drawn(part._widths(limit) or narrowest)]
        return lines[1:]


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


def in_units(value: float, std: float | None, si: str) -> tuple[str, str]:
    """Return value and 1 sigma of a parameter or a combination as `concise` does, and their unit."""
    factor, unit = parameter_unit(si)
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
