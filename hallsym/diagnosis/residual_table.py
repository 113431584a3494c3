"""The residual of a model, sample by sample, beside the coordinates it may depend on, and its spectrum.

At most `ROOM` samples are kept, evenly decimated, so that memory does not grow with the log.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from hallsym.diagnosis.normal_equations import UNITS
from hallsym.diagnosis.p_values import stretch
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residuals import Base, Piece, found_once, pieces
from hallsym.estimation.goodness_of_fit import STILL
from hallsym.families.mechanisms import MAINS_HZ
from hallsym.log.core import edges_of
from hallsym.log.quality.scan import FEWEST_SAMPLES
from hallsym.model.arrays import on_arrays

ROOM = 60_000
"""Most samples that are kept."""
PARTS = 4
"""Fewest stretches of a run, so that a gain of that run can be distinguished from noise."""


@dataclass(frozen=True, eq=False)
class ResidualTable:
    """Residual of the readings of `base` on some runs and the quantities it may depend on.

    `residual`, `sensed`, `rate`: (K, n) residual, expected reading at the smoothed reference, and its rate.
    `columns`: (n,) each; of a periodic reference also `phase_<reference>`, the place within its period.
    `decoding`: (n_pose, K, n) maps a residual to an error of the decoded pose. `fold`, `block`, `part`:
    (n,) index of the group of runs, of the block for significance, of the stretch of a run.
    """

    base: Base
    run: np.ndarray
    residual: np.ndarray
    sensed: np.ndarray
    rate: np.ndarray
    columns: Mapping[str, np.ndarray]
    decoding: np.ndarray
    fold: np.ndarray
    block: np.ndarray
    part: np.ndarray

    @cached_property
    def variance(self) -> np.ndarray:
        """Variance of one residual of each sensor that the noise makes, (K,)."""
        return np.diag(self.base.covariance)

    @cached_property
    def precision(self) -> np.ndarray:
        """Inverse covariance of one residual, (K, K)."""
        return np.linalg.inv(self.base.covariance)

    @cached_property
    def squares(self) -> np.ndarray:
        """Whitened square of each sample, (n,); K on average where there is noise only."""
        return self.whitened_squares(self.residual)

    def whitened_squares(self, residual: np.ndarray) -> np.ndarray:
        """Return the whitened square of each sample of a residual (K, n), (n,)."""
        return np.asarray(np.einsum("kn,kl,ln->n", residual, self.precision, residual))

    def run_of(self, group: np.ndarray) -> np.ndarray:
        """Return the run, as it was recorded, in which each of the consecutive groups begins."""
        return self.run[edges_of(group)[:-1]] * (not self.base.sliced)

    @property
    def excess(self) -> float:
        """Sum of the whitened squares above those of the noise."""
        return float(self.squares.sum()) - self.residual.size

    def decoded(self, residual: np.ndarray) -> np.ndarray:
        """Return the errors of the decoded pose that a residual (K, n) makes, (n_pose, n)."""
        return np.asarray(np.einsum("ikn,kn->in", self.decoding, residual))

    def metric(self, residual: np.ndarray) -> float:
        """Return the gap metric of a residual (K, n)."""
        weighed = self.base.pose_weights[:, None] * self.decoded(residual)
        return float(np.linalg.norm(weighed) / np.sqrt(len(self.run)))


def table_of(base: Base, runs: frozenset[int]) -> ResidualTable | None:
    """Return the residual of `base` on `runs`; None where no sample of them counts."""
    model, back = base.model, np.linalg.inv(base.whiten)
    stride = max(1, -(-base.part.log.rows // ROOM))
    seen = Counter[int]()
    out: dict[str, list[np.ndarray]] = {}
    for piece in pieces(base, runs):
        at = np.flatnonzero(piece.used)[::stride]
        data = {c: v[at] for c, v in piece.data.items()}
        for c in model.references:
            if c in model.period:
                data[phase(c)] = data[f"d0_{c}"] % model.period[c]
            data[f"d0_{c}"] = at_rest(data[f"d0_{c}"], base.sigma.get(c, 0.0))
        data |= {"residual": back @ piece.residual[:, at], "rate": back @ piece.speed[:, at]}
        data |= {"run": np.full(len(at), piece.run), "place": seen[piece.run] + at}
        seen[piece.run] += len(piece.t)
        for name, values in data.items():
            out.setdefault(name, []).append(values)
    if not out or sum(len(v) for v in out["run"]) == 0:
        return None
    joined = {c: np.concatenate(out.pop(c), axis=-1) for c in list(out)}  # column by column, to save memory
    residual, rate, run, place = (joined.pop(name) for name in ("residual", "rate", "run", "place"))
    pose, smooth, state = (
        [joined[c] for c in names]
        for names in (model.references, [f"d0_{c}" for c in model.references], model.state)
    )
    edges = edges_of(run)
    own = np.array([base.offsets_in(k) for k in run[edges[:-1]].tolist()])
    offsets = np.repeat(own.T, np.diff(edges), axis=1)
    (sensed,) = on_arrays(model.reading)(base.p, offsets, smooth, state)
    fold, block, part = _blocks(run, place, sum(seen[k] for k in set(run.tolist())), base.policy)
    return ResidualTable(
        base, run, residual, sensed, rate, joined, base.to_pose(pose, state), fold, block, part
    )


residual_table = found_once(table_of)
"""The same, cached for the life of the base."""


def both(base: Base, runs: Sequence[int]) -> tuple[ResidualTable | None, ResidualTable | None]:
    """Return the residual on the fitted and on the holdout runs among `runs`."""
    holdout = base.holdout.intersection(runs)
    return residual_table(base, set(runs) - holdout), residual_table(base, holdout)


def slices(group: np.ndarray) -> list[slice]:
    """Return the consecutive samples of each group."""
    return [slice(a, b) for a, b in pairwise(edges_of(group))]


def sums(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the sums of `values` (..., n) over the consecutive samples of each group."""
    return np.add.reduceat(values, edges_of(group)[:-1], axis=-1)


def means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the means of `values` (..., n) over the consecutive samples of each group."""
    return sums(values, group) / np.diff(edges_of(group))


def phase(reference: str) -> str:
    """Return the column of the place of a reference within its period."""
    return f"phase_{reference}"


def at_rest(x: np.ndarray, sigma: float) -> np.ndarray:
    """Return the place of an axis: its mean where it moved by noise alone, which is part of the residual."""
    return x if len(x) == 0 or np.std(x) > STILL * sigma else np.full(len(x), x.mean())


def _blocks(
    run: np.ndarray, place: np.ndarray, samples: int, policy: Policy
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group of runs to leave out, block for significance and stretch of a run of each sample.

    `place`: of each sample within its run; `samples`: of all runs. Blocks are the units of the scores.
    """
    _, first, order, counts = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
    fold = order * min(UNITS, len(first)) // len(first)
    parts = max(PARTS, -(-2 * policy.fewest_units // len(first)))
    within = np.arange(len(run)) - first[order]
    each = np.clip(counts // FEWEST_SAMPLES, 1, parts)[order]
    part = order * parts + within * each // counts[order]
    length = stretch(samples, len(first), policy)
    if length is None:
        return fold, fold, part
    return fold, order * (1 + int(place.max()) // length) + place // length, part


# -- where it lies in frequency ------------------------------------------------------------------------------


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
        """Plain name."""
        if self.mains:
            return f"the mains, {self.low:g} Hz"
        return f"{self.low:g} to {self.high:g} Hz" if self.low else f"less than {self.high:g} Hz"


Spectrum = dict[FrequencyBand, dict[int, np.ndarray]]
"""Power of the whitened residual by band and run, and that of noise: (2,) each."""


def spectrum(found: Iterable[Piece]) -> Spectrum:
    """Return the power of stretches of runs by band; those too short to have a spectrum are left out."""
    out: Spectrum = {}
    for piece in found:
        n = len(piece.t)
        if n < 2 * FEWEST_SAMPLES:
            continue
        r = np.where(piece.used, piece.residual, 0.0)
        f = np.fft.rfftfreq(n, float(np.median(np.diff(piece.t))))
        twice = np.where((f > 0) & ((n % 2 == 1) | (f < f[-1])), 2.0, 1.0)
        power = (np.abs(np.fft.rfft(r, axis=1)) ** 2).sum(axis=0) / n * twice
        white = twice * len(r)
        for band, here in _bands(f).items():
            floor = white
            if band.mains:  # a line stands out from its neighbours, whatever the spectrum
                beside = np.convolve(here, np.ones(2 * int(here.sum()) + 1), "same") > 0
                floor = np.maximum(white, power[beside & ~here].mean() if (beside & ~here).any() else 0.0)
            runs = out.setdefault(band, {})
            runs[piece.run] = runs.get(piece.run, 0.0) + np.array([power[here].sum(), floor[here].sum()])
    return out


def _bands(f: np.ndarray) -> dict[FrequencyBand, np.ndarray]:
    """Return the frequencies of each band: those of the mains, and the octaves of the others."""
    wide = max(0.2, 1.5 * f[1])  # Hz, that the mains may drift by: grid code of Europe (EU 2017/1485)
    out = {FrequencyBand(hz, hz): np.abs(f - hz) < wide for hz in MAINS_HZ}
    left = ~np.any(list(out.values()), axis=0)
    octave = np.floor(np.log2(np.maximum(f, 1.0)))
    for k in np.unique(octave):
        out[FrequencyBand(2**k if k else 0.0, 2 ** (k + 1))] = left & (octave == k)
    return out
