"""What has to be said of an encoder's log before it is fitted: turns, direction, zero."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.log.batches import Batch, batches
from hallsym.log.phase import unwrapped
from hallsym.model import Inspection, Model

# -- sums over a log that tell how an encoder follows its reference: turns and sectors -------------------

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


# -- what is said of an encoder's log ------------------------------------------------------------------------

TOGETHER = 0.75
"""An encoder follows its reference within a run if the mean of exp(i (angle - reference)) is longer: 43 deg
of scatter, far beyond any offset, gain or clipping."""
GAP_NOTE, GAP_REFUSE = 30.0, 120.0
"""Widest part of a turn [deg] without a sample: what is worth a note, and what no harmonics survive."""
FOLLOWS = 0.5
"""An encoder follows its reference if the mean of exp(i (angle - reference)) is longer than this."""
CLEARLY, LEAST_ZERO = 3.0, 1.0
"""What zeros of runs must differ by for a note: times the scatter of the angle within a run, and deg."""
ORDERED = 0.3
"""Length of the mean of exp(2 i |step|) below which rows follow no motion."""


def inspect(model: Model, log: Any, *, fitted: bool = True) -> Inspection:
    """Refuse a log that no encoder model can be fitted to; return its direction and what it cannot tell.

    `fitted` False: the log is only judged, for which a part of a turn is enough.

    Raises `InputError` when the reference covers too little of a turn, makes another number of turns, or does
    not belong to the readings.
    """
    seen, (column,) = seen_of(model, log), model.references
    own = bool(model.zeros)  # each run has a zero of its own
    forward = seen.follows(1.0, each=own) >= seen.follows(-1.0, each=own)
    sign = 1.0 if forward else -1.0
    _refuse(seen, log, model, fitted)
    guessed = fitted and "t_s" not in log.columns and column not in log.noise
    if guessed and abs(seen.even) < ORDERED * (seen.samples - len(seen.runs)):
        raise InputError(
            f"Rows of {log.name} are in no order ({column} moves by anything from one to the next), so the "
            f"noise cannot be estimated: sort them by {column}, or state the noise with --noise."
        )
    notes = _notes(seen, column, timed="t_s" in log.columns)
    notes += _homed(seen, column, sign, own)
    if not forward:
        channel = model.channels[0]
        swapped = ", or the two voltages are swapped" if len(model.channels) == 2 else ""
        notes.append(
            f"The encoder turns against {column} (its other side faces the reference{swapped}); {channel} is "
            "taken with its sign reversed."
        )
    return Inspection(tuple(notes), () if forward else model.channels[:1])


def _refuse(seen: Seen, log: Any, model: Model, fitted: bool) -> None:
    gap, other, (column,), name = _gap(seen.reference), _gap(seen.angle), model.references, log.name
    if fitted and gap > GAP_REFUSE and other > GAP_REFUSE:
        raise InputError(
            f"Column {column} of {name} covers only {360 - gap:.0f} deg of a turn; offset, gain and phase of "
            "an encoder show once and twice per turn, so record at least one full turn, or check its unit."
        )
    own = bool(model.zeros)
    straight, alone = (max(seen.follows(k, each=each) for k in (1.0, -1.0)) for each in (own, True))
    if straight < FOLLOWS < alone and len(seen.runs) > 1:
        raise InputError(
            f"The encoder in {name} follows {column} in each run, but each from another zero: the reference "
            "was homed anew between runs. Fit with --effect zero_deviation, which "
            "gives each run its own."
        )
    if max(straight, alone) < (TOGETHER if gap < GAP_REFUSE else FOLLOWS):
        raise InputError(
            f"The encoder in {name} does not follow {column} (their difference is spread over the turn); it "
            "does not belong to these readings: check file, clock, columns and units."
        )


def _notes(seen: Seen, column: str, *, timed: bool) -> list[str]:
    notes, gap = [], _gap(seen.reference)
    if gap > GAP_NOTE:
        notes.append(
            f"No sample lies in {gap:.0f} deg of the turn: what is said of that part is extrapolated."
        )
    if min(seen.up, seen.down) < 0.05 * (seen.up + seen.down):
        lost = "hysteresis looks like another zero and is not observable; record both directions to tell it."
        if timed:
            lost = (
                "latency and hysteresis look like another zero and are not observable (latency is, as far as "
                "the speed changes); record both directions to tell them."
            )
        notes.append(f"{column} turns in one direction only: {lost}")
    return notes


def _homed(seen: Seen, column: str, sign: float, own: bool) -> list[str]:
    """What to say of zeros of runs that clearly differ, unless each has its `own`."""
    if own or len(seen.runs) < 2:
        return []
    first = next(iter(seen.runs))
    zeros = {run: np.angle(k[sign] / seen.runs[first][sign]) for run, k in seen.runs.items()}
    length = [abs(k[sign]) / max(seen.counts[run], 1) for run, k in seen.runs.items()]
    spread = float(np.sqrt(max(-2 * np.log(max(np.median(length), 1e-9)), 0.0)))
    far = max(zeros, key=lambda run: abs(zeros[run]))
    if abs(zeros[far]) < max(CLEARLY * spread, np.radians(LEAST_ZERO)):
        return []
    return [
        f"The zero of {column} differs between runs, by {np.degrees(abs(zeros[far])):.3g} deg in run {far} "
        f"beside run {first}. If it was homed anew, --effect zero_deviation gives each run its own; latency, "
        "another scale of the reference or inverted voltages make differences too."
    ]


def _gap(bins: np.ndarray) -> float:
    """Widest run of empty sectors around the turn [deg]."""
    if bins.all():
        return 0.0
    if not bins.any():
        return 360.0
    at = np.flatnonzero(bins)
    between = np.diff(np.r_[at, at[0] + BINS]) - 1
    return float(between.max()) * 360.0 / BINS
