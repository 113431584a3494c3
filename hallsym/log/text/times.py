"""Times as text: dates with a time of day, or a time of day, as seconds from the first sample."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.arrow import Onward
from hallsym.log.extras import load

_CLOCK = r"\d{1,2}:\d{2}:\d{2}(?:[.,]\d{1,9})?"
_ZONE = r"(?:Z|[+-]\d{2}:?\d{2})"
_DATES = {
    "year first": r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}",
    "day.month": r"\d{1,2}\.\d{1,2}\.\d{4}",  # dots: everywhere the day stands first
    "open": r"\d{1,2}[-/]\d{1,2}[-/]\d{4}",
}


@dataclass(frozen=True)
class TimeForm:
    """How times are written: `date` as in `_DATES`, "" for a time of day alone; whether a zone is stated."""

    date: str
    zoned: bool

    @property
    def said(self) -> str:
        """What the form is called."""
        return "dates with times" if self.date else "times of day"


def time_form(cells: Sequence[str]) -> TimeForm | None:
    """Return the form that all cells of a column have; None where they are no times."""
    if not cells:
        return None
    for date, pattern in {**_DATES, "": ""}.items():
        start = rf"{pattern}[T ]\s*" if pattern else ""
        for zone in ("", rf"\s*{_ZONE}") if date else ("",):
            whole = re.compile(rf"\s*{start}{_CLOCK}{zone}\s*")
            if all(whole.fullmatch(cell) for cell in cells):
                return TimeForm(date, bool(zone))
    return None


class Seconds:
    """Turns chunks of one column of times into seconds from its first one, in the order of the file."""

    def __init__(self, form: TimeForm, what: str) -> None:
        """Begin; `what` names the column in messages."""
        self.form, self.what = form, what
        self._day_first: bool | None = None
        self._first: int | None = None
        self._onward = Onward()
        self._dates: set[str] = set()

    def __call__(self, cells: Any) -> np.ndarray:
        """Return seconds (samples,) of an Arrow array of strings; a missing cell is nan."""
        arrow, compute = load("pyarrow"), load("pyarrow.compute")
        text = compute.utf8_trim_whitespace(cells.cast(arrow.string()))
        text = compute.replace_substring_regex(text, ",", ".")
        if self.form.date == "open":
            self._decide(text, compute)
        for pattern, plain in self._steps():
            text = compute.replace_substring_regex(text, pattern, plain)
        kind = arrow.timestamp("ns", "UTC") if self.form.zoned else arrow.timestamp("ns")
        try:
            times = text.cast(kind).cast(arrow.int64())
        except arrow.ArrowInvalid as error:
            raise InputError(
                f"{self.what} must hold {self.form.said} written alike in every line; one is not "
                f"({str(error)[:80]}): put it right, or leave the line out."
            ) from error
        missing = np.asarray(compute.is_null(times))
        values = np.asarray(compute.fill_null(times, 0), dtype=np.int64)
        seconds = self._from_first(values, missing)
        return seconds if self.form.date else self._onward(seconds)

    def _from_first(self, values: np.ndarray, missing: np.ndarray) -> np.ndarray:
        known = np.flatnonzero(~missing)
        if self._first is None and len(known):
            self._first = int(values[known[0]])
        seconds = (values - (self._first or 0)) * 1e-9
        seconds[missing] = np.nan
        return seconds

    def _decide(self, text: Any, compute: Any) -> None:
        """Find which number of a date is the day, where that matters: not while all dates are the same."""
        if self._day_first is not None:
            return
        dates = compute.unique(compute.replace_substring_regex(text, r"[-/](\d{4})\s.*$", r"/\1")).to_pylist()
        pairs = [re.split("[-/]", date)[:2] for date in dates if date]
        first, second = (max((int(pair[k]) for pair in pairs), default=0) for k in (0, 1))
        self._dates |= {date for date in dates if date}
        if max(first, second) > 12 and self._first is None:
            self._day_first = first > 12
        elif len(self._dates) > 1:
            raise InputError(
                f"{self.what} holds dates such as {min(self._dates)}, whose day may stand first or second: "
                "write the year first, 2026-04-03."
            )

    def _steps(self) -> list[tuple[str, str]]:
        """Return the replacements that make ISO 8601 of a time."""
        pad = (r"(^|[-/. T])(\d)([-/.:])", r"\1" + r"0\2\3")
        day, month = (r"\2", r"\1") if not self._day_first else (r"\1", r"\2")
        swaps = {
            "": [("^", "1970-01-01 ")],
            "year first": [(r"^(\d{4})[-/.](\d\d)[-/.](\d\d)", r"\1-\2-\3")],
            "day.month": [(r"^(\d\d)\.(\d\d)\.(\d{4})", r"\3-\2-\1")],
            "open": [(r"^(\d\d)[-/](\d\d)[-/](\d{4})", rf"\3-{month}-{day}")],
        }[self.form.date]
        return [pad, pad, *swaps, (r"\s+", " "), (r" ?([+-]\d\d):?(\d\d)$", r"\1:\2"), (r" Z$", "Z")]
