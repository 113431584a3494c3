"""Numbers of a diagnosis as its page shows them."""

from __future__ import annotations

import math
import re

from hallsym.diagnosis import Diagnosis
from hallsym.report.text.diagnosis import p_text
from hallsym.report.words import MINUS


def changed(d: Diagnosis) -> bool:
    """Return whether there is an after that differs from before."""
    return bool(d.effects or d.ranked)


def percent(value: float, digits: int = 1) -> str:
    """Return a share in per cent; nothing where it does not exist."""
    return "" if not math.isfinite(value) else f"{100 * value:.{digits}f} %".replace("-", MINUS)


def with_interval(value: float, interval: tuple[float, float] | None) -> str:
    """Return a share and its interval in per cent: `61.0 % (57.0 to 64.0)`; of each what exists."""
    if interval is None or not all(map(math.isfinite, (value, *interval))):
        return percent(value)
    return f"{100 * value:.1f} % ({100 * interval[0]:.1f} to {100 * interval[1]:.1f})".replace("-", MINUS)


def p_cell(value: float | None) -> str:
    """Return a p-value as a cell of a table, empty where there is none."""
    return "" if value is None or math.isnan(value) else p_text(value).replace("-", MINUS)


def typeset(text: str) -> str:
    """Return words with the micro sign in units."""
    return re.sub(r"(?<=\d )u(?=(m|rad)\b)", "µ", text)
