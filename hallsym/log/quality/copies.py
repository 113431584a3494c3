"""Recordings that occur twice: whole runs, columns of another run, one signal twice."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

import numpy as np

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.limits import is_moving, is_reading, is_reference
from hallsym.log.quality.findings import Finding, name_of, others
from hallsym.log.quality.motion import is_noisy
from hallsym.log.quality.scan import Scan, Span, Spans

Pairs = dict[tuple[int, int], list[str]]
"""Columns that hold the same samples in two runs, the earlier first."""


def copied(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Samples that are there twice. Only columns with noise count: without it every repetition is alike."""
    same = _same(log, seen, spans)
    if same:
        yield _pasted(log, same, spans)
    yield from _twins(log, seen, spans)


def _same(log: Log, seen: Scan, spans: Spans) -> Pairs:
    """Return the columns that are equal bit for bit in two runs, where one of them carries noise."""
    pairs: Pairs = defaultdict(list)
    noisy: set[tuple[int, int]] = set()
    for name in filter(is_moving, spans.overall):
        sums = seen.bit_sums(name)
        if len(set(sums)) == len(sums):
            continue
        groups: dict[tuple[int, int], list[int]] = defaultdict(list)
        for run, bits in zip(spans.runs, sums, strict=True):
            if spans.runs[run][name].min < spans.runs[run][name].max:
                groups[bits, spans.samples[run]].append(run)
        for first, *later in groups.values():
            values = log.run(first, (name,))[name] if later else np.empty(0)
            equal = [(first, r) for r in later if np.array_equal(log.run(r, (name,))[name], values)]
            noisy.update(equal if is_noisy(values) else ())
            for pair in equal:
                pairs[pair].append(name)
    return {pair: pairs[pair] for pair in sorted(noisy, key=lambda pair: pair[::-1])}


def _all(names: list[str], spans: Mapping[str, Span]) -> bool:
    """Say whether these are all readings and references of a run that change there."""
    told = [c for c, span in spans.items() if (is_reading(c) or is_reference(c)) and span.min < span.max]
    return set(told) <= set(names)


def _pasted(log: Log, same: Pairs, spans: Spans) -> Finding:
    """Of a run that is a copy, the first one is good; of columns in two runs, either may be wrong."""
    wrong = [run for pair, c in same.items() for run in (pair[1:] if _all(c, spans.runs[pair[1]]) else pair)]
    (first, run), names = next(iter(same.items()))
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    subject, verb = ("Columns", "hold") if len(names) > 1 else ("Column", "holds")
    return Finding(
        f"{subject} {shown} of {name_of(log)} {verb} the same samples in runs {first} and {run}"
        f"{others(same, 'more pair')}",
        True, Drop(runs=frozenset(wrong)),
        remedy="remove a run that is a copy, or give each run the columns that were recorded with it",
    )  # fmt: skip


def _twins(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Two columns that hold the same signal."""
    known: dict[tuple[int, ...], str] = {}
    for name in filter(is_moving, spans.overall):
        if spans.overall[name].min == spans.overall[name].max:
            continue
        bits = tuple(seen.bit_sums(name))
        twin = known.setdefault(bits, name)
        if twin != name and is_noisy(log.run(seen.segments[0][0], (name,))[name]):
            yield Finding(
                f"Columns {twin} and {name} of {name_of(log)} hold the same samples:"
                " one signal was logged twice",
                True, remedy="check which column of the logger is which",
            )  # fmt: skip
