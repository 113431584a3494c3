"""Values that cannot be what was measured: at rest, held, or recorded twice."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from hallsym.log.columns import is_moving, is_reading, is_reference, run_list, tells
from hallsym.log.core import Block, Drop, Log
from hallsym.log.quality.findings import Fault, Finding, name_of, others, the
from hallsym.log.quality.scan import (
    FEWEST_SAMPLES,
    HELD_SAMPLES,
    Scan,
    Span,
    Spans,
    equal_by_chance,
    is_noisy,
    noise_in_codes,
    stretches,
)
from hallsym.units import Array, si_symbol


def dead(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Readings that never change, or not in a run in which the references say that they should."""
    runs, long = list(spans.samples), np.array(list(spans.samples.values())) >= FEWEST_SAMPLES
    for c in filter(is_reference, spans.overall):
        long &= ~spans.rests(c)
    for name in filter(is_reading, spans.overall):
        overall = spans.overall[name]
        if overall.min == overall.max:
            yield Finding(
                f"{the(log, name)} never changes; it is {overall.min:.6g} in all {seen.rows} samples",
                claim="stuck", columns=(name,),
                remedy="check the probe, its wiring and the step of its converter",
            )  # fmt: skip
            continue
        rests = spans.rests(name)
        still = [runs[k] for k in np.flatnonzero(long & rests)]
        if still and is_noisy(log.run(runs[int(np.argmin(rests))], (name,))[name]):
            yield Finding(
                f"{the(log, name)} never changes in run {still[0]}{others(still)} although the reference"
                " moves",
                claim="stuck", drop=Drop(runs=frozenset(still)), remedy="check the probe and its wiring",
                columns=(name,), runs=tuple(still),
                correction=f"stuck {name} 0 {max(seen.samples[run] for run in still)} in {run_list(still)}",
            )  # fmt: skip


def _steady(spans: Spans, column: str) -> list[int]:
    """Return the runs in which a column holds one value."""
    return [run for run, rests in zip(spans.samples, spans.rests(column), strict=True) if rests]


_CHANGES = 16
_EVENLY = 0.8
"""Share of the changes of a column that come after the usual number of samples, or one more or less, of one
that is recorded at a lower rate: a coarse converter changes as fast as the motion."""


def repeated(log: Log, columns: Iterable[str]) -> Iterator[Fault]:
    """Yield the claim that columns were recorded at a lower rate than the others.

    An axis that steps from rest to rest looks the same; a model that describes a log is not asked for it.
    """
    for name in filter(is_moving, columns):
        first = next(log.blocks((name,)))
        lasts = np.diff(np.flatnonzero(np.diff(first.data[name])))
        usual = float(np.median(lasts)) if len(lasts) >= _CHANGES else 0.0
        if usual >= 2 and np.mean(np.abs(lasts - usual) <= 1) > _EVENLY:
            yield Fault(
                f"{the(log, name)} repeats each value about {usual:.0f} times: it was recorded at a lower "
                "rate than the others, which looks like a delay; record all columns at one rate.",
                "low_rate", (name,),
            )  # fmt: skip


_JUMP = 3.0
"""Usual steps of a column that it goes on with after a stretch of old samples."""
_CHANCE = 1e-6
"""Probability that noise repeats a code for so long somewhere in a block from which it is no chance."""
_AT_A_TURN = 4.0
"""Equal neighbours at a turning point over those elsewhere, at most."""


class Stretch(NamedTuple):
    """Samples `start` to `stop` of the log in which a column of `run` holds `value`."""

    run: int
    start: int
    stop: int
    value: float


def held(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Columns that hold one value for a while although they move, or should, before, meanwhile or after."""
    for name, trace in seen.traces.items():
        if not is_moving(name) or not trace.held or name not in spans.overall:
            continue
        found = _off_ends(_stretches(log, seen, name, spans), spans.overall[name])
        if not found:
            continue
        lasts, first = [one.stop - one.start for one in found], found[0]
        stretches_of = "1 stretch" if len(found) == 1 else f"{len(found)} stretches"
        undone = _correction(spans, name, found)
        cause = (
            "the logger repeated old samples"
            if any(one.value for one in found)
            else "the channel dropped out"
        )
        cause = "it stops at an end of its range" if (undone or "").startswith("clipped") else cause
        yield Finding(
            f"{the(log, name)} holds one value for up to {max(lasts)} samples ({stretches_of},"
            f" {sum(lasts) / seen.rows:.1%}, first in row {first.start + 1}, run {first.run},"
            f" {first.value:.4g} {si_symbol(name)}): {cause}",
            claim="stuck", drop=Drop(rows=tuple((one.start, one.stop) for one in found)),
            remedy="look at the channel and the logger", columns=(name,),
            runs=tuple(dict.fromkeys(one.run for one in found)),
            correction=undone,
        )  # fmt: skip


def _off_ends(found: list[Stretch], span: Span) -> list[Stretch]:
    """Return the stretches that are at no rail: at an end of the range more than once; the fit finds that."""
    ends = [end for end in (span.min, span.max) if sum(one.value == end for one in found) > 1]
    return [one for one in found if one.value not in ends]


def _correction(spans: Spans, name: str, found: list[Stretch]) -> str | None:
    """Return what undoes the first stretch, a rail where it is at an end of what its run holds.

    None where the fit tells: at an end of what the column holds other runs may stop too, and what is late
    repeats its first or last value at an end of each run.
    """
    whole = spans.overall[name]
    starts = dict(zip(spans.samples, np.cumsum([0, *spans.samples.values()]).tolist(), strict=False))
    low, high = (dict(zip(spans.samples, row, strict=True)) for row in spans.by_run[name][:2])
    for one in found:
        run, a, b = one.run, one.start - starts[one.run], one.stop - starts[one.run]
        if a == 0 or b == spans.samples[run] or one.value in (whole.min, whole.max):
            continue
        if one.value not in (low[run], high[run]):
            return f"stuck {name} {a} {b} in {run}"
        ends = {stretch.value for stretch in found if stretch.run == run}
        rails = (low[run] if low[run] in ends else -np.inf, high[run] if high[run] in ends else np.inf)
        return f"clipped {name} {rails[0]:.9g} {rails[1]:.9g} in {run}"
    return None


def _stretches(log: Log, seen: Scan, name: str, spans: Spans) -> list[Stretch]:
    beside = tuple(c for c in seen.traces if tells(c, name))
    steady = _steady(spans, name)
    found: list[Stretch] = []
    row = 0
    for block in log.blocks((name, *beside)):
        x = block.data[name]
        if block.run not in steady:
            found += [
                Stretch(block.run, row + a, row + b, float(x[a])) for a, b in _frozen(block, name, beside)
            ]
        row += len(x)
    return found


def _frozen(block: Block, name: str, beside: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return (start, stop) of the stretches of one value in a block that cannot be a rest."""
    x = block.data[name]
    step = np.abs(np.diff(x))
    long = [(a, b + 1) for a, b in stretches(step == 0, shortest=HELD_SAMPLES - 1)]
    if not long:
        return []
    free = np.ones(len(x), bool)
    for a, b in long:
        free[a:b] = False
    between = free[1:] | free[:-1]
    moving = step[between & (step > 0)]
    if sure := _beyond_chance(x, long):
        return sure
    usual = float(np.median(moving)) if len(moving) else np.inf
    again = min(0.5, _AT_A_TURN * float(np.mean(step[between] == 0))) if between.any() else 0.5
    leaps = [_leaps(block.data[c], free) for c in beside]
    return [(a, b) for a, b in long if _jumps(step, a, b, usual, leaps) and _no_chance(len(x), again, b - a)]


def _beyond_chance(x: Array, long: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the stretches that the noise in the longest part of a column between them would have ended."""
    edges = [0, *(edge for pair in long for edge in pair), len(x)]
    parts = [x[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    codes = noise_in_codes(max(parts, key=len))
    if not codes:
        return []
    again = equal_by_chance(codes)
    return [(a, b) for a, b in long if _no_chance(len(x), again, b - a)]


def _no_chance(samples: int, again: float, length: int) -> bool:
    """Say whether a value does not repeat so often by chance, where it does once with probability `again`."""
    return samples * again ** (length - 1) < _CHANCE


def _leaps(other: Array, free: Array) -> Array:
    """Return (n - 1,) where another column makes an unusual step too: then the motion does."""
    step = np.abs(np.diff(other))
    usual = float(np.median(step[free[1:] & free[:-1]])) if (free[1:] & free[:-1]).any() else 0.0
    return np.asarray(step > _JUMP * usual)


def _jumps(step: Array, a: int, b: int, usual: float, leaps: list[Array]) -> bool:
    """Say whether a column goes on with a jump at either end of a stretch that no other column makes."""
    ends = [i for i in (a - 1, b - 1) if 0 <= i < len(step)]
    return any(step[i] > _JUMP * usual and not any(leap[i] for leap in leaps) for i in ends)


Pairs = dict[tuple[int, int], list[str]]
"""Columns that hold the same samples in two runs, the earlier first."""


def copied(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Samples that are there twice. Only columns with noise count: without it every repetition is alike."""
    if same := _same(log, seen, spans):
        yield _pasted(log, same, spans)
    known: dict[tuple[int, ...], str] = {}
    for name in filter(is_moving, spans.overall):
        if spans.overall[name].min == spans.overall[name].max:
            continue
        twin = known.setdefault(tuple(seen.bit_sums(name)), name)
        if twin != name and is_noisy(log.run(seen.segments[0][0], (name,))[name]):
            yield Finding(
                f"Columns {twin} and {name} of {name_of(log)} hold the same samples:"
                " one signal was logged twice",
                claim="copied_column", columns=(twin, name),
                remedy="check which column of the logger is which",
            )  # fmt: skip


def _same(log: Log, seen: Scan, spans: Spans) -> Pairs:
    """Return the columns that are equal bit for bit in two runs, where one of them carries noise."""
    pairs: Pairs = defaultdict(list)
    noisy: set[tuple[int, int]] = set()
    for name in filter(is_moving, spans.overall):
        sums = seen.bit_sums(name)
        if len(set(sums)) == len(sums):
            continue
        groups: dict[tuple[int, int], list[int]] = defaultdict(list)
        steady = _steady(spans, name)
        for run, bits in zip(spans.samples, sums, strict=True):
            if run not in steady:
                groups[bits, spans.samples[run]].append(run)
        for first, *later in groups.values():
            values = log.run(first, (name,))[name] if later else np.empty(0)
            equal = [(first, r) for r in later if np.array_equal(log.run(r, (name,))[name], values)]
            noisy.update(equal if is_noisy(values) else ())
            for pair in equal:
                pairs[pair].append(name)
    return {pair: pairs[pair] for pair in sorted(noisy, key=lambda pair: pair[::-1])}


def _pasted(log: Log, same: Pairs, spans: Spans) -> Finding:
    """Of a run that is a copy, the first one is good; of columns in two runs, either may be wrong."""
    told = [c for c in spans.overall if is_reading(c) or is_reference(c)]
    runs = list(spans.samples)
    wrong: set[int] = set()
    for pair, c in same.items():
        later = runs.index(pair[1])
        whole = all(name in c or spans.rests(name)[later] for name in told)
        wrong |= set(pair[1:] if whole else pair)
    (first, run), names = next(iter(same.items()))
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    subject, verb = ("Columns", "hold") if len(names) > 1 else ("Column", "holds")
    return Finding(
        f"{subject} {shown} of {name_of(log)} {verb} the same samples in runs {first} and {run}"
        f"{others(same, 'more pair')}",
        claim="copied_run", drop=Drop(runs=frozenset(wrong)) if len(wrong) < len(runs) else None,
        remedy="remove a run that is a copy, or give each run the columns that were recorded with it",
        columns=tuple(names), runs=tuple(sorted(wrong)), correction=f"copied_run in {run_list([*wrong])}",
    )  # fmt: skip
