"""What every text is made of: aligned tables, values with their uncertainty, rows of errors."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from textwrap import fill, wrap

import numpy as np

from hallsym.terminal import columns
from hallsym.units import parameter_unit, readable

LEAST_WORDS = 20
"""Characters that a column of words needs beside others; where there are fewer, it stands below the table."""
GAP = 2


def grid(rows: Sequence[Sequence[str]], *, left: int = 1, rule_after: int = 1, words: bool = False) -> str:
    """Return rows as aligned text: the first `left` columns left-aligned, a rule after the header.

    `words`: the last column is prose, outside the rule. A table that is wider than the terminal has folded
    headers, then folded words or words below it, then its columns in blocks, one below the other.
    """
    table = _Table([list(row) for row in rows], left, rule_after, words)
    limit = columns()
    return "\n".join(table.lines(limit) if limit and sum(table.natural()) > limit else table.plain())


@dataclass(frozen=True)
class _Table:
    """Cells of a table; `head` rows are its header."""

    rows: list[list[str]]
    left: int
    head: int
    words: bool

    def natural(self) -> list[int]:
        """Return the width of each column with its gap; the last one needs none."""
        widths = [max(map(len, column)) for column in zip(*self.rows, strict=True)]
        return [w + GAP for w in widths[:-1]] + widths[-1:]

    def plain(self) -> list[str]:
        """Return the lines of the table where its width does not matter."""
        return self._drawn([w - GAP for w in self.natural()[:-1]] + self.natural()[-1:])

    def lines(self, limit: int) -> list[str]:
        """Return the lines of the table in a width that is less than its own."""
        if not self.words:
            widths = self._widths(limit)
            return self._drawn(widths) if widths else self._blocks(limit)
        numbers = _Table([row[:-1] for row in self.rows], self.left, self.head, False)
        widths = numbers._widths(limit - LEAST_WORDS - GAP)
        if widths:
            return self._drawn([*widths, limit - sum(widths) - GAP * len(widths)])
        return numbers._with_words_below([row[-1] for row in self.rows], limit)

    def _widths(self, limit: int) -> list[int] | None:
        """Return widths of the columns that fit, headers folded, and names where they must be; else None."""
        natural = [max(map(len, column)) for column in zip(*self.rows, strict=True)]
        widths = [self._narrowest(k) for k in range(len(natural))]
        room = limit - sum(widths) - GAP * (len(widths) - 1)
        if room < 0:
            return None
        for k, wanted in enumerate(natural):
            more = min(wanted - widths[k], room)
            widths[k], room = widths[k] + more, room - more
        return widths

    def _narrowest(self, k: int) -> int:
        """Return the least width of a column: words of its header may stand in lines of their own."""
        header = [word for row in self.rows[: self.head] for word in row[k].split()]
        cells = [row[k] for row in self.rows[self.head :]]
        if k < self.left:
            cells = [word for cell in cells for word in cell.split()]
        return max(map(len, [*header, *cells, ""]))

    def _drawn(self, widths: Sequence[int]) -> list[str]:
        ruled = widths[:-1] if self.words else widths
        lines = []
        for number, row in enumerate(self.rows):
            if number == self.head:
                lines.append("-" * (sum(ruled) + GAP * (len(ruled) - 1)))
            cells = [_fold(cell, width) for cell, width in zip(row, widths, strict=True)]
            for parts in zip_longest(*cells, fillvalue=""):
                lines.append((" " * GAP).join(map(self._aligned, range(len(row)), parts, widths)).rstrip())
        return lines

    def _aligned(self, k: int, cell: str, width: int) -> str:
        prose = self.words and k == len(self.rows[0]) - 1
        return cell.ljust(width) if k < self.left or prose else cell.rjust(width)

    def _blocks(self, limit: int) -> list[str]:
        """Return the columns in blocks, each begun by the first ones, which name the rows."""
        left = self.left if self.left < len(self.rows[0]) else 1  # all of them: the first one names the rows
        first = sum(self._narrowest(k) + GAP for k in range(left))
        lines: list[str] = []
        chosen: list[int] = []
        for k in range(left, len(self.rows[0]) + 1):
            ended = k == len(self.rows[0])
            used = first + sum(self._narrowest(j) + GAP for j in chosen)
            if chosen and (ended or used + self._narrowest(k) > limit):
                block = [[*row[:left], *(row[j] for j in chosen)] for row in self.rows]
                part = _Table(block, left if left == self.left else len(block[0]), self.head, False)
                lines += [
                    "",
                    *part._drawn(part._widths(limit) or [part._narrowest(j) for j in range(len(block[0]))]),
                ]
                chosen = []
            chosen.append(k)
        return lines[1:]

    def _with_words_below(self, words: Sequence[str], limit: int) -> list[str]:
        """Return the table, and below it the prose of each row."""
        widths = self._widths(limit)
        named = (" ".join([*row[: self.left], text]) for row, text in zip(self.rows, words, strict=True))
        table = self._drawn(widths) if widths else self._blocks(limit)
        return [*table, "", *(fill(line, limit) for line in named)]


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


def error_rows(
    pose: Sequence[str],
    rows: Mapping[str, Mapping[str, Mapping[str, float]] | None],
    floor: Mapping[str, float] | None,
    source: str = "",
    turning: Collection[str] | None = None,
) -> str:
    """Return a table of rmse and peak per pose coordinate, one line per entry of `rows`.

    `source`: whether the noise floor is stated or estimated, where that is to be said. `turning`: coordinates
    that go round, see `hallsym.units.readable`.
    """
    shown = [readable(c, turning) for c in pose]
    head = ["errors", *(f"{what} {name} [{unit}]" for what in ("rmse", "peak") for _, unit, name in shown)]
    body = [
        [
            label,
            *(
                _fixed(row[what][c] * factor)
                for what in ("rmse", "peak")
                for c, (factor, _, _) in zip(pose, shown, strict=True)
            ),
        ]
        for label, row in rows.items()
        if row is not None
    ]
    if floor:
        noise = [_fixed(floor[c] * factor) for c, (factor, _, _) in zip(pose, shown, strict=True)]
        body.append([f"noise floor, {source}" if source else "noise floor", *noise, *[""] * len(noise)])
    return grid([head, *body])


def _fixed(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.3e}"
