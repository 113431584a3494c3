"""Sums over a log that tell how an encoder follows its reference: turns and sectors."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.log.batches import Batch, batches
from hallsym.log.phase import unwrapped
from hallsym.model import Model

BINS = 72
"""Sectors of a turn that are looked at: 5 deg each."""
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
    scales: list[tuple[float, float]] = field(default_factory=list)
    """Middle and half of the extent of each voltage [V]."""

    def add(self, at: Stretches, angle: np.ndarray, reference: np.ndarray) -> None:
        """Take stretches, (n,) each [rad]."""
        self.samples += at.samples
        for run, count in zip(at.runs, at.counts.tolist(), strict=True):
            self.counts[run] = self.counts.get(run, 0) + count
        self.some.add(np.array([np.repeat(at.runs, at.counts), angle, reference]))
        along, inside = unwrapped(reference, 2 * np.pi, at.starts), at.inside()
        for k in (1.0, -1.0):
            apart = angle - k * reference
            turns = at.sums(np.cos(apart)) + 1j * at.sums(np.sin(apart))
            for run, turn in zip(at.runs, turns.tolist(), strict=True):
                own = self.runs.setdefault(run, {})
                own[k] = own.get(k, 0j) + turn
        for bins, values in ((self.reference, reference), (self.angle, angle)):
            bins[np.floor(values * (BINS / (2 * np.pi))).astype(int) % BINS] = True
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
