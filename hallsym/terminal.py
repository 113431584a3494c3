"""How wide a terminal is, text that fits it, and steps of long work that say how much of it is done."""

from __future__ import annotations

import re
from shutil import get_terminal_size
from textwrap import fill

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
    """Return text whose lines fit the terminal: long ones are folded, and nothing is left out.

    A command to copy that ends a line is folded with backslashes, so that it can be pasted as it stands.
    """
    width = columns()
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
