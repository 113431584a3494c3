"""Values that cannot be measurements: frozen, stuck, or recorded twice."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from hallsym.errors import counted, few
from hallsym.log.columns import is_moving, is_reading, is_reference, run_list
from hallsym.log.core import Drop, Log
from hallsym.log.quality.findings import STUCK, Fault, Finding, others, the
from hallsym.log.quality.scan import (
    STUCK_SAMPLES,
    Scan,
    Spans,
    by_chance,
    equal_by_chance,
    is_noisy,
    noise_in_codes,
    stretches,
)
from hallsym.units import Array, si_symbol

_CHANGES = 16
_BENT = 1e-3
"""Differences over the largest that are due to rounding in a file of single precision."""
_HELD = {1: "repeats each value about {:.0f} times", 2: "goes along lines of about {:.0f} samples"}
"""Order of the differences that are zero between samples, and how such a column looks."""
_EVENLY = 0.8
"""Share of the changes of a column that come after the usual number of samples, or one more or less, of one
that is recorded at a lower rate: a coarse converter changes as fast as the motion."""


def repeated(log: Log, columns: Iterable[str]) -> Iterator[Fault]:
    """Yield the claim that columns were recorded at a lower rate than the others.

    An axis that steps from rest to rest looks the same; where a model describes the log there is no claim.
    """
    for name in filter(is_moving, columns):
        x = next(log.blocks((name,))).data[name]
        for order, how in _HELD.items():
            step = np.abs(np.diff(x, order))
            lasts = np.diff(np.flatnonzero(step > _BENT * step.max(initial=0.0)))
            usual = float(np.median(lasts)) if len(lasts) >= _CHANGES else 0.0
            if usual >= 2 and np.mean(np.abs(lasts - usual) <= 1) > _EVENLY:
                yield Fault(
                    f"{the(log, name)} {how.format(usual)}: it was recorded at a lower "
                    "rate than the others, which looks like a delay; record all columns at one rate.",
                    "low_rate", (name,),
                )  # fmt: skip
                break


_CHANCE = 1e-6
"""Probability that noise repeats a code for so long somewhere in a run, below which it is a fault."""


class Stretch(NamedTuple):
    """Samples `start` to `stop` of a run, the first in `row` of the log, in which a column holds `value`."""

    run: int
    start: int
    stop: int
    row: int
    value: float


def stuck(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Readings that never change; columns that hold one value for longer than their noise allows."""
    for name, trace in seen.traces.items():
        if not is_moving(name) or name not in spans.overall:
            continue
        overall = spans.overall[name]
        if overall.min == overall.max and is_reading(name):
            text = f"{the(log, name)} never changes; it is {overall.min:.6g} in all {seen.rows} samples"
            remedy = "check the probe, its wiring and the step of its converter"
            yield Finding(Fault(text, STUCK, (name,)), remedy)
        if overall.min == overall.max or not trace.stuck:
            continue
        rests = spans.rests(name)
        if is_reading(name):  # it may rest with an axis
            rests &= np.any([spans.rests(c) for c in spans.overall if is_reference(c)], axis=0)
        still = np.array([*spans.samples])[rests]
        found = [one for one in _stretches(log, name) if one.run not in still]
        ends = dict(zip(spans.samples, spans.by_run[name][:2].T.tolist(), strict=True))
        rails = {  # an end of a run, which goes on below it on either side: the fit finds that
            (one.run, one.value)
            for one in found
            if one.value in ends[one.run] and one.start > 0 and one.stop < seen.samples[one.run]
        }
        found = [one for one in found if (one.run, one.value) not in rails]
        if not found:
            continue
        lasts, first = [one.stop - one.start for one in found], found[0]
        where = f"{counted(len(found), 'stretch')}, {sum(lasts) / seen.rows:.1%}"
        runs = tuple(dict.fromkeys(one.run for one in found))
        # a column that is late repeats its value at one end of a run; the fit distinguishes the two
        at_neither = (one for one in found if (one.start > 0) == (one.stop < seen.samples[one.run]))
        part = next(at_neither, None)  # or at both
        how = (
            "the logger repeated old samples"
            if any(one.value for one in found)
            else "the channel dropped out"
        )
        text = (
            f"{the(log, name)} holds one value for up to {max(lasts)} samples ({where}, first in row"
            f" {first.row + 1}, run {first.run}, {first.value:.4g} {si_symbol(name)}): {how}"
        )
        correction = f"stuck {name} {part.start} {part.stop} in {part.run}" if part else None
        yield Finding(
            Fault(text, STUCK, (name,), runs, correction), "look at the channel, its wiring and the logger",
            drop=Drop(rows=tuple((one.row, one.row + n) for one, n in zip(found, lasts, strict=True))),
        )  # fmt: skip


def _stretches(log: Log, name: str) -> list[Stretch]:
    """Return the stretches of one value that the noise in the longest part between them would have ended.

    A block whose values repeat elsewhere too is coarse, or at rest.
    """
    found: list[tuple[Stretch, int, Array]] = []
    free, row, begun, run = np.empty(0), 0, 0, None
    for block in log.blocks((name,)):
        x, begun, run = block.data[name], row if block.run != run else begun, block.run
        step = np.abs(np.diff(x))
        long = [(a, b + 1) for a, b in stretches(step == 0, shortest=STUCK_SAMPLES - 1)]
        edges = [0, *(edge for pair in long for edge in pair), len(x)]
        free = max(free, *(x[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)), key=len)
        between = np.delete(step, np.r_[tuple(slice(a, b - 1) for a, b in long)]) if long else step
        at = row - begun
        found += [(Stretch(run, at + a, at + b, row + a, float(x[a])), len(x), between) for a, b in long]
        row += len(x)
    codes = noise_in_codes(free) if found else 0.0
    again = equal_by_chance(codes) if codes else 1.0
    return [
        one for one, n, between in found
        if n * again ** (one.stop - one.start - 1) < _CHANCE and by_chance(between, codes)
    ]  # fmt: skip


Pairs = dict[tuple[int, int], list[str]]
"""Columns that hold the same samples in two runs, the earlier first."""


def copied(log: Log, seen: Scan, spans: Spans) -> Iterator[Finding]:
    """Samples that occur twice. Only columns with noise count: without it every repetition is equal."""
    if same := _same(log, spans):
        yield _pasted(log, same, spans)
    known: dict[bytes, str] = {}
    for name in filter(is_moving, spans.overall):
        if spans.overall[name].min == spans.overall[name].max:
            continue
        twin = known.setdefault(spans.by_run[name][:2].tobytes(), name)
        first = log.run(seen.segments[0][0], (twin, name)) if twin != name else {}
        if first and np.array_equal(first[twin], first[name]) and is_noisy(first[name]):
            text = f"Columns {twin} and {name} of {log.short_name} are equal: one signal was logged twice"
            yield Finding(
                Fault(text, "copied_column", (twin, name)), "check which column of the logger is which"
            )


def _same(log: Log, spans: Spans) -> Pairs:
    """Return the columns that are equal bit for bit in two runs, where one of them carries noise."""
    pairs: Pairs = defaultdict(list)
    noisy: set[tuple[int, int]] = set()
    for name in filter(is_moving, spans.overall):
        extents = list(zip(*spans.by_run[name][:2].tolist(), spans.samples.values(), strict=True))
        often, by_digest = Counter(extents), defaultdict[bytes, list[int]](list)
        doubtful = {run: blake2b() for run, (low, high, n) in zip(spans.samples, extents, strict=True)
                    if low < high and often[low, high, n] > 1}  # fmt: skip
        for block in log.blocks((name,)) if doubtful else ():
            if block.run in doubtful:
                doubtful[block.run].update(block.data[name].tobytes())
        for run, samples in doubtful.items():
            by_digest[samples.digest()].append(run)
        for first, *later in by_digest.values():
            pasted = {(first, run) for run in later}
            noisy |= pasted if pasted and is_noisy(log.run(first, (name,))[name]) else set()
            for pair in pasted:
                pairs[pair].append(name)
    return {pair: pairs[pair] for pair in sorted(noisy, key=lambda pair: pair[::-1])}


def _pasted(log: Log, same: Pairs, spans: Spans) -> Finding:
    """For a copied run, keep the first; for columns in two runs, either may be wrong."""
    measured = [c for c in spans.overall if is_reading(c) or is_reference(c)]
    runs = list(spans.samples)
    wrong: set[int] = set()
    for pair, c in same.items():
        later = runs.index(pair[1])
        whole = all(name in c or spans.rests(name)[later] for name in measured)
        wrong |= set(pair[1:] if whole else pair)
    (first, run), names = next(iter(same.items()))
    subject, verb = ("Columns", "hold") if len(names) > 1 else ("Column", "holds")
    text = (
        f"{subject} {few(names, 3)} of {log.short_name} {verb} the same samples in runs {first} and {run}"
        f"{others(same, 'more pair')}"
    )
    correction = f"copied_run in {run_list([*wrong])}"
    return Finding(
        Fault(text, "copied_run", names, tuple(sorted(wrong)), correction),
        "remove a run that is a copy, or give each run the columns that were recorded with it",
        drop=Drop(runs=frozenset(wrong)) if len(wrong) < len(runs) else None,
    )
