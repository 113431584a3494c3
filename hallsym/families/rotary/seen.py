"""Sums over a log that tell how an encoder follows its reference: turns, sectors, drift, waves of a plate."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.log.batches import Batch, batches
from hallsym.log.phase import unwrapped
from hallsym.model import Model

BINS = 72
"""Sectors of a turn that are looked at: 5 deg each."""
RARE, BESIDE = 0.1, 0.1
"""Wraps per step, at most, and how far from whole turns they are [rad] at least, to say so."""
MANY = 65536
"""Numbers of a stream that are kept, however long it is."""
EDGE = 0.02
"""Share of the samples at either end that may be spikes."""


@dataclass(frozen=True, eq=False)
class Stretches:
    """Samples of consecutive stretches of a run each: run of each, where it begins, samples of all."""

    runs: tuple[int, ...]
    starts: np.ndarray
    samples: int

    @staticmethod
    def of(batch: Batch, good: np.ndarray) -> "Stretches":
        """Return the stretches of a batch, of its `good` samples (n,), that hold any."""
        before = np.r_[0, np.cumsum(good)][list(batch.edges)]
        some = np.flatnonzero(np.diff(before))
        runs = tuple(batch.blocks[k].run for k in some)
        return Stretches(runs, before[some], int(before[-1]))

    @property
    def counts(self) -> np.ndarray:
        """Samples of each stretch, (s,)."""
        return np.diff(self.starts, append=self.samples)

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sum values (..., n) over each stretch, (..., s)."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=-1))

    def inside(self) -> np.ndarray:
        """Whether each step from a sample to the next lies in one stretch, (n - 1,)."""
        out = np.ones(self.samples - 1, dtype=bool)
        out[self.starts[1:] - 1] = False
        return out


@dataclass(frozen=True)
class Line:
    """Slope [rad/rad], share of the variation that it makes, longest way of a run, scatter about it [rad]."""

    slope: float
    share: float
    longest: float
    left: float


@dataclass
class Straight:
    """Sums for a line of angle - sign * reference along the reference, each run about its own mean."""

    last: tuple[int, float, float] | None = None
    sums: dict[int, np.ndarray] = field(default_factory=dict)
    ends: dict[int, tuple[float, float]] = field(default_factory=dict)

    def add(self, at: Stretches, apart: np.ndarray, reference: np.ndarray) -> None:
        """Take stretches (n,) [rad]: angle - sign * reference in any form, the reference unwrapped."""
        r, d = reference, unwrapped(apart, 2 * np.pi, at.starts)
        if self.last and self.last[0] == at.runs[0]:  # go on from the stretch before
            first = np.arange(at.samples) < at.counts[0]
            r = r + first * 2 * np.pi * np.round((self.last[1] - r[0]) / (2 * np.pi))
            d = d + first * 2 * np.pi * np.round((self.last[2] - d[0]) / (2 * np.pi))
        self.last = at.runs[-1], float(r[-1]), float(d[-1])
        sums = at.sums(np.array([np.ones(at.samples), r, d, r * r, r * d, d * d]))
        lows, highs = np.minimum.reduceat(r, at.starts).tolist(), np.maximum.reduceat(r, at.starts).tolist()
        for run, new, low, high in zip(at.runs, sums.T, lows, highs, strict=True):
            before = self.ends.get(run, (np.inf, -np.inf))
            self.ends[run] = min(before[0], low), max(before[1], high)
            self.sums[run] = self.sums.get(run, 0.0) + new

    def found(self) -> "Line":
        """Return the line."""
        rr = rd = dd = samples = 0.0
        for n, r, d, r2, cross, d2 in self.sums.values():
            rr, rd, dd = rr + r2 - r * r / n, rd + cross - r * d / n, dd + d2 - d * d / n
            samples += n
        longest = max((high - low for low, high in self.ends.values()), default=0.0)
        if rr <= 0 or dd <= 0:
            return Line(0.0, 0.0, longest, 0.0)
        left = float(np.sqrt(max(dd - rd * rd / rr, 0.0) / samples))
        return Line(float(rd / rr), float(rd * rd / (rr * dd)), longest, left)


@dataclass
class Plates:
    """Sums for one wave per turn in each voltage, run by run."""

    square: dict[int, np.ndarray] = field(default_factory=dict)
    right: dict[int, np.ndarray] = field(default_factory=dict)
    energy: dict[int, np.ndarray] = field(default_factory=dict)

    def add(self, at: Stretches, values: np.ndarray, reference: np.ndarray) -> None:
        """Take stretches: voltages (2, n), reference (n,) [rad]."""
        rows = np.array([np.ones_like(reference), np.cos(reference), np.sin(reference)])
        for kept, new in (
            (self.square, at.sums(rows[:, None] * rows)),
            (self.right, at.sums(rows[:, None] * values)),
            (self.energy, at.sums(values**2)),
        ):
            for k, run in enumerate(at.runs):
                kept[run] = kept.get(run, 0.0) + new[..., k]

    def shares(self) -> np.ndarray:
        """Share of each voltage's variation within runs that one wave of the reference makes, (2,)."""
        made, whole = np.zeros(2), np.zeros(2)
        for run, square in self.square.items():
            right, n = self.right[run], square[0, 0]
            found, *_ = np.linalg.lstsq(square, right, rcond=1e-9)
            level = right[0] ** 2 / n
            made += (found * right).sum(axis=0) - level
            whole += self.energy[run] - level
        return np.asarray(made / np.maximum(whole, 1e-300))


class Some:
    """Evenly taken numbers (..., n) of a stream, at most MANY of them; `count` went by."""

    def __init__(self, none: np.ndarray) -> None:
        """Begin with no number: `none` is (..., 0)."""
        self.count, self.every = 0, 1
        self._taken, self._size = [none], 0

    @property
    def values(self) -> np.ndarray:
        """The numbers that were taken."""
        if len(self._taken) > 1:
            self._taken = [np.concatenate(self._taken, axis=-1)]
        return self._taken[0]

    def add(self, new: np.ndarray) -> None:
        """Take more of the stream."""
        kept = new[..., -self.count % self.every :: self.every].copy()  # a view would hold all of `new`
        self._taken.append(kept)
        self._size, self.count = self._size + kept.shape[-1], self.count + new.shape[-1]
        while self._size > MANY:
            self._taken, self.every = [self.values[..., ::2]], 2 * self.every
            self._size = self._taken[0].shape[-1]


@dataclass
class Jumps:
    """Steps of a column: those of half a turn or more, where it wraps, and the others."""

    wraps: Some = field(default_factory=lambda: Some(np.empty(0)))
    steps: Some = field(default_factory=lambda: Some(np.empty(0)))
    apart: Some = field(default_factory=lambda: Some(np.empty((2, 0))))
    """What angle - reference and angle + reference do where it wraps, whole turns aside."""

    def add(self, values: np.ndarray, angle: np.ndarray, reference: np.ndarray, inside: np.ndarray) -> None:
        """Take stretches (n,) [rad]; `values`: one of the other two; `inside`: steps that count (n - 1,)."""
        size = np.abs(np.diff(values))
        wraps = inside & (size > np.pi)
        self.steps.add(size[inside & ~wraps])
        if not wraps.any():
            return
        self.wraps.add(size[wraps])
        both = np.array([np.diff(angle - reference), np.diff(angle + reference)])[:, wraps]
        self.apart.add(np.abs(both - 2 * np.pi * np.round(both / (2 * np.pi))))

    @property
    def odd(self) -> float:
        """Turns after which the column wraps, if that is always the same and no whole number; else 0.

        And if the other column does not go along, as it does where parts of a turn are repeated.
        """
        if self.wraps.count < 2 or self.wraps.count > RARE * self.steps.count:
            return 0.0
        low, size, high = np.quantile(self.wraps.values, [0.25, 0.5, 0.75])
        usual = float(np.quantile(self.steps.values, 0.9))
        beside = abs(size - 2 * np.pi * round(size / (2 * np.pi)))
        alone = np.median(self.apart.values, axis=1).min() > BESIDE
        odd = high - low < 2 * usual + 0.02 and beside > 3 * usual + BESIDE
        return float((size + usual) / (2 * np.pi)) if odd and alone else 0.0


@dataclass
class Seen:
    """Sums over a log. `runs[r][k]`: of exp(i (angle - k reference)) in run r, k = 1, and -1: against it."""

    samples: int = 0
    runs: dict[int, dict[float, complex]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    some: Some = field(default_factory=lambda: Some(np.empty((3, 0))))
    """Run, angle and reference of some samples."""
    reference: np.ndarray = field(default_factory=lambda: np.zeros(BINS, dtype=bool))
    angle: np.ndarray = field(default_factory=lambda: np.zeros(BINS, dtype=bool))
    up: float = 0.0
    down: float = 0.0
    even: complex = 0j
    """Sum of exp(2 i |step|) over the steps of the reference: short where they are of all lengths."""
    lines: dict[float, Straight] = field(default_factory=lambda: {1.0: Straight(), -1.0: Straight()})
    plates: Plates = field(default_factory=Plates)
    jumps: tuple[Jumps, Jumps] = field(default_factory=lambda: (Jumps(), Jumps()))
    """Of angle and reference."""
    scales: list[tuple[float, float]] = field(default_factory=list)
    """Middle and half of the extent of each voltage [V]."""

    def add(self, at: Stretches, angle: np.ndarray, reference: np.ndarray) -> None:
        """Take stretches, (n,) each [rad]."""
        self.samples += at.samples
        for run, count in zip(at.runs, at.counts.tolist(), strict=True):
            self.counts[run] = self.counts.get(run, 0) + count
        self.some.add(np.array([np.repeat(at.runs, at.counts), angle, reference]))
        along, inside = unwrapped(reference, 2 * np.pi, at.starts), at.inside()
        for k, line in self.lines.items():
            apart = angle - k * reference
            turns = at.sums(np.cos(apart)) + 1j * at.sums(np.sin(apart))
            for run, turn in zip(at.runs, turns.tolist(), strict=True):
                own = self.runs.setdefault(run, {})
                own[k] = own.get(k, 0j) + turn
            line.add(at, apart, along)
        for bins, values in ((self.reference, reference), (self.angle, angle)):
            bins[np.floor(values * (BINS / (2 * np.pi))).astype(int) % BINS] = True
        for jumps, values in zip(self.jumps, (angle, reference), strict=True):
            jumps.add(values, angle, reference, inside)
        moved = np.diff(along)[inside]
        twice = 2 * np.abs(moved)
        self.even += complex(np.cos(twice).sum(), np.sin(twice).sum())
        self.up += float(moved[moved > 0].sum())
        self.down -= float(moved[moved < 0].sum())

    def follows(self, k: float, *, each: bool) -> float:
        """Return the length of the mean of exp(i (angle - k reference)), of runs by themselves or of all."""
        sums = [own[k] for own in self.runs.values()]
        return float(sum(map(abs, sums)) if each else abs(sum(sums))) / max(self.samples, 1)

    def length(self, run: int, k: float) -> float:
        """Return that of one run."""
        return abs(self.runs[run][k]) / max(self.counts[run], 1)


def seen_of(model: Model, log: Any) -> Seen:
    """Go over a log once (twice for voltages, whose middle and extent come first)."""
    scales = _scales(model, log) if len(model.channels) == 2 else []
    seen, (column,) = Seen(scales=scales), model.references
    for batch in batches(log, (*model.channels, column)):
        values, reference = np.array(batch.columns(model.channels)), batch.data[column]
        good = np.isfinite(values.sum(axis=0) + reference)
        at = Stretches.of(batch, good)
        if not at.samples:
            continue
        if not good.all():
            values, reference = values[:, good], reference[good]
        if scales:
            y, x = ((v - middle) / half for v, (middle, half) in zip(values, scales, strict=True))
            seen.plates.add(at, np.array([y, x]), reference)
            angle = np.arctan2(y, x)
        else:
            angle = values[0]
        seen.add(at, angle, reference)
    return seen


def _scales(model: Model, log: Any) -> list[tuple[float, float]]:
    """Middle and half of the extent of each voltage, spikes aside: near enough to count turns by."""
    seen = Some(np.empty((2, 0)))
    for batch in batches(log, model.channels):
        seen.add(np.array(batch.columns(model.channels)))
    low, high = np.nanquantile(seen.values, [EDGE, 1 - EDGE], axis=1)
    return [(float(a + b) / 2, float(b - a) / 2 or 1.0) for a, b in zip(low, high, strict=True)]
