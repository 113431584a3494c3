"""The simulated machine of the detection power: a fitted model on recorded motion, and its noise.

The recorded reference, smoothed, vertical state, time and temperature are taken as the truth. The noise has
the size and autocorrelation of the residual of the fit (`noise_of_rest`), in the readings and in the
reference. The simulated logs state the noise that the log states.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hallsym.diagnosis.normal_equations import coefficients, normal_equations
from hallsym.diagnosis.residual_table import at_rest
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.setup import of_recording
from hallsym.diagnosis.survey import noise_of_rest
from hallsym.diagnosis.words import noise_text
from hallsym.estimation.goodness_of_fit import SETTLE, autoregressive
from hallsym.families.faults import Recording
from hallsym.log import Log, Noise, Sigma
from hallsym.log.part import part_of
from hallsym.model import Model


@dataclass(frozen=True, eq=False)
class SimulatedMachine:
    """A fitted model as the machine: `base` holds the log with the motion, the values and the offsets.

    `columns`: of its log but the readings; `recording`: the readings without noise. `floor_m`: gap metric
    that the noise makes. `stated`: columns whose noise the log states.
    """

    base: Base
    columns: Mapping[str, np.ndarray]
    recording: Recording
    floor_m: float
    stated: Collection[str]

    @property
    def runs(self) -> list[int]:
        """Runs that are fitted."""
        return [r for r in self.base.log.runs if r not in self.base.holdout]

    def log(self, readings: np.ndarray, reference: Mapping[str, np.ndarray] = MappingProxyType({})) -> Log:
        """Return the log with other readings, (K, rows), and noise of the `reference` by column, (rows,)."""
        base = self.base
        rows = dict(zip(base.model.channels, readings, strict=True))
        rows |= {c: self.columns[c] + noise for c, noise in reference.items()}
        noise = Noise({c: Sigma(s, "given") for c, s in base.sigma.items() if c in self.stated})
        meta = replace(base.log.meta, holdout=tuple(sorted(base.holdout)))
        log = Log.from_arrays({**self.columns, **rows}, noise, meta, "a simulated log")
        return of_recording(log) if base.sliced else log

    def gap(self, readings: np.ndarray) -> tuple[float, float]:
        """Gap metric [m] of noise-free readings on the holdout runs: with the model fitted, and before."""
        t = normal_equations(replace(self.base, log=self.log(readings)))
        known, judged = t.units(self.runs), t.units(tuple(self.base.holdout))
        theta = coefficients(t.likelihood[known].sum(axis=0), np.arange(len(self.base.free)))
        v = np.append(-theta, 1.0)
        M = t.decoded.border[judged].sum(axis=0) / max(t.count[judged].sum(), 1.0)
        return float(np.sqrt(max(v @ M @ v, 0.0))), float(np.sqrt(max(M[-1, -1], 0.0)))


def on_part(base: Base, rows: int) -> Base:
    """Return `base` on about `rows` samples of its log, without those that the fit left out.

    Of a longer log they are stretches at the full rate (`part_of`), each a run of its own: what is computed
    of neighbouring samples does not go on from one to the next.
    """
    log, cut = base.log, base.log.rows > rows
    if not cut and base.keep is None:
        return base
    blocks = list((part_of(log, rows, 0) if cut else log).blocks())
    runs = [k if cut else block.run for k, block in enumerate(blocks)]
    used = [slice(None) if base.keep is None else base.keep(block) > 0 for block in blocks]
    parts = [{**b.data, "run": np.full(len(b.data["t_s"]), k)} for k, b in zip(runs, blocks, strict=True)]
    columns = {c: np.concatenate([p[c][u] for p, u in zip(parts, used, strict=True)]) for c in log.columns}
    logged = dict(zip(runs, (block.run for block in blocks), strict=True))
    return replace(
        base,
        log=Log.from_arrays(columns, log.noise, log.meta, log.name),
        keep=None,
        offsets={k: base.offsets_in(run) for k, run in logged.items()},
        holdout=frozenset(k for k, run in logged.items() if run in base.holdout),
    )


def machine_of(base: Base, floor_m: float, stated: Collection[str] | None = None) -> SimulatedMachine:
    """Return the machine of a fitted model on the motion that `base.log` recorded.

    `stated`: columns whose noise the simulated logs state, by default all.
    """
    base, model = base.on_all, base.model
    columns = {c: base.log.array(c) for c in base.log.columns}
    columns["run"] = columns["run"].astype(int)
    if base.timed:  # the motion as it was, without the noise of the log
        whole = list(pieces(base, frozenset(base.log.runs), whole=True))
        for c in model.references:
            parts = [at_rest(piece.data[f"d0_{c}"], base.sigma.get(c, 0.0)) for piece in whole]
            columns[c] = np.concatenate(parts)
    base = replace(base, log=Log.from_arrays(columns, base.log.noise, base.log.meta, base.log.name))
    columns = {c: v for c, v in columns.items() if c not in model.channels}
    unit = model.channels[0].rpartition("_")[2]
    back = np.linalg.inv(base.whiten)
    recording = Recording(
        channels=model.channels,
        clean=readings_of(base, model, base.p),
        speed=np.hstack([back @ piece.speed for piece in pieces(base, frozenset(base.log.runs), whole=True)]),
        run=columns["run"],
        step_s=float(np.median(np.diff(columns["t_s"]))),
        sigma=float(np.sqrt(np.diag(base.covariance).mean())),
        unit="V" if unit == "v" else unit,
        decoded=model.channels == model.pose,
    )
    return SimulatedMachine(base, columns, recording, floor_m, base.sigma if stated is None else stated)


def readings_of(base: Base, model: Model, p: np.ndarray) -> np.ndarray:
    """Return the readings (K, rows) of `model`, an extension of the base's, with values `p`."""
    parts = []
    for batch in base.batches(model):
        pose, state = batch.columns(model.references), batch.columns(model.state)
        parts.append(model.readings(p, pose, state, base.offsets_of(batch)))
    return np.hstack(parts)


@dataclass(frozen=True, eq=False)
class SimulatedNoise:
    """Gaussian noise of readings and reference as a log has it.

    `coefficients` of the autoregression, empty for white noise. `readings`: (K,) standard deviations,
    `reference`: by column. `text`: what it is, in words. `ratio`: to the noise floor of the log.
    """

    coefficients: np.ndarray
    readings: np.ndarray
    reference: Mapping[str, float]
    ratio: float
    text: str

    def draw(self, run: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return noise of the readings, (K, rows), and of each reference, (rows,); every run begins anew."""
        size = np.concatenate([self.readings, list(self.reference.values())])
        gaps = SETTLE * np.cumsum(np.diff(run, prepend=run[0] - 1) != 0) if len(self.coefficients) else 0
        at = np.arange(len(run)) + gaps
        white = rng.standard_normal((len(size), at[-1] + 1))
        noise = size[:, None] * autoregressive(self.coefficients, white)[:, at]
        K = len(self.readings)
        return noise[:K], dict(zip(self.reference, noise[K:], strict=True))


def simulated_noise(base: Base, runs: Sequence[int], stated: bool = True) -> SimulatedNoise:
    """Return noise like the residual of `base` on `runs`.

    It is white and as large as the noise floor if the runs are too short. `stated`: whether the floor is.
    """
    found, model = noise_of_rest(base, runs), base.model
    reference = {c: base.sigma[c] for c in model.references if base.sigma.get(c, 0.0) > 0}
    readings = np.array([base.sigma[c] for c in model.channels])
    if found is None:
        text = "white Gaussian noise of the size of the noise floor (the log is too short to tell more)"
        return SimulatedNoise(np.zeros(0), readings, reference, 1.0, text)
    return SimulatedNoise(
        coefficients=np.zeros(0) if found.white else np.array(found.coefficients),
        readings=readings * np.array([found.by_sensor[c] for c in model.channels]),
        reference={c: s * found.ratio for c, s in reference.items()},
        ratio=found.ratio,
        text=f"Gaussian, as the log has it: {noise_text(found, stated)}",
    )
