"""Columns that never change, or were recorded at a lower rate than the others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.limits import is_moving, is_reading, is_reference, tells
from hallsym.log.quality.findings import Finding, others, the
from hallsym.log.quality.motion import gains, is_noisy
from hallsym.log.quality.runs import FEWEST_SAMPLES
from hallsym.log.quality.scan import WHOLE_ROWS, Scan, Span, Spans
from hallsym.units import Array

_FEWEST_CHANGES = 16
_ALIKE = 0.6
"""Share of the values that a slow logger repeats as often as the usual one."""
_GOES_ON = 0.5
"""What other columns do while one repeats its value, over what they do until it goes on, per share of samples
that repeat: 1 for a slow logger, about 0 where all of them step from rest to rest."""
_CODE_AT = 0.005
"""Quantile of the changes that is one code of a converter if there is one: outliers make smaller ones."""
_OFTEN = 0.02
"""Share of samples that are equal to the one before from which a column is looked at."""
_SLOW = 4.0
"""Usual change over the least one from which values that repeat are those of a slow channel: those of a
coarse converter change by one code most of the time."""


def dead(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Readings that never change, or not in a run in which the references say that they should."""
    for name in filter(is_reading, spans.overall):
        overall = spans.overall[name]
        if overall.min == overall.max:
            yield Finding(
                f"{the(log, name)} never changes; it is {overall.min:.6g} in all {seen.rows} samples",
                True, remedy="check the probe, its wiring and the step of its converter",
            )  # fmt: skip
            continue
        still = [run for run, span in spans.runs.items() if _still(name, span, spans.samples[run])]
        still = [run for run in still if _should_move(log, seen, name, run, spans.runs)]
        if still:
            yield Finding(
                f"{the(log, name)} never changes in run {still[0]}{others(still)} although the reference"
                " moves",
                True, Drop(runs=frozenset(still)), remedy="check the probe and its wiring",
            )  # fmt: skip


def _still(name: str, spans: Mapping[str, Span], samples: int) -> bool:
    if not _rests(spans[name]) or samples < FEWEST_SAMPLES:
        return False
    return not any(_rests(span) for column, span in spans.items() if is_reference(column))


def _should_move(log: Log, seen: Scan, name: str, run: int, runs: Mapping[int, Mapping[str, Span]]) -> bool:
    """Say whether noise or the references' motion should have moved a reading that is constant in a run."""
    steady = [r for r, span in runs.items() if _rests(span[name])]
    live = next(r for r in runs if r not in steady)
    if is_noisy(log.run(live, (name,))[name]):
        return True
    whole = seen.sample.whole
    x, here, good = whole.data[name], whole.run == run, ~np.isin(whole.run, steady)
    motion = [values for c, values in whole.data.items() if is_reference(c)]
    found = gains(x, motion, good)
    if found is None or not found.believed:
        repeats = seen.traces[name].repeats - sum(seen.samples[r] - 1 for r in steady)
        return repeats < seen.rows / 2
    return found.moves([values[here] for values in motion])


def stale(log: Log, seen: Scan, spans: Spans, rails: Drop) -> Iterator[Finding]:
    """Columns that were recorded at a lower rate; in a run where a column rests there is nothing to repeat.

    Nor is there on a rail: columns of `rails` are not judged.
    """
    ends = {name for name, _, _ in rails.between}
    for name, trace in seen.traces.items():
        if not is_moving(name) or name not in spans.overall or name in ends:
            continue
        resting = [n for run, n in spans.samples.items() if _rests(spans.runs[run][name])]
        repeats, rows = trace.repeats - sum(resting) + len(resting), seen.rows - sum(resting)
        if repeats <= _OFTEN * rows or not (share := _repeats(log, name)):
            continue
        yield Finding(
            f"{the(log, name)} repeats each value about {1 / (1 - share):.0f} times: it was recorded at a"
            " lower rate than the others, which looks like a delay",
            remedy="record all columns at one rate",
        )


def _rests(span: Span) -> bool:
    return span.min == span.max


def _repeats(log: Log, column: str) -> float:
    """Return the share of samples that repeat the one before because of the logger; 0 where they need not.

    Where the motion rests, what the column tells of rests too.
    """
    beside = tuple(c for c in log.columns if tells(c, column))
    shares, inside, across = [], np.zeros(len(beside)), np.zeros(len(beside))
    for block in log.blocks((column, *beside), size=WHOLE_ROWS):
        step = np.abs(np.diff(block.data[column]))
        changes = np.flatnonzero(step)
        if len(changes) >= _FEWEST_CHANGES:
            shares.append(_repeated(step))
        first, last = changes[:-1] + 1, changes[1:]
        held = first < last
        for k, name in enumerate(beside):
            x = block.data[name]
            inside[k] += np.abs(x[last] - x[first])[held].sum()
            across[k] += np.abs(x[last + 1] - x[first])[held].sum()
    share = float(np.median(shares)) if shares else 0.0  # a logger is late in every run
    goes_on = inside > _GOES_ON * share * across
    return share if not beside or goes_on.all() else 0.0


def _repeated(step: Array) -> float:
    """Return the share of absolute steps (n,) that are nil by the logger, or 0.

    A slow logger repeats each value equally often. A coarse converter repeats by itself where the motion is
    slow: then its steps are mostly one code.
    """
    changes = np.flatnonzero(step)
    size, lasts = step[changes], np.diff(changes)
    code, usual = float(np.quantile(size, _CODE_AT)), float(np.median(lasts))
    if np.median(size) < _SLOW * code:
        return 0.0
    alike = np.abs(lasts - usual) <= usual / 4
    if usual < 2 or alike.mean() <= _ALIKE:
        return 0.0
    return 1.0 - 1.0 / float(lasts[alike].mean())
