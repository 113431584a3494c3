"""Values that no machine reaches: a unit that cannot be, counts beyond a turn, a clock in another unit."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence

from hallsym.log.core import Log
from hallsym.log.limits import fastest, is_reference, likely_units, limit_of
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.scan import Scan, Spans
from hallsym.units import UNITS, si_unit, split_unit

_LONGEST_TICK_S = 100.0
_SLOW_TICK_S = 1.0
"""Usual step of a clock from which on it may be in ms: motion is recorded at 10 Hz and faster, and a log that
is slower than 1 Hz approaches its points one by one. Nothing else tells the two apart."""
_TOLD_DECADES = 1.0
"""So many decades nearer to what other columns span, a unit is the only one that is named."""


def units(log: Log, spans: Spans) -> Iterator[Finding]:
    """Columns that span more than their unit allows."""
    extents = {name: span.max - span.min for name, span in spans.overall.items()}
    for name, span in spans.overall.items():
        limit = limit_of(name)
        if limit is None:
            continue
        extent = extents[name]
        unit = split_unit(name)[1]
        symbol = UNITS[unit.si].symbol if unit else ""
        if extent > limit.span:
            what = f"it spans {extent:.4g} {symbol}, more than {limit.what} ({limit.span:g} {symbol})"
        elif span.max > limit.level:
            what = f"it reaches {span.max:.4g} {symbol}, beyond {limit.level:g} {symbol}"
        else:
            continue
        yield _unit(log, name, what, _beside(name, extents, likely_units(limit, extent)))


def clock_unit(log: Log, seen: Scan) -> Iterator[Finding]:
    """A clock that ticks too slowly for a recording, or so slowly that its unit is worth a remark."""
    tick = seen.clock.tick if seen.clock else 0.0
    if tick > _LONGEST_TICK_S:
        yield _unit(log, "t_s", f"its usual step is {tick:.4g} s", ["ms" if tick < 1e4 else "us"])
    elif tick > _SLOW_TICK_S and log.table.source_name("t_s") == "t_s":
        yield Finding(
            f"{the(log, 't_s')} has a usual step of {tick:.4g} s; if that is {tick:.4g} ms, say --column "
            "t_ms=t_s, or delays, time constants and frequencies will be 1000 times off"
        )


def speeds(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """A clock in which the references cross their range within a run faster than any machine."""
    if "t_s" not in spans.overall or log.counted:
        return
    for name in filter(is_reference, spans.overall):
        limit, unit = fastest(name), split_unit(name)[1]
        for run, columns in spans.runs.items():
            lasts, covers = (columns[c].max - columns[c].min for c in ("t_s", name))
            if unit and lasts > 0 and covers > limit * lasts:
                what = f"in run {run} {name} covers {covers:.3g} {UNITS[unit.si].symbol} in {lasts:.3g} s"
                yield _unit(log, "t_s", what, ["s"] if log.table.source_name("t_s") != "t_s" else [])
                return


def _beside(name: str, extents: Mapping[str, float], possible: Sequence[str]) -> Sequence[str]:
    """Return the unit of several possible ones that the other columns of the quantity tell; else all."""
    si = si_unit(name)
    others = [e for c, e in extents.items() if c != name and si_unit(c) == si and _usual(c, e)]
    if len(possible) < 2 or not others:
        return possible
    usual = statistics.median(others)
    off = {unit: abs(math.log10(extents[name] * UNITS[unit].factor / usual)) for unit in possible}
    best, second = sorted(possible, key=off.__getitem__)[:2]
    return [best] if off[second] - off[best] > _TOLD_DECADES else possible


def _usual(name: str, extent: float) -> bool:
    limit = limit_of(name)
    return limit is not None and 0 < extent <= limit.likely


def _unit(log: Log, name: str, what: str, units: Sequence[str]) -> Finding:
    stem = split_unit(name)[0]
    source = log.table.source_name(name)
    likely = " or ".join(UNITS[unit].symbol for unit in units)
    say = " or ".join(f"--column {stem}_{unit}={source}" for unit in units)
    guess = f"it looks like {likely}, so say {say}" if units else "check its unit"
    return Finding(f"{the(log, name)} cannot be in that unit; {what}", True, remedy=guess)
