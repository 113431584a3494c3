"""Errors that repeat with a coordinate: their size, causes and remedies.

The error of the decoded coordinate is a sum of harmonics of one period of the reference. The effects of the
family state which harmonics come from the mounting, which from the reference, and which from other causes, so
that the error splits into those of the machine and of the reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.special import chdtri

from hallsym.estimation import Fit
from hallsym.estimation.prediction import decoded
from hallsym.families.recording import as_read
from hallsym.log import Log
from hallsym.log.batches import Weigh
from hallsym.model import Family

HIGHEST = 12
"""Harmonics per period that are always fitted: clipping and the second harmonic of a field's third reach this
order, and with it a table of 24 entries."""
SECTORS = 36
"""Parts of the period that must each hold a sample: 10 deg of a turn, a third of the shortest wave."""
ALONE = 3
"""Samples for each coefficient at least."""
CHANCE = 0.01
"""Probability that noise alone shows one of all harmonics. The usual 1 %."""
STEEP = 5.0
"""Standard uncertainties above which a reference has another scale. Over a single period a slope resembles
the sum of all harmonics, so it must be certain."""
MOUNTED, REFERENCE = "mechanics", "reference"
"""Links of the chain whose effects mounting makes, and the reference."""
ALIAS = 1e-2
"""Information on a wave beside slower ones, relative to that of the wave alone, below which it is left out:
knots at 200 places a turn do not determine the phase of a hundredth wave. A slope over a single turn has
5e-2."""
GRID = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)


@dataclass(frozen=True)
class Size:
    """Root mean square and peak over the period, in SI."""

    rms: float
    peak: float


@dataclass(frozen=True)
class Harmonic:
    """`per_period` waves of the error with the nominal decoder; amplitude and its 95 % half width, in SI."""

    per_period: int
    amplitude: float
    half_width: float
    shown: bool
    """Whether it is significant."""


@dataclass(frozen=True)
class PeriodicError:
    """The error of `coordinate` over its `period`, with the nominal decoder, and after remedies.

    `machine`: the part of the machine. `mounted`: without `mount_orders`, which mounting the parts anew can
    remove. `calibrated`: with the fitted parameters. `pattern`: the part of the reference, at
    `pattern_orders`. `rest`, `rest_calibrated`: rms of the non-periodic part with the nominal and with the
    fitted parameters, which no table removes. `elsewhere`: by order of the mounting, other effects of that
    order, which mounting does not remove.
    """

    coordinate: str
    period: float
    harmonics: tuple[Harmonic, ...]
    machine: Size
    mounted: Size
    calibrated: Size
    pattern: Size
    rest: float
    rest_calibrated: float
    mount_orders: tuple[int, ...]
    pattern_orders: tuple[int, ...]
    elsewhere: Mapping[int, tuple[str, ...]]
    slope: float
    """Error of the scale of the reference, 0 where the log shows none."""

    def to_dict(self) -> dict[str, Any]:
        """Return the record of `--json`, in SI."""
        return asdict(self)


def periodic_error(log: Log, fit: Fit, keep: Weigh | None = None) -> PeriodicError | None:
    """Return the errors that repeat with the first periodic coordinate; None where there are none.

    That is: where the family's effects name no harmonics, where the log does not cover a period, or where it
    has too few samples. `log`: as the model reads it (`as_read`).
    """
    model = fit.model
    coordinate = next((c for c in model.pose if c in model.period), None)
    if coordinate is None or not model.family.waves:
        return None
    k, period = model.pose.index(coordinate), model.period[coordinate]
    mount, pattern, elsewhere = _sources(model.family)
    orders = tuple(sorted({*range(1, HIGHEST + 1), *pattern}))
    sums = _Sums(orders, 2 * np.pi / period)
    for block, errors in decoded(log, fit, keep).blocks():
        sums.add(block.run, block.data[model.references[k]], errors[:, k])
    if not sums.enough:
        return None
    before, after = sums.solved(0), sums.solved(1)
    own = [n for n in orders if n not in pattern]
    return PeriodicError(
        coordinate, period, tuple(before.harmonics), before.size(own),
        before.size([n for n in own if n not in mount]), after.size(own), before.size(pattern), before.rest,
        after.rest, mount, pattern, elsewhere, before.slope,
    )  # fmt: skip


def periodic_of(fit: Fit, log: Log | None = None) -> PeriodicError | None:
    """Return the errors that repeat on the log of a fit, or on another one; None where no log is at hand."""
    seen, keep = (fit.source, fit.keep) if log is None else (log, None)
    return None if seen is None else periodic_error(as_read(seen, fit.model, fit.corrections), fit, keep)


def _sources(family: Family) -> tuple[tuple[int, ...], tuple[int, ...], dict[int, tuple[str, ...]]]:
    """Return orders of the mounting, orders of the reference alone, and other causes of the former."""
    by_link: dict[str, set[int]] = {}
    for effect in family.effects:
        by_link.setdefault(effect.link, set()).update(effect.waves)
    mount, reference = (by_link.get(link, set()) for link in (MOUNTED, REFERENCE))
    others = set().union(*(orders for link, orders in by_link.items() if link != REFERENCE))
    elsewhere = {
        n: tuple(e.name for e in family.effects if e.link != MOUNTED and n in e.waves) for n in sorted(mount)
    }
    return tuple(sorted(mount)), tuple(sorted(reference - others)), elsewhere


@dataclass(eq=False)
class _Sums:
    """Normal equations of harmonics and of a slope, the mean of each run and direction taken out."""

    orders: tuple[int, ...]
    rate: float
    square: np.ndarray | float = 0.0
    groups: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)
    seen: np.ndarray = field(default_factory=lambda: np.zeros(SECTORS, dtype=int))

    @property
    def width(self) -> int:
        return 2 * len(self.orders) + 1

    def add(self, run: int, reference: np.ndarray, errors: np.ndarray) -> None:
        """Add a block: the errors (2, samples) by the nominal and by the fitted parameters."""
        phase = self.rate * reference
        waves = np.array([f(n * phase) for n in self.orders for f in (np.cos, np.sin)])
        rows = np.vstack([waves, reference[None] * self.rate, errors])
        good = np.isfinite(rows).all(axis=0)
        ahead = np.sign(np.diff(reference, prepend=reference[:1]))
        if len(ahead) > 1:
            ahead[0] = ahead[1]
        sector = np.floor(phase[good] / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS
        self.seen += np.bincount(sector, minlength=SECTORS)
        for direction in (-1, 0, 1):
            chosen = rows[:, good & (ahead == direction)]
            if chosen.shape[1]:
                self.square = self.square + chosen @ chosen.T
                sums = np.r_[chosen.sum(axis=1), chosen.shape[1]]
                self.groups[run, direction] = self.groups.get((run, direction), 0.0) + sums

    @property
    def enough(self) -> bool:
        """Whether a period is covered by enough samples."""
        return bool(self.seen.all() and self.seen.sum() >= ALONE * (self.width + len(self.groups)))

    def solved(self, version: int) -> _Solved:
        """Return the harmonics of the error by the nominal (0) or the fitted parameters (1)."""
        means = np.array([g[:-1] / np.sqrt(g[-1]) for g in self.groups.values()])
        centred = self.square - means.T @ means
        target, free = self.width + version, self.seen.sum() - len(self.groups)
        found, covariance, rest = _solve(centred, list(range(self.width)), target, free)
        if abs(found[-1]) > STEEP * np.sqrt(covariance[-1, -1]) > 0:
            return _Solved(self.orders, found[:-1], covariance[:-1, :-1], rest, found[-1])
        return _Solved(self.orders, *_solve(centred, list(range(self.width - 1)), target, free), 0.0)


def _solve(
    square: np.ndarray, columns: list[int], target: int, free: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return coefficients, their covariance and the rms of the rest; undetermined coefficients are zero."""
    kept: list[int] = []
    for j in columns:  # from slow waves to fast ones, which may look like slow ones at these samples
        own = square[np.ix_(kept, kept)], square[kept, j]
        new = square[j, j] - own[1] @ np.linalg.solve(*own) if kept else square[j, j]
        if new > ALIAS * max(square[j, j], free / 2):
            kept.append(j)
    found, covariance = np.zeros(len(columns)), np.zeros((len(columns),) * 2)
    at = np.searchsorted(columns, kept)
    inverse = np.linalg.inv(square[np.ix_(kept, kept)])
    found[at] = inverse @ square[kept, target]
    rest = float(square[target, target] - found @ square[columns, target]) / max(free - len(kept), 1)
    covariance[np.ix_(at, at)] = inverse * max(rest, 0.0)
    return found, covariance, float(np.sqrt(max(rest, 0.0)))


@dataclass(frozen=True, eq=False)
class _Solved:
    """Coefficients (2 per order) of the harmonics, their covariance, rms of the rest, slope."""

    orders: tuple[int, ...]
    found: np.ndarray
    covariance: np.ndarray
    rest: float
    slope: float

    @property
    def harmonics(self) -> Iterator[Harmonic]:
        """Yield each harmonic with its amplitude and uncertainty."""
        limit = chdtri(2, CHANCE / len(self.orders))
        for k, order in enumerate(self.orders):
            at = slice(2 * k, 2 * k + 2)
            pair, spread = self.found[at], self.covariance[at, at]
            amplitude = float(np.hypot(*pair))
            along = pair / amplitude if amplitude else np.zeros(2)
            half = 1.96 * float(np.sqrt(max(along @ spread @ along, 0.0)))
            telling = bool(pair @ np.linalg.pinv(spread, hermitian=True) @ pair > limit)
            yield Harmonic(order, amplitude, half, telling)

    def size(self, orders: Sequence[int]) -> Size:
        """Return the size of the sum of those of `orders` that the log shows."""
        error = np.zeros(len(GRID))
        for k, harmonic in enumerate(self.harmonics):
            if harmonic.shown and harmonic.per_period in orders:
                n = harmonic.per_period
                error += self.found[2 * k] * np.cos(n * GRID) + self.found[2 * k + 1] * np.sin(n * GRID)
        return Size(float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()))
