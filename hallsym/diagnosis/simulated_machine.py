"""A fitted model as the machine: its readings on the motion that a log recorded, and the gap of others.

The recorded reference, vertical state, time and temperature are taken as the truth.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.refit import solve
from hallsym.diagnosis.residuals import pieces
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log, Noise, Sigma
from hallsym.log.batches import batches
from hallsym.log.derived import extended
from hallsym.model import Model
from hallsym.model.arrays import on_arrays


@dataclass(frozen=True, eq=False)
class SimulatedMachine:
    """A fitted model as the machine: `base` holds the log with the motion, the values and the zeros.

    `clean`: its readings without noise, (K, rows). `speed`: d clean / dt along the smoothed motion.
    `floor_m`: gap metric that the stated noise makes. `origin_s`: time of the first sample.
    """

    base: Base
    columns: Mapping[str, np.ndarray]
    clean: np.ndarray
    speed: np.ndarray
    floor_m: float

    @property
    def runs(self) -> list[int]:
        """Runs that are fitted."""
        return [r for r in self.base.log.runs if r not in self.base.apart]

    def log(self, readings: np.ndarray) -> Log:
        """Return the log with other readings, (K, rows); its noise is stated."""
        base = self.base
        rows = dict(zip(base.model.channels, readings, strict=True))
        noise = Noise({c: Sigma(s, "given") for c, s in base.sigma.items()})
        meta = replace(base.log.meta, holdout=tuple(sorted(base.apart)))
        return Log.from_arrays({**self.columns, **rows}, noise, meta, "a simulated log")

    def gap(self, readings: np.ndarray) -> tuple[float, float]:
        """Gap metric [m] of noise-free readings on the held-out runs: with the model fitted, and before."""
        t = normal_equations(replace(self.base, log=self.log(readings)), {})
        n = len(self.base.free)
        known, judged = t.units(self.runs), t.units(tuple(self.base.apart))
        theta = solve(t.likelihood[known].sum(axis=0), np.arange(n))
        v = np.concatenate([-theta, [1.0]])
        out = t.output[judged].sum(axis=0) / max(t.count[judged].sum(), 1.0)
        return float(np.sqrt(max(v @ out @ v, 0.0))), float(np.sqrt(max(out[-1, -1], 0.0)))


def machine_of(base: Base, floor_m: float) -> SimulatedMachine:
    """Return the machine of a fitted model on the motion that `base.log` recorded."""
    columns = {c: base.log.array(c) for c in base.log.columns if c not in base.model.channels}
    columns["run"] = columns["run"].astype(int)
    base = replace(base, keep=None)
    return SimulatedMachine(base, columns, readings_of(base, base.model, base.p), _speed(base), floor_m)


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
