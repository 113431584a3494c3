"""Cells of a text file: numbers with a decimal point or comma, what stands for none, and names with units."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from hallsym.errors import InputError
from hallsym.units import UNITS, split_unit

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


_AGAIN = re.compile(r"(.+)\.\d+")
"""A name that pandas has numbered, since another column has it too."""


def stems_of(
    texts: Sequence[str], stated: Sequence[str | None] = (), where: str = ""
) -> dict[str, tuple[str, str | None]]:
    """Return headers' own texts and units by their names without unit, or by the text where two are alike.

    `stated`: units that the file states elsewhere. Columns of one name are numbered. `where`: a file whose
    names may be wrong: refuse a column of ours that is there twice, and a column with two units.
    """
    texts = [text or f"(column {k})" for k, text in enumerate(texts, 1)]
    same = Counter(texts)
    bare = [m[1] if (m := _AGAIN.fullmatch(text)) and m[1] in texts else text for text in texts]
    groups, times, seen = Counter(text.rpartition("/")[0] for text in bare), Counter(bare), Counter[str]()
    parts = []
    for k, text in enumerate(bare):
        before, _, last = text.rpartition("/")
        group = f"{before}/" if before and groups[before] > 1 else ""  # then it is a group of channels
        stem, unit = split_header(last if group else text)
        if where and times[text] > 1 and (text == "run" or split_unit(text)[1]):
            raise InputError(f"Column names of {where} must differ; '{text}' stands there twice: rename one.")
        seen[text] += 1
        number = f" {seen[text]}" if times[text] > 1 else ""
        texts[k] = f"{text}{number}" if same[texts[k]] > 1 else texts[k]
        other = stated[k] if k < len(stated) else None
        if where and unit and other and unit != other:
            raise InputError(
                f"The unit of column '{group}{stem}' of {where} must be one; the names say {unit}, the line"
                f" below {other}."
            )
        parts.append((f"{group}{stem}{number}", other or unit))
    often = Counter(stem for stem, _ in parts)
    return {
        stem if often[stem] == 1 else text: (text, unit)
        for text, (stem, unit) in zip(texts, parts, strict=True)
    }


class Spelling(NamedTuple):
    """Another way to write numbers: what it is called, what is found in or behind one, what that becomes."""

    said: str
    pattern: re.Pattern[str]
    plain: str | Callable[[re.Match[str]], str]

    def __call__(self, text: str) -> str:
        """Return lines with usual numbers."""
        return self.pattern.sub(self.plain, text)


_NAMES_OF_UNITS = "|".join(
    re.escape(unit)
    for unit in sorted({*_WORDS, *_EXACT, *_ANY_CASE}, key=len, reverse=True)
    if unit[0] not in "\"'"  # which may stand around a cell
)
_ENDS = r'(?=\s*(?:[;,\t|"\n]|$))'
SPELLINGS = (
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
