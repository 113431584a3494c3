"""Cells of a text file: numbers with a decimal point or comma, what stands for none, and names with units."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

from hallsym.units import UNITS

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


def conventions_of(cells: Iterable[str], decimal: str | None = None) -> tuple[list[Convention], str]:
    """Return the conventions that read most of the cells, and a cell that tells them apart ("" if none does).

    Several are returned only where they read the same cells as other numbers: 1,234.
    """
    numbers = [c for c in dict.fromkeys(cells) if is_number(c)]
    if decimal != "," and all(_PATTERNS[POINT].fullmatch(n) for n in numbers):
        return [POINT], ""
    signs = set().union(*numbers)
    allowed = [c for c in CONVENTIONS if decimal in (None, c.decimal) and set(c.grouping) <= signs]
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


_WORDS = {
    "°": "deg", "º": "deg", "degree": "deg", "degrees": "deg", "grad": "", "°c": "degc", "celsius": "degc",
    "deg c": "degc", "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us", "micron": "um",
    "microns": "um", "micrometer": "um", "micrometre": "um", "millimeter": "mm", "millimetre": "mm",
    "meter": "m", "metre": "m", "volt": "v", "volts": "v", "ampere": "a", "amp": "a", "tesla": "t",
    "kelvin": "k", "rad/s": "rad_s", "°/s": "deg_s", "deg/s": "deg_s", "1/min": "rpm", "u/min": "rpm",
    "min-1": "rpm", "r/min": "rpm", "m/s": "m_s", "mm/s": "mm_s", "counts": "count", "cts": "count",
    "inc": "count", "lsb": "count", "digit": "count", "digits": "count", '"': "arcsec", "″": "arcsec",
    "''": "arcsec", "arcseconds": "arcsec", "′": "arcmin", "arcminutes": "arcmin", "turn": "rev",
    "turns": "rev", "urad": "urad",
}  # fmt: skip
_EXACT = {
    "V": "v", "mV": "mv", "uV": "uv", "A": "a", "mA": "ma", "T": "t", "mT": "mt", "uT": "ut", "Hz": "hz",
    "kHz": "khz", "K": "k",
}  # fmt: skip
"""Units in which a capital letter is another size: mV is not MV."""
_ANY_CASE = set(UNITS) - {unit for unit in _EXACT.values() if len(unit) > 1} - {"k", "t"}
NO_UNIT = ("", "-", "--", "1", "[]", "[-]", "()", "(-)", "n/a", "none", "#", "[1]")
"""What a row of units says of a column without one."""
LONGEST_UNIT = 12
"""Characters of a unit that is not known."""
_BRACKETS = re.compile(r"(.*?)[\s_]*[\[({<]\s*([^\])}>]*?)\s*[\])}>]")
_BEHIND = (
    re.compile(r"([^/]*[^/\s])\s*/\s*(\S+?(?:/\S+)?)"),
    re.compile(r"(.*\S)\s+in\s+(\S+)"),
    re.compile(r"(.*\S),\s*(\S+)"),
    re.compile(r"(.*\S)_([µμ°]\S*)"),
)


_PROGRAMS = {"X_Value": ("t", "s")}
"""Names that a program gives whatever is recorded: LabVIEW's of the time in its measurement files."""
_PLAIN = re.compile(r"(.*\S)\s+(\S+)")
_SURE = {
    "um", "nm", "mm", "urad", "mrad", "nrad", "deg", "mdeg", "arcmin", "arcsec", "ms", "us", "mv", "uv", "mt",
    "ut", "rpm", "degc",
}  # fmt: skip
"""Units that are no words: x um is x in micrometres, Hall A and y min are names."""


def unit_of(text: str) -> str | None:
    """Return hallsym's name of a unit as people write it; None for what is none.

    >>> unit_of("[µm]"), unit_of("°"), unit_of("mV"), unit_of("MV")
    ('um', 'deg', 'mv', None)
    """
    plain = unicodedata.normalize("NFKC", text).strip().replace("μ", "u").replace("º", "°")
    for left, right in ("[]", "()", "{}", "<>"):
        if plain.startswith(left) and plain.endswith(right):
            plain = plain[1:-1].strip()
    if plain in _EXACT:
        return _EXACT[plain]
    folded = plain.lower()
    if folded in _WORDS:
        return _WORDS[folded] or None
    return folded if folded in _ANY_CASE or (plain in UNITS and plain not in "kt") else None


def split_header(text: str) -> tuple[str, str | None]:
    """Return name and unit of a header's cell; the unit is None where none stands in it.

    >>> split_header("x_ref [µm]"), split_header("Hall A / mV"), split_header("hall_a_m")
    (('x_ref', 'um'), ('Hall A', 'mv'), ('hall_a_m', None))
    """
    if text in _PROGRAMS:
        return _PROGRAMS[text]
    match = _BRACKETS.fullmatch(text)
    if match and match[1]:
        unit = unit_of(match[2])
        if unit or match[2].lower() in NO_UNIT:
            return match[1], unit
        return text, None
    for pattern in _BEHIND:
        match = pattern.fullmatch(text)
        unit = unit_of(match[2]) if match else None
        if match and unit:
            return match[1], unit
    plain = _PLAIN.fullmatch(text)
    if plain and unit_of(plain[2]) in _SURE:
        return plain[1], unit_of(plain[2])
    return text, None


def stems_of(
    texts: Iterable[str], stated: Mapping[str, str | None] | None = None
) -> dict[str, tuple[str, str | None]]:
    """Return headers' own texts and units by their names without unit, or by the text where two are alike.

    `stated`: units that the file states elsewhere, by text.
    """
    parts = {text: split_header(text) for text in texts}
    often = Counter(stem for stem, _ in parts.values())
    return {
        stem if often[stem] == 1 else text: (text, (stated or {}).get(text) or unit)
        for text, (stem, unit) in parts.items()
    }


def is_unit_row(cells: list[str]) -> bool:
    """Say whether the cells under the names are units: some are, and the others say that there is none."""
    found = [unit_of(cell) for cell in cells]
    odd = [c for c, unit in zip(cells, found, strict=True) if not unit and c.strip().lower() not in NO_UNIT]
    known = sum(unit is not None for unit in found)
    return 0 < known >= len(odd) and not any(len(c) > LONGEST_UNIT or is_number(c) for c in odd)
