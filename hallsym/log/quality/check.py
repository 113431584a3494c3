"""Check a log before anything is computed from it: what really goes wrong in a lab, without any model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from hallsym.errors import InputError
from hallsym.log.columns import RUN
from hallsym.log.core import Log
from hallsym.log.drop import Drop, without
from hallsym.log.quality import findings
from hallsym.log.quality.findings import Finding
from hallsym.log.quality.scan import Scan, Spans, scan

_PASSES = 4


def check_log(log: Log, required: Sequence[str] = (), *, drop_bad: bool = False) -> list[str]:
    """Return what is worth knowing about a log, one sentence each; refuse one that cannot be used.

    `required` names the columns that will be used (none: all of them); only these are judged. With `drop_bad`
    samples and runs that can be left out are no reason to refuse; `clean_log` returns the log without them.
    """
    return list(clean_log(log, required).notes) if drop_bad else [*log.notes, *_notes(log, required)]


def clean_log(log: Log, required: Sequence[str] = (), *, rails: bool = True) -> Log:
    """Return the log without its bad samples and runs; its `notes` say what was left out.

    Left out: samples with NaN or infinity, with time that does not advance, at a level where a reading is
    saturated (unless not `rails`), runs that are too short or in which a reading is dead. A log that streams
    goes on streaming.
    """
    dropped: list[str] = []
    for _ in range(_PASSES):
        notes, drop = [], Drop()
        for finding in _judge(log, required):
            if finding.drop and finding.drop.levels and not rails:
                notes.append(f"{finding.text}.")
            elif finding.refuse and finding.drop:
                drop |= finding.drop
                dropped.append(f"{finding.text}; left out.")
            elif finding.refuse and not finding.bear:
                before = f" ({dropped[-1][:-1]})" if dropped else ""
                raise InputError(f"{finding.sentence[:-1]}{before}.")
            else:
                notes.append(f"{finding.text}.")
        if not drop:
            break
        log = without(log, drop)
        if log.rows == 0:
            raise InputError(f"Nothing is left of {log.name} without its bad samples ({dropped[-1][:-1]}).")
    return replace(log, notes=(*log.notes, *dropped, *notes))


def spans(log: Log, columns: Sequence[str] | None = None) -> Spans:
    """Return min, max, mean and standard deviation of each column, overall and per run, from one pass."""
    return scan(log, log.columns if columns is None else columns).spans()


def _notes(log: Log, required: Sequence[str]) -> Iterator[str]:
    for finding in _judge(log, required):
        if finding.refuse:
            raise InputError(finding.sentence)
        yield finding.sentence


def _judge(log: Log, required: Sequence[str]) -> Iterator[Finding]:
    """Yield findings in the order in which to put them right; a later one may be due to an earlier."""
    log.table.require(required)
    columns = tuple(required) or log.columns
    if "t_s" in log.columns:
        columns = tuple(dict.fromkeys(("t_s", *columns)))
    seen = scan(log, [name for name in columns if name != RUN])
    if seen.rows == 0:
        raise InputError(f"Log {log.name} has no samples; record it again.")
    rounds: tuple[Callable[[], Iterator[Finding]], ...] = (
        lambda: findings.finite(log, seen, required),
        lambda: findings.time(log, seen),
        lambda: findings.short_runs(log, seen),
        lambda: _values(log, seen),
    )
    for judge in rounds:
        stop = False
        for finding in judge():
            yield finding
            stop = stop or bool(finding.refuse and finding.drop)
        if stop:
            return


def _values(log: Log, seen: Scan) -> Iterator[Finding]:
    spans = seen.spans()
    yield from findings.units(log, spans)
    yield from findings.counts(log, spans)
    yield from findings.dead(log, seen, spans)
    yield from findings.saturated(log, seen)
    yield from findings.stale(log, seen, spans)
