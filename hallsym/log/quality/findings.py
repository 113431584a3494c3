"""What a scan of a log reveals, each fault as one sentence: what, where, what was expected, what to do."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hallsym.errors import counted
from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.limits import is_moving, is_reading, is_reference, likely_unit, limit_of
from hallsym.log.quality.scan import Scan, Span, Spans
from hallsym.log.quality.suspects import held, piled_up, repeats_each
from hallsym.units import split_unit

FEWEST_SAMPLES = 8
_MISSING_NOTE, _MISSING_REFUSE = 0.0, 0.02
_SATURATED_NOTE, _SATURATED_REFUSE = 0.005, 0.05
_LONGEST_TICK_S = 100.0


@dataclass(frozen=True)
class Finding:
    """A fault, `text` without its end. `refuse` stops the work, unless `drop` or `bear` helps (drop_bad)."""

    text: str
    refuse: bool = False
    drop: Drop | None = None
    bear: bool = False
    remedy: str = ""

    @property
    def sentence(self) -> str:
        """The whole sentence."""
        way = "leave the bad samples out with --drop-bad" if self.drop else "accept it with --drop-bad"
        ends = [self.remedy] if self.remedy else []
        ends += [way] if self.refuse and (self.drop or self.bear) else []
        return self.text + (": " if ends else "") + ", or ".join(ends) + "."


def finite(log: Log, scan: Scan, required: Sequence[str]) -> Iterator[Finding]:
    """NaN and infinity; a column without any finite value matters only if it is required."""
    for name, trace in scan.traces.items():
        if trace.nonfinite == scan.rows and name not in required:
            yield Finding(f"{_the(log, name)} has no finite value and is not used")
        elif trace.nonfinite == scan.rows:
            yield Finding(f"{_the(log, name)} has no finite value", True, remedy="record it again")
        elif trace.nonfinite:
            row = trace.first_nonfinite
            yield Finding(
                f"{_the(log, name)} must be finite; {trace.nonfinite} of {scan.rows} values are NaN or"
                f" infinite, the first in row {row + 1} (run {scan.run_of(row)})",
                True, Drop(finite=(name,)), remedy="repair them",
            )  # fmt: skip


def time(log: Log, scan: Scan) -> Iterator[Finding]:
    """Time that runs backwards or repeats, a unit that is not seconds, and missing ticks."""
    clock = scan.clock
    if clock is None:
        return
    if clock.first_backward:
        row, run, t, step = clock.first_backward
        how = "repeats" if step == 0 else "runs backwards"
        yield Finding(
            f"{_the(log, 't_s')} must increase within a run; it {how} {clock.backward} times, first in row"
            f" {row + 1} (run {run}) at {t:.6g} s",
            True, Drop(forward=True), remedy="sort the samples by time or number the runs",
        )  # fmt: skip
        return
    if clock.tick > _LONGEST_TICK_S:
        yield _unit(log, "t_s", f"its usual step is {clock.tick:.4g} s", "ms" if clock.tick < 1e4 else "us")
    share = clock.missing / max(1, clock.missing + clock.steps)
    if clock.first_missing and share > _MISSING_NOTE:
        row, run, t, step = clock.first_missing
        yield Finding(
            f"{_the(log, 't_s')} misses {clock.missing} ticks ({share:.2%}), first after {t:.6g} s in row"
            f" {row + 1} (run {run}), a step of {step:.4g} s",
            share > _MISSING_REFUSE, bear=True,
            remedy="number the stretches around a pause as runs" if share > _MISSING_REFUSE else "",
        )  # fmt: skip


def units(log: Log, spans: Spans) -> Iterator[Finding]:
    """Columns that span more than their unit allows."""
    for name, span in spans.overall.items():
        limit = limit_of(name)
        if limit is None:
            continue
        extent = span.max - span.min
        unit = split_unit(name)[1]
        symbol = unit.si if unit else ""
        if extent > limit.span:
            what = f"it spans {extent:.4g} {symbol}, more than {limit.what} ({limit.span:g} {symbol})"
        elif span.max > limit.level:
            what = f"it reaches {span.max:.4g} {symbol}, beyond {limit.level:g} {symbol}"
        else:
            continue
        yield _unit(log, name, what, likely_unit(limit, extent))


def counts(log: Log, spans: Spans) -> Iterator[Finding]:
    """Readings in counts beyond what a turn has."""
    for name, span in spans.overall.items():
        turn = log.table.counts_per_turn(name)
        if turn is None or not is_reading(name):
            continue
        low, high = (value * turn / (2 * math.pi) for value in (span.min, span.max))
        one_sided, signed = (
            low >= -0.5 and high <= turn + 0.5,
            -0.5 * turn - 0.5 <= low and high <= 0.5 * turn + 0.5,
        )
        if not one_sided and not signed:
            yield Finding(
                f"{_the(log, name)} holds counts from {low:.6g} to {high:.6g} where a turn has {turn:.6g}",
                True, remedy="check --counts-per-turn, and samples that are not readings",
            )  # fmt: skip


def short_runs(log: Log, scan: Scan) -> Iterator[Finding]:
    """Runs with too few samples to say anything."""
    short = {run: n for run, n in scan.samples.items() if n < FEWEST_SAMPLES}
    if short:
        run, n = next(iter(short.items()))
        yield Finding(
            f"Every run of {log.name} must have at least {FEWEST_SAMPLES} samples; run {run} has"
            f" {n}{_others(short)}",
            True, Drop(runs=frozenset(short)) if len(short) < len(scan.samples) else None,
            remedy="record longer runs",
        )  # fmt: skip


def dead(log: Log, scan: Scan, spans: Spans) -> Iterator[Finding]:
    """Readings that never change, or not in a run in which every reference does."""
    for name in filter(is_reading, spans.overall):
        overall = spans.overall[name]
        if overall.min == overall.max:
            yield Finding(
                f"{_the(log, name)} never changes; it is {overall.min:.6g} in all {scan.rows} samples",
                True, remedy="check the probe and its wiring",
            )  # fmt: skip
            continue
        still = [run for run, span in spans.runs.items() if _still(name, span, spans.samples[run])]
        repeats = scan.traces[name].repeats - sum(spans.samples[run] - 1 for run in still)
        if still and repeats < scan.rows / 2:
            yield Finding(
                f"{_the(log, name)} never changes in run {still[0]}{_others(still)} although the reference"
                " moves",
                True, Drop(runs=frozenset(still)), remedy="check the probe and its wiring",
            )  # fmt: skip


def saturated(log: Log, scan: Scan) -> Iterator[Finding]:
    """Readings cut off at their greatest or least value."""
    for name, trace in scan.traces.items():
        for level, count in ((trace.high, trace.at_high), (trace.low, trace.at_low)):
            share = count / scan.rows
            if share <= _SATURATED_NOTE or trace.low == trace.high or not piled_up(log, name, level):
                continue
            yield Finding(
                f"{_the(log, name)} is saturated: {count} samples ({share:.1%}) sit exactly at {level:.6g}",
                share > _SATURATED_REFUSE, Drop(levels=((name, level),)),
                remedy="lower the gain or the travel" if share > _SATURATED_REFUSE else "",
            )  # fmt: skip


def stale(log: Log, scan: Scan, spans: Spans) -> Iterator[Finding]:
    """Samples that the logger repeated; in a run where a column rests there is nothing to repeat."""
    for name, trace in scan.traces.items():
        if not is_moving(name) or name not in spans.overall:
            continue
        resting = [n for run, n in spans.samples.items() if _rests(spans.runs[run][name])]
        repeats, rows = trace.repeats - sum(resting) + len(resting), scan.rows - sum(resting)
        if repeats > rows / 2 and (times := repeats_each(log, name)):
            yield Finding(
                f"{_the(log, name)} repeats each value about {times:.0f} times: it was recorded at a lower"
                " rate than the others, which looks like a delay"
            )
        elif trace.held and (found := held(log, name)):
            yield Finding(
                f"{_the(log, name)} holds one value for up to {found.longest} samples while it moves before"
                f" and after ({found.stretches} stretches, first in row {found.row + 1}, run {found.run}):"
                " the logger repeated old samples"
            )


def _rests(span: Span) -> bool:
    return span.min == span.max


def _unit(log: Log, name: str, what: str, unit: str | None) -> Finding:
    stem = split_unit(name)[0]
    source = log.table.source_name(name)
    guess = f"it looks like {unit}, so say --column {stem}_{unit}={source}" if unit else "check its unit"
    return Finding(f"{_the(log, name)} cannot be in that unit; {what}", True, remedy=guess)


def _the(log: Log, name: str) -> str:
    return f"Column {name} of {log.name}"


def _still(name: str, spans: dict[str, Span], samples: int) -> bool:
    if spans[name].min < spans[name].max or samples < FEWEST_SAMPLES:
        return False
    return all(span.min < span.max for column, span in spans.items() if is_reference(column))


def _others(runs: Sequence[int] | dict[int, int]) -> str:
    return f" (and {counted(len(runs) - 1, 'more run')})" if len(runs) > 1 else ""
