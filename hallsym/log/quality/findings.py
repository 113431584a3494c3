"""One fault of a log as one sentence: what, where, what was expected, what to do."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from hallsym.errors import counted
from hallsym.log.core import Drop, Log

_LONGEST_NAME = 60
"""Characters of a log's name that a sentence has room for: with them it stays below 300."""


class Fault(str):
    """A note on what is wrong with a recording that is used all the same; other notes are remarks."""


@dataclass(frozen=True)
class Finding:
    """A fault, `text` without its end and `remedy`.

    `refuse` stops the work, unless `drop` or `bear` helps and the user asks for it (drop_bad). Without
    `refuse` it is a note, and the samples of `drop` are left out unasked.
    """

    text: str
    refuse: bool = False
    drop: Drop | None = None
    bear: bool = False
    remedy: str = ""

    @property
    def sentence(self) -> str:
        """The whole sentence of a log that is used as it is, or refused; a `Fault` if it says what to do."""
        way = "leave the bad samples out with --drop-bad" if self.drop else "accept it with --drop-bad"
        ends = [self.remedy] if self.remedy else []
        ends += [way] if self.refuse and (self.drop or self.bear) else []
        said = self.text + (": " if ends else "") + ", or ".join(ends) + "."
        return Fault(said) if ends else said

    @property
    def left_out(self) -> str:
        """The whole sentence of a log without the bad samples, with the remedy where nobody asked for it."""
        return f"{self.text}; left out." if self.refuse else Fault(f"{self.text}; left out: {self.remedy}.")

    @property
    def borne(self) -> str:
        """The whole sentence of a log that is used although it should be refused."""
        return f"{self.text}."


def name_of(log: Log) -> str:
    """Return what to call a log in a sentence; a long path keeps its end."""
    return log.name if len(log.name) <= _LONGEST_NAME else f"...{log.name[3 - _LONGEST_NAME :]}"


def the(log: Log, column: str) -> str:
    """Return the beginning of a sentence about a column."""
    return f"Column {column} of {name_of(log)}"


def others(things: Collection[object], thing: str = "more run") -> str:
    """Return ` (and 3 more runs)` for what a sentence names one of, or nothing."""
    return f" (and {counted(len(things) - 1, thing)})" if len(things) > 1 else ""
