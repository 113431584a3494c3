"""The unit that a column's header states, in the ways laboratories write it."""

from __future__ import annotations

import re
import unicodedata

from hallsym.log.text.numbers import is_number
from hallsym.units import UNITS

_WORDS = {
    "°": "deg", "º": "deg", "degree": "deg", "degrees": "deg", "grad": "", "°c": "degc", "celsius": "degc",
    "deg c": "degc", "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us", "micron": "um",
    "microns": "um", "micrometer": "um", "micrometre": "um", "millimeter": "mm", "millimetre": "mm",
    "meter": "m", "metre": "m", "volt": "v", "volts": "v", "ampere": "a", "amp": "a", "tesla": "t",
    "kelvin": "k", "rad/s": "rad_s", "°/s": "deg_s", "deg/s": "deg_s", "1/min": "rpm", "u/min": "rpm",
    "min-1": "rpm", "r/min": "rpm", "m/s": "m_s", "mm/s": "mm_s", "counts": "count", "cts": "count",
    "inc": "count", "lsb": "count", "digit": "count", "digits": "count", '"': "arcsec", "″": "arcsec",
    "''": "arcsec", "arcseconds": "arcsec", "turn": "rev", "turns": "rev", "urad": "urad",
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
    re.compile(r"(.*\S)\s*/\s*(\S+?(?:/\S+)?)"),
    re.compile(r"(.*\S)\s+in\s+(\S+)"),
    re.compile(r"(.*\S),\s*(\S+)"),
)


_PLAIN = re.compile(r"(.*\S)\s+(\S+)")
_SURE = {
    "um", "nm", "mm", "urad", "mrad", "nrad", "deg", "mdeg", "arcsec", "ms", "us", "mv", "uv", "mt", "ut",
    "rpm", "degc",
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


def is_unit_row(cells: list[str]) -> bool:
    """Say whether the cells under the names are units: some are, and the others say that there is none."""
    found = [unit_of(cell) for cell in cells]
    odd = [c for c, unit in zip(cells, found, strict=True) if not unit and c.strip().lower() not in NO_UNIT]
    known = sum(unit is not None for unit in found)
    return 0 < known >= len(odd) and not any(len(c) > LONGEST_UNIT or is_number(c) for c in odd)
