"""The simulated machine of a self-test: a fitted model on recorded motion, its noise, decimated logs.

The recorded reference, vertical state, time and temperature are taken as the truth. The noise looks like the
residuals of the log: as large as stated, correlated in time as they are. What the catalogue can explain is
taken out first, so that a gap does not pass for correlated noise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np
from scipy.linalg import solve_toeplitz

from hallsym.diagnosis.normal_equations import Accumulator, coefficients, normal_equations
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.scores import candidates
from hallsym.estimation import pseudo_inverse
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log, Noise, Sigma
from hallsym.log.batches import batches
from hallsym.log.derived import extended
from hallsym.model import Effect, Facts, Model
from hallsym.model.arrays import on_arrays
from hallsym.model.derived import rate


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
        return [r for r in self.base.log.runs if r not in self.base.holdout]

    def log(self, readings: np.ndarray) -> Log:
        """Return the log with other readings, (K, rows); its noise is stated."""
        base = self.base
        rows = dict(zip(base.model.channels, readings, strict=True))
        noise = Noise({c: Sigma(s, "given") for c, s in base.sigma.items()})
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


ORDERS = 12
"""Highest order of the autoregression that is tried."""
SETTLE = 400
"""Samples for which a simulated noise runs before it counts."""


SPIKE = 5.0
"""Standard deviations at which a residual is clipped: a spike is no noise."""
ALIKE = 1e-7
"""Eigenvalue of the products of columns of unit length, over the largest, below which it is rounding."""


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Gaussian autoregressive noise: `coefficients` (order,), empty for white noise.

    `colour`: (K, K), turns K independent noises of unit variance into noise of the readings. `excess`:
    variance of the residuals over the stated one; `lag_one`: their autocorrelation at one sample.
    """

    coefficients: np.ndarray
    drive: float
    colour: np.ndarray
    excess: float
    lag_one: float

    def draw(self, run: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return noise of the readings, (K, rows); every run begins anew."""
        white = rng.standard_normal((len(self.colour), len(run)))
        if len(self.coefficients):
            from scipy.signal import lfilter

            edges = [0, *(np.flatnonzero(np.diff(run)) + 1).tolist(), len(run)]
            for first, last in pairwise(edges):
                settle = rng.standard_normal((len(white), SETTLE))
                driven = np.hstack([settle, white[:, first:last]]) * self.drive
                shaped = lfilter([1.0], np.concatenate([[1.0], -self.coefficients]), driven, axis=1)
                white[:, first:last] = shaped[:, SETTLE:]
        return self.colour @ white

    @property
    def text(self) -> str:
        """What the noise is, in words."""
        if not len(self.coefficients):
            return "white Gaussian noise of the stated size (the residuals show no correlation in time)"
        return (
            f"Gaussian noise of the stated size, autoregressive of order {len(self.coefficients)} as the "
            f"residuals (correlation of neighbouring samples {self.lag_one:.2f})"
        )


def residual_noise(base: Base, catalogue: Sequence[Effect], facts: Facts) -> ResidualNoise:
    """Return noise like the residuals of `base` on its log, what the catalogue explains taken out."""
    correlation, variance, count = _autocorrelation(base, catalogue, facts)
    coefficients, drive = _autoregression(correlation, count)
    colour = np.linalg.cholesky(base.covariance)
    return ResidualNoise(coefficients, drive, colour, variance, float(correlation[1]))


def _autocorrelation(base: Base, catalogue: Sequence[Effect], facts: Facts) -> tuple[np.ndarray, float, int]:
    """Autocorrelation (ORDERS + 1,) and variance of the whitened residual, and how many values it is from."""
    tried, _ = candidates(base, catalogue, facts)
    plain = {key: (model, new) for key, (_, _, model, new) in tried.items()}
    work = Accumulator(base, plain)

    def whitened() -> Iterator[np.ndarray]:
        """Columns [parameters | effects | residual] of each block, (c, K, samples), its zeros taken out."""
        for batch in work.batches():
            A = work.whitened(batch, None)
            for _, at in batch.parts():
                W = A[:, :, at].reshape(len(A), -1)
                zeros, rest = np.linalg.qr(W[: work.z].T)[0], W[work.z :]
                yield (rest - (rest @ zeros) @ zeros.T).reshape(len(rest), len(work.whiten), -1)

    M: np.ndarray = np.zeros((work.size - work.z,) * 2)
    for W in whitened():
        flat = W.reshape(len(W), -1)
        M += flat @ flat.T
    # what is nearly alike is taken together
    v = np.append(-pseudo_inverse(M[:-1, :-1], ALIKE) @ M[:-1, -1], 1.0)
    sums, squares, count = np.zeros(ORDERS + 1), 0.0, 0
    for W in whitened():
        r = np.einsum("cks,c->ks", W, v)
        squares, count = squares + float((r**2).sum()), count + r.size
        r = np.clip(r, -SPIKE, SPIKE)
        r = r - r.mean(axis=1, keepdims=True)
        for lag in range(min(ORDERS + 1, r.shape[1])):
            sums[lag] += float((r[:, lag:] * r[:, : r.shape[1] - lag]).sum())
    return sums / max(sums[0], 1e-300), squares / max(count - len(M), 1), count


def _autoregression(correlation: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Yule-Walker coefficients of the order that BIC prefers, and the deviation of what drives them."""
    best: tuple[float, np.ndarray, float] = (0.0, np.zeros(0), 1.0)
    for order in range(1, ORDERS + 1):
        try:
            a = solve_toeplitz(correlation[:order], correlation[1 : order + 1])
        except np.linalg.LinAlgError:
            break
        rest = 1.0 - float(a @ correlation[1 : order + 1])
        if not 1e-6 < rest <= 1.0:
            break
        score = count * float(np.log(rest)) + order * float(np.log(count))
        if score < best[0]:
            best = (score, a, float(np.sqrt(rest)))
    return best[1], best[2]


PER_PERIOD = 25.0
"""Samples that a period of the fastest motion must keep."""
MAINS_HZ = 126.0
"""Sampling rate that must be kept: a little more than twice the mains."""
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
    return int(1.0 / (step * max(fastest * PER_PERIOD, MAINS_HZ)))
