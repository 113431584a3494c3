"""What has to be said of an encoder's log before it is fitted: turns, direction, zero."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.model import Inspection, Model

BINS = 72
"""Sectors of a turn that are looked at: 5 deg each."""
GAP_NOTE, GAP_REFUSE = 30.0, 120.0
"""Widest part of a turn [deg] without a sample: what is worth a note, and what no harmonics survive."""
FOLLOWS = 0.5
"""An encoder follows its reference if the mean of exp(i (angle - reference)) is longer than this."""
CLEARLY, LEAST_ZERO = 3.0, 1.0
"""What zeros of runs must differ by for a note: times the scatter of the angle within a run, and deg."""
RATIOS = tuple(range(2, 13))
"""Other counts of turns that are tried: pole pairs and gears."""


@dataclass
class _Seen:
    """Sums over a log. `follows[k]`: of exp(i (angle - k reference)); 1/k stands for k angle - reference."""

    samples: int = 0
    follows: dict[float, complex] = field(default_factory=dict)
    runs: dict[int, dict[float, complex]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    reference: np.ndarray = field(default_factory=lambda: np.zeros(BINS, dtype=bool))
    angle: np.ndarray = field(default_factory=lambda: np.zeros(BINS, dtype=bool))
    up: float = 0.0
    down: float = 0.0

    def add(self, run: int, angle: np.ndarray, reference: np.ndarray) -> None:
        self.samples += len(angle)
        self.counts[run] = self.counts.get(run, 0) + len(angle)
        own = self.runs.setdefault(run, {})
        for k in (1.0, -1.0):
            own[k] = own.get(k, 0j) + np.exp(1j * (angle - k * reference)).sum()
        for k in (1, -1, *RATIOS, *(-k for k in RATIOS)):
            self._follow(float(k), angle - k * reference)
            if abs(k) > 1:
                self._follow(1.0 / k, k * angle - reference)
        for bins, values in ((self.reference, reference), (self.angle, angle)):
            bins[(np.mod(values, 2 * np.pi) / (2 * np.pi) * BINS).astype(int) % BINS] = True
        moved = np.diff(np.unwrap(reference))
        self.up += float(moved[moved > 0].sum())
        self.down -= float(moved[moved < 0].sum())

    def _follow(self, k: float, difference: np.ndarray) -> None:
        self.follows[k] = self.follows.get(k, 0j) + np.exp(1j * difference).sum()


def inspect(model: Model, log: Any, *, fitted: bool = True) -> Inspection:
    """Refuse a log that no encoder model can be fitted to; return its direction and what it cannot tell.

    `fitted` False: the log is only judged, for which a part of a turn is enough.

    Raises `InputError` when the reference covers too little of a turn, makes another number of turns, or does
    not belong to the readings.
    """
    seen, (column,) = _Seen(), model.references
    middle = _middles(model, log)
    for block in log.blocks((*model.channels, column)):
        values = [block.data[c] for c in model.channels]
        good = np.isfinite(np.sum([*values, block.data[column]], axis=0))
        if len(values) == 2:
            y, x = (v[good] - m for v, m in zip(values, middle, strict=True))
            angle = np.arctan2(y, x)
        else:
            angle = values[0][good]
        seen.add(block.run, angle, block.data[column][good])
    if model.zeros:  # each run has a zero of its own
        for k in (1.0, -1.0):
            seen.follows[k] = sum(abs(own[k]) for own in seen.runs.values())
    _refuse(seen, log.name, column, fitted)
    forward = abs(seen.follows[1.0]) >= abs(seen.follows[-1.0])
    notes = [*_notes(seen, column), *_homed(seen, column, 1.0 if forward else -1.0, bool(model.zeros))]
    if not forward:
        channel = model.channels[0]
        swapped = ", or the two voltages are swapped" if len(model.channels) == 2 else ""
        notes.append(
            f"The encoder turns against {column} (its other side faces the reference{swapped}); {channel} is "
            "taken with its sign reversed."
        )
    wiring = None if forward else tuple((c, -1 if k == 0 else 1) for k, c in enumerate(model.channels))
    return Inspection(tuple(notes), wiring)


def _middles(model: Model, log: Any) -> list[float]:
    """Middle of the extent of each voltage: near enough to its offset to count turns."""
    low, high = np.full(len(model.channels), np.inf), np.full(len(model.channels), -np.inf)
    for block in log.blocks(model.channels):
        for k, c in enumerate(model.channels):
            low[k] = np.fmin(low[k], np.nanmin(block.data[c]))
            high[k] = np.fmax(high[k], np.nanmax(block.data[c]))
    return [float(v) for v in (low + high) / 2]


def _refuse(seen: _Seen, name: str, column: str, fitted: bool) -> None:
    gap, other = _gap(seen.reference), _gap(seen.angle)
    length = {k: abs(v) / max(seen.samples, 1) for k, v in seen.follows.items()}
    if fitted and gap > GAP_REFUSE and other > GAP_REFUSE:
        raise InputError(
            f"Column {column} of {name} covers only {360 - gap:.0f} deg of a turn; offset, gain and phase of "
            "an encoder show once and twice per turn, so record at least one full turn."
        )
    best = max(length, key=lambda k: (round(length[k], 3), -abs(k)))
    straight = max(length[1.0], length[-1.0])
    if straight < FOLLOWS and length[best] > FOLLOWS:
        many = f"{abs(best):g} turns" if abs(best) > 1 else f"1/{1 / abs(best):.0f} of a turn"
        raise InputError(
            f"In {name} the encoder makes {many} while {column} makes one; both must be angles of one shaft: "
            f"scale the reference by {abs(best):.6g} in a column file, or check its unit."
        )
    alone = max(sum(abs(own[k]) for own in seen.runs.values()) for k in (1.0, -1.0)) / max(seen.samples, 1)
    if straight < FOLLOWS < alone and len(seen.runs) > 1:
        raise InputError(
            f"The encoder in {name} follows {column} in each run, but each from another zero: the reference "
            "was homed anew between runs. Fit with --effect zero_deviation, which gives each run its own."
        )
    if straight < FOLLOWS:
        raise InputError(
            f"The encoder in {name} does not follow {column} (their difference is spread over the turn); it "
            "does not belong to these readings: check file, clock, columns and units."
        )


def _notes(seen: _Seen, column: str) -> list[str]:
    notes, gap = [], _gap(seen.reference)
    if gap > GAP_NOTE:
        notes.append(
            f"No sample lies in {gap:.0f} deg of the turn: what is said of that part is extrapolated."
        )
    if min(seen.up, seen.down) < 0.05 * (seen.up + seen.down):
        notes.append(
            f"{column} turns in one direction only: latency and hysteresis look like another zero and are "
            "not observable (latency is, as far as the speed changes); record both directions to tell them."
        )
    return notes


def _homed(seen: _Seen, column: str, sign: float, own: bool) -> list[str]:
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
    most = np.degrees(abs(zeros[far]))
    return [
        f"The zero of {column} differs between runs, by {most:.3g} deg in run {far} beside run {first}. If "
        "it was homed anew, --effect zero_deviation gives each run its own; latency makes differences too."
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
