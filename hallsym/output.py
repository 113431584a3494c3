"""Text that leaves hallsym: no control character reaches a terminal, a page, a CSV cell or a comment in C.

Names come from files that others made. Each is escaped once, by `printable`, where it is shown; and text that
is shown fits the terminal.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from math import isfinite
from shutil import get_terminal_size
from textwrap import fill
from unicodedata import category

_CREDENTIALS = re.compile(r"\b([a-z][a-z0-9+.-]+:/{1,2})[^/\s]*@", re.IGNORECASE)
"""User and password of a URL (RFC 3986, section 3.2.1), also where a path made one slash of its two."""


def printable(text: object, keep: str = "") -> str:
    r"""Return `text` with control, format and bidirectional characters escaped as in Python.

    Characters of `keep` and spaces of any width stay. The user and the password of a URL are left out.

    >>> printable("a\nb\x1b[2J"), printable("https://me:secret@host/log.csv")
    ('a\\nb\\x1b[2J', 'https://***@host/log.csv')
    """
    shown = str(text)
    if not shown.isprintable():
        shown = "".join(
            c if c.isprintable() or c in keep or category(c) == "Zs" else repr(c)[1:-1] for c in shown
        )
    return _CREDENTIALS.sub(r"\1***@", shown) if "@" in shown else shown


def percent(share: float, digits: int = 0) -> str:
    """Return a share in per cent; nothing where it does not exist."""
    return f"{100 * share:.{digits}f} %" if isfinite(share) else ""


def commented(text: str) -> str:
    """Return a text that stays within its comment in C: one line, no backslash, no end of a comment."""
    shown = printable(text).replace("\\", " ")
    return shown.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def csv_text(rows: Iterable[Sequence[object]], delimiter: str = ",") -> str:
    """Return rows as CSV (RFC 4180), with one line for each row whatever its cells hold."""
    text = io.StringIO()
    csv.writer(text, delimiter=delimiter, lineterminator="\n").writerows(map(printable, row) for row in rows)
    return text.getvalue()


def toml_text(text: str) -> str:
    r"""Return a basic string of TOML, which reads back as `text`, with only printable characters.

    >>> toml_text("a\nb")
    '"a\\u000ab"'
    """
    escaped = (f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}" for c in text)
    shown = (c if c.isprintable() and c not in '"\\' else e for c, e in zip(text, escaped, strict=True))
    return f'"{"".join(shown)}"'


PROSE = 110
"""Characters of a line of prose at most, and where no terminal says how many there are."""
NARROWEST = 40
"""Characters of a line at least: on less nothing can be read."""
_COMMAND = re.compile(r"\bnext: hallsym .*$")


def columns() -> int | None:
    """Return the characters of a line of the terminal, or what the variable COLUMNS states.

    None where output goes to a file or a pipe, whose lines may have any length.
    """
    width = get_terminal_size((0, 0)).columns
    return max(width, NARROWEST) if width else None


def prose_width() -> int:
    """Return the characters of a line of prose."""
    return min(columns() or PROSE, PROSE)


def fitted(text: str) -> str:
    """Return printable text whose lines fit the terminal: long ones are folded, and nothing is left out.

    A command to copy that ends a line is folded with backslashes, so that it can be pasted as it stands.
    """
    text, width = printable(text, keep="\n"), columns()
    if width is None:
        return text
    return "\n".join(line if len(line) <= width else _folded(line, width) for line in text.split("\n"))


def _folded(line: str, width: int) -> str:
    indent = line[: len(line) - len(line.lstrip())]
    command = _COMMAND.search(line)
    if command and len(line) > width:
        before = line[: command.start()].rstrip()
        parts = [_folded(before, width)] if len(before) > width else [before] if before.strip() else []
        typed = f"{indent}{command[0]}"
        if len(typed) > width:
            typed = _filled(typed, width - 2, f"{indent}    ").replace("\n", " \\\n")
        return "\n".join([*parts, typed])
    return _filled(line, width, f"{indent}  ")


def _filled(line: str, width: int, indent: str) -> str:
    return fill(line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class Step(str):
    """What long work does now, with the share of it that is done, 0 to 1."""

    share: float

    def __new__(cls, text: str, share: float) -> Step:
        """Make the text, which is a string as any other."""
        step = super().__new__(cls, text)
        step.share = share
        return step


def said_time(seconds: float) -> str:
    """Return a duration for reading.

    >>> said_time(12.3), said_time(250), said_time(7800)
    ('12 s', '4 min', '2 h 10 min')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
