"""The residual of a model, sample by sample, beside what it may depend on, and where it lies in frequency.

At most `ROOM` samples are held, evenly decimated, so that memory does not grow with the log.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.normal_equations import UNITS
from hallsym.diagnosis.residuals import Base, Piece, pieces
from hallsym.diagnosis.sign_flips import FEWEST_UNITS, stretch
from hallsym.diagnosis.survey import ENOUGH, MAINS
from hallsym.estimation.decoding import decoding_gain
from hallsym.log.quality.runs import FEWEST_SAMPLES
from hallsym.model.arrays import on_arrays

LINE = 0.01
"""Power of the motion, over that of its strongest line, from which on a frequency counts as its own."""
AROUND = 12
"""Frequencies on either side that a line is held against."""
MEDIAN = 0.85
"""Median over mean of the power of noise, a little low for the sum over three readings."""
RESOLVED = 3
"""Periods that a stretch must hold for its motion to be told from what is slow."""
MAINS_DRIFT = 0.3
"""Distance from them [Hz] that the mains and a clock may drift by."""
CROWDED = 0.3
"""Share of all frequencies from which on a motion is broad and has none of its own."""
STRETCH = 32
"""Samples that a stretch must have."""
BANDS = (0.0, 0.5, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0)
"""Lower ends of the bands in which all other frequencies are told apart [Hz]."""


@dataclass(frozen=True)
class Band:
    """Frequencies that belong together: `kind` "mains", "motion" (also its harmonics) or "band"."""

    kind: str
    name: str


MOTION = Band("motion", "the frequencies of the motion")
HARMONICS = {2: Band("motion", f"twice {MOTION.name}"), 3: Band("motion", f"three times {MOTION.name}")}


@dataclass(eq=False)
class Spectrum:
    """Power of the whitened residual by band and run: `power[band][run]`, `white` for noise."""

    power: dict[Band, dict[int, float]] = field(default_factory=dict)
    white: dict[Band, dict[int, float]] = field(default_factory=dict)
    motion_hz: list[float] = field(default_factory=list)
    seen: int = 0

    def add(self, piece: Piece) -> None:
        """Add a stretch of one run."""
        n = len(piece.t)
        if n < STRETCH or self.seen > ENOUGH:
            return
        self.seen += n
        r = np.where(piece.used, piece.residual, 0.0)
        f = np.fft.rfftfreq(n, float(np.median(np.diff(piece.t))))
        twice = np.where((f > 0) & ((n % 2 == 1) | (f < f[-1])), 2.0, 1.0)
        power = (np.abs(np.fft.rfft(r, axis=1)) ** 2).sum(axis=0) / n * twice
        white = twice * len(r)
        around = np.maximum(white, median_filter(power, 2 * AROUND + 1, mode="nearest") / MEDIAN)
        left = np.ones(len(f), bool)
        for band, mask in self._bands(piece, f).items():
            here = mask & left
            left &= ~mask
            floor = white if band.kind == "band" else around
            for store, values in ((self.power, power), (self.white, floor)):
                runs = store.setdefault(band, {})
                runs[piece.run] = runs.get(piece.run, 0.0) + float(values[here].sum())

    def _bands(self, piece: Piece, f: np.ndarray) -> dict[Band, np.ndarray]:
        """Frequencies of each band; the first that claims one has it."""
        wide = max(MAINS_DRIFT, 1.5 * f[1])
        out = {Band("mains", f"the mains, {hz:g} Hz"): np.abs(f - hz) < wide for hz in MAINS}
        window = np.hanning(len(piece.t))
        moved = np.abs(np.fft.rfft(piece.speed * window, axis=1)) ** 2
        position = moved.sum(axis=0) / np.maximum(f, f[1]) ** 2
        slow = float(position[1:RESOLVED].max())
        position[:RESOLVED] = 0.0
        lines = np.flatnonzero(position > LINE * max(position.max(), slow))
        near = _near(lines, len(f))
        if position.max() > slow and near.mean() < CROWDED:
            self.motion_hz.append(float(f[np.argmax(position)]))
            out[MOTION] = near
            for n, band in HARMONICS.items():
                out[band] = _near(n * lines[n * lines < len(f)], len(f))
        for low, high in zip(BANDS, (*BANDS[1:], np.inf), strict=True):
            name = f"{low:g} to {high:g} Hz" if np.isfinite(high) else f"more than {low:g} Hz"
            if (mask := (f >= low) & (f < high)).any():
                out[Band("band", name)] = mask
        return out


def _near(lines: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros(n, bool)
    for shift in (-1, 0, 1):
        out[np.clip(lines + shift, 0, n - 1)] = True
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
    of runs, of the block for significance, of the stretch of a run. `output`: (n_pose, K) turns a residual
    into decoded pose. `state`: logged columns that the model reads. `weights`: (n_pose,) of the pose metric.
    `towards`: (K, n) of a periodic reference, turns a residual into an error of it. `period`: by reference.
    `words`, `together`: what a person calls columns, and all of the state. `timed`: with a clock.
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
    output: np.ndarray
    weights: np.ndarray
    sigma: Mapping[str, float]
    spectrum: Spectrum = field(default_factory=Spectrum)
    timed: bool = True
    period: Mapping[str, float] = field(default_factory=dict)
    towards: Mapping[str, np.ndarray] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    together: str = ""

    @property
    def squares(self) -> np.ndarray:
        """Whitened square of each sample, (n,); K on average where there is noise only."""
        return np.einsum("kn,kl,ln->n", self.residual, self.precision, self.residual)

    def run_of(self, group: np.ndarray) -> np.ndarray:
        """Return the run in which each of the consecutive groups begins."""
        first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
        return self.run[first]

    @property
    def excess(self) -> float:
        """Sum of the whitened squares above what the noise explains."""
        return float(self.squares.sum()) - self.residual.size


def residual_table(base: Base, runs: Sequence[int]) -> ResidualTable | None:
    """Return what `base` leaves on `runs`; None where no sample of them counts."""
    model, wanted = base.model, frozenset(runs)
    read, decode = on_arrays(model.reading), decoding_gain(model)
    back = np.linalg.inv(base.whiten)
    stride = max(1, -(-base.log.rows // ROOM))
    seen = Counter[int]()
    out: dict[str, list[np.ndarray]] = {}
    spectrum = Spectrum()
    for piece in pieces(base, wanted):
        spectrum.add(piece)
        at = np.flatnonzero(piece.used)[::stride]
        place, seen[piece.run] = seen[piece.run] + at, seen[piece.run] + len(piece.t)
        data = {c: v[at] for c, v in piece.data.items()}
        state = [data[c] for c in model.state]
        if model.period:
            (gain,) = decode(base.p, [data[c] for c in model.references], state, base.weight)
            gain = np.asarray(gain).reshape(len(model.channels), len(model.pose), -1)
        for k, c in enumerate(model.references):
            if c in model.period:
                data[phase(c)] = data[f"d0_{c}"] % model.period[c]
                data[f"towards_{c}"] = np.broadcast_to(gain[:, k], (len(gain), len(at)))
            data[f"d0_{c}"] = at_rest(data[f"d0_{c}"], base.sigma.get(c, 0.0))
        smooth = [data[f"d0_{c}"] for c in model.references]
        (sensed,) = read(base.p, base.zeros_in(piece.run), smooth, state)
        rows = {"residual": back @ piece.residual[:, at], "rate": back @ piece.speed[:, at], "sensed": sensed}
        for name, values in {**data, **rows, "run": np.full(len(at), piece.run), "place": place}.items():
            out.setdefault(name, []).append(values)
    if not out or sum(len(v) for v in out["run"]) == 0:
        return None
    joined = {c: np.concatenate(v, axis=-1) for c, v in out.items()}
    run = joined.pop("run")
    spread = np.asarray(model.noise_gain(base.p, [float(joined[c].mean()) for c in model.state], base.weight))
    known = dict.fromkeys(run.tolist())
    fold, block, part = _blocks(run, joined.pop("place"), sum(seen[k] for k in known) / len(known))
    made = {c.name for c in model.computed}
    return ResidualTable(
        channels=model.channels,
        pose=model.pose,
        references=model.references,
        state=tuple(c for c in model.state if c not in made),
        run=run,
        residual=joined.pop("residual"),
        sensed=joined.pop("sensed"),
        rate=joined.pop("rate"),
        towards={c: joined.pop(f"towards_{c}") for c in model.references if c in model.period},
        columns=joined,
        precision=np.linalg.inv(base.covariance),
        fold=fold,
        block=block,
        part=part,
        output=spread,
        weights=base.pose_weights,
        sigma=base.sigma,
        spectrum=spectrum,
        timed=base.timed,
        period={c: model.period[c] for c in model.references if c in model.period},
        words=model.family.words,
        together=model.family.together,
    )


def phase(reference: str) -> str:
    """Return the column of the place of a reference within its period."""
    return f"phase_{reference}"


STILL = 5.0
"""An axis that moves less than this many sigma of its noise (rms) is at rest.

Its logged place is then noise to 4 % of its variance, and that noise is in the residual too."""


def at_rest(x: np.ndarray, sigma: float) -> np.ndarray:
    """Return where an axis was: its mean where all that moved it is noise, which is part of the residual."""
    return x if len(x) == 0 or np.std(x) > STILL * sigma else np.full(len(x), x.mean())


def _blocks(run: np.ndarray, place: np.ndarray, samples: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group of runs to leave out, block for significance and stretch of a run of each sample.

    `place`: of each sample within its run; `samples`: of a run. Blocks are the units of the scores.
    """
    _, first, order, counts = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
    fold = order * min(UNITS, len(first)) // len(first)
    within = np.arange(len(run)) - first[order]
    parts = max(PARTS, -(-2 * FEWEST_UNITS // len(first)))
    each = np.clip(counts // FEWEST_SAMPLES, 1, parts)[order]
    part = order * parts + within * each // counts[order]
    length = stretch(samples * len(first), len(first))
    if length is None:
        return fold, fold, part
    return fold, order * (1 + int(place.max()) // length) + place // length, part
