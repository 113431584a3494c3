"""Pre-fit checks of a log for faults that occur in a lab, without a model."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import RUN, is_reference
from hallsym.log.core import Drop, Log, without
from hallsym.log.quality.findings import Fault, Finding, others, the
from hallsym.log.quality.scan import FEWEST_SAMPLES, Clock, Scan, Spans, scan
from hallsym.log.quality.values import copied, stuck
from hallsym.units import si_symbol, si_unit


def finite(log: Log, seen: Scan, required: Sequence[str]) -> Iterator[Finding]:
    """NaN and infinity; a column without any finite value matters only if it is required."""
    for name, trace in seen.traces.items():
        if trace.nonfinite == seen.rows and name not in required:
            yield Finding(f"{the(log, name)} has no finite value and is not used")
        elif trace.nonfinite == seen.rows:
            yield Finding(f"{the(log, name)} has no finite value", "record it again", refuse=True)
        elif trace.nonfinite:
            row, ends = trace.first_nonfinite, np.cumsum([n for _, n in seen.segments])
            run = seen.segments[int(np.searchsorted(ends, row, side="right"))][0]
            yield Finding(
                f"{the(log, name)} must be finite; {trace.nonfinite} of {seen.rows} values are NaN or"
                f" infinite, the first in row {row + 1} (run {run})",
                "repair them", refuse=True, drop=Drop(finite=(name,)),
            )  # fmt: skip


_PASSES = 6


def check_log(log: Log, required: Sequence[str] = ()) -> list[str]:
    """Return notes on a log, one sentence each; refuse one that cannot be read.

    `required` names the columns that will be used (none: all of them); only these are judged.
    """
    found = list(_judge(log, required))
    for finding in found:
        if finding.refuse:
            raise InputError(finding.said())
    return [*log.notes, *(finding.said() for finding in found)]


def clean_log(log: Log, required: Sequence[str] = ()) -> Log:
    """Return the log without its bad samples and runs; its `notes` say what was left out.

    Left out: samples with NaN or infinity, with time that does not advance, of a column that is frozen,
    copies of others, runs in which a reading is dead. A log that streams goes on streaming.
    """
    log, notes = usable(log, required, drop_bad=True)
    return replace(log, notes=tuple(notes))


def usable(
    log: Log, required: Sequence[str] = (), *, drop_bad: bool = False, accept: Collection[str] = ()
) -> tuple[Log, list[str]]:
    """Return the log to compute from, and notes on it; refuse one that cannot be read.

    Samples of which a claim says that they are bad are left out, unless its name is in `accept`; the log
    itself is returned where nothing is. With `drop_bad` samples that cannot be read are left out too, and
    nothing that was left out is a claim.
    """
    notes, began = list(log.notes), log
    for _ in range(_PASSES):
        said_of, drop = [], Drop()
        for finding in _judge(log.recording or log, required, thinned=log is not began):
            if finding.refuse and not (drop_bad and finding.drop):
                before = [f" ({note[:-1]})" for note in notes[len(log.notes) :]]
                raise InputError(f"{finding.said()[:-1]}{''.join(before[-1:])}.")
            if finding.claim in accept:
                said_of.append(f"{finding.text}.")
            elif finding.drop:
                drop |= finding.drop
                notes.append(f"{finding.text}; left out." if drop_bad else finding.said(left_out=True))
            else:
                said_of.append(finding.said())
        if not drop:
            break
        log = without(log, drop)
        if log.rows == 0:
            raise InputError(f"Nothing is left of {log.name} without its bad samples ({notes[-1][:-1]}).")
        if not drop_bad:
            break
    return log, [*notes, *said_of]


def spans(log: Log, columns: Sequence[str] | None = None) -> Spans:
    """Return min, max, mean and standard deviation of each column, overall and per run, from one pass."""
    return scan(log, log.columns if columns is None else columns).spans()


def _judge(log: Log, required: Sequence[str], *, thinned: bool = False) -> Iterator[Finding]:
    """Yield findings in the order in which to put them right; a later one may be due to an earlier.

    `thinned`: samples were left out of the log already, which are no missing ticks.
    """
    log.table.require(required)
    columns = tuple(required) or log.columns
    if "t_s" in log.columns:
        columns = tuple(dict.fromkeys(("t_s", *columns)))
    seen = scan(log, [name for name in columns if name != RUN])
    if seen.rows == 0:
        raise InputError(f"Log {log.name} has no samples; record it again.")
    spans = seen.spans()
    for found in (
        finite(log, seen, required),
        clock(log, seen.clock, thinned=thinned) if seen.clock and not log.counted else (),
        short_runs(log, seen),
        speeds(log, spans), copied(log, seen, spans), stuck(log, seen, spans),
    ):  # fmt: skip
        stop = False
        for finding in found:
            yield finding
            stop = stop or bool(finding.refuse and finding.drop)
        if stop:
            return


_CUT_SHORT = 0.1
"""Samples of a run over those of the usual run below which somebody, or something, ended it early."""
_FEW = 16
"""Samples of a run below which a frozen column, noise or a delay cannot be seen in it."""


def short_runs(log: Log, seen: Scan) -> Iterator[Finding]:
    """A log with too few samples to say anything; runs with far fewer than the others, or all with few."""
    samples, name = seen.samples, log.short_name
    if seen.rows < FEWEST_SAMPLES:
        yield Finding(
            f"{name} must have at least {FEWEST_SAMPLES} samples; it has {seen.rows}",
            "record more samples", refuse=True,
        )  # fmt: skip
        return
    usual = float(np.median(list(samples.values())))
    cut = [run for run, n in samples.items() if n < _CUT_SHORT * usual]
    if cut:
        yield Finding(
            f"Run {cut[0]} of {name} has {samples[cut[0]]} samples{others(cut)} where the usual run has"
            f" {usual:.0f}: it determines little more than its own offset; it may be cut short"
        )
    elif usual < _FEW:
        runs = "The usual run" if log.timed else "Each part that is compared"
        yield Finding(
            f"{runs} of {name} has {usual:.0f} samples: a frozen column, noise or a delay cannot be seen in"
            " so few"
        )


_LONGEST_TICK_S = 100.0
_SLOW_TICK_S = 1.0
"""Usual step of a clock above which it may be in ms: motion is recorded at 10 Hz and faster, and a log slower
than 1 Hz approaches its points one by one. Only the step distinguishes the two."""


def clock(log: Log, clock: Clock, *, thinned: bool) -> Iterator[Finding]:
    """Time that runs backwards, a unit that it may not be in, and ticks that are missing: a remark."""
    if clock.first_backward:
        row, run, t, step = clock.first_backward
        how = "repeats" if step == 0 else "runs backwards"
        yield Finding(
            f"{the(log, 't_s')} must increase within a run; it {how} {clock.backward} times, first in row"
            f" {row + 1} (run {run}) at {t:.6g} s",
            "sort the samples by time or number the runs", refuse=True, drop=Drop(forward=True),
        )  # fmt: skip
    tick, source = clock.tick, log.table.bindings["t_s"].source
    if tick > _LONGEST_TICK_S or (tick > _SLOW_TICK_S and source == "t_s"):
        unit = "ms" if tick < 1e4 else "us"
        text = (
            f"{the(log, 't_s')} has a usual step of {tick:.4g} s; if that is {tick:.4g} {unit}, say --column "
            f"t_{unit}={source}, or delays, time constants and frequencies will be off"
        )
        yield Finding(Fault(text, "clock_unit", ("t_s",)) if tick > _LONGEST_TICK_S else text)
    if clock.first_missing and not clock.first_backward and not thinned:
        row, run, t, step = clock.first_missing
        share = clock.missing / max(1, clock.missing + clock.steps)
        yield Finding(
            f"{the(log, 't_s')} misses {clock.missing} ticks ({share:.2%}), first after {t:.6g} s in row"
            f" {row + 1} (run {run}), a step of {step:.4g} s"
        )


_FASTEST = {"m": 100.0, "rad": 1e5}
"""m/s and rad/s that no reference moves at: a thousand times a stage, a million revolutions a minute."""


def speeds(log: Log, spans: Spans) -> Iterator[Finding]:
    """References that cross their range within a run faster than any machine."""
    if "t_s" not in spans.overall or log.counted:
        return
    lasts = spans.covers("t_s")
    for name in filter(is_reference, spans.overall):
        covers = spans.covers(name)
        for k in np.flatnonzero((lasts > 0) & (covers > _FASTEST[si_unit(name)] * lasts))[:1]:
            run, symbol = list(spans.samples)[k], si_symbol(name)
            text = (
                f"In run {run} of {log.short_name} {name} covers {covers[k]:.3g} {symbol} in {lasts[k]:.3g} "
                "s, faster than any machine"
            )
            fault = Fault(text, "clock_unit", (name, "t_s"), (run,))
            yield Finding(fault, f"check the units of {name} and t_s")
            return
