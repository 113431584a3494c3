"""A diagnosis record as its page reads it: what may be missing, and numbers as they are shown."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from hallsym.report.text.diagnosis import p_text
from hallsym.report.words import MINUS

Record = Mapping[str, Any]


def floor_of(record: Record) -> dict[str, float]:
    """Return the noise floor by output or channel."""
    found = record.get("noise_floor") or {}
    return {c: v for c, v in found.items() if isinstance(v, int | float) and math.isfinite(v)}


def log_of(record: Record) -> Record:
    """Return what the record says of its log."""
    return record.get("log") or {}


def source_of(record: Record, before: str = "") -> str:
    """Return whether the noise floor was stated or estimated."""
    source = (record.get("noise_floor") or {}).get("source")
    return f"{before}{source}" if source else ""


def changed(record: Record) -> bool:
    """Return whether there is an after that differs from before."""
    return bool(record.get("effects") or record.get("ranked"))


def pair(interval: Sequence[float] | None) -> tuple[float, float] | None:
    """Return both ends of an interval, None where one is missing."""
    return None if not interval or None in interval else (float(interval[0]), float(interval[1]))


def interval_text(interval: Sequence[float] | None) -> str:
    """Return an interval of shares in per cent, in parentheses; nothing where an end is missing."""
    ends = pair(interval)
    return f" ({100 * ends[0]:.1f} to {100 * ends[1]:.1f})".replace("-", MINUS) if ends else ""


def percent(value: float, digits: int = 1) -> str:
    """Return a share in per cent."""
    return f"{100 * value:.{digits}f} %".replace("-", MINUS)


def p_cell(value: float | None) -> str:
    """Return a probability as a cell of a table, empty where there is none."""
    if value is None:
        return ""
    return p_text(value).replace("-", MINUS)


def typeset(text: str) -> str:
    """Return words with the micro sign in units."""
    return re.sub(r"(?<=\d )u(?=(m|rad)\b)", "µ", text)
