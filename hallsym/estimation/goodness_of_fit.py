"""Noise floor and verdict: the residual in multiples of the noise, overall, by run and by channel.

If the model is right and the noise is as stated, the cost of a fit is chi-square distributed: its value per
degree of freedom is 1 within sqrt(2 / dof). An excess answers two different questions:

- Is it *significant*? Then the noise is not as stated, or the model is wrong, and the standard uncertainties
  are scaled (`covariance`). With 80,000 readings one percent of noise is significant.
- Is it *material*? Then the report begins with it, and a command ends with exit code 3. That is a question of
  size: every real log has a few percent.

What the model leaves is noise plus, where the model is wrong, a function of the place, the motion and the
time. Such functions are projected out first; the rest, which differs from run to run, is modelled as an
autoregression. Noise estimated from differences of neighbouring samples (`hallsym.log.estimate`) is 2 to 4
times too small where it is correlated: a first guess.

Each projected column and each run's offset removes some noise, mostly slow noise. The loss is simulated with
noise of the estimated model and added (indirect inference: C. Gourieroux, A. Monfort, E. Renault, J. Appl.
Econometrics 8 (1993) S85, doi:10.1002/jae.3950080507).
"""

import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.linalg import solve_toeplitz
from scipy.linalg.lapack import dtbtrs
from scipy.special import chdtrc, chdtri, ndtri, stdtrit

from hallsym.estimation.decoding import column_slopes, columns_of, gain_at, residual_of
from hallsym.estimation.likelihood import Cost, Point, offsets_of
from hallsym.families.mechanisms import stop_operators
from hallsym.log import Log, Noise
from hallsym.log.batches import Weigh, batches
from hallsym.log.core import edges_of
from hallsym.log.derived import extended
from hallsym.model import Model

KNOWN = 0.03
"""Relative uncertainty of a noise floor: n samples know a standard deviation to 1 / sqrt(2 n), 560 to 3 %."""
WORTH_REPORTING = 0.05
"""Relative decrease of the error above which a gap is worth reporting, unless the user or the log states
another. A choice."""
OUTWEIGHS = 2.0
"""Cost per degree of freedom above which one channel in one run counts by itself.

There the model error is as large as the noise."""
CERTAIN = 3.0
"""Standard deviations above which a cost per degree of freedom contradicts 1, and the scatter between runs
contradicts the noise (the same probability, 0.13 %)."""
CHANCE = 0.01
"""Probability that noise alone makes the worst of all runs and channels count. The usual 1 %."""
MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class GoodnessOfFit:
    """The residual of a fit in multiples of the noise.

    `residual_over_noise`: the decoded residual error over the noise floor. Contradictions between sensors
    move no pose; they count in `cost_per_degree_of_freedom`: 1 where model and noise are right.
    `degrees_of_freedom`: effective ones: readings less estimates, fewer where noise is autocorrelated.
    `by_run`, `by_channel`: rms residual over its standard deviation by noise. `worst_run`, `worst_channel`:
    the channel in one run with the largest residual, `worst` times the noise; `worst_least` is the lower end
    of that multiple, at 99 % for all runs and channels together; `usual`: its median over the runs, which the
    noise of this channel does not exceed, None of few runs. `uncertain`: factor within which the noise floor
    is known; `threshold`: relative decrease of the error that is worth reporting. `noise`: the residual over
    the stated noise, if it is noise; else 0. `what`: the model that does not describe the log where the
    residual is material; `next_command` finds the cause.
    """

    residual_over_noise: float
    cost_per_degree_of_freedom: float
    degrees_of_freedom: float
    by_run: Mapping[int, float]
    by_channel: Mapping[str, float]
    worst_run: int
    worst_channel: str
    worst: float
    worst_least: float
    usual: float | None = None
    uncertain: float = 1.0
    threshold: float = WORTH_REPORTING
    noise: float = 0.0
    next_command: str = ""
    what: str = "The model"

    @property
    def limit(self) -> float:
        """Multiple of the noise floor up to which a residual is not worth reporting."""
        return limit_of(self.uncertain, self.threshold)

    @property
    def noise_estimated(self) -> bool:
        """Whether a large part of the noise floor is estimated noise."""
        return self.uncertain > 1 + KNOWN

    @property
    def scatter(self) -> float:
        """Standard deviation of the cost per degree of freedom where model and noise are right."""
        return float(np.sqrt(2.0 / self.degrees_of_freedom))

    @property
    def contradicts(self) -> bool:
        """Whether the residual differs significantly from the noise: larger or smaller."""
        return abs(self.cost_per_degree_of_freedom - 1.0) > CERTAIN * self.scatter

    @property
    def significant(self) -> bool:
        """Whether the residual is significantly larger than the noise."""
        return self.contradicts and self.cost_per_degree_of_freedom > 1.0

    @property
    def material(self) -> bool:
        """Whether the residual is so much larger than the noise that a report begins with it."""
        over = self.significant and self.residual_over_noise > self.limit
        return over or self.odd_run or self.worst_least > OUTWEIGHS**0.5 * self.uncertain

    @property
    def odd_run(self) -> bool:
        """Whether one run has much more than noise in a channel, by the noise of most runs there."""
        return self.usual is not None and self.worst_least > OUTWEIGHS**0.5 * max(self.usual, 1.0)

    @property
    def sentence(self) -> str | None:
        """The first sentence of a report; None where the model describes the log."""
        numbers = self.said(f"{self.what} does not describe this log")
        return numbers and f"{numbers}; next: {self.next_command}".removesuffix("; next: ")

    @property
    def verdict(self) -> str:
        """The first sentence of a report, whether the model describes the log or not."""
        size = f"{self.residual_over_noise:#.3g} times the noise floor{self._guessed}"
        more = f"; up to {_times(self.limit)} is not worth reporting" if self.significant else ""
        return self.sentence or f"{self.what} describes this log: residual error is {size}{more}."

    @property
    def _guessed(self) -> str:
        return ", which was estimated from the log" if self.noise_estimated else ""

    def said(self, what: str) -> str | None:
        """Return `what` with its numbers; None where the fit is good."""
        if not self.material:
            return None
        if self.noise:
            return (
                f"The noise is larger than stated: residual error is {_times(self.residual_over_noise)} the "
                f"noise floor, and that is noise, {_times(self.noise)} the stated"
            )
        return (
            f"{what}: residual error is {_times(self.residual_over_noise)} the noise floor{self._guessed}, "
            f"{self.where}"
        )

    @property
    def where(self) -> str:
        """Place and size of the largest residual; a run is named only if there are several."""
        run = f"run {self.worst_run}, " if len(self.by_run) > 1 else ""
        return f"worst in {run}channel {self.worst_channel} ({_times(self.worst)})"

    def judged(self, uncertain: float, threshold: float | None = None) -> "GoodnessOfFit":
        """Return the record for a floor known within a factor, and the threshold of the log."""
        return replace(self, uncertain=uncertain, threshold=threshold or WORTH_REPORTING)

    def to_dict(self) -> dict[str, Any]:
        """Return the record of calib.json and `--json`."""
        stored = {name: value for name, value in vars(self).items() if name not in ("by_run", "by_channel")}
        return {
            "statement": self.sentence,
            "material": self.material,
            "significant": self.significant,
            "scatter": self.scatter,
            "limit": self.limit,
            **stored,
            "by_run": {str(run): value for run, value in self.by_run.items()},
            "by_channel": dict(self.by_channel),
        }


def limit_of(uncertain: float, threshold: float) -> float:
    """Return the multiple of a noise floor up to which nothing is worth reporting, of a fit or a diagnosis.

    `uncertain`: factor within which the floor is known, beside the 3 % of a stated one.
    """
    return uncertain * (1 + KNOWN) / (1 - threshold)


def goodness_of(point: Point, estimated: int) -> GoodnessOfFit:
    """Return the goodness of fit at a point, of whose parameters `estimated` were fitted to these runs."""
    cost, summary = point.cost, point.cost.summary
    channels, offsets = summary.model.channels, len(summary.model.offsets)
    used = np.flatnonzero(cost.weights > 0)
    counts = (cost.weights * summary.counts)[used]
    squares = np.einsum("rkk->rk", point.squares)[used] * cost.weights[used, None]
    relative = squares / np.einsum("rkk->rk", point.covariance)[used]
    K = len(channels)
    dof = max(float(counts.sum()) * K - estimated - offsets * len(used), 1.0)
    # a run's offsets are estimated from it alone, the parameters from all runs
    cell = np.maximum(counts - offsets / K - estimated * counts / (K * max(counts.sum(), 1.0)), 0.5)[:, None]
    ratio = relative / cell
    typical = np.median(ratio, axis=0)
    coloured = _inflation(ratio, typical, cell)
    independent = np.maximum(cell / coloured, 1.0)
    least = ratio * independent / chdtri(independent, CHANCE / ratio.size)
    run, channel = np.unravel_index(int(np.argmax(least)), least.shape)
    by_run = np.sqrt(point.run_values[used] * cost.weights[used] / (K * cell[:, 0]))
    return GoodnessOfFit(
        residual_over_noise=residual_over_floor(point) * float(np.sqrt(counts.sum() * K / dof)),
        cost_per_degree_of_freedom=point.value / dof,
        degrees_of_freedom=max(dof / coloured, 1.0),
        by_run=dict(zip((summary.runs[r] for r in used), by_run.tolist(), strict=True)),
        by_channel=dict(zip(channels, np.sqrt(relative.sum(axis=0) / cell.sum()).tolist(), strict=True)),
        worst_run=summary.runs[used[run]],
        worst_channel=channels[channel],
        worst=float(np.sqrt(ratio[run, channel])),
        worst_least=float(np.sqrt(least[run, channel])),
        usual=float(np.sqrt(typical[channel])) if len(used) >= FEWEST_RUNS else None,
    )


def _inflation(ratio: np.ndarray, typical: np.ndarray, cell: np.ndarray) -> float:
    """Variance of the cost of a channel in a run over that of white noise, 1 or more.

    `ratio`: (r, K) mean squares over the noise's, `typical`: (K,) their medians, which ignore runs that are
    wrong, `cell`: (r, 1) their degrees of freedom. Coloured noise has fewer independent samples than samples,
    in every run.
    """
    spread = (ratio / np.maximum(typical, 1e-300) - 1.0) / np.sqrt(2.0 / cell)
    return max(1.0, float(MAD * np.median(np.abs(spread))) ** 2)


def diagnose_command(path: object, model: Model, effects: Sequence[str]) -> str:
    """Return the command that finds the cause; a call in Python where the log came from no file."""
    if path is None:
        return f'hallsym.diagnose(log, "{model.name}")' if not effects else "hallsym.diagnose(log, fit)"
    added = [word for effect in effects for word in ("--effect", effect)]
    return shlex.join(["hallsym", "diagnose", str(path), "--model", model.name, *added])


def _times(multiple: float) -> str:
    return f"{multiple:.0f} times" if multiple >= 10 else f"{multiple:.2g} times"


# -- the noise floor: what noise, or a residual, adds to the error of the decoded pose ---------------------


def uncertain(point: Point, noise: Noise, length_scale_m: float | None) -> float:
    """Return the factor within which the noise floor is known, as the pose metric weighs coordinates.

    Each column counts by its contribution to the error.
    """
    known = {c: s.uncertain for c, s in noise.sigmas.items()}
    model = point.cost.summary.model
    if len(factors := set(known.values())) == 1:
        return factors.pop()
    weights = model.family.pose_metric.weights(model.pose, length_scale_m)
    low, high = (float(np.linalg.norm(weights * floor)) for floor in _floors(point, {}, known))
    return high / low if low > 0 else max(known.values())


def noise_floor(point: Point) -> dict[str, float]:
    """RMSE of the decoded pose by reading and reference noise alone, by pose coordinate."""
    (floor,) = _floors(point, {})
    return dict(zip(point.cost.summary.model.pose, floor.tolist(), strict=True))


def _floors(point: Point, *factors: Mapping[str, float]) -> list[np.ndarray]:
    """Return the noise floor (n_pose,) for noise of columns that is larger than stated by `factors`."""
    D, share, poses, state = _gains(point)
    model, m, floors, J = point.cost.summary.model, len(D), [], None
    if model.typical:  # the covariance of a residual is not the same all over a run
        slopes = column_slopes(model, point.p, poses, state)
        J = slopes.reshape(m, -1, *slopes.shape[1:])
    for each in factors:
        columns = (model.channels, (*model.references, *model.state))
        own, other = (np.array([each.get(c, 1.0) for c in names]) ** 2 for names in columns)
        reading, column = own * point.cost.reading_variance, other * point.cost.column_variance
        if J is not None:
            made = np.square(D) @ reading + np.square(D @ J) @ column
        else:
            cost = replace(point.cost, reading_variance=reading, column_variance=column) if each else None
            made = _decoded(D, cost.at(point.p).covariance if cost else point.covariance)
        floors.append(np.sqrt(np.einsum("r,mri->i", share / m, made)))
    return floors


def residual_over_floor(point: Point) -> float:
    """Return the decoded residual over its size by noise, as the pose metric weighs coordinates.

    Mean squares are over the number of samples, not the degrees of freedom, so a good fit is below 1.
    """
    cost, model = point.cost, point.cost.summary.model
    D, share, _, _ = _gains(point)
    left = point.squares / np.maximum(cost.summary.counts, 1.0)[:, None, None]
    weights = model.family.pose_metric.weights(model.pose, None)
    real, noise = (
        float(np.einsum("r,mri,i->", share, _decoded(D, S), weights**2)) for S in (left, point.covariance)
    )
    return float(np.sqrt(real / noise)) if noise > 0 else 1.0


def _decoded(D: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance of decoded coordinates, (m, r, n_pose), of readings with a covariance (r, K, K)."""
    return np.asarray(np.einsum("mrik,mrik->mri", D @ covariance, D))


def _gains(point: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return d pose / d reading (m, r, n_pose, K) at m poses of r runs, the runs' shares, poses and state."""
    cost, summary, model = point.cost, point.cost.summary, point.cost.summary.model
    share = cost.weights * summary.counts / (cost.weights @ summary.counts)
    poses, m = _poses(cost), max(len(model.typical), 1)
    state = np.tile(summary.mean_state.T, m)
    D = gain_at(model, point.p, poses, state, 1.0 / cost.reading_variance)
    return D.reshape(m, -1, *D.shape[1:]), share, poses, state


def _poses(cost: Cost) -> np.ndarray:
    """Poses over which noise is averaged, (n_pose, m * runs): m typical ones, the zero pose without any.

    A coordinate that does not repeat, such as a gap on which the noise depends, is where each run was.
    """
    summary, model = cost.summary, cost.summary.model
    typical = np.array(model.typical or (np.zeros(len(model.pose)),))
    out = np.repeat(typical.T[:, :, None], len(summary.runs), axis=2)
    for k, coordinate in enumerate(model.pose):
        if summary.places and coordinate not in model.period:
            shares = (np.arange(len(typical)) + 0.5) / len(typical)
            out[k] = np.transpose([np.quantile(place[k], shares) for place in summary.places])
    return out.reshape(len(model.pose), -1)


# -- the residual noise: its size and autocorrelation -------------------------------------------------------


ORDER = 3
"""Order of the autoregression: a resonance and a drift, or the beginning of 1/f noise."""
LAGS = 10
"""Lags over which the whiteness of noise is tested (Ljung and Box, Biometrika 65 (1978) 297)."""
WHITE = 0.01
"""P-value below which noise counts as autocorrelated: one white log in a hundred does."""
DRAWS = 24
"""Simulated rows of noise for the loss by elimination: K / 24 of its variance is added to a covariance."""
ROUNDS = 4
"""Rounds of correcting the autocovariance by simulation: each leaves about the square of the relative
loss."""
FAR = 6.0
"""Robust standard deviations beyond which a sample takes no part in correlations: a spike has none."""
ROUNDING = 1e-9
"""Part of a column's squares, and of the products of columns of unit length, that is rounding."""
TOGETHER = 8
"""Rows whose products are formed at once: 8000 samples of so many stay in the cache."""
PIECE = 1024
"""Samples of all functions that are combined at once."""
STABLE = 0.995
"""Largest modulus of a root of the autoregression; beyond it noise is a drift over a whole run."""
SETTLE = 500
"""Samples for which simulated noise runs before it counts: e^-2.5 of the most persistent noise is left."""
GAUSSIAN, FLATTER = 3.0, 4.0
"""Kurtosis of Gaussian noise, and standard errors below it at which a signal is bounded: of 36 channels one
in a thousand logs. A sine has 1.5. Its variance is 24 / n times the sum of the fourth powers of the
autocorrelations (T. Gasser, Biometrika 62 (1975) 563)."""
LONGEST = 1000
"""Lags beyond which the most persistent noise is uncorrelated."""
COVERED = 0.975
"""Probability below the upper end of a two-sided 95 % interval."""
FEWEST_RUNS = 6
"""Fewest runs whose scatter gives the uncertainty of a mean square."""


@dataclass(frozen=True)
class ResidualNoise:
    """Residual noise of a model, in multiples of the noise that was stated or estimated before.

    `ratio`: standard deviation over all sensors, with its 95 % `interval`; `by_sensor`: the same of each
    sensor, `larger_in`: the sensors in which it is certainly larger. `white`: whether its samples may be
    independent; `whiteness_p`: probability that white noise is as correlated. `correlation`: of neighbouring
    samples, `memory`: variance of a slow average over that of white noise, `coefficients`: (ORDER,) of the
    autoregression, the same for all sensors. `bounded`: whether its kurtosis is below that of Gaussian noise,
    such as of a wave, a sweep or steps between levels: no noise. `resolved`: whether the samples resolve
    functions of the place over the whole travel. `samples`: number used. `within`: factor within which it is
    the noise, if it includes a gap.
    """

    ratio: float
    interval: tuple[float, float]
    by_sensor: dict[str, float]
    larger_in: tuple[str, ...]
    white: bool = True
    whiteness_p: float = 1.0
    correlation: float = 0.0
    memory: float = 1.0
    coefficients: tuple[float, ...] = (0.0,) * ORDER
    bounded: bool = False
    resolved: bool = True
    samples: int = 0
    within: float = 2.0

    @property
    def larger(self) -> bool:
        """Whether it is larger than the noise floor by more than the uncertainty of a floor."""
        return self.interval[0] > 1 + KNOWN

    @property
    def slow_on_top(self) -> bool:
        """Whether differences of neighbouring samples have the stated noise in full, and more is correlated.

        Then something slow is added to the stated noise.
        """
        rho = correlations(np.array(self.coefficients), 3)
        fast = self.ratio * float(np.sqrt((6 - 8 * rho[1] + 2 * rho[2]) / 6))  # of second differences
        return not self.white and abs(fast - 1.0) < KNOWN

    def in_pose(
        self,
        model: Model,
        p: np.ndarray,
        state: Sequence[float],
        covariance: np.ndarray,
        weights: np.ndarray,
    ) -> float:
        """Return the gap metric of this noise over that of a residual of `covariance` (K, K).

        A noisy sensor may count for more in the pose than in the residuals of all sensors. `state`: means.
        `weights`: (n_pose,) of the pose metric.
        """
        spread = np.asarray(model.noise_gain(p, state, 1 / np.diag(covariance))) * weights[:, None]
        larger = np.array([max(self.by_sensor[c], 1.0) for c in model.channels])
        each = covariance, covariance * np.outer(larger, larger)
        known, real = (float(np.einsum("ik,kl,il->", spread, C, spread)) for C in each)
        return float(np.sqrt(real / known)) if known > 0 else self.ratio

    def makes(self, over: float, in_pose: float, uncertain: float, threshold: float) -> bool:
        """Return whether this noise alone explains an error worth reporting, `over` times a floor.

        `in_pose`: error by this noise over the floor, which is known within `uncertain`. Waves, steps between
        levels and slow changes added to the stated noise are no noise; nor is what is correlated from sample
        to sample where it may follow the place as well.
        """
        limit = limit_of(uncertain, threshold)
        sure = self.interval[0] > (1 + KNOWN) * uncertain and (self.white or self.resolved)
        return sure and not (self.bounded or self.slow_on_top) and limit < over <= in_pose * limit


@dataclass(frozen=True, eq=False)
class Residual:
    """A residual whose noise is estimated.

    `values`: (K, n) residual of the readings. `covariance`: (K, K) that noise was said to give it. `run`:
    (n,) which run each sample is of, runs one after the other. `columns`: (m, n) functions that it may
    follow. `used`: (n,) which samples count. `offsets`: whether every run has an offset of its own.
    """

    values: np.ndarray
    covariance: np.ndarray
    run: np.ndarray
    columns: np.ndarray
    used: np.ndarray
    offsets: bool


def _whitening(covariance: np.ndarray) -> np.ndarray | None:
    """Return the whitening matrix of a covariance (K, K); None where it is singular.

    Rounding makes it so where the reference's noise is common to all readings and far above theirs, as with
    exchanged columns.
    """
    try:
        return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).T)
    except np.linalg.LinAlgError:
        return None


def residual_noise(r: Residual, channels: Sequence[str]) -> ResidualNoise | None:
    """Return the noise of a residual; None where samples are too few to separate it from the columns."""
    work = _Elimination(r)
    if work.free <= 2 * LAGS or (whiten := _whitening(r.covariance)) is None:
        return None
    raw = work.left(r.values)
    left = whiten @ raw
    body = MAD * np.median(np.abs(left[:, r.used]), axis=1, keepdims=True)
    if not np.all(body > 0):
        return None
    # a spike also moves the offset of its run, by which all samples of the run would be correlated
    far = np.any(np.abs(left) > FAR * body, axis=0)
    body_of = _Elimination(replace(r, used=r.used & ~far)) if far.any() else work
    near = whiten @ body_of.left(r.values) if far.any() else left
    scaled = near / np.sqrt(body_of.covariances(near, 0))
    white = np.random.default_rng(0).standard_normal((DRAWS, left.shape[1] + SETTLE))
    seen = body_of.covariances(scaled, LAGS).mean(axis=0)
    if not np.isfinite(seen).all():  # the residual of a reading is 0 or out of range
        return None
    phi, kept = _autoregression(body_of, seen[: ORDER + 1], white)
    rho = correlations(phi, LONGEST)
    fewer, fourth = (1.0 + 2.0 * float((rho[1:] ** power).sum()) for power in (2, 4))
    ratio, interval = work.size(left, kept, fewer)
    own = raw / np.sqrt(np.diag(r.covariance))[:, None]
    each = {c: work.size(row[None], kept, fewer) for c, row in zip(channels, own, strict=True)}
    # Ljung and Box, against white noise with the same elimination
    pairs = np.array([float(p.sum()) for p in body_of.pairs])[1:]
    off = (seen / seen[0] - body_of.of_white(LAGS))[1:]
    whiteness_p = float(chdtrc(np.count_nonzero(pairs), float((off**2 * len(left) * pairs).sum())))
    squares = left**2
    kurtosis = float(np.min((squares**2).sum(axis=1) * work.count / squares.sum(axis=1) ** 2))
    return ResidualNoise(
        ratio=ratio,
        interval=interval,
        by_sensor={c: value for c, (value, _) in each.items()},
        larger_in=tuple(c for c, (_, (low, _)) in each.items() if low > 1 + KNOWN),
        white=whiteness_p >= WHITE,
        whiteness_p=whiteness_p,
        correlation=float(rho[1]),
        memory=float(max(1.0, 1.0 + 2.0 * rho[1:].sum())),
        coefficients=tuple(phi.tolist()),
        bounded=kurtosis < GAUSSIAN - FLATTER * float(np.sqrt(24.0 * fourth / work.free)),
        samples=int(work.count),
    )


class _Elimination:
    """Projects columns and offsets of runs out of residuals, and sums products of the rest."""

    def __init__(self, r: Residual) -> None:
        self.used, n = r.used.astype(float), len(r.run)
        self.count = float(self.used.sum())
        self.runs = np.array(edges_of(r.run)[:-1])
        self.starts = self.runs if r.offsets else np.zeros(1, int)
        self.lengths = np.diff(self.starts, append=n)
        self.sizes = np.maximum(np.add.reduceat(self.used, self.starts), 1.0)
        X = self._centred(r.columns)
        gram = X @ X.T
        size, raw = np.diag(gram), np.einsum("ij,ij,j->i", r.columns, r.columns, self.used)
        seen = size > ROUNDING * np.maximum(raw, 1e-300)
        unit = seen / np.sqrt(np.where(seen, size, 1.0))
        values, axes = np.linalg.eigh(gram * np.outer(unit, unit))
        real = values > ROUNDING * max(int(seen.sum()), 1)
        T = (axes[:, real] / np.sqrt(values[real])).T * unit
        for first in range(0, n, PIECE):  # in its place: functions are most of the memory
            X[: len(T), first : first + PIECE] = T @ X[:, first : first + PIECE]
        self.basis = X[: len(T)]
        self.free = self.count - len(self.starts) - len(self.basis)
        index = np.repeat(np.arange(len(self.runs)), np.diff(self.runs, append=n))
        same = [index[lag:] == index[: n - lag] for lag in range(LAGS + 1)]
        self.pairs = [self.used[: len(s)] * self.used[n - len(s) :] * s for s in same]

    def _centred(self, values: np.ndarray) -> np.ndarray:
        """Take the mean of each run, or of all where runs have no offsets, out of rows (m, n)."""
        counted = values if self.count == len(self.used) else values * self.used
        means = np.add.reduceat(counted, self.starts, axis=1) / self.sizes
        out = np.repeat(means, self.lengths, axis=1)
        np.subtract(values, out, out=out)
        out *= self.used
        return out

    def left(self, values: np.ndarray) -> np.ndarray:
        """Return rows (m, n) with columns and offsets projected out; 0 where samples do not count."""
        y = self._centred(values)
        y -= (y @ self.basis.T) @ self.basis
        return y

    def size(self, rows: np.ndarray, kept: float, fewer: float) -> tuple[float, tuple[float, float]]:
        """Return the rms of rows (m, n) before `kept` of their squares was left, and its 95 % interval.

        `fewer`: samples over independent ones. The interval is that of such noise with the tails of the rows,
        or the scatter of the runs where that is larger: noise differs between runs.
        """
        squares = rows**2
        mean = max(float(squares.mean(axis=0).sum()) / self.count, 1e-300)
        tails = (squares**2).sum(axis=1) * self.count / np.maximum(squares.sum(axis=1) ** 2, 1e-300)
        error = float(np.sqrt(max(float(np.mean(tails)) - 1.0, 2.0) * fewer / (self.free * len(rows))))
        factor, runs = float(stdtrit(max(self.free, 1.0), COVERED)), len(self.runs)
        if runs >= FEWEST_RUNS:
            sizes = np.maximum(np.add.reduceat(self.used, self.runs), 1.0)
            off = np.add.reduceat(squares.mean(axis=0), self.runs) - mean * sizes
            scatter = float(np.sqrt((off**2).sum() * runs / (runs - 1))) / (mean * self.count)
            if scatter > error:
                error, factor = scatter, float(stdtrit(runs - 1, COVERED))
        ratio, spread = float(np.sqrt(mean / kept)), 0.5 * factor * error
        return ratio, (ratio * float(np.exp(-spread)), ratio * float(np.exp(spread)))

    def covariances(self, rows: np.ndarray, lags: int) -> np.ndarray:
        """Return the mean products of each row (m, n) with itself `lag` samples later, (m, lags + 1)."""
        n, out = rows.shape[1], np.zeros((len(rows), lags + 1))
        for first in range(0, len(rows), TOGETHER):
            some = slice(first, first + TOGETHER)
            for lag, pairs in enumerate(self.pairs[: lags + 1]):
                out[some, lag] = (rows[some, lag:] * rows[some, : n - lag]) @ pairs
        return out / np.maximum([pairs.sum() for pairs in self.pairs[: lags + 1]], 1.0)

    def of_white(self, lags: int) -> np.ndarray:
        """Return the expected autocorrelations of white noise once it is eliminated, (lags + 1,): below 0.

        The elimination is I - Q with Q = U^T U and the offsets: its entries beside the diagonal are -Q.
        """
        taken, over = (
            self.covariances(self.basis, lags).sum(axis=0),
            np.repeat(1.0 / self.sizes, self.lengths),
        )
        for lag, pairs in enumerate(self.pairs[: lags + 1]):
            taken[lag] += float(pairs @ over[: len(pairs)]) / max(float(pairs.sum()), 1.0)
        out = -taken / (1.0 - taken[0])
        out[0] = 1.0
        return np.asarray(out)


def _autoregression(work: _Elimination, seen: np.ndarray, white: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the coefficients whose noise has the autocovariance `seen` (ORDER + 1,) once it is eliminated.

    And the share of the variance of such noise that the elimination leaves.
    """
    whole, kept = seen.copy(), 1.0
    for _ in range(ROUNDS):
        phi = _stable(solve_toeplitz(whole[:-1], whole[1:]))
        noise = autoregressive(phi, white)[:, SETTLE:]
        got = work.covariances(work.left(noise), ORDER).mean(axis=0)
        # the drawn noise does not have exactly its covariance: the loss is relative to the draw
        drawn = work.covariances(noise, ORDER).mean(axis=0)
        kept = float(np.clip(got[0] / drawn[0], 0.05, 1.0))
        variance = seen[0] / kept
        whole = seen + variance * (drawn - got) / drawn[0]
        whole[0] = variance
    return _stable(solve_toeplitz(whole[:-1], whole[1:])), kept


def autoregressive(phi: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Return noise of unit variance (m, n) with coefficients `phi` from white noise (m, n)."""
    if not np.any(phi):
        return white
    rho = correlations(phi, len(phi) + 1)
    return _driven(phi, np.sqrt(max(1.0 - float(phi @ rho[1:]), 1e-9)) * white)


def _driven(phi: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Return x (m, n) with x[k] = phi[0] x[k - 1] + phi[1] x[k - 2] + ... + drive[k], from rest."""
    band = np.repeat(np.append(1.0, -phi)[:, None], drive.shape[1], axis=1)
    return np.asarray(dtbtrs(np.asfortranarray(band), drive.T, uplo="L", diag="U", overwrite_b=True)[0].T)


def _stable(phi: np.ndarray) -> np.ndarray:
    """Draw the roots of an autoregression inside the circle of radius `STABLE`."""
    roots = np.roots(np.concatenate([[1.0], -phi]))
    largest = float(np.abs(roots).max(initial=0.0))
    if largest <= STABLE:
        return phi
    return phi * (STABLE / largest) ** np.arange(1, len(phi) + 1)


def correlations(phi: np.ndarray, lags: int) -> np.ndarray:
    """Return the autocorrelations of an autoregression at lags 0 .. `lags` - 1."""
    p = len(phi)
    # Yule-Walker equations for the first p, then the recursion
    A = np.eye(p)
    for k in range(p):
        for j in np.delete(np.arange(p), k):
            A[k, abs(k - j) - 1] -= phi[j]
    first = np.append(1.0, np.linalg.solve(A, phi))[:lags]
    drive = np.zeros((1, lags))
    drive[0, : len(first)] = [first[k] - phi[:k] @ first[:k][::-1] for k in range(len(first))]
    return _driven(phi, drive)[0]


ROOM = 8_000
"""Samples that are used: of three channels they give the standard deviation of white noise to 0.5 %."""
READINGS = 100_000
"""The same times the channels, of models of many channels."""
SHARE = 20
"""Samples for each function, at least: fewer functions are tried on a short log."""
CURVE, WAVES, TIMES, PLACES = 12, 12, 8, 4
"""Cosines over a coordinate, waves per period, cosines over the time of the log, and over two coordinates."""
FINE = 8
"""Cosines per period over a travel of several: waves down to a quarter of it; shorter ones have faded at the
sensors."""
MEMORIES = (0.05, 0.15, 0.4, 1.0)
"""Half-widths of the play that a residual may follow, over the standard deviation of the coordinate."""
STILL = 5.0
"""An axis that moves less than this many sigma of its noise (rms) is at rest.

Its logged place is then noise to 4 % of its variance, and that noise is in the residual too."""
LEAST = 0.05
"""Least part of a first guess of a noise, where stated noise explains all of a residual."""
SLOW = 5.0
"""Ratio of noise to its size in differences of neighbouring samples above which it is a disturbance.

Noise that is correlated over 10 samples has 4.3 times as much (first order, simulated), over 14 samples 5."""
REACH = 2
"""Samples on either side between which a rate is taken: none of them is the sample itself."""
TURNS = 0.05
"""Part of the greatest rate within which the direction of motion turns over."""


def noise_left(
    log: Log,
    model: Model,
    p: np.ndarray,
    offsets: Mapping[int, np.ndarray],
    covariance: np.ndarray,
    sigma: Mapping[str, float],
    keep: Weigh | None = None,
) -> ResidualNoise | None:
    """Return the noise that a model with parameters `p` (n,) leaves on the runs of `offsets`.

    `offsets`: run -> zero deviations, as displacements. `covariance`: (K, K) that the noise `sigma` by column
    gives a residual; the ratio is against it. `keep`: weight of each sample. None where the log is too short
    to tell.
    """
    read = _read(log, model, p, offsets, sigma, keep)
    return read and _noise_of(read, log, model, covariance, sigma)


def _noise_of(
    read: "_Read", log: Log, model: Model, covariance: np.ndarray, sigma: Mapping[str, float]
) -> ResidualNoise | None:
    data, values, used = read
    if not log.timed:
        return _noise_of_knots(model, data, values[:, used], covariance, used)
    finite, most = (r for r in _columns(model, data, sigma) if np.isfinite(r).all()), int(used.sum()) // SHARE
    columns = np.array([*islice(finite, most)]).reshape(-1, len(used))
    found = Residual(values, covariance, data["run"], columns, used, bool(model.offsets))
    noise = residual_noise(found, model.channels)
    return noise and replace(noise, resolved=sum(_along(model, data).values()) <= most / 2)


def _is_known(read: "_Read", model: Model, covariance: np.ndarray) -> bool:
    """Return whether a residual certainly is independent noise of `covariance` (K, K).

    It has that size within `KNOWN`, and its autocorrelations exclude a slow part larger than `KNOWN`.
    """
    data, values, used = read
    none = np.zeros((0, len(used)))
    work = _Elimination(Residual(values, covariance, data["run"], none, used, bool(model.offsets)))
    if (whiten := _whitening(covariance)) is None:
        return False
    seen = work.covariances(whiten @ work.left(values), LAGS).mean(axis=0)
    size = float(np.sqrt(seen[0] * work.count / max(work.free, 1.0)))
    if not 1 / (1 + KNOWN) <= size <= 1 + KNOWN:
        return False
    slow = float(np.abs(seen / seen[0] - work.of_white(LAGS))[1:].max())
    return slow + CERTAIN / np.sqrt(work.count * len(values)) <= (1 + KNOWN) ** 2 - 1


def _noise_of_knots(
    model: Model, data: Mapping[str, np.ndarray], values: np.ndarray, covariance: np.ndarray, used: np.ndarray
) -> ResidualNoise | None:
    """Return the noise of knots, which have places and no times, by the median of their periodogram.

    Waves of any number are lines in it, which do not move the median as long as they are less than half.
    """
    K, n = values.shape
    if len(model.references) == 1:
        values = values[:, np.argsort(data[model.references[0]][used], kind="stable")]
    bins = (n - 1) // 2
    if bins <= 2 * LAGS:
        return None

    def median_of(rows: np.ndarray) -> np.ndarray:
        power = np.abs(np.fft.rfft(rows, axis=1)[:, 1 : bins + 1]) ** 2 / n
        return np.asarray(np.median(power, axis=1) / np.log(2.0))

    if (whiten := _whitening(covariance)) is None:
        return None
    ratio = float(np.sqrt(median_of(whiten @ values).mean()))
    each = np.sqrt(median_of(values) / np.diag(covariance))
    if not ratio > 0:
        return None
    spread = [float(np.exp(0.5 * ndtri(COVERED) / (np.log(2.0) * np.sqrt(m)))) for m in (bins * K, bins)]
    by_sensor = dict(zip(model.channels, each.tolist(), strict=True))
    return ResidualNoise(
        ratio=ratio,
        interval=(ratio / spread[0], ratio * spread[0]),
        by_sensor=by_sensor,
        larger_in=tuple(c for c, v in by_sensor.items() if v / spread[1] > 1 + KNOWN),
        samples=n,
        within=spread[0],
    )


def noise_at(
    log: Log, point: Point, sigma: Mapping[str, float], keep: Weigh | None = None
) -> ResidualNoise | None:
    """Return the residual noise of a fit on its runs; `point`: of its cost at the optimum."""
    model, covariance = point.cost.summary.model, point.covariance.mean(axis=0)
    return noise_left(log, model, point.p, offsets_of(point.cost, point.p), covariance, sigma, keep)


def with_noise(
    known: GoodnessOfFit, log: Log, point: Point, noise: Noise, keep: Weigh | None = None
) -> GoodnessOfFit:
    """Return the goodness of a fit against its floor, marked as noise where its excess is noise.

    `point`: of its cost at the optimum, with `noise`.
    """
    model, meta = point.cost.summary.model, log.meta
    known = known.judged(uncertain(point, noise, meta.gap_length_scale_m), meta.gap_threshold_rel)
    stated = any(s.source == "given" for s in noise.sigmas.values())
    if not stated or known.residual_over_noise <= known.limit or not known.significant:
        return known
    left = noise_at(log, point, noise.std, keep)
    if left is None:
        return known
    state, covariance = point.cost.summary.mean_state.mean(axis=0), point.covariance.mean(axis=0)
    weights = model.family.pose_metric.weights(model.pose, log.meta.gap_length_scale_m)
    in_pose = left.in_pose(model, point.p, state.tolist(), covariance, weights)
    noisy = left.makes(known.residual_over_noise, in_pose, known.uncertain, known.threshold)
    return replace(known, noise=left.ratio) if noisy else known


def noise_followed(log: Log, point: Point, noise: Noise, keep: Weigh | None = None) -> Noise | None:
    """Return the noise with the residual noise in place of estimates; None where they agree.

    Differences of neighbouring samples miss correlated noise and include motion from sample to sample; the
    residual has neither error. `point`: of the fit with `noise`.
    """
    model, sigma = point.cost.summary.model, noise.std
    guessed = {c for c in (*model.channels, *model.references) if noise[c].source == "estimated"}
    if not guessed or log.counted:
        return None
    covariance = point.covariance.mean(axis=0)
    read = _read(log, model, point.p, offsets_of(point.cost, point.p), sigma, keep)
    if read is None or (log.timed and _is_known(read, model, covariance)):
        return None
    if (left := _noise_of(read, log, model, covariance, sigma)) is None:
        return None
    factor = _factor(left, point, guessed)
    if abs(factor - 1.0) <= KNOWN and left.within == noise[min(guessed)].within:
        return None
    return Noise({
        c: replace(s, value=s.value * factor, within=left.within) if c in guessed else s
        for c, s in noise.sigmas.items()
    })  # fmt: skip


def _factor(left: ResidualNoise, point: Point, columns: Collection[str]) -> float:
    """Return the factor on the noise of `columns` for which a residual has the noise `left`.

    1 where the residual agrees with the noise, and where it is larger but no noise: waves, steps between
    levels, or a change too slow for differences of neighbouring samples.
    """
    model, cost = point.cost.summary.model, point.cost
    own = np.array([c in columns for c in model.channels])
    precision = np.linalg.inv(point.covariance.mean(axis=0))
    readings = np.diag(np.where(own, cost.reading_variance, 0.0))
    if any(c in columns for c in model.references):  # the rest is due to the references
        readings = readings + point.covariance.mean(axis=0) - np.diag(cost.reading_variance)
    share = float(np.trace(precision @ readings)) / len(own)
    larger = left.interval[0] > 1.0 and not left.bounded and left.ratio < SLOW
    ratio = left.ratio if larger or left.interval[1] < 1.0 else 1.0
    return float(np.sqrt(max(1.0 + (ratio**2 - 1.0) / share, LEAST**2))) if share > 0 else 1.0


Data = dict[str, np.ndarray]
_Read = tuple[Data, np.ndarray, np.ndarray]
"""Columns, the residual (K, n) and which samples count."""


def _read(
    log: Log,
    model: Model,
    p: np.ndarray,
    offsets: Mapping[int, np.ndarray],
    sigma: Mapping[str, float],
    keep: Weigh | None,
) -> _Read | None:
    """Return the beginning of each run of `offsets`; None where no sample counts."""
    most = max(1, min(ROOM, READINGS // len(model.channels)))
    wanted = dict.fromkeys(
        (*columns_of(model), *(c for c in ("temperature_degc", "t_s") if c in log.columns))
    )
    left = dict.fromkeys(offsets, -(-most // max(len(offsets), 1)))
    parts, counted = [{c: np.zeros(0) for c in ("run", *wanted)}], [np.zeros(0, bool)]
    for batch in batches(extended(log, model, sigma, model.named(p)), tuple(wanted)):
        pick = []
        for block, (_, at) in zip(batch.blocks, batch.parts(), strict=True):
            n = min(left.get(block.run, 0), at.stop - at.start)
            if n:
                left[block.run] -= n
                pick.append(slice(at.start, at.start + n))
                counted.append(np.ones(n, bool) if keep is None else keep(block)[:n] > 0)
        if pick:
            run = np.repeat(batch.runs, np.diff(batch.edges))
            parts += [{c: v[at] for c, v in {"run": run, **batch.data}.items()} for at in pick]
        if not any(left.values()):
            break
    data = {c: np.concatenate([part[c] for part in parts]) for c in parts[0]}
    runs, index = np.unique(data["run"], return_inverse=True)
    none = np.zeros(len(model.offsets))
    own = np.array([offsets.get(run, none) for run in runs.tolist()]).reshape(len(runs), len(none))
    values = residual_of(model)(p, own[index].T, data)
    finite = np.isfinite(values).all(axis=0)
    used = np.concatenate(counted) & finite
    return (data, np.where(finite, values, 0.0), used) if used.any() else None


def _columns(model: Model, data: Data, sigma: Mapping[str, float]) -> Iterator[np.ndarray]:
    """Yield functions (n,) that a residual may follow, the most likely ones first."""
    made = {c.name for c in model.computed}
    edges = np.array(edges_of(data["run"]))
    data = data | {c: _at_rest(v, edges, sigma[c]) for c, v in data.items() if c in sigma}
    moves = [c for c in model.references if _moves(data[c], sigma.get(c, 0.0))]
    place = {c: _beside(data[c], edges) for c in moves}
    turns = {c: 2 * np.pi / model.period[c] * place[c] for c in moves if c in model.period}
    lines = {c: _unit(place[c]) for c in moves if c not in turns}
    states = [c for c in dict.fromkeys((*model.state, "temperature_degc")) if c in data and c not in made]
    states = [c for c in states if c not in model.references and _moves(data[c], sigma.get(c, 0.0))]
    s = [_unit(data[c]) for c in states]
    q = [*lines.values(), *(f(k * u) for u in turns.values() for k in (1, 2) for f in (np.cos, np.sin))]
    yield from q
    yield from s
    yield from (a * x for a in s for x in q)
    rates = list(_rates(data, moves))
    for v, a in rates:
        yield from (v, np.tanh(v / TURNS), a)
    for k in range(2, WAVES + 1):
        yield from (f(k * u) for u in turns.values() for f in (np.cos, np.sin))
    time = [c for c in ("t_s",) if c in data and np.ptp(data[c]) > 0]
    for t in (_unit(data[c]) for c in time):
        yield from _cosines(t, TIMES)
        yield from (f * x for f in (t, t * t) for x in q)
    if time:
        yield from _within_runs(data["t_s"], lines, edges)
    yield from (a * b for a, b in combinations(s, 2))
    yield from (a * a for a in s)
    for c, count in _along(model, data).items():
        yield from _cosines(_unit(place[c]), min(count, len(place[c])))
    waves = [_cosines(x, CURVE) for x in lines.values()]
    for k in range(1, CURVE):
        yield from (wave[k] for wave in waves)
    yield from (a * a * x for a in s for x in q)
    for v, a in rates:
        yield from (w * x for w in (np.abs(v), v * np.abs(v), v, np.tanh(v / TURNS), a) for x in (1.0, *q))
    for one, other in combinations(waves, 2):
        yield from (x * y for x in one[:PLACES] for y in other[:PLACES])


def _along(model: Model, data: Data) -> dict[str, int]:
    """Return how many cosines resolve the travel of each coordinate that goes over several magnets' periods.

    A turn in angle is the same place again; a further period is other magnets.
    """
    lengths = [c for c in model.references if c in model.period and c.endswith("_m")]
    periods = {c: float(np.ptp(data[c])) / model.period[c] for c in lengths}
    return {c: int(np.ceil(FINE * n)) for c, n in periods.items() if n > 1}


def _cosines(x: np.ndarray, most: int) -> np.ndarray:
    """Return cos(k pi (x + 1) / 2) for k = 1 .. `most`, (most, n), of places -1 .. 1."""
    return np.asarray(chebvander(np.cos(np.pi * (x + 1) / 2), most).T[1:])


def _within_runs(t: np.ndarray, lines: Data, edges: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the time within a run and its square, and the play of coordinates."""
    t = _unit(t, edges)
    yield from (t, t * t)
    scaled = [x / max(float(np.std(x)), 1e-300) for x in lines.values()]
    for plays in stop_operators(np.array(scaled), edges.tolist(), MEMORIES) if scaled else ():
        yield from plays


def _beside(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return a coordinate interpolated from the neighbours of each sample, by cubics through four of them.

    The noise of a sample's own coordinate is in its residual: places beyond a turning point are noise.
    """
    first, last = (np.repeat(ends, np.diff(edges)) for ends in (edges[:-1], edges[1:] - 1))

    def neighbour(steps: int) -> np.ndarray:
        """Return the sample so many steps on; beyond the end of its run, mirrored there."""
        at = np.arange(len(x)) + steps
        inside = np.clip(at, first, last)
        return np.asarray(2 * x[inside] - x[np.clip(2 * inside - at, first, last)])

    near = (4.0 * (neighbour(-1) + neighbour(1)) - neighbour(-2) - neighbour(2)) / 6.0
    return np.where(last - first >= 4, near, x)


def _rates(data: Data, moves: Sequence[str]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield velocity and acceleration of each coordinate over their greatest values, run by run."""
    t = data["t_s"]
    for c in moves:
        v = _slope(data[c], t, data["run"], REACH)
        a = _slope(v, t, data["run"], REACH + 1)  # one more, so that the sample itself has no part in it
        yield _over(v), _over(a)


def _slope(x: np.ndarray, t: np.ndarray, run: np.ndarray, reach: int) -> np.ndarray:
    """Slope between the samples `reach` before and after each, nil at the ends of a run."""
    out = np.zeros(len(x))
    if len(x) <= 2 * reach:
        return out
    inside = slice(reach, len(x) - reach)
    ahead, behind = slice(2 * reach, None), slice(0, -2 * reach)
    step = t[ahead] - t[behind]
    good = (run[ahead] == run[behind]) & (step > 0)
    out[inside] = np.where(good, (x[ahead] - x[behind]) / np.where(step > 0, step, 1.0), 0.0)
    return out


def _at_rest(x: np.ndarray, edges: np.ndarray, sigma: float) -> np.ndarray:
    """Return where an axis was: in a run where all that moved it is noise, its mean."""
    count = np.diff(edges)
    mean = np.repeat(np.add.reduceat(x, edges[:-1]) / count, count)
    still = np.add.reduceat((x - mean) ** 2, edges[:-1]) / count <= (STILL * sigma) ** 2
    return np.where(np.repeat(still, count), mean, x)


def _moves(x: np.ndarray, sigma: float) -> bool:
    return len(x) > 0 and float(np.std(x)) > max(STILL * sigma, 1e-300)


def _unit(x: np.ndarray, edges: np.ndarray | None = None) -> np.ndarray:
    """Scale a column to -1 .. 1 over its range, or between each two `edges`."""
    edges = np.array([0, len(x)]) if edges is None else edges
    low, high = (np.repeat(f.reduceat(x, edges[:-1]), np.diff(edges)) for f in (np.minimum, np.maximum))
    return np.asarray((x - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-300))


def _over(x: np.ndarray) -> np.ndarray:
    return x / max(float(np.abs(x).max(initial=0.0)), 1e-300)
