"""Readings that are cut off at the ends of their range: both rails together, with or without noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.log.core import Log
from hallsym.log.drop import Drop
from hallsym.log.limits import is_reading, is_reference
from hallsym.log.quality.findings import Finding, the
from hallsym.log.quality.motion import code, follows
from hallsym.log.quality.sample import WHOLE_ROWS, Whole
from hallsym.log.quality.scan import Scan
from hallsym.units import Array, si_unit

REFUSE = 0.05
"""Share of the samples on the rails from which a log is refused. A sine cut off for 5 %
of the time lacks 0.3 % of its stroke, which matters to nothing; beyond it a calibration extrapolates."""
_FEWEST = 8
"""Samples that make a pile."""
_PILE = 4.0
"""Samples within a window about the end of the range over those of the window beside it. A sine that turns
there has 1 / (sqrt(3) - 1) = 1.4, a triangle 0.5; with the end at the edge of the window, 2.4 and 1."""
_WINDOWS = 4
"""Windows beside it, of which the fullest counts."""
_BESIDE = 4
"""Samples that the fullest window beside it must hold: values that repeat with each period are no piles."""
_WIDEST, _NARROWEST = 1 / 16, 1 / 8192
"""Width of the windows over the range: noise on a rail is not wider, a code of a converter not narrower."""
_BEYOND = 0.002
"""Share of the samples that may lie beyond a rail: glitches of the logger."""
_LEVELS = 10
"""Codes that a range must have: fewer say nothing about a pile."""
_LINEAR = 0.98
"""Share of a run's variation from which the reading is a linear function of the references there."""
_ENDS = 0.1
"""Share of a run's range at either end that takes no part in the fit of that function."""
_FEWEST_OFF = 20
"""Samples of a run off the rails that a linear function is fitted to."""
_OVER_NOISE, _FLAT = 2.0, 0.5
"""A rail hides motion: the prediction spreads more than what the fit leaves, the reading less than it."""
_GOES_ON = 0.5
"""Motion of the reference on a rail over that elsewhere, median steps: 0 at a turning point or a rest."""


_NO_EDGES = (None, None)


@dataclass(frozen=True)
class Rails:
    """The rails of a reading: samples that are not between `low` and `high` lie on them (-inf, inf: none).

    `at` holds the level of each rail, `count` the samples on them; `worst` the run with the largest share.
    """

    low: float
    high: float
    at: tuple[float, ...]
    count: int
    worst: tuple[int, float]


def saturated(log: Log, seen: Scan) -> Iterator[Finding]:
    """Readings with samples on a rail."""
    for name in filter(is_reading, seen.traces):
        trace = seen.traces[name]
        if trace.nonfinite or not trace.low < trace.high:
            continue
        if max(trace.at_low, trace.at_high) >= _FEWEST or _edges(seen.sample.whole.data[name]) != _NO_EDGES:
            rails = _rails(log, name)
            if rails:
                yield _finding(log, name, rails, min(seen.rows, WHOLE_ROWS))


def _finding(log: Log, name: str, rails: Rails, rows: int) -> Finding:
    share, unit = rails.count / rows, si_unit(name)
    where = " and ".join(f"{level:.4g}" for level in rails.at)
    refuse = share > REFUSE
    return Finding(
        f"{the(log, name)} is saturated: {rails.count} samples ({share:.1%}) lie on its"
        f" rail{'s' if len(rails.at) > 1 else ''} at {where} {unit}, most in run {rails.worst[0]}"
        f" ({rails.worst[1]:.0%})",
        refuse, Drop(between=((name, rails.low, rails.high),)), remedy="lower the gain or the travel",
    )  # fmt: skip


def _rails(log: Log, name: str) -> Rails | None:
    """Look at whole columns: both ends, then whether the reading is cut off there or rests or turns there."""
    references = [column for column in log.columns if is_reference(column)]
    whole = Whole.of(log, (name, *references))
    x = whole.data[name]
    low, high = _edges(x)
    ends = [(sign, edge) for sign, edge in ((-1.0, low), (1.0, high)) if edge is not None]
    piles = [(sign * x >= sign * edge) for sign, edge in ends]
    if not piles:
        return None
    free = ~np.any(piles, axis=0)
    motion = [whole.data[column] for column in references]
    found = [
        (sign, edge, pile)
        for (sign, edge), pile in zip(ends, piles, strict=True)
        if not motion or _cut_off(x, motion, whole.run, pile, free)
    ]
    if not found:
        return None
    if len(found) == 1 and (end := _opposite(x, found[0][0])) is not None:
        sign = -found[0][0]
        found.append((sign, end, sign * x >= sign * end))
    on = np.any([pile for _, _, pile in found], axis=0)
    return Rails(
        max((edge for sign, edge, _ in found if sign < 0), default=-np.inf),
        min((edge for sign, edge, _ in found if sign > 0), default=np.inf),
        tuple(sorted(float(np.median(x[pile])) for _, _, pile in found)),
        int(np.count_nonzero(on)),
        _worst(whole.run, on),
    )


def _opposite(x: Array, sign: float) -> float | None:
    """Return the other end of a reading cut off at one, where samples sit exactly there: it is a rail too."""
    ordered = np.sort(-sign * x)
    at = int(np.count_nonzero(ordered == ordered[-1]))
    return -sign * float(ordered[-1]) if at >= _FEWEST and code(ordered[:-at]) == 0.0 else None


def _worst(run: Array, on: Array) -> tuple[int, float]:
    runs, inverse, counts = np.unique(run, return_inverse=True, return_counts=True)
    shares = np.bincount(inverse, weights=on) / counts
    worst = int(np.argmax(shares))
    return int(runs[worst]), float(shares[worst])


def _edges(x: Array) -> tuple[float | None, float | None]:
    """Return the values below and above which samples (n,) pile up at the ends of their range, or None."""
    ordered = np.sort(x)
    step = code(ordered)
    if ordered[-1] - ordered[0] < _LEVELS * step:
        return _NO_EDGES
    low, high = (_edge(values, step) for values in (-ordered[::-1], ordered))
    return (None if low is None else -low), high


def _edge(ordered: Array, step: float) -> float | None:
    """Return the value from which on ascending samples (n,) pile up; windows are not narrower than `step`."""
    n, span = len(ordered), float(ordered[-1] - ordered[0])
    end = ordered[-1 - int(_BEYOND * n)]
    best, edge = 0.0, None
    width = _NARROWEST * span
    while width <= _WIDEST * span:
        if width > 1.5 * step:
            bounds = end + width * (0.5 - np.arange(_WINDOWS + 2))
            counts = -np.diff(np.searchsorted(ordered, bounds, side="right"))
            top, fullest = int(counts[0]), int(counts[1:].max())
            sure = fullest >= _BESIDE and top > _PILE * (fullest + np.sqrt(fullest))
            if sure and top / fullest > best:
                best, edge = top / fullest, float(np.nextafter(bounds[1], np.inf))
        width *= 2
    return edge


def _cut_off(x: Array, motion: Sequence[Array], run: Array, pile: Array, free: Array) -> bool:
    """Say whether the references move on while the reading stays at its end."""
    if not free.any():
        return False
    spread, left, flat, count, linear = 0.0, 0.0, 0.0, 0, False
    for one in np.unique(run[pile]).tolist():
        here = run == one
        on, off = pile[here], free[here]
        if np.count_nonzero(on) < 2 or np.count_nonzero(off) < _FEWEST_OFF:
            continue
        found = follows(x[here], [values[here] for values in motion], off & _middle(x[here]))
        if found is None or found.share < _LINEAR:
            continue
        linear = True
        n = int(np.count_nonzero(on))
        spread += n * float(np.var(found.predicted[on]))
        left += n * found.spread**2
        flat += n * float(np.var(x[here][on]))
        count += n
    if linear:
        return spread > _OVER_NOISE**2 * left and flat < _FLAT**2 * spread
    return any(_goes_on(values, run, pile, x) for values in _related(x, motion, free))


def _middle(x: Array) -> Array:
    """Return the samples of a run that are not near the ends of its range, where another rail may be."""
    low, high = x.min(), x.max()
    return np.asarray((x > low + _ENDS * (high - low)) & (x < high - _ENDS * (high - low)))


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


def _goes_on(motion: Array, run: Array, pile: Array, x: Array) -> bool:
    """Say whether a reference moves on through the samples of a pile as it does elsewhere."""
    inside = run[2:] == run[:-2]
    step = np.abs(motion[2:] - motion[:-2])
    there, everywhere = step[inside & pile[1:-1]], step[inside]
    return bool(len(there) and np.median(there) >= _GOES_ON * np.median(everywhere) and np.median(there) > 0)
