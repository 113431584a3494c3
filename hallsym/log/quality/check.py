"""Check a log before anything is computed from it: what really goes wrong in a lab, without any model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from hallsym.errors import InputError
from hallsym.log.columns import RUN
from hallsym.log.core import Log
from hallsym.log.drop import Drop, without
from hallsym.log.quality.clock import ticks, time
from hallsym.log.quality.copies import copied
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.frozen import held
from hallsym.log.quality.levels import dead, stale
from hallsym.log.quality.rails import saturated
from hallsym.log.quality.runs import short_runs
from hallsym.log.quality.scales import clock_unit, speeds, units
from hallsym.log.quality.scan import Scan, Spans, scan


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


_PASSES = 6


def check_log(log: Log, required: Sequence[str] = (), *, drop_bad: bool = False) -> list[str]:
    """Return what is worth knowing about a log, one sentence each; refuse one that cannot be used.

    `required` names the columns that will be used (none: all of them); only these are judged. With `drop_bad`
    samples and runs that can be left out are no reason to refuse; `clean_log` returns the log without them.
    """
    if drop_bad:
        return usable(log, required, drop_bad=True)[1]
    found = list(_judge(log, required))
    for finding in found:
        if finding.refuse:
            raise InputError(finding.sentence)
    return [*log.notes, *(finding.sentence for finding in found)]


def clean_log(log: Log, required: Sequence[str] = (), *, rails: bool = True) -> Log:
    """Return the log without its bad samples and runs; its `notes` say what was left out.

    Left out: samples with NaN or infinity, with time that does not advance, on a rail (unless not `rails`),
    of a column that is frozen, copies of others, runs that are too short or in which a reading is dead.
    A log that streams goes on streaming.
    """
    log, notes = usable(log, required, drop_bad=True, rails=rails)
    return replace(log, notes=tuple(notes))


def usable(
    log: Log, required: Sequence[str] = (), *, drop_bad: bool = False, rails: bool = True
) -> tuple[Log, list[str]]:
    """Return the log to compute from, and what is worth knowing about it; refuse one that cannot be used.

    A few samples on a rail or in a frozen stretch are left out unasked; the log itself is returned where
    nothing is. With `drop_bad` everything that can be left out is no reason to refuse. Without `rails`
    samples on a rail are kept: for what explains them.
    """
    notes, began = list(log.notes), log
    for _ in range(_PASSES):
        told, drop = [], Drop()
        for finding in _judge(log.recording or log, required, thinned=log is not began):
            on_rails = finding.drop is not None and bool(finding.drop.between)
            leave_out = finding.drop is not None and not (on_rails and not rails)
            if finding.refuse and not drop_bad and not (on_rails and not rails):
                raise InputError(finding.sentence)
            if leave_out and finding.drop:
                drop |= finding.drop
                notes.append(finding.left_out)
            elif finding.refuse and not finding.bear and not on_rails:
                raise InputError(_after(finding, notes[len(log.notes) :]))
            else:
                told.append(finding.borne if finding.refuse else finding.sentence)
        if not drop:
            break
        log = without(log, drop)
        if log.rows == 0:
            raise InputError(f"Nothing is left of {log.name} without its bad samples ({notes[-1][:-1]}).")
        if not drop_bad:
            break
    return log, [*notes, *told]


def on_rails(log: Log, required: Sequence[str] = ()) -> Drop:
    """Return the samples that lie on a rail of a reading, of `required` columns (none: of all)."""
    columns = tuple(required) or log.columns
    found = saturated(log, scan(log, [name for name in columns if name != RUN]))
    return Drop(between=tuple(ends for finding in found if finding.drop for ends in finding.drop.between))


def spans(log: Log, columns: Sequence[str] | None = None) -> Spans:
    """Return min, max, mean and standard deviation of each column, overall and per run, from one pass."""
    return scan(log, log.columns if columns is None else columns).spans()


def _after(finding: Finding, dropped: Sequence[str]) -> str:
    before = f" ({dropped[-1][:-1]})" if dropped else ""
    return f"{finding.sentence[:-1]}{before}."


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
    rounds: tuple[Callable[[], Iterator[Finding]], ...] = (
        lambda: finite(log, seen, required),
        lambda: _clock(log, seen, thinned),
        lambda: short_runs(log, seen),
        lambda: _values(log, seen),
    )
    for judge in rounds:
        stop = False
        for finding in judge():
            yield finding
            stop = stop or bool(finding.refuse and finding.drop)
        if stop:
            return


def _clock(log: Log, seen: Scan, thinned: bool) -> Iterator[Finding]:
    if seen.clock is not None and not log.counted:
        yield from time(log, seen.clock)
        yield from clock_unit(log, seen)
        if not thinned:
            yield from ticks(log, seen.clock)


def _values(log: Log, seen: Scan) -> Iterator[Finding]:
    spans = seen.spans()
    yield from units(log, spans)
    yield from speeds(log, seen, spans)
    yield from dead(log, seen, spans)
    yield from copied(log, seen, spans)
    rails = Drop()
    for finding in saturated(log, seen):
        yield finding
        rails |= finding.drop or Drop()
    yield from held(log, seen, spans, rails)
    yield from stale(log, seen, spans, rails)
