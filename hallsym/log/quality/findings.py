"""One fault of a log as one sentence: fault, place, expectation and remedy."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from hallsym.errors import counted
from hallsym.log.core import Drop, Log

UNRELATED, LAYOUT, STUCK = "unrelated", "layout", "stuck"
"""Claims: readings do not follow the reference, sensors are elsewhere, a column never changes."""


class Fault(str):
    """A claim: an anomaly of a recording, or a fit, that is used nevertheless; other notes are remarks.

    `name`: argument of `--accept`. `columns`, `runs`: where, all runs if empty. `correction`: argument of
    `--correct` that undoes it, None if there is none.
    """

    name: str
    columns: tuple[str, ...]
    runs: tuple[int, ...]
    correction: str | None

    def __new__(
        cls,
        text: str,
        name: str = "",
        columns: Collection[str] = (),
        runs: Collection[int] = (),
        correction: str | None = None,
    ) -> Fault:
        """Make a sentence a claim."""
        fault = super().__new__(cls, text)
        fault.name, fault.columns, fault.runs = name, tuple(columns), tuple(runs)
        fault.correction = correction
        return fault

    def of(self, text: str) -> Fault:
        """Return the same claim in other words."""
        return Fault(text, self.name, self.columns, self.runs, self.correction)


@dataclass(frozen=True)
class Finding:
    """An anomaly of a log, a remark or the `Fault` that is claimed, `text` without its end and `remedy`.

    `refuse`: nothing can be computed from the samples of `drop`, or of the log, so it stops the work. Samples
    of `drop` that a claim calls bad are left out unless it is accepted.
    """

    text: str
    remedy: str = ""
    refuse: bool = False
    drop: Drop | None = None

    @property
    def claim(self) -> str:
        """Name of the claim, "" of a remark."""
        return self.text.name if isinstance(self.text, Fault) else ""

    def said(self, *, left_out: bool = False) -> str:
        """Return the whole sentence: a `Fault` of a claim. `left_out`: the samples of `drop` are."""
        fault = self.text if isinstance(self.text, Fault) else None
        ends = f"{'; left out' if left_out else ''}{': ' if self.remedy else ''}{self.remedy}"
        if left_out and fault and fault.correction:
            ends += f", and state it with --correct '{fault.correction}'"
        if self.refuse and self.drop:
            ends += ", or leave the bad samples out with --drop-bad"
        text = f"{self.text}{ends}."
        return fault.of(text) if fault else text


def the(log: Log, column: str) -> str:
    """Return the beginning of a sentence about a column."""
    return f"Column {column} of {log.short_name}"


def others(things: Collection[object], thing: str = "more run") -> str:
    """Return ` (and 3 more runs)` for what a sentence names one of, or nothing."""
    return f" (and {counted(len(things) - 1, thing)})" if len(things) > 1 else ""
