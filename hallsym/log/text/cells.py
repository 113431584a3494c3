"""Cells of a text file: numbers with a decimal point or comma, and what stands for none."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

from hallsym.log.columns import LONGEST_UNIT, NO_UNIT, UNITS_AS_WRITTEN, unit_of

MISSING = (
    "", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "-", "--", "---",
    "-nan(ind)", "1.#QNAN", "-1.#IND", "1,#QNAN", "-1,#IND", "∞", "-∞",
)  # fmt: skip
"""Cells without a value: empty ones, and what programs write for no number."""
_INFINITE = r"[-+]?(?:inf|infinity)"
_POWER = r"(?:[eE][-+]?\d+)?"
_GAPS = " '\u00a0\u202f\u2009"
"""Separators of thousands beside comma and point: blanks of all widths, the Swiss apostrophe."""


@dataclass(frozen=True)
class Convention:
    """How numbers are written: the `decimal` sign, and what separates thousands ("" where nothing does)."""

    decimal: str
    grouping: str = ""

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """Pattern of a number."""
        d = re.escape(self.decimal)
        whole = (
            r"\d+" if not self.grouping else rf"(?:[1-9]\d{{0,2}}(?:{re.escape(self.grouping)}\d{{3}})+|\d+)"
        )
        return re.compile(rf"[-+]?(?:{whole}(?:{d}\d*)?|{d}\d+){_POWER}|{_INFINITE}", re.IGNORECASE)


POINT, COMMA = Convention("."), Convention(",")
CONVENTIONS = (
    POINT, COMMA, Convention(".", ","), Convention(",", "."),
    *(Convention(decimal, gap) for gap in _GAPS for decimal in ".,"),
)  # fmt: skip
"""From the usual one on: the first that reads all is taken, where none after it reads other numbers."""
_ANY = re.compile(rf"[-+]?[\d.,{_GAPS}]*\d[\d.,{_GAPS}]*{_POWER}|{_INFINITE}", re.IGNORECASE)


@lru_cache(maxsize=1 << 12)
def is_number(cell: str) -> bool:
    """Say whether a cell is a number under some convention; a missing one is none."""
    return bool(_ANY.fullmatch(cell)) and any(c.pattern.fullmatch(cell) for c in CONVENTIONS)


def conventions_of(cells: Iterable[str], decimal: str | None = None) -> tuple[list[Convention], str]:
    """Return the conventions that read most of the cells, and a cell that distinguishes them ("" if none).

    Several are returned only where they read the same cells as other numbers: 1,234.
    """
    numbers = [c for c in dict.fromkeys(cells) if is_number(c)]
    if decimal != "," and all(map(POINT.pattern.fullmatch, numbers)):
        return [POINT], ""
    signs = set().union(*numbers)
    allowed = [c for c in CONVENTIONS if decimal in (None, c.decimal) and set(c.grouping) <= signs]
    counts = {c: sum(map(bool, map(c.pattern.fullmatch, numbers))) for c in allowed}
    most = max(counts.values(), default=0)
    best = [c for c in allowed if counts[c] == most]
    if POINT in best:
        return [POINT], ""
    plain = best[0]
    for other in best[1:]:
        for n in numbers:
            if as_float(n, plain) != as_float(n, other):
                return [plain, other], n
    return [plain], ""


def as_float(cell: str, convention: Convention) -> float | None:
    """Return the number in a cell, nan for a missing one, None for anything else."""
    if cell in MISSING:
        return float("nan")
    if not convention.pattern.fullmatch(cell):
        return None
    plain = cell.replace(convention.grouping, "") if convention.grouping else cell
    return float(plain.replace(convention.decimal, "."))


class Spelling(NamedTuple):
    """Another notation of numbers: its name, the pattern in or behind a number, its replacement."""

    said: str
    pattern: re.Pattern[str]
    plain: str | Callable[[re.Match[str]], str]

    def __call__(self, text: str) -> str:
        """Return lines with usual numbers."""
        return self.pattern.sub(self.plain, text)


_NAMES_OF_UNITS = "|".join(
    re.escape(unit)
    for unit in sorted(UNITS_AS_WRITTEN, key=len, reverse=True)
    if unit[0] not in "\"'"  # which may stand around a cell
)
_ENDS = r'(?=\s*(?:[;,\t|"\n]|$))'
LABELS = Spelling(
    "names before numbers", re.compile(r"(?:(?<=[;,\t| ])|^)([^\W\d]\w*) ?[:=] ?(?=[-+.]?\d)", re.M), ""
)
MIXED = Spelling("blanks and commas between names", re.compile(r"(?<=[^\s,]) (?=\w+=|\d+$)", re.M), ",")
"""A blank separates tags, fields and the time behind them: `rig,run=3 hall_a=1.5,z=2i 1772400000`."""
ARRIVED = Spelling("times of arrival before lines", re.compile(r"^\d+:\d+:\d+[.,]\d+ -> ?", re.M), "")
SPELLINGS = (
    ARRIVED,
    MIXED,
    LABELS,
    Spelling("whole numbers written with i", re.compile(r"(?<=\d)i(?=[\s,;]|$)", re.M), ""),
    Spelling("exponents written with D", re.compile(r"(?<=[\d.])[dD](?=[-+]?\d+(?:\W|$))"), "e"),
    Spelling(
        "hexadecimal numbers",
        re.compile(r"(?<![\w.])0[xX]([\dA-Fa-f]+)(?!\w)"),
        lambda found: str(int(found[1], 16)),
    ),
    Spelling(
        "units behind numbers", re.compile(rf"(?<=\d)[ \xa0]?(?:[µμ]\w+|{_NAMES_OF_UNITS}){_ENDS}", re.I), ""
    ),
)
LEAST = 5
"""Lines in a row that show how numbers are written."""


def spellings_of(lines: Sequence[str]) -> dict[Spelling, int]:
    """Return the spellings that the last lines of a text have without a break, and from which line on."""
    found = {}
    for spelling in SPELLINGS:
        first = len(lines)
        while first > 1 and spelling.pattern.search(lines[first - 1]):  # the first one holds names
            first -= 1
        if len(lines) - first >= min(LEAST, max(len(lines) - 1, 1)):
            found[spelling] = first
    return found


def labels_of(line: str) -> str:
    """Return the names of a line with one before each number.

    >>> labels_of("t_ms:10,sin:-0.5")
    't_ms,sin'
    """
    named = re.sub(rf"{LABELS.pattern.pattern}[-+.\w]+", r"\1", MIXED(line), flags=re.M)
    return re.sub(r"(?<=,)\d+$", "", named)


def unit_behind(cell: str) -> str | None:
    """Return the unit that stands behind the number in a cell.

    >>> unit_behind("12.5 µm"), unit_behind("3mV"), unit_behind("7")
    ('um', 'mv', None)
    """
    match = re.fullmatch(r"[-+\d.,eE]*\d[ \xa0]?(\D+)", cell)
    return unit_of(match[1]) if match else None


def is_unit_row(cells: list[str]) -> bool:
    """Say whether the cells under the names are units: some are, and the others say that there is none."""
    found = [unit_of(cell) for cell in cells]
    odd = [c for c, unit in zip(cells, found, strict=True) if not unit and c.strip().lower() not in NO_UNIT]
    known = sum(unit is not None for unit in found)
    return 0 < known >= len(odd) and not any(len(c) > LONGEST_UNIT or is_number(c) for c in odd)
