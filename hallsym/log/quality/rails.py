"""Readings that are cut off at the ends of their range: both rails together, with or without noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.limits import is_reading, is_reference
from hallsym.log.quality.cut_off import is_cut_off
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.piles import SAME, piles
from hallsym.log.quality.sample import WHOLE_ROWS, Whole
from hallsym.log.quality.scan import Scan
from hallsym.units import Array, si_symbol

REFUSE = 0.05
"""Share of the samples on the rails from which a log is refused. A sine cut off for 5 % of the
time lacks 0.3 % of its stroke, which matters to nothing; beyond it a calibration extrapolates."""


@dataclass(frozen=True)
class Rails:
    """The rails of a reading: samples that are not between `low` and `high` lie on them (-inf, inf: none).

    `at` holds the level of each rail, `share` that of the samples on them; `worst` the run with the largest.
    """

    low: float
    high: float
    at: tuple[float, ...]
    share: float
    worst: tuple[int, float]


def saturated(log: Log, seen: Scan) -> Iterator[Finding]:
    """Readings with samples on a rail."""
    for name in filter(is_reading, seen.traces):
        trace = seen.traces[name]
        if trace.nonfinite or not trace.low < trace.high:
            continue
        if max(trace.at_low, trace.at_high) >= SAME or piles(seen.sample.whole.ordered(name)):
            rails = _rails(_samples(log, seen, name), name)
            if rails:
                yield _finding(log, name, rails, seen.rows)


def _finding(log: Log, name: str, rails: Rails, rows: int) -> Finding:
    count, unit = round(rails.share * rows), si_symbol(name)
    where = " and ".join(f"{level:.4g}" for level in rails.at)
    refuse = rails.share > REFUSE
    return Finding(
        f"{the(log, name)} is saturated: {count} samples ({rails.share:.1%}) lie on its"
        f" rail{'s' if len(rails.at) > 1 else ''} at {where} {unit}, most in run {rails.worst[0]}"
        f" ({rails.worst[1]:.0%})",
        refuse, Drop(between=((name, rails.low, rails.high),)), remedy="lower the gain or the travel",
    )  # fmt: skip


def _samples(log: Log, seen: Scan, name: str) -> Whole:
    """Return a reading beside the references: whole, or thinned where the log is long."""
    references = [column for column in seen.traces if is_reference(column)]
    if seen.rows > WHOLE_ROWS:
        thinned = seen.sample.whole
        return Whole(thinned.run, {c: thinned.data[c] for c in (name, *references)})
    return Whole.of(log, (name, *references))


def _rails(whole: Whole, name: str) -> Rails | None:
    """Find both ends, then whether the reading is cut off there or rests or turns there."""
    references = [column for column in whole.data if is_reference(column)]
    x = whole.data[name]
    found = piles(whole.ordered(name))
    free = ~np.any([pile.of(x) for pile in found], axis=0) if found else np.empty(0, bool)
    motion = [whole.data[column] for column in references]
    found = [pile for pile in found if not motion or is_cut_off(x, motion, whole.run, pile, free)]
    if not found:
        return None
    on = np.any([pile.of(x) for pile in found], axis=0)
    return Rails(
        max((pile.edge for pile in found if pile.sign < 0), default=-np.inf),
        min((pile.edge for pile in found if pile.sign > 0), default=np.inf),
        tuple(sorted(float(np.median(x[pile.of(x)])) for pile in found)),
        float(np.mean(on)),
        _worst(whole.run, on),
    )


def _worst(run: Array, on: Array) -> tuple[int, float]:
    runs, inverse, counts = np.unique(run, return_inverse=True, return_counts=True)
    shares = np.bincount(inverse, weights=on) / counts
    worst = int(np.argmax(shares))
    return int(runs[worst]), float(shares[worst])
