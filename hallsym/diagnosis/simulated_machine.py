"""The simulated machine of a self-test: a fitted model on recorded motion, its noise, decimated logs.

The recorded reference, smoothed, vertical state, time and temperature are taken as the truth. The noise is
that of the log as it is: as large and as correlated in time as what the fit leaves
(`hallsym.diagnosis.noise`), in the readings and in the reference. What is stated of it is what the log
states, and no more.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from types import MappingProxyType

import numpy as np

from hallsym.diagnosis.noise import noise_of_rest, noise_text
from hallsym.diagnosis.normal_equations import coefficients, normal_equations
from hallsym.diagnosis.residual_table import at_rest
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.survey import MAINS, MAINS_BAND
from hallsym.estimation import autoregressive
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log, Noise, Sigma
from hallsym.log.batches import batches
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.model.derived import rate

NOTHING: Mapping[str, np.ndarray] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class SimulatedMachine:
    """A fitted model as the machine: `base` holds the log with the motion, the values and the zeros.

    `clean`: its readings without noise, (K, rows). `speed`: d clean / dt along the smoothed motion.
    `floor_m`: gap metric that the noise makes. `stated`: columns whose noise the log states.
    """

    base: Base
    columns: Mapping[str, np.ndarray]
    clean: np.ndarray
    speed: np.ndarray
    floor_m: float
    stated: frozenset[str]

    @property
    def runs(self) -> list[int]:
        """Runs that are fitted."""
        return [r for r in self.base.log.runs if r not in self.base.holdout]

    def log(self, readings: np.ndarray, reference: Mapping[str, np.ndarray] = NOTHING) -> Log:
        """Return the log with other readings, (K, rows), and noise of the `reference` by column, (rows,)."""
        base = self.base
        rows = dict(zip(base.model.channels, readings, strict=True))
        rows |= {c: self.columns[c] + noise for c, noise in reference.items()}
        noise = Noise({c: Sigma(s, "given") for c, s in base.sigma.items() if c in self.stated})
        meta = replace(base.log.meta, holdout=tuple(sorted(base.holdout)))
        return Log.from_arrays({**self.columns, **rows}, noise, meta, "a simulated log")

    def gap(self, readings: np.ndarray) -> tuple[float, float]:
        """Gap metric [m] of noise-free readings on the held-out runs: with the model fitted, and before."""
        t = normal_equations(replace(self.base, log=self.log(readings)))
        n = len(self.base.free)
        known, judged = t.units(self.runs), t.units(tuple(self.base.holdout))
        theta = coefficients(t.likelihood[known].sum(axis=0), np.arange(n))
        v = np.concatenate([-theta, [1.0]])
        out = t.output[judged].sum(axis=0) / max(t.count[judged].sum(), 1.0)
        return float(np.sqrt(max(v @ out @ v, 0.0))), float(np.sqrt(max(out[-1, -1], 0.0)))


def machine_of(base: Base, floor_m: float, stated: Collection[str] | None = None) -> SimulatedMachine:
    """Return the machine of a fitted model on the motion that `base.log` recorded.

    `stated`: columns whose noise the simulated logs state, by default all.
    """
    base = base.on_all
    columns = {c: base.log.array(c) for c in base.log.columns}
    columns["run"] = columns["run"].astype(int)
    columns |= _motion(base)
    base = replace(base, log=Log.from_arrays(columns, base.log.noise, base.log.meta, base.log.name))
    columns = {c: v for c, v in columns.items() if c not in base.model.channels}
    known = frozenset(base.sigma if stated is None else stated)
    return SimulatedMachine(
        base, columns, readings_of(base, base.model, base.p), _speed(base), floor_m, known
    )


def _motion(base: Base) -> dict[str, np.ndarray]:
    """Return the references as the motion was, without the noise of the log where it has time."""
    references = base.model.references if base.timed else ()
    parts: dict[str, list[np.ndarray]] = {c: [] for c in references}
    for piece in pieces(base, frozenset(base.log.runs)):
        for c in references:
            parts[c].append(at_rest(piece.data[f"d0_{c}"], base.sigma.get(c, 0.0)))
    return {c: np.concatenate(v) for c, v in parts.items()}


def readings_of(base: Base, model: Model, p: np.ndarray) -> np.ndarray:
    """Return the readings (K, rows) of `model`, an extension of the base's, with values `p`."""
    run = on_arrays(model.reading)
    log = extended(base.log, model, base.sigma, base.values)
    parts = []
    for batch in batches(log, columns_of(model)):
        parts.append(
            run(p, base.zeros_of(batch), batch.columns(model.references), batch.columns(model.state))[0]
        )
    return np.hstack(parts)


def _speed(base: Base) -> np.ndarray:
    """Velocity of the readings along the smoothed motion, (K, rows) in m/s."""
    back = np.linalg.inv(base.whiten)
    return np.hstack([back @ piece.speed for piece in pieces(base, frozenset(base.log.runs))])


def unit_of(truth: SimulatedMachine) -> str:
    """Return the unit of the readings, as parameters have it."""
    unit = truth.base.model.channels[0].rpartition("_")[2]
    return "V" if unit == "v" else unit


def goes_round(truth: SimulatedMachine) -> bool:
    """Return whether the reading is the decoded angle: one channel without rails or other wires."""
    return truth.base.model.channels == truth.base.model.pose


@dataclass(frozen=True, eq=False)
class SimulatedNoise:
    """Gaussian noise of readings and reference as a log has it.

    `coefficients` of the autoregression, empty for white noise. `readings`: (K,) standard deviations,
    `reference`: by column. `text`: what it is, in words. `ratio`: to the noise floor of the log.
    """

    coefficients: np.ndarray
    readings: np.ndarray
    reference: Mapping[str, float]
    correlation: float
    ratio: float
    text: str

    def draw(self, run: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return noise of the readings, (K, rows), and of each reference, (rows,); every run begins anew."""
        size = np.concatenate([self.readings, list(self.reference.values())])
        noise = rng.standard_normal((len(size), len(run)))
        if len(self.coefficients):
            edges = [0, *(np.flatnonzero(np.diff(run)) + 1).tolist(), len(run)]
            for first, last in pairwise(edges):
                settle = rng.standard_normal((len(size), SETTLE))
                driven = np.hstack([settle, noise[:, first:last]])
                noise[:, first:last] = autoregressive(self.coefficients, driven)[:, SETTLE:]
        noise *= size[:, None]
        K = len(self.readings)
        return noise[:K], dict(zip(self.reference, noise[K:], strict=True))


SETTLE = 400
"""Samples for which a simulated noise runs before it counts."""


def simulated_noise(base: Base, runs: Sequence[int], stated: bool = True) -> SimulatedNoise:
    """Return noise like that which `base` leaves on `runs`.

    It is white and as large as the noise floor where they are too short to tell. `stated`: whether that is.
    """
    found, model = noise_of_rest(base, runs), base.model
    reference = {c: base.sigma[c] for c in model.references if base.sigma.get(c, 0.0) > 0}
    readings = np.array([base.sigma[c] for c in model.channels])
    if found is None:
        text = "white Gaussian noise of the size of the noise floor (the log is too short to tell more)"
        return SimulatedNoise(np.zeros(0), readings, reference, 0.0, 1.0, text)
    ratio = np.array([found.by_sensor[c] for c in model.channels])
    return SimulatedNoise(
        coefficients=np.zeros(0) if found.white else np.array(found.coefficients),
        readings=readings * ratio,
        reference={c: s * found.ratio for c, s in reference.items()},
        correlation=0.0 if found.white else found.correlation,
        ratio=found.ratio,
        text=f"Gaussian, as the log has it: {noise_text(found, stated)}",
    )


PER_PERIOD = 25.0
"""Samples that a period of the fastest motion must keep."""
MOST = 30_000
"""Samples beyond which long runs are cut."""


def decimated(base: Base, rows: int) -> tuple[Log, str]:
    """Return about `rows` samples of `base.log`, as far as motion and mains stay resolved.

    The text says what was left out, "" for nothing.
    Samples that the fit left out are left out here too.
    """
    log = base.log
    lengths: dict[int, int] = {}
    for block in log.blocks(("t_s",)):
        lengths[block.run] = lengths.get(block.run, 0) + len(block.data["t_s"])
    every = max(1, min(log.rows // rows, _coarsest(base)))
    share = min(1.0, max(MOST, rows) * every / log.rows)
    limits = {run: max(int(np.ceil(share * n)), min(n, 64 * every)) for run, n in lengths.items()}
    parts: dict[str, list[np.ndarray]] = {}
    for run, data, keep in _kept(base, every, limits):
        parts.setdefault("run", []).append(np.full(int(keep.sum()), run))
        for column, values in data.items():
            if column != "run":
                parts.setdefault(column, []).append(values[keep])
    columns = {c: np.concatenate(v) for c, v in parts.items()}
    said = [f"every {every}. sample"] if every > 1 else []
    said += [f"the first {100 * share:.3g} % of each run"] if share < 1 else []
    short = Log.from_arrays(columns, log.noise, replace(log.meta), log.name)
    return short, " of ".join(said)


def _kept(
    base: Base, every: int, limits: dict[int, int]
) -> Iterator[tuple[int, dict[str, np.ndarray], np.ndarray]]:
    done: dict[int, int] = {}
    for block in base.log.blocks():
        n = len(block.data["t_s"])
        index = done.get(block.run, 0) + np.arange(n)
        done[block.run] = int(index[-1]) + 1
        keep = (index % every == 0) & (index < limits[block.run])
        if base.keep is not None:
            keep &= base.keep(block) > 0
        yield block.run, block.data, keep


def _coarsest(base: Base) -> int:
    """How many samples one may stand for: by the fastest motion of the first 64 blocks, and by the mains."""
    model, squares = base.model, np.zeros(2)
    axes = [[rate(c, order) for c in model.references] for order in (1, 2)]
    log = extended(base.log, model.with_columns(*axes[0], *axes[1]), base.sigma, base.values)
    steps = []
    for block in islice(log.blocks(("t_s", *(a.name for row in axes for a in row))), 64):
        t = block.data["t_s"]
        if len(t) > 1:
            steps.append(float(np.median(np.diff(t))))
        for k, row in enumerate(axes):
            squares[k] += sum(
                float(((f * block.data[a.name]) ** 2).sum())
                for f, a in zip(base.pose_weights, row, strict=True)
            )
    step = float(np.median(steps)) if steps else 1.0
    fastest = float(np.sqrt(squares[1] / max(squares[0], 1e-300))) / (2 * np.pi)
    return int(1.0 / (step * max(fastest * PER_PERIOD, 2 * (MAINS[-1] + MAINS_BAND))))
