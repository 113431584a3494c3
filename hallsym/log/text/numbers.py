"""Numbers as text: a decimal point or comma, separators of thousands, and what stands for a missing value."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

MISSING = (
    "", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "-", "--", "---",
    "-nan(ind)", "1.#QNAN", "-1.#IND", "1,#QNAN", "-1,#IND",
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

    @property
    def pattern(self) -> re.Pattern[str]:
        """What a number looks like."""
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
_PATTERNS = {c: c.pattern for c in CONVENTIONS}
_ANY = re.compile(rf"[-+]?[\d.,{_GAPS}]*\d[\d.,{_GAPS}]*{_POWER}|{_INFINITE}", re.IGNORECASE)


@lru_cache(maxsize=1 << 12)
def is_number(cell: str) -> bool:
    """Say whether a cell is a number under some convention; a missing one is none."""
    return bool(_ANY.fullmatch(cell)) and any(p.fullmatch(cell) for p in _PATTERNS.values())


def is_missing(cell: str) -> bool:
    """Say whether a cell holds no value."""
    return cell in MISSING


def conventions_of(cells: Iterable[str], decimal: str | None = None) -> tuple[list[Convention], str]:
    """Return the conventions that read most of the cells, and a cell that tells them apart ("" if none does).

    Several are returned only where they read the same cells as other numbers: 1,234.
    """
    numbers = [c for c in dict.fromkeys(cells) if is_number(c)]
    if decimal != "," and all(_PATTERNS[POINT].fullmatch(n) for n in numbers):
        return [POINT], ""
    allowed = [c for c in CONVENTIONS if decimal in (None, c.decimal)]
    counts = {c: sum(bool(_PATTERNS[c].fullmatch(n)) for n in numbers) for c in allowed}
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
    """Return the number in a cell, nan for a missing one, None for what is no number."""
    if cell in MISSING:
        return float("nan")
    if not (_PATTERNS.get(convention) or convention.pattern).fullmatch(cell):
        return None
    plain = cell.replace(convention.grouping, "") if convention.grouping else cell
    return float(plain.replace(convention.decimal, "."))
