"""The residual of a model, sample by sample, beside what it may depend on, and where it lies in frequency.

At most `ROOM` samples are held, evenly decimated, so that memory does not grow with the log.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from hallsym.diagnosis.normal_equations import UNITS
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residuals import Base, Piece, found_once, pieces
from hallsym.diagnosis.sign_flips import stretch
from hallsym.estimation.residual_noise import STILL
from hallsym.families.mechanisms import MAINS_HZ
from hallsym.log.quality.runs import FEWEST_SAMPLES
from hallsym.model.arrays import on_arrays


@dataclass(frozen=True)
class FrequencyBand:
    """Frequencies that belong together, from `low` to `high` [Hz]: octaves, and the mains, which are both."""

    low: float
    high: float

    @property
    def mains(self) -> bool:
        """Whether it is a frequency of the mains."""
        return self.low == self.high

    @property
    def name(self) -> str:
        """What a person calls it."""
        if self.mains:
            return f"the mains, {self.low:g} Hz"
        return f"{self.low:g} to {self.high:g} Hz" if self.low else f"less than {self.high:g} Hz"


@dataclass(eq=False)
class Spectrum:
    """Power of the whitened residual by band and run: `power[band][run]`, `white` for noise."""

    power: dict[FrequencyBand, dict[int, float]] = field(default_factory=dict)
    white: dict[FrequencyBand, dict[int, float]] = field(default_factory=dict)

    def add(self, piece: Piece) -> None:
        """Add a stretch of one run."""
        n = len(piece.t)
        if n < 2 * FEWEST_SAMPLES:
            return
        r = np.where(piece.used, piece.residual, 0.0)
        f = np.fft.rfftfreq(n, float(np.median(np.diff(piece.t))))
        twice = np.where((f > 0) & ((n % 2 == 1) | (f < f[-1])), 2.0, 1.0)
        power = (np.abs(np.fft.rfft(r, axis=1)) ** 2).sum(axis=0) / n * twice
        white = twice * len(r)
        for band, here in _bands(f).items():
            floor = white
            if band.mains:  # a line stands out from what is beside it, whatever its colour
                beside = np.convolve(here, np.ones(2 * int(here.sum()) + 1), "same") > 0
                floor = np.maximum(white, power[beside & ~here].mean() if (beside & ~here).any() else 0.0)
            for store, values in ((self.power, power), (self.white, floor)):
                runs = store.setdefault(band, {})
                runs[piece.run] = runs.get(piece.run, 0.0) + float(values[here].sum())


def _bands(f: np.ndarray) -> dict[FrequencyBand, np.ndarray]:
    """Return the frequencies of each band: those of the mains, and the octaves of the others."""
    wide = max(0.2, 1.5 * f[1])  # Hz, that the mains may drift by: grid code of Europe (EU 2017/1485)
    out = {FrequencyBand(hz, hz): np.abs(f - hz) < wide for hz in MAINS_HZ}
    left = ~np.any(list(out.values()), axis=0)
    octave = np.floor(np.log2(np.maximum(f, 1.0)))
    for k in np.unique(octave):
        out[FrequencyBand(2**k if k else 0.0, 2 ** (k + 1))] = left & (octave == k)
    return out


ROOM = 60_000
"""Samples that are held."""
PARTS = 4
"""Stretches of a run at least, so that a gain of its own can be told from noise."""


@dataclass(frozen=True, eq=False)
class ResidualTable:
    """Residual of the readings on some runs and what it may depend on.

    `residual`, `sensed`, `rate`: (K, n) residual, expected reading at the smoothed reference, and its rate.
    `columns`: (n,) each; of a periodic reference also `phase_<reference>`, the place within its period.
    `precision`: (K, K) inverse covariance of one residual. `fold`, `block`, `part`: (n,) index of the group
    of runs, of the block for significance, of the stretch of a run. `decoding`: (n_pose, K, n) turns a
    residual into an error of the decoded pose, which `weights` (n_pose,) weigh in the pose metric. `state`:
    logged columns that the model reads. `period`: by reference.
    `words`, `together`: what a person calls columns, and all of the state. `timed`: with a clock. `sliced`:
    of slices of one recording.
    """

    channels: tuple[str, ...]
    pose: tuple[str, ...]
    references: tuple[str, ...]
    state: tuple[str, ...]
    run: np.ndarray
    residual: np.ndarray
    sensed: np.ndarray
    rate: np.ndarray
    columns: Mapping[str, np.ndarray]
    precision: np.ndarray
    fold: np.ndarray
    block: np.ndarray
    part: np.ndarray
    decoding: np.ndarray
    weights: np.ndarray
    sigma: Mapping[str, float]
    policy: Policy
    spectrum: Spectrum = field(default_factory=Spectrum)
    timed: bool = True
    sliced: bool = False
    period: Mapping[str, float] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    together: str = ""

    @property
    def squares(self) -> np.ndarray:
        """Whitened square of each sample, (n,); K on average where there is noise only."""
        return np.einsum("kn,kl,ln->n", self.residual, self.precision, self.residual)

    def run_of(self, group: np.ndarray) -> np.ndarray:
        """Return the run, as it was recorded, in which each of the consecutive groups begins."""
        first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
        return self.run[first] * (not self.sliced)

    @property
    def excess(self) -> float:
        """Sum of the whitened squares above what the noise explains."""
        return float(self.squares.sum()) - self.residual.size

    def decoded(self, residual: np.ndarray) -> np.ndarray:
        """Return the errors of the decoded pose that a residual (K, n) makes, (n_pose, n)."""
        return np.asarray(np.einsum("ikn,kn->in", self.decoding, residual))

    def metric(self, residual: np.ndarray) -> float:
        """Return the gap metric of a residual (K, n)."""
        return float(np.linalg.norm(self.weights[:, None] * self.decoded(residual)) / np.sqrt(len(self.run)))


@found_once
def residual_table(base: Base, runs: frozenset[int]) -> ResidualTable | None:
    """Return what `base` leaves on `runs`; None where no sample of them counts."""
    model = base.model
    read, back = on_arrays(model.reading), np.linalg.inv(base.whiten)
    stride = max(1, -(-base.log.rows // ROOM))
    seen = Counter[int]()
    out: dict[str, list[np.ndarray]] = {}
    spectrum = Spectrum()
    for piece in pieces(base, runs):
        spectrum.add(piece)
        at = np.flatnonzero(piece.used)[::stride]
        place, seen[piece.run] = seen[piece.run] + at, seen[piece.run] + len(piece.t)
        data = {c: v[at] for c, v in piece.data.items()}
        for c in model.references:
            if c in model.period:
                data[phase(c)] = data[f"d0_{c}"] % model.period[c]
            data[f"d0_{c}"] = at_rest(data[f"d0_{c}"], base.sigma.get(c, 0.0))
        rows = {"residual": back @ piece.residual[:, at], "rate": back @ piece.speed[:, at]}
        for name, values in {**data, **rows, "run": np.full(len(at), piece.run), "place": place}.items():
            out.setdefault(name, []).append(values)
    if not out or sum(len(v) for v in out["run"]) == 0:
        return None
    joined = {c: np.concatenate(v, axis=-1) for c, v in out.items()}
    run = joined.pop("run")
    state = [joined[c] for c in model.state]
    smooth = [joined[f"d0_{c}"] for c in model.references]
    (sensed,) = read(base.p, base.zeros_in_runs(run), smooth, state)
    known = dict.fromkeys(run.tolist())
    samples = sum(seen[k] for k in known) / len(known)
    fold, block, part = _blocks(run, joined.pop("place"), samples, base.policy)
    made = {c.name for c in model.computed}
    return ResidualTable(
        channels=model.channels,
        pose=model.pose,
        references=model.references,
        state=tuple(c for c in model.state if c not in made),
        run=run,
        residual=joined.pop("residual"),
        sensed=sensed,
        rate=joined.pop("rate"),
        decoding=base.to_pose([joined[c] for c in model.references], state),
        columns=joined,
        precision=np.linalg.inv(base.covariance),
        fold=fold,
        block=block,
        part=part,
        weights=base.pose_weights,
        sigma=base.sigma,
        policy=base.policy,
        spectrum=spectrum,
        timed=base.timed,
        sliced=base.sliced,
        period={c: model.period[c] for c in model.references if c in model.period},
        words=model.family.words,
        together=model.family.together,
    )


def both(base: Base, runs: Sequence[int]) -> tuple[ResidualTable | None, ResidualTable | None]:
    """Return the residual on those of `runs` that are fitted and on those that are held out."""
    apart = (False, True)
    fitted, held = (residual_table(base, [r for r in runs if (r in base.holdout) == held]) for held in apart)
    return fitted, held


def slices(group: np.ndarray) -> list[slice]:
    """Return the consecutive samples of each group."""
    edges = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), len(group)]
    return [slice(a, b) for a, b in pairwise(edges)]


def phase(reference: str) -> str:
    """Return the column of the place of a reference within its period."""
    return f"phase_{reference}"


def at_rest(x: np.ndarray, sigma: float) -> np.ndarray:
    """Return where an axis was: its mean where all that moved it is noise, which is part of the residual."""
    return x if len(x) == 0 or np.std(x) > STILL * sigma else np.full(len(x), x.mean())


def _blocks(
    run: np.ndarray, place: np.ndarray, samples: float, policy: Policy
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group of runs to leave out, block for significance and stretch of a run of each sample.

    `place`: of each sample within its run; `samples`: of a run. Blocks are the units of the scores.
    """
    _, first, order, counts = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
    fold = order * min(UNITS, len(first)) // len(first)
    parts = max(PARTS, -(-2 * policy.fewest_units // len(first)))
    within = np.arange(len(run)) - first[order]
    each = np.clip(counts // FEWEST_SAMPLES, 1, parts)[order]
    part = order * parts + within * each // counts[order]
    length = stretch(samples * len(first), len(first), policy)
    if length is None:
        return fold, fold, part
    return fold, order * (1 + int(place.max()) // length) + place // length, part
