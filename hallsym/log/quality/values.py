"""Values that cannot be what was measured: cut off at a rail, at rest, held, slow, or recorded twice."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hallsym.log.columns import RUN, is_moving, is_reading, is_reference, tells
from hallsym.log.core import Block, Drop, Log
from hallsym.log.quality.findings import Finding, name_of, others, the
from hallsym.log.quality.scan import (
    FEWEST_SAMPLES,
    HELD_SAMPLES,
    OVER_NOISE,
    WHOLE_ROWS,
    Scan,
    Spans,
    Whole,
    code,
    equal_by_chance,
    gains,
    is_noisy,
    noise_in_codes,
    stretches,
)
from hallsym.log.table import joined
from hallsym.units import Array, si_symbol

TURN = 2.6
"""Samples within a window at the end of the range over those of the fullest window beside it, of a pile. A
sine that turns there has 1 / (sqrt(2) - 1) = 2.4, a triangle 1."""
SAME = 8
"""Samples exactly at the end of the range that are a pile where no three of the others are equal but for
rounding."""
_ROUNDING = 1e-9
"""Distance over the range up to which values are equal but for rounding: a wave that comes back to the same
phase again and again has one exact value at its ends only, where it is flat. Of 100,000 samples at random,
three are as close once in 2,000 logs."""
_BY_CHANCE = 2.0
"""Standard deviations of a count that are left to chance."""
_WINDOWS = 2
"""Windows beside it, of which the fullest counts."""
_BESIDE = 4
"""Samples that the fullest must hold: values that repeat with each period are no piles."""
_WIDTHS = 2.0 ** np.arange(-13, -3.9, 0.5)
"""Widths of the windows over the range: noise on a rail is not wider than a sixteenth, nor codes narrower."""
_BEYOND = 0.002
"""Share of the samples that may lie beyond a rail: glitches of the logger."""
_LEVELS = 10
"""Codes that a range must have: fewer say nothing about a pile."""


@dataclass(frozen=True)
class Pile:
    """The pile at one end, `sign` +1 (high) or -1: samples from `edge` on; `ratio` to those beside it."""

    sign: float
    edge: float
    ratio: float

    def of(self, x: Array) -> Array:
        """Return which samples (n,) belong to it."""
        return np.asarray(self.sign * x >= self.sign * self.edge)


def piles(ordered: Array) -> list[Pile]:
    """Return the piles at the ends of samples (n,) by size."""
    step = code(ordered)
    if not ordered[-1] - ordered[0] > _LEVELS * step:
        return []
    ends = (-1.0, _highest(-ordered[::-1], step)), (1.0, _highest(ordered, step))
    return [Pile(sign, sign * found[0], found[1]) for sign, found in ends if found is not None]


def _highest(ordered: Array, step: float) -> tuple[float, float] | None:
    """Return edge and ratio of the pile at the end of ascending samples; windows are wider than `step`."""
    n, span = len(ordered), float(ordered[-1] - ordered[0])
    first = int(np.searchsorted(ordered, ordered[-1]))
    if n - first >= SAME and _alone(ordered[:first]):
        return float(ordered[-1]), np.inf
    end = ordered[-1 - int(_BEYOND * n)]
    widths = span * _WIDTHS
    bounds = end - np.outer(widths, np.arange(_WINDOWS + 2))
    counts = -np.diff(np.searchsorted(ordered, bounds.ravel(), side="right").reshape(bounds.shape), axis=1)
    top, fullest = counts[:, 0], counts[:, 1:].max(axis=1)
    sure = top > TURN * fullest + _BY_CHANCE * np.sqrt(top + TURN**2 * fullest)
    good = sure & (fullest >= _BESIDE) & (widths > 1.5 * step)
    if not good.any():
        return None
    ratio = np.where(good, top / np.maximum(fullest, 1), 0.0)
    best = int(np.argmax(ratio))
    return float(np.nextafter(bounds[best, 1], np.inf)), float(ratio[best])


def _alone(ordered: Array) -> bool:
    """Say whether no three of ascending samples are equal but for rounding, but at their lower end."""
    above = ordered[int(np.searchsorted(ordered, ordered[0], side="right")) :] if len(ordered) else ordered
    near = _ROUNDING * float(ordered[-1] - ordered[0]) if len(ordered) else 0.0
    return not bool((above[2:] - above[:-2] <= near).any())


_SURE = 8.0
"""Ratio of a pile that is told from a turning point by its size alone, where the reading is no linear
function of the references: a wave with a flat top has up to 1 / (2^(1/4) - 1) = 5.3."""
_CORNER, _OUTSIDE = 2.0, 3
"""Depth that a smooth turning point would have, slope times duration over 8, over the width of the pile from
which it is cut off; and samples before and after it that tell the slope. A parabola is a quarter of slope
times duration deep, a wave with a flat top, of fourth order, an eighth."""
_LINEAR, _STRAIGHT = 0.98, 0.9995
"""Share of a run's variation from which the reading is a linear function of the references there: where noise
is what it leaves, and where something else is."""
_NEAR, _BENT = 0.1, 0.3
"""Share of a run's range beside a pile in which a linear function still holds if the pile is a rail, and what
it may miss there over what it misses in the pile: a reading that bends by itself begins to before."""
_FLAT = 0.5
"""Spread of a reading on a rail over that of its prediction, at most: a rail hides motion."""
_WHITE = 0.5
"""Whiteness from which what a linear function leaves is noise, and from which a reference only has noise."""
_GOES_ON = 0.5
"""Motion of the reference on a rail over that elsewhere, median steps: 0 at a turning point or a rest."""


def is_cut_off(x: Array, motion: Sequence[Array], run: Array, pile: Pile, free: Array) -> bool:
    """Say whether references (n,) move on while a reading x (n,) stays in a pile; `free`: samples in none."""
    if not free.any():
        return False
    within = pile.of(x)
    linear = _linear(x, motion, run, pile, free)
    if linear is not None:
        return linear
    open_runs = np.isin(run, np.unique(run[free]))  # a run that never leaves the pile says nothing
    told = np.count_nonzero(within & open_runs)
    if not told or pile.ratio * told < _SURE * np.count_nonzero(within):
        return False
    goes_on = any(_goes_on(values, run, within) for values in _related(x, motion, free))
    return goes_on and _has_corners(x, run, within) and _is_flat(x, run, within)


def _linear(x: Array, motion: Sequence[Array], run: Array, pile: Pile, free: Array) -> bool | None:
    """Judge the runs in which the reading is a linear function of the references; None if there is none."""
    runs = np.unique(run[pile.of(x)])
    parts = [run == one for one in runs.tolist()]
    found = [_beside_gains(x[p], [values[p] for values in motion], pile, free[p]) for p in parts]
    found = [row for row in found if row is not None] or [_beside_gains(x, motion, pile, free)]
    if found == [None]:
        rest = [run == one for one in np.setdiff1d(run, runs).tolist()]
        alike = [_beside_gains(x[p], [values[p] for values in motion], pile, free[p]) for p in rest]
        return False if sum(row is not None for row in alike) > len(alike) / 2 else None
    table = np.array([row for row in found if row])
    if not len(table):
        return False
    hidden, left, seen, missed, bent = np.average(table[:, 1:], axis=0, weights=table[:, 0])
    moves = hidden > OVER_NOISE**2 * left and seen < _FLAT**2 * hidden
    return bool(moves and bent < _BENT * missed)


def _beside_gains(x: Array, motion: Sequence[Array], pile: Pile, free: Array) -> list[float] | None:
    """Return what a linear function of the references, fitted to the `free` samples, says of a pile.

    Samples of the pile, variances of prediction, fit and reading there, what the function misses in the pile
    and beside it. [] where it cannot tell, None where the reading is no such function.
    """
    on = pile.of(x)
    found = gains(x, motion, free)
    if found is None or found.share < _LINEAR:
        return None
    predicted, known = found.predicted(motion)
    on &= known
    if np.count_nonzero(on) < 2:
        return []
    misses = pile.sign * (predicted - x)
    if _whiteness(misses[free]) < _WHITE and found.share < _STRAIGHT:
        return None
    near = free & (pile.sign * x > pile.sign * pile.edge - _NEAR * np.ptp(x))
    bent = float(misses[near].mean()) if near.any() else 0.0
    spreads = (float(np.var(predicted[on])), found.spread**2, float(np.var(x[on])))
    return [float(np.count_nonzero(on)), *spreads, float(misses[on].mean()), bent]


def _whiteness(rest: Array) -> float:
    """Return half the mean square of the steps over the variance: 1 for white noise, near 0 for misfit."""
    variance = float(np.var(rest))
    return float(np.var(np.diff(rest))) / (2 * variance) if variance > 0 else 0.0


def _related(x: Array, motion: Sequence[Array], free: Array) -> list[Array]:
    """Return the references that a reading follows, or all of them where none stands out."""
    strength = []
    for values in motion:
        spread = x[free].std() * values[free].std()
        strength.append(
            abs(np.mean((x[free] - x[free].mean()) * (values[free] - values[free].mean())))
            / (spread or np.inf)
        )
    least = max(0.3, 0.9 * max(strength, default=0.0))
    return [values for values, s in zip(motion, strength, strict=True) if s >= least] or list(motion)


def _goes_on(motion: Array, run: Array, pile: Array) -> bool:
    """Say whether a reference moves on through the samples of a pile as it does elsewhere in their runs."""
    there = []
    for one in np.unique(run[pile]).tolist():
        here = run == one
        if _whiteness(motion[here]) > _WHITE:
            continue
        step = np.abs(motion[here][2:] - motion[here][:-2])
        if (usual := float(np.median(step)) if len(step) else 0.0) > 0:
            there.append(step[pile[here][1:-1]] / usual)
    steps = np.concatenate(there) if there else np.empty(0)
    return len(steps) > 0 and bool(np.median(steps) >= _GOES_ON)


def _has_corners(x: Array, run: Array, pile: Array) -> bool:
    """Say whether a reading comes to a pile, and leaves it, faster than a smooth turning point would."""
    low, high = np.quantile(x[pile], [0.025, 0.975])
    middle, depths, weights = np.median(x[pile]), [], []
    for one in np.unique(run[pile]).tolist():
        here = run == one
        values = x[here]
        for a, b in stretches(pile[here], shortest=1):
            outside = [i for i in (a - _OUTSIDE, b + _OUTSIDE - 1) if 0 <= i < len(values)]
            slopes = [abs(values[i] - middle) / _OUTSIDE for i in outside]
            if slopes:
                depths.append(float(np.mean(slopes)) * (b - a) / 8)
                weights.append(b - a)
    return len(depths) > 0 and bool(np.average(depths, weights=weights) > _CORNER * (high - low))


def _is_flat(x: Array, run: Array, pile: Array) -> bool:
    """Say whether what a reading does in a pile is noise, or nothing; True if it is too short."""
    steps = np.abs(np.diff(x))[pile[1:] & pile[:-1] & (run[1:] == run[:-1])]
    wide = float(np.median(np.abs(x[pile] - np.median(x[pile]))))
    if not len(steps) or wide == 0.0:
        return True
    return float(np.median(steps)) > _WHITE * np.sqrt(2.0) * wide


REFUSE = 0.05
"""Share of the samples on the rails from which a log is refused. A sine cut off for 5 % of the
time lacks 0.3 % of its stroke, which matters to nothing; beyond it a calibration extrapolates."""


def saturated(log: Log, seen: Scan) -> Iterator[Finding]:
    """Readings with samples on a rail; what is left out are those not between the edges of its piles."""
    for name in filter(is_reading, seen.traces):
        trace = seen.traces[name]
        if trace.nonfinite or not trace.low < trace.high:
            continue
        if max(trace.at_low, trace.at_high) < SAME and not piles(np.sort(seen.sample.whole.data[name])):
            continue
        whole = _samples(log, seen, name)
        found, x = _rails(whole, name), whole.data[name]
        if not found:
            continue
        on = np.any([pile.of(x) for pile in found], axis=0)
        low = max((pile.edge for pile in found if pile.sign < 0), default=-np.inf)
        high = min((pile.edge for pile in found if pile.sign > 0), default=np.inf)
        where = " and ".join(f"{v:.4g}" for v in sorted(float(np.median(x[pile.of(x)])) for pile in found))
        runs, inverse, counts = np.unique(whole.run, return_inverse=True, return_counts=True)
        shares, share = np.bincount(inverse, weights=on) / counts, float(np.mean(on))
        worst = int(np.argmax(shares))
        yield Finding(
            f"{the(log, name)} is saturated: {round(share * seen.rows)} samples ({share:.1%}) lie on its"
            f" rail{'s' if len(found) > 1 else ''} at {where} {si_symbol(name)}, most in run {runs[worst]}"
            f" ({shares[worst]:.0%})",
            share > REFUSE, Drop(between=((name, low, high),)), remedy="lower the gain or the travel",
        )  # fmt: skip


def _samples(log: Log, seen: Scan, name: str) -> Whole:
    """Return a reading beside the references: whole, or thinned where the log is long."""
    references = [column for column in seen.traces if is_reference(column)]
    if seen.rows > WHOLE_ROWS:
        thinned = seen.sample.whole
        return Whole(thinned.run, {c: thinned.data[c] for c in (name, *references)})
    columns = (RUN, name, *references)
    data = joined([block.data for block in log.blocks(columns)], columns)
    return Whole(data.pop(RUN).astype(np.int64), data)


def _rails(whole: Whole, name: str) -> list[Pile]:
    """Return the piles at both ends in which the reading is cut off, and does not rest or turn."""
    x, found = whole.data[name], piles(np.sort(whole.data[name]))
    free = ~np.any([pile.of(x) for pile in found], axis=0) if found else np.empty(0, bool)
    motion = [values for column, values in whole.data.items() if is_reference(column)]
    return [pile for pile in found if not motion or is_cut_off(x, motion, whole.run, pile, free)]


_FEWEST_CHANGES = 16
_ALIKE = 0.6
"""Share of the values that a slow logger repeats as often as the usual one."""
_MEANWHILE = 0.5
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
    runs, long = list(spans.samples), np.array(list(spans.samples.values())) >= FEWEST_SAMPLES
    for c in filter(is_reference, spans.overall):
        long &= ~spans.rests(c)
    for name in filter(is_reading, spans.overall):
        overall = spans.overall[name]
        if overall.min == overall.max:
            yield Finding(
                f"{the(log, name)} never changes; it is {overall.min:.6g} in all {seen.rows} samples",
                True, remedy="check the probe, its wiring and the step of its converter",
            )  # fmt: skip
            continue
        still = [runs[k] for k in np.flatnonzero(long & spans.rests(name))]
        still = [run for run in still if _should_move(log, seen, name, run, spans)]
        if still:
            yield Finding(
                f"{the(log, name)} never changes in run {still[0]}{others(still)} although the reference"
                " moves",
                True, Drop(runs=frozenset(still)), remedy="check the probe and its wiring",
            )  # fmt: skip


def _should_move(log: Log, seen: Scan, name: str, run: int, spans: Spans) -> bool:
    """Say whether noise or the references' motion should have moved a reading that is constant in a run."""
    steady = _steady(spans, name)
    live = next(r for r in spans.samples if r not in steady)
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
        resting = [spans.samples[run] for run in _steady(spans, name)]
        repeats, rows = trace.repeats - sum(resting) + len(resting), seen.rows - sum(resting)
        if repeats <= _OFTEN * rows or not (share := _repeats(log, name)):
            continue
        yield Finding(
            f"{the(log, name)} repeats each value about {1 / (1 - share):.0f} times: it was recorded at a"
            " lower rate than the others, which looks like a delay",
            remedy="record all columns at one rate",
        )


def _steady(spans: Spans, column: str) -> list[int]:
    """Return the runs in which a column holds one value."""
    return [run for run, rests in zip(spans.samples, spans.rests(column), strict=True) if rests]


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
    goes_on = inside > _MEANWHILE * share * across
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


REFUSE_HELD = 0.05
"""Share of a column's samples from which a log is refused: below, the others tell what it would have told."""
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


def held(log: Log, seen: Scan, spans: Spans, rails: Drop) -> Iterator[Finding]:
    """Columns that hold one value for a while although they move, or should, before, meanwhile or after.

    `rails`: the values beyond which columns are saturated, which holds them too.
    """
    ends = {name: (low, high) for name, low, high in rails.between}
    for name, trace in seen.traces.items():
        if not is_moving(name) or not trace.held or name not in spans.overall:
            continue
        low, high = ends.get(name, (-np.inf, np.inf))
        found = [one for one in _stretches(log, seen, name, spans) if low < one.value < high]
        if not found:
            continue
        lasts, first = [one.stop - one.start for one in found], found[0]
        stretches_of = "1 stretch" if len(found) == 1 else f"{len(found)} stretches"
        zero = not any(one.value for one in found)
        yield Finding(
            f"{the(log, name)} holds one value for up to {max(lasts)} samples ({stretches_of},"
            f" {sum(lasts) / seen.rows:.1%}, first in row {first.start + 1}, run {first.run},"
            f" {first.value:.4g} {si_symbol(name)})"
            + (": the channel dropped out" if zero else ": the logger repeated old samples"),
            sum(lasts) > REFUSE_HELD * seen.rows, Drop(rows=tuple((one.start, one.stop) for one in found)),
            remedy="look at the channel and the logger",
        )  # fmt: skip


def _stretches(log: Log, seen: Scan, name: str, spans: Spans) -> list[Stretch]:
    beside = tuple(c for c in seen.sample.columns if tells(c, name))
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
                True, remedy="check which column of the logger is which",
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
        True, Drop(runs=frozenset(wrong)),
        remedy="remove a run that is a copy, or give each run the columns that were recorded with it",
    )  # fmt: skip
