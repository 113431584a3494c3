"""NaN and infinity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.scan import Scan


def finite(log: Log, seen: Scan, required: Sequence[str]) -> Iterator[Finding]:
    """NaN and infinity; a column without any finite value matters only if it is required."""
    for name, trace in seen.traces.items():
        if trace.nonfinite == seen.rows and name not in required:
            yield Finding(f"{the(log, name)} has no finite value and is not used")
        elif trace.nonfinite == seen.rows:
            yield Finding(f"{the(log, name)} has no finite value", True, remedy="record it again")
        elif trace.nonfinite:
            row = trace.first_nonfinite
            yield Finding(
                f"{the(log, name)} must be finite; {trace.nonfinite} of {seen.rows} values are NaN or"
                f" infinite, the first in row {row + 1} (run {seen.run_of(row)})",
                True, Drop(finite=(name,)), remedy="repair them",
            )  # fmt: skip
