"""What a text file is, recognised from its first and last lines; asked for where it could be two things."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from hallsym.errors import InputError
from hallsym.log.text.dialect import SAID, TYPED, Dialect
from hallsym.log.text.encoding import Encoded, end_of
from hallsym.log.text.numbers import Convention, conventions_of, is_missing, is_number
from hallsym.log.text.rows import BLANKS, DELIMITERS, Line, Table, split, table_under
from hallsym.log.text.times import TimeForm, time_form
from hallsym.log.text.units import is_unit_row, split_header, unit_of

SAMPLE = 1 << 18
"""Characters of the beginning that are looked at, and more where its lines are long."""
FEW = 12
"""Lines that are looked at at least."""
MOST, NUMBERS = 100, 4000
"""Lines that are looked at at most to find the table, and for how its numbers are written."""
LONGEST_FOOTER = 20
"""Lines after a table that are taken for words about it; more are damage."""
_COMMENTS = ("#", "%", "//", "!")
_SEP = re.compile(r"sep=(.)", re.IGNORECASE)
_WORD = re.compile(r"[^\W\d_]{2,}")


def sniffed(file: Encoded, where: str, delimiter: str | None = None, decimal: str | None = None) -> Dialect:
    """Recognise a file. `where` names it in messages; `delimiter` and `decimal` are what somebody stated.

    Raises `InputError` for what is no table with names, and for numbers that can be read in two ways.
    """
    lines, comments = _sample(file, where)
    known = {c for c in _COMMENTS if c == "#" or any(text.startswith(c) for _, text in comments)}
    marks = tuple(c for c in _COMMENTS if c in known)
    if lines and (stated := _SEP.fullmatch(lines[0].text.strip())):
        lines, delimiter = lines[1:], delimiter or stated[1]
    if not lines:
        raise InputError(
            f"{where} is empty: it must hold a header line with column names and one line per sample."
        )
    table, names, header = _table(lines[:MOST], comments, delimiter, where)
    first, units_line, units = _units(table, lines)
    stems = _stems(names, units, where)
    below = lines[min(first, len(lines)) :]
    rows = (split(line.text, table.delimiter) for line in below)
    body = [row for row in rows if len(row) == table.width]
    quotes = _quotes(below, table.delimiter)
    numbers = _numbers(body, "" if quotes == "inside" else table.delimiter, decimal, where)
    found = Dialect(
        file.encoding, file.compressed, table.delimiter, tuple(stems), header,
        lines[first].number if first < len(lines) else lines[-1].number + 1, numbers,
        {stem: unit for stem, (_, unit) in stems.items() if unit},
        {text: stem for stem, (text, _) in stems.items() if text != stem},
        units_line, marks, above=sum(line.number < header for line in lines),
        quoted=quotes, padded=_padded(below, table.delimiter), times=_times(tuple(stems), body),
    )  # fmt: skip
    return _with_footer(found, end_of(file), body)


def is_comment(text: str, marks: Sequence[str]) -> bool:
    """Say whether a line is a comment."""
    return text.lstrip(' \t"').startswith(tuple(marks))


# -- the beginning ---------------------------------------------------------------------------------------


def _sample(file: Encoded, where: str) -> tuple[list[Line], list[tuple[int, str]]]:
    """Return the first lines that hold something, and the comments among them."""
    lines: list[Line] = []
    comments: list[tuple[int, str]] = []
    length = 0
    for number, text in enumerate(_guarded(file, where), start=1):
        length += len(text)
        if is_comment(text, _COMMENTS):
            comments.append((number, text.strip(' \t"')))
        elif text.strip():
            lines.append(Line(number, text))
        if (length > SAMPLE and len(lines) >= FEW) or len(lines) >= NUMBERS:
            break
    return lines, comments


def _guarded(file: Encoded, where: str) -> Iterator[str]:
    """Yield lines; refuse a file whose first ones are no text."""
    for number, text in enumerate(file.lines(where), start=1):
        if "\0" in text and number <= FEW:
            raise InputError(
                f"Line {number} of {where} must hold column names; it is no text, so the file is damaged or "
                "of another format: copy it again, or state its --format."
            )
        yield text


def _table(
    lines: list[Line], comments: list[tuple[int, str]], delimiter: str | None, where: str
) -> tuple[Table, list[str], int]:
    """Return the table under the delimiter that makes most of the lines numbers, its names and their line."""
    tables = [table_under(lines, d) for d in ((delimiter,) if delimiter else DELIMITERS)]
    several = [t for t in tables if t.fits and t.width > 1 and t.quality > 0]
    single = [t for t in tables if t.fits and t.width == 1 and t.quality > 0.5]
    best = max(several, key=lambda t: (round(t.quality, 2), t.width)) if several else None
    if best is None or (single and best.quality < 0.5):
        best = single[0] if single else best
    if any(t.top < 0 and t.width > 1 and t.quality > (best.quality if best else 0.5) for t in tables):
        best = None  # numbers from the first line on
    chosen = best or _commented(tables, lines, comments)
    chosen = chosen or max(tables, key=lambda t: (round(t.quality, 2), t.top >= 0, t.width))
    if chosen.top < 0:
        for number, text in reversed([c for c in comments if c[0] < lines[0].number]):
            names = split(text.lstrip("#%/! \t"), chosen.delimiter)
            if len(names) == chosen.width and not any(map(is_number, names)):
                return chosen, names, number
        raise InputError(
            f"Line {lines[0].number} of {where} must hold column names such as hall_a_m; it holds numbers."
        )
    names, number = chosen.rows[chosen.top], lines[chosen.top].number
    _check_stated(lines[chosen.top], chosen, delimiter, where)
    names = [*names, ""] if len(names) == chosen.width - 1 and chosen.trailing else names
    return chosen, names, number


def _commented(tables: list[Table], lines: list[Line], comments: list[tuple[int, str]]) -> Table | None:
    """Return the table whose names stand in a comment."""
    before = [text.lstrip("#%/! \t") for number, text in comments if number < lines[0].number]
    for table in sorted(tables, key=lambda t: -t.quality):
        named = any(len(split(text, table.delimiter)) == table.width for text in before)
        if table.top < 0 and named and table.width > 1 and table.quality > 0.5:
            return table
    return None


def _check_stated(line: Line, table: Table, delimiter: str | None, where: str) -> None:
    """Refuse a stated delimiter that makes one column of a line that another one would split."""
    other = next((d for d in DELIMITERS[:-1] if d != delimiter and d in line.text), None)
    if delimiter and table.width == 1 and other:
        raise InputError(
            f"Columns of {where} must be separated by {SAID.get(delimiter, repr(delimiter))}; line"
            f" {line.number} looks separated by {SAID[other]}: leave --delimiter out, or say"
            f" --delimiter {TYPED.get(other, repr(other))} (in Python delimiter={other!r})."
        )


# -- names and units -------------------------------------------------------------------------------------


def _units(table: Table, lines: list[Line]) -> tuple[int, int, list[str]]:
    """Return the first row of data, the line of the units (0 without one) and the units' cells."""
    first = table.data
    if table.top < 0 or first >= len(table.rows):
        return first, 0, []
    row = table.rows[first]
    if len(row) == len(table.rows[table.top]) and is_unit_row(row):
        return first + 1, lines[first].number, row
    return first, 0, []


def _stems(names: list[str], units: list[str], where: str) -> dict[str, tuple[str, str | None]]:
    """Return the header's own text and the unit of each column, by its name without the unit."""
    texts = [text or f"(column {k + 1})" for k, text in enumerate(names)]
    name, times = Counter(texts).most_common(1)[0]
    if times > 1:
        raise InputError(f"Column names of {where} must differ; '{name}' stands there twice.")
    parts = [split_header(text) for text in texts]
    stems = Counter(stem for stem, _ in parts)
    found: dict[str, tuple[str, str | None]] = {}
    for k, (text, (stem, unit)) in enumerate(zip(texts, parts, strict=True)):
        under = unit_of(units[k]) if k < len(units) else None
        if unit and under and unit != under:
            raise InputError(
                f"The unit of column '{stem}' of {where} must be one; the names say {unit}, the line below"
                f" {under}."
            )
        found[stem if stems[stem] == 1 else text] = (text, unit or under)
    return found


# -- numbers ---------------------------------------------------------------------------------------------


def _numbers(body: list[list[str]], delimiter: str, decimal: str | None, where: str) -> Convention:
    """Return how numbers are written; beside a stated decimal sign the other may separate thousands."""
    found, cell = conventions_of((cell for row in body for cell in row), decimal)
    if len(found) > 1:
        raise InputError(
            f"Numbers such as '{cell}' of {where} can be read in two ways: say --decimal , if the comma is"
            " the decimal sign, or --decimal . if it separates thousands (in Python decimal=',' or '.')."
        )
    other = "," if decimal == "." else "."
    stated = decimal and not found[0].grouping and other != delimiter
    return Convention(found[0].decimal, other) if stated else found[0]


def _quotes(lines: list[Line], delimiter: str) -> str:
    """Return whether cells are quoted: "" for none, "inside" where a delimiter stands between quotes."""
    texts = [line.text for line in lines if '"' in line.text]
    if 2 * len(texts) <= len(lines) or any(text.count('"') % 2 for text in texts):
        return ""
    inside = any(delimiter in part for text in texts for part in re.findall(r'"([^"]*)"', text))
    return "inside" if inside else "around"


def _padded(lines: list[Line], delimiter: str) -> bool:
    """Return whether blanks stand beside delimiters, or at an end of a line."""
    mark = re.escape(delimiter)
    blank = " " if delimiter == "\t" else r"[ \t]"
    blanks = re.compile(rf"{blank}{mark}|{mark}{blank}|^{blank}|{blank}$")
    return delimiter != BLANKS and any(blanks.search(line.text) for line in lines)


def _times(names: tuple[str, ...], body: list[list[str]]) -> dict[str, TimeForm]:
    """Return the columns of times as text, and how they are written."""
    found = {}
    for k, name in enumerate(names):
        cells = [cell for row in body if not is_missing(cell := row[k].strip(' "'))]
        if cells and ":" in cells[0] and (form := time_form(cells)):
            found[name] = form
    return found


# -- the end ---------------------------------------------------------------------------------------------


def _with_footer(found: Dialect, end: str, body: list[list[str]]) -> Dialect:
    """Add the lines of words, and those without any cell, that end the file after its table."""
    if not body or not is_number(body[0][0]):
        return found  # a first column of words looks like words
    texts = end.rstrip("\r\n").replace("\r\n", "\n").replace("\r", "\n").split("\n")[1:]
    lines = passed = 0
    said = ""
    for text in reversed(texts[-LONGEST_FOOTER:]):
        passed += 1
        if is_comment(text, found.comments):
            continue
        cells = split(text, found.delimiter) or [""]
        words = len(cells) != len(found.names) and bool(_WORD.match(cells[0])) and not is_number(cells[0])
        if any(cells) and not words:
            break
        lines, said = passed, text.strip() if words else said
    return replace(found, footer=lines, footer_text=said) if lines else found
