"""Standard uncertainties of parameters: from the noise by octave of frequency, or the scatter between runs.

Noise: each parameter collects the noise at the frequencies of its own column. The covariance is the sandwich
(H. White, Econometrica 50 (1982) 1, doi:10.2307/1912526) of the information and of the covariance of the
score: products of the columns by thirds of an octave, times the variance of the noise there. White noise
leaves the inverse of the information.

The scatter between runs: bias-reduced linearisation, CR2 (R. M. Bell and D. F. McCaffrey, Survey Methodology
28 (2002) 169; with the offsets of the runs as absorbed effects: J. E. Pustejovsky and E. Tipton, J. Bus.
Econ. Stat. 36 (2018) 672, doi:10.1080/07350015.2016.1247004).

Its coordinates are those in which the information of all runs together is the unit matrix: K K^T is the
covariance by the likelihood, J_g = K^T I_g K is the leverage of run g, and the J_g add up to 1. If white
noise alone acts, the score t_g of a run at the optimum has the covariance J_g - J_g^2; (1 - J_g)^(-1/2) t_g
has J_g, the contribution of that run's errors to the estimate. The sum of their squares is the covariance of
the estimate, whatever acts on a run as a whole.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
from scipy.fft import dct
from scipy.special import chdtri, ndtr

from hallsym.estimation.calibration import CombinationEstimate
from hallsym.estimation.decoding import columns_of, residual_of
from hallsym.estimation.factors import SINGULAR, eliminate, program, pseudo_inverse, solve, unit_scale
from hallsym.estimation.goodness_of_fit import CERTAIN, GoodnessOfFit, goodness_of
from hallsym.estimation.identifiable import (
    UNDETERMINED,
    Determination,
    linear_combinations,
    opened,
)
from hallsym.estimation.likelihood import Cost, Point, offsets_of
from hallsym.log import Log
from hallsym.log.batches import Batch, Weigh, batches
from hallsym.log.derived import extended
from hallsym.model.influence import reading_slopes
from hallsym.model.model import combination, linear

ALONE = 1e-3
"""1 - leverage below which a run determines a direction alone: its score does not show its error there."""
BANDS = 3
"""Bands of an octave: across one the power of a random walk changes 1.6 times, across an octave 4 times."""
STEEP, BEND = 2 * np.log(2.0), np.log(2.0)
"""Change of the logarithm of the power of noise from octave to octave, that of a random walk, and the change
of that slope: white noise becomes 1/f noise within an octave."""
PARTS, STEPS = (0.03, 0.3), 30
"""Parts of `BEND` that are tried, a power of frequency and a gradual bend (with 1, unseen octaves of a random
walk were anything), and steps of each, which change a logarithm by at most 1."""
WHITE, CHANCE = 1.2, 0.05
"""Ratio of the variances of noise in two octaves that must be seen before it counts as white, since it makes
a standard uncertainty a tenth too small; and the probability that white noise does not count as white."""
ENOUGH = 100_000
"""Samples from which the residual is judged to be white or not: whole runs, evenly spread."""
ENTRIES = 500_000
"""Derivatives of the readings, or products of them, in memory at once: 4 MB each."""


@dataclass(frozen=True, eq=False)
class Octaves:
    """Products of whitened columns by bands of a third of an octave, the offsets of each run eliminated.

    `products`: (bands, c, c) of the parameters' columns and the residual, which is last. `values`: (bands,)
    how many values the residual has there, those that offsets take not counted. The slowest band is the last.
    """

    products: np.ndarray
    values: np.ndarray

    @staticmethod
    def of(*logs: Iterable[tuple[Batch, np.ndarray]], offsets: int = 0) -> "Octaves":
        """Return those of some logs, each in pieces with the columns (offsets + c, K, samples) of each.

        A run that continues in the next piece is taken in parts. Where the columns are the residual alone,
        its `offsets` have taken their values from the mean. Means without offsets are waves across runs, one
        after the other: noise slower than a run goes on in the next one.
        """
        sums, counts = dict[int, np.ndarray](), dict[int, float]()
        means, lengths = list[np.ndarray](), list[int]()

        def add(band: np.ndarray, products: np.ndarray, values: np.ndarray) -> None:
            for o, more, count in zip(band.tolist(), products, values.tolist(), strict=True):
                sums[o] = sums.get(o, 0.0) + more
                counts[o] = counts.get(o, 0.0) + count

        def across() -> None:
            if means:
                waves = dct(np.concatenate(means), axis=0, norm="ortho").transpose(1, 2, 0)
                band, products, values = _in_bands(waves[None], float(np.sum(lengths)))
                add(band, products[0], values)
                means.clear()
                lengths.clear()

        def eliminated(parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
            whole = sum(products.sum(axis=1) for _, products, _ in parts)
            follow = eliminate(whole, offsets)[1]
            rest = np.tile(np.eye(follow.shape[2]), (len(follow), 1, 1))
            along = np.concatenate([follow, rest], axis=1)[:, None]
            own = pseudo_inverse(whole[:, :offsets, :offsets])
            for band, products, values in parts:
                taken = np.einsum("rij,roji->ro", own, products[:, :, :offsets, :offsets])
                left = (along.swapaxes(2, 3) @ products @ along).sum(axis=0)
                add(band, left, (values - taken).sum(axis=0))

        for pieces in logs:
            run, parts = None, list[tuple[np.ndarray, np.ndarray, np.ndarray]]()  # of what may go on
            for runs, waves in (one for own in pieces for one in _waves(*own)):
                if not offsets:
                    means.append(waves[..., 0])
                    lengths.extend([waves.shape[-1]] * len(runs))
                    if sum(map(np.size, means)) > ENTRIES:
                        across()
                band, products, values = _in_bands(waves, waves.shape[-1], 0 if offsets else 1)
                if products.shape[2] == 1 or not offsets:
                    taken = offsets * (np.arange(len(band)) == 0)
                    add(band, products.sum(axis=0), len(runs) * (values - taken))
                    continue
                first = np.flatnonzero([a != b for a, b in pairwise((None, *runs))])
                products = np.add.reduceat(products, first)
                values = np.diff(first, append=len(runs))[:, None] * values
                for part in (slice(1), slice(1, -1), slice(max(len(first) - 1, 1), None)):  # the last may too
                    own = [runs[k] for k in first[part]]
                    if parts and own and own[0] != run:
                        eliminated(parts)
                        parts = []
                    if own:
                        run = own[-1]
                        parts.append((band, products[part], values[part]))
            if parts:
                eliminated(parts)
            across()
        order, none = range(min(sums), max(sums) + 1), np.zeros_like(next(iter(sums.values())))
        return Octaves(*(np.array([known.get(o, of) for o in order])
                         for known, of in ((sums, none), (counts, 0.0))))  # fmt: skip

    @property
    def white(self) -> bool:
        """Whether the variances of the residual in all bands are certainly equal, within about `WHITE`.

        All are estimated as well as that, and differ no more than by chance (likelihood ratio).
        """
        seen = self.values >= 1.0
        values, power = self.values[seen], self.products[seen, -1, -1] / self.values[seen]
        ratio = np.maximum(power / np.average(power, weights=values), 1e-300)
        deviance = float(values @ (ratio - 1.0 - np.log(ratio)))
        known = values.min() >= 2.0 / (WHITE - 1.0) ** 2
        return bool(known and deviance <= chdtri(max(len(values) - 1, 1), CHANCE))

    @property
    def said(self) -> str:
        """How far the residual is from white noise."""
        power, _ = self.spectrum
        return f"the variance of the noise differs {power.max() / power.min():.1f} x over frequency"

    @cached_property
    def spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """The variance of the noise in each band, (b,), and the covariance of its logarithm, (b, b).

        By the restricted likelihood (H. D. Patterson and R. Thompson, Biometrika 58 (1971) 545,
        doi:10.1093/biomet/58.3.545): parameters take what lies along their columns, mostly at slow bands,
        and the residual does not show it. The logarithm is smooth with slopes of `STEEP` and parts of `BEND`,
        each part as far as it is likely: bands without values continue the slope of the faster ones.
        """
        squares, values, count = self.products[:, -1, -1], self.values, len(self.values)
        root = _roots(self.products[:, :-1, :-1].sum(axis=0))
        level = max(squares.sum(), 1e-300) / max(values.sum() - root.shape[1], 1.0)
        K = root.T @ self.products[:, :-1, :-1] @ root
        squares, along = squares / level, self.products[:, :-1, -1] @ root / np.sqrt(level)
        slope, bend = (np.diff(np.eye(count), k, axis=0) * BANDS ** (k - 0.5) for k in (1, 2))

        def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
            """Gradient and information of the restricted log-likelihood, and -2 times its value."""
            weight = np.exp(-x)
            H = np.tensordot(weight, K, 1)
            inverse = np.linalg.inv(H)
            moved = inverse @ (weight @ along)
            left = weight * (squares - 2.0 * along @ moved + K @ moved @ moved)
            share = (inverse @ K) * weight[:, None, None]
            taken = np.trace(share, axis1=1, axis2=2)
            both = share.reshape(count, -1) @ share.swapaxes(1, 2).reshape(count, -1).T
            known = 0.5 * (np.diag(np.maximum(values - 2.0 * taken, 0.0)) + both)
            lost = float(values @ x + left.sum() + np.linalg.slogdet(H)[1])
            return 0.5 * (left + taken - values), known, lost

        x, found = np.zeros(count), list[tuple[float, np.ndarray, np.ndarray]]()
        for part in PARTS:
            prior = slope.T @ slope / STEEP**2 + bend.T @ bend / (part * BEND) ** 2
            for _ in range(STEPS):  # Fisher's scoring
                gradient, known, lost = at(x)
                step = np.linalg.solve(known + prior, gradient - prior @ x)
                x = x + step / max(1.0, np.abs(step).max())
                if np.abs(step).max() < 1e-3:
                    break
            sizes = np.linalg.eigvalsh(prior)[1:], np.linalg.eigvalsh(known + prior)
            gained = np.log(sizes[0]).sum() - np.log(sizes[1]).sum() - lost - x @ prior @ x
            found.append((0.5 * gained, x, np.linalg.inv(known + prior)))
        gains, each, within = (np.array(v) for v in zip(*found, strict=True))
        likely = np.exp(gains - gains.max())
        likely /= likely.sum()
        mean = likely @ each
        between = (likely * (each - mean).T) @ (each - mean)
        return level * np.exp(mean), np.tensordot(likely, within, 1) + between

    def reduced(self, basis: np.ndarray) -> "Octaves":
        """Return those of other parameters q, of which those of the columns are basis (p, q) times q."""
        wide = np.zeros((len(basis) + 1, basis.shape[1] + 1))
        wide[:-1, :-1], wide[-1, -1] = basis, 1.0
        return Octaves(wide.T @ self.products @ wide, self.values)


def _waves(batch: Batch, columns: np.ndarray) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Yield of b blocks of one length the runs and the cosines of the `columns`, (b, K, c, samples).

    `columns`: (c, K, samples). Cosines are nearly uncorrelated for slow noise too: a block of a random walk
    ends elsewhere than it begins.
    """
    lengths, (c, K) = np.diff(batch.edges), columns.shape[:2]
    cuts = [0, *(np.flatnonzero(np.diff(lengths)) + 1).tolist(), len(lengths)]
    for first, last in pairwise(cuts):
        n = int(lengths[first])
        here = columns[..., batch.edges[first] : batch.edges[last]].reshape(c, K, last - first, n)
        yield batch.runs[first:last], dct(here, norm="ortho").transpose(2, 1, 0, 3)


def _in_bands(waves: np.ndarray, span: float, first: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return bands, products (b, bands, c, c) and numbers of values of cosines (b, K, c, n) from `first`."""
    b, K, c, n = waves.shape
    band, ends = _bands_of(n, span, first)
    products = np.empty((b, len(band), c, c))
    for k, (start, end) in enumerate(pairwise(ends)):
        part = waves[..., start:end]
        products[:, k] = (part @ part.swapaxes(2, 3)).sum(axis=1)
    return band, products, K * np.diff(ends).astype(float)


@cache
def _bands_of(n: int, span: float, first: int) -> tuple[np.ndarray, list[int]]:
    """Return the bands of n cosines from the `first`, and where they begin among these, with the end.

    Cosine j has a period of 2 `span` / j samples, the mean one of 4 `span`. Band o: periods of
    2^(o / `BANDS`) to 2^((o + 1) / `BANDS`) samples.
    """
    band = np.floor(BANDS * np.log2(2 * span / np.maximum(np.arange(first, n), 0.5))).astype(int)
    begin = np.flatnonzero(np.diff(band, prepend=-1))
    return band[begin], [*(first + begin).tolist(), n]


def _roots(information: np.ndarray) -> np.ndarray:
    """Return K (p, n) with K^T `information` K = 1, of the n directions that it determines."""
    unit = unit_scale(information)
    values, axes = np.linalg.eigh(information * np.outer(unit, unit))
    some = values > SINGULAR * values.max(initial=0.0)
    return np.asarray(unit[:, None] * axes[:, some] / np.sqrt(values[some]))


@dataclass(frozen=True, eq=False)
class RunScatter:
    """Scores of r runs about p parameters.

    `root`: (p, n) K, n <= p: of the directions that the runs determine. `leverage`: (r, n, n) J. `scores`:
    (r, n) t. `by_noise`: (n, n) covariance of the sum of the scores by noise, 1 where it is white.
    """

    root: np.ndarray
    leverage: np.ndarray
    scores: np.ndarray
    by_noise: np.ndarray

    @staticmethod
    def of(runs: np.ndarray, scores: np.ndarray, noise: np.ndarray | None = None) -> "RunScatter":
        """Change to the coordinates from those of the parameters.

        `runs`: (r, p, p) information, overwritten. `scores`: (r, p). `noise`: (p, p) covariance of the sum of
        the scores by noise, None where it is the information.
        """
        K = _roots(runs.sum(axis=0))
        by_noise = np.eye(K.shape[1]) if noise is None else K.T @ noise @ K
        return RunScatter(K, K.T @ runs @ K, scores @ K, by_noise)

    @cached_property
    def _powers(self) -> tuple[np.ndarray, float]:
        """Sum over runs of J^2, (n, n), and of the trace of J^3."""
        squares = self.leverage @ self.leverage
        return squares.sum(axis=0), float(np.sum(squares * self.leverage))

    @cached_property
    def expected(self) -> float:
        """Sum of squares of all scores that noise alone predicts; that of each run by its leverage."""
        squares, _ = self._powers
        return float(np.trace(self.by_noise)) - float(np.sum(squares * self.by_noise))

    @cached_property
    def ratio(self) -> float:
        """Sum of squares of all scores over its expectation by noise; 1 without scores."""
        squares = float(np.einsum("ri,ri->", self.scores, self.scores))
        return squares / self.expected if self.expected > ALONE * len(self.by_noise) else 1.0

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Of `ratio`: 2 mean^2 / variance, for leverages as they are."""
        squares, cubes = self._powers
        variance = float(np.trace(squares)) - 2.0 * cubes + float(np.sum(squares * squares))
        mean = len(self.by_noise) - float(np.trace(squares))
        return max(mean**2 / variance, 1.0) if variance > ALONE**2 else 1.0

    def limit(self, size: float) -> float:
        """Return the `ratio` that white noise of variance `size` certainly does not exceed."""
        return size * float(chdtri(self.degrees_of_freedom, ndtr(-CERTAIN))) / self.degrees_of_freedom

    @cached_property
    def _adjusted(self) -> tuple[np.ndarray, np.ndarray]:
        """(1 - J)^(-1/2) without the directions that a run determines alone, (r, n, n), and the leverage of
        all runs in those directions, (n, n)."""
        share, axes = np.linalg.eigh(self.leverage)
        alone = 1.0 - share <= ALONE
        grow = np.where(alone, 0.0, 1.0 / np.sqrt(np.maximum(1.0 - share, ALONE)))
        adjust, own = ((axes * of[:, None]) @ axes.swapaxes(1, 2) for of in (grow, share * alone))
        return adjust, own.sum(axis=0)

    def covariance(self, least: float) -> np.ndarray:
        """Return the covariance of the parameters, (n, n).

        A direction that one run determines alone gets the variance by noise, scaled by the scatter of all
        directions together and by no less than `least`.
        """
        adjust, alone = self._adjusted
        share, axes = np.linalg.eigh(alone)
        root = (axes * np.sqrt(np.maximum(share, 0.0))) @ axes.T
        grown = np.einsum("rij,rj->ri", adjust, self.scores)
        inner = grown.T @ grown + max(self.ratio, least) * (root @ self.by_noise @ root)
        return self.root @ inner @ self.root.T

    def degrees_of_freedom_of(self, gradients: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom (m,) of the variances of linear combinations (m, n) of parameters.

        Bell and McCaffrey's: of the chi-square with the mean and the variance that noise alone gives the
        estimate of that variance. Where one run determines a part alone, that part has those of `ratio`.
        """
        along = gradients @ self.root
        size = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.where(size > 0, size, 1.0)
        adjust, alone = self._adjusted
        w = along @ adjust
        y = w @ self.leverage
        own, squares = (w * y).sum(axis=2), (y * y).sum(axis=2)
        across = y.transpose(1, 2, 0) @ y.swapaxes(0, 1)
        mean = (own - squares).sum(axis=0)
        variance = (own * (own - 2.0 * squares)).sum(axis=0) + (across**2).sum(axis=(1, 2))
        pooled = np.einsum("mi,ij,mj->m", along, alone, along)
        spread = variance + pooled**2 / self.degrees_of_freedom
        return np.maximum((mean + pooled) ** 2 / np.maximum(spread, 1e-300), 1.0)


PLACES = 16_384
"""Most places whose slopes are computed at once."""
OVERSTATED = 0.1
"""Cost per degree of freedom below which noise was overstated or there is none (a plan): it is not used."""
AT_BOUND = 1e-6
"""Part of a bound, or of the width of the bounds, within which a parameter counts as at it (`pressed`)."""
BY_OCTAVES = "noise by octave of frequency"
"""Method of a covariance by noise that is not white."""
BY_RUNS = "runs as blocks"
"""Method of a covariance that comes from the scatter between runs."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of every parameter and determined combination; see `Fit` for the fields.

    `degrees_of_freedom`: (n,), infinite where the noise is as stated. `fitted`: how many numbers were fitted.
    """

    std: np.ndarray
    determined: np.ndarray
    covariance: np.ndarray
    method: str
    reason: str
    at_bound: tuple[str, ...]
    combinations: tuple[CombinationEstimate, ...]
    undetermined_by_log: tuple[str, ...]
    degrees_of_freedom: np.ndarray
    goodness: GoodnessOfFit
    fitted: int


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples that a cost was made of: a log, the noise of its columns, and the weight of each sample."""

    log: Log
    sigma: Mapping[str, float]
    keep: Weigh | None = None


def uncertainty(point: Point, found: Determination, samples: Sequence[Samples] = ()) -> Uncertainty:
    """Return the uncertainties where `point` is the optimum of its cost.

    `samples`: of each log that the cost is made of. Without them noise counts as white, as that of a plan.
    """
    cost, p, model = point.cost, point.p, point.cost.summary.model
    at_bound = tuple(k for k in pressed(model.bounds, p) if k not in found.not_free)
    axes = found.coordinates(at_bound)
    moving, fitted = axes.moving, len(axes.free)
    basis = axes.basis(len(p))
    fit = goodness_of(point, fitted)
    covariance = np.zeros((len(p), len(p)))
    known = Estimated(covariance, "likelihood", "there was nothing to estimate", White(1.0, 1.0).freedom)
    if fitted:
        runs, more = point.information(1.0, moving), _excess_noise_of(point, moving)
        noisy = fit.cost_per_degree_of_freedom > OVERSTATED
        octaves = _octaves(point, moving, samples) if noisy else None
        if len(axes.dependent):
            own = basis[moving]
            runs, more = own.T @ runs @ own, None if more is None else own.T @ more @ own
            octaves = octaves and octaves.reduced(own)
        scores = 0.5 * axes.slope(point.run_gradients)
        weights = cost.weights
        runs *= weights[:, None, None]
        known = estimated(runs, scores * weights[:, None], White.of(fit), octaves, more)
        covariance = basis @ known.covariance @ basis.T
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    determined = np.isin(np.arange(len(p)), moving) & ~_loose(model.names, std, found)
    dof = np.full(len(p), np.inf)
    dof[moving] = known.dof(basis[moving])

    def dof_of(gradient: np.ndarray) -> float | None:
        of_it = float(known.dof(axes.slope(gradient)[None])[0])
        return of_it if np.isfinite(of_it) else None

    combinations, lost = _combinations(cost, p, covariance, found, determined, dof_of)
    open_ = [p.width > 0 and p.name not in found.structural for p in model.parameters]
    another = np.flatnonzero(~determined & open_ & ~np.isin(np.arange(len(p)), at_bound))  # recording
    loose = [model.names[k] for k in another]
    return Uncertainty(
        std=np.where(determined, std, np.nan),
        determined=determined,
        covariance=covariance,
        method=known.method,
        reason=known.reason,
        at_bound=tuple(model.names[k] for k in at_bound),
        combinations=combinations,
        undetermined_by_log=(*loose, *lost),
        degrees_of_freedom=dof,
        goodness=fit,
        fitted=fitted,
    )


def _octaves(point: Point, moving: np.ndarray, samples: Sequence[Samples]) -> Octaves | None:
    """Return what the parameters `moving` and the residual have in each octave; None where noise is white.

    The columns of the parameters are computed only where the residual is not white.
    """
    cost, none = point.cost, np.zeros(0, dtype=int)
    if not samples:
        return None
    logs = [
        (point if part is cost else part.at(point.p[chosen]), chosen, own)
        for (part, chosen), own in zip(cost.shares, samples, strict=True)
    ]
    offsets = len(cost.summary.model.offsets)
    if Octaves.of(*(_columns(at, chosen, none, own) for at, chosen, own in logs), offsets=offsets).white:
        return None
    return Octaves.of(*(_columns(at, chosen, moving, own) for at, chosen, own in logs), offsets=offsets)


def _columns(
    point: Point, chosen: np.ndarray, moving: np.ndarray, samples: Samples
) -> Iterator[tuple[Batch, np.ndarray]]:
    """Yield a log in pieces, with the whitened columns of offsets, parameters `moving` and residual.

    (columns, K, samples); without parameters the residual alone, of `ENOUGH` samples in whole runs. `point`:
    of the cost of this log, whose parameters are those `chosen` of all.
    """
    cost, model, p, log = point.cost, point.cost.summary.model, point.p, samples.log
    fitted = [run for run, weight in zip(cost.summary.runs, cost.weights, strict=True) if weight > 0]
    if not len(moving):
        fitted = fitted[:: -(-int(cost.summary.counts.sum()) // ENOUGH)]
    offsets, z, K = offsets_of(cost, p), len(model.offsets) if len(moving) else 0, len(model.channels)
    whiten = np.linalg.cholesky(np.linalg.inv(point.covariance.mean(axis=0))).T
    residual = model.remember("residual", lambda: residual_of(model))
    parts = program(model) if len(moving) else None
    if parts:
        k0, j0 = np.array(parts.zero_entries, dtype=int).reshape(-1, 2).T
        k, j = np.array(parts.entries, dtype=int).reshape(-1, 2).T
        place = np.full(int(max(chosen.max(initial=0), moving.max(initial=0))) + 1, -1)
        place[moving] = z + np.arange(len(moving))
        own = np.flatnonzero(place[chosen[j]] >= 0)
    columns, most = columns_of(model), ENTRIES // (K * (z + len(moving) + 1))
    for whole in batches(extended(log, model, samples.sigma, model.named(p)), columns):
        for batch, _ in whole.of_runs(fitted).pieces(max(most, 1)):
            here, weights = batch.offsets(offsets, len(model.offsets)), batch.weights(samples.keep)
            A = np.zeros((z + len(moving) + 1, K, len(batch)))
            A[-1] = residual(p, here, batch.data)
            if parts:
                pose, state = batch.columns(model.references), batch.columns(model.state)
                slopes = parts.values(p, here, pose, state)[0]
                A[j0, k0] = slopes[: len(k0)]
                A[place[chosen[j[own]]], k[own]] = slopes[len(k0) + own]
            yield batch, whiten @ (A if weights is None else A * weights)


def _excess_noise_of(point: Point, free: np.ndarray) -> np.ndarray | None:
    """Return the sum of `_excess_noise` over the runs of all shares of a cost; None where none has any."""
    cost, out = point.cost, None
    for part, chosen in cost.shares:
        own = np.flatnonzero(np.isin(free, chosen))
        at = point if part is cost else part.at(point.p[chosen])
        found = _excess_noise(at, np.searchsorted(chosen, free[own]))
        if found is not None:
            out = np.zeros((len(free), len(free))) if out is None else out
            out[own[:, None], own] += np.tensordot(part.weights, found, 1)
    return out


def _excess_noise(point: Point, free: np.ndarray) -> np.ndarray | None:
    """Covariance of each run's scores beyond its information, (r, n, n) for n `free` parameters.

    The cost weighs every residual of a run by the mean of their covariances C (`likelihood`). Where the
    noise of the reference acts along an ellipse, C goes round with the pose: scores g^T W r, g = dr/dp and W
    the inverse of the mean C, then have the covariance sum of g^T W C W g, and the estimate the sandwich of
    both (White, Econometrica 50 (1982) 1, doi:10.2307/1912526). None where readings are linear in the pose.
    """
    cost, p, summary, model = point.cost, point.p, point.cost.summary, point.cost.summary.model
    if not summary.places or not np.any(cost.column_variance):
        return None
    K, n = len(cost.reading_variance), len(free)
    out, W, poses = np.zeros((len(summary.runs), n, n)), point.W[:, None], len(model.pose)
    for some in _of_one_size(summary.places):
        places = np.array([summary.places[k] for k in some])  # (r, columns, s)
        r, _, s = places.shape
        columns = np.swapaxes(places, 0, 1).reshape(-1, r * s)
        offsets = np.repeat(point.offsets[some].T, s, axis=1)
        found = reading_slopes(model, p, offsets, columns[:poses], columns[poses:])
        g, z, *by_columns = (v.reshape(r, s, K, v.shape[2]) for v in found)
        j = np.concatenate(by_columns, axis=3)
        if z.shape[3]:  # slopes with the offsets of a run eliminated
            square, both = (_products(z, W[some] @ v) for v in (z, g))
            g = g - z @ solve(square, both)[:, None]
        g = g[..., free]
        C = (j * cost.column_variance) @ np.swapaxes(j, 2, 3)
        weighed = W[some] @ g
        more = _products(weighed, (C - C.mean(axis=1, keepdims=True)) @ weighed)
        out[some] = more * (summary.counts[some] / s)[:, None, None]
    return out


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the sum of a^T b over samples and channels, (r, i, j), of a (r, s, K, i) and b (r, s, K, j)."""
    left, right = (v.reshape(len(v), -1, v.shape[-1]) for v in (a, b))
    return np.asarray(np.swapaxes(left, 1, 2) @ right)


def _of_one_size(places: Sequence[np.ndarray]) -> Iterator[list[int]]:
    """Yield runs with one number of places (n_columns, samples), as many as are handled at once."""
    by_samples: dict[int, list[int]] = {}
    for k, own in enumerate(places):
        by_samples.setdefault(own.shape[1], []).append(k)
    for samples, runs in by_samples.items():
        most = max(1, PLACES // max(samples, 1))
        yield from (runs[first : first + most] for first in range(0, len(runs), most))


@dataclass(frozen=True, eq=False)
class White:
    """The variance of white noise, as a multiple of that by which information and scores are weighted.

    `size`: of the residual; `scale`: of the noise, with its degrees of freedom `dof`; `said`: why it is not
    the stated one.
    """

    size: float
    scale: float
    dof: float = np.inf
    said: str = ""

    @staticmethod
    def of(fit: GoodnessOfFit) -> "White":
        """Return that of a fit, whose noise is as stated unless the residual is significantly larger."""
        size = fit.cost_per_degree_of_freedom if fit.contradicts else 1.0
        size = size if size > OVERSTATED else 1.0
        if not fit.significant:
            return White(size, 1.0)
        said = f"the cost per degree of freedom is {size:.3g} +- {fit.scatter:.2g}; "
        return White(size, size, fit.degrees_of_freedom, said)

    def freedom(self, gradients: np.ndarray) -> np.ndarray:
        """Return `dof` for each of the rows of `gradients`."""
        return np.full(len(gradients), self.dof)


@dataclass(frozen=True, eq=False)
class Estimated:
    """Covariance (p, p) of parameters, and how it came about.

    `dof`: degrees of freedom (m,) of the variances of linear combinations (m, p) of the parameters.
    """

    covariance: np.ndarray
    method: str
    reason: str
    dof: Callable[[np.ndarray], np.ndarray]


def estimated(
    runs: np.ndarray,
    scores: np.ndarray,
    white: White,
    octaves: Octaves | None = None,
    more: np.ndarray | None = None,
) -> Estimated:
    """Return the covariance by the noise, or by the scatter between runs where that certainly is larger.

    `runs`: (r, p, p) information of each run, `scores`: (r, p), 0 where a run has no weight. `white`: the
    noise where it is white, else `octaves` of the parameters and the residual. `more`: (p, p) covariance of
    the sum of the scores beyond that, or None. Errors of the model go with the motion of a run, and not with
    a frequency: they show in the scatter between runs.
    """
    information = runs.sum(axis=0)
    n, noise, kind = int(np.sum(np.einsum("rii->r", runs) > 0)), information, "white noise"
    method, said, scale, size = "likelihood", white.said, white.scale, white.size
    if said:
        method += ", scaled"

    dof: Callable[[np.ndarray], np.ndarray] = white.freedom
    if octaves is not None:
        inverse = pseudo_inverse(information)
        power, of_power = octaves.spectrum
        each = octaves.products[:, :-1, :-1] * power[:, None, None]
        noise, kind, scale, size = each.sum(axis=0), "noise of this spectrum", 1.0, 1.0
        if more is not None:  # what the spectrum makes of white noise, it makes of noise that varies too
            root, varying = _root(information), _root(information + more)
            inner = pseudo_inverse(root)
            noise, more = varying @ inner @ noise @ inner @ varying, None
        method, said = BY_OCTAVES, f"{octaves.said}; "

        def of_octaves(gradients: np.ndarray) -> np.ndarray:
            along = gradients @ inverse
            shares = np.einsum("mi,oij,mj->mo", along, each, along)
            spread = np.einsum("mo,op,mp->m", shares, of_power, shares)
            return 2.0 * shares.sum(axis=1) ** 2 / np.maximum(spread, 1e-300)

        dof = of_octaves
    noise = noise if more is None else noise + more
    scatter = RunScatter.of(runs, scores, noise)
    by_noise = Estimated(scale * (scatter.root @ scatter.by_noise @ scatter.root.T), method, said, dof)
    if n == 1:
        return replace(by_noise, reason=f"{said}one run has no scatter between runs")
    # correlated noise without octaves has a smaller residual within a run, and more scatter between runs
    limit = scatter.limit(size)
    said += f"scores of the {n} runs scatter {scatter.ratio:.2f} x what {kind} predicts (limit {limit:.2f})"
    if scatter.ratio <= limit:
        return replace(by_noise, reason=said)
    found = Estimated(scatter.covariance(scale), BY_RUNS, said, scatter.degrees_of_freedom_of)
    return found if octaves is None else _larger(found, by_noise)


def _root(matrix: np.ndarray) -> np.ndarray:
    """Return the symmetric root of a covariance."""
    values, axes = np.linalg.eigh(matrix)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)


def _larger(by_runs: Estimated, by_noise: Estimated) -> Estimated:
    """Return an estimate by runs no variance of which is smaller than by noise: a few may agree by chance."""
    sizes = [np.maximum(np.diag(one.covariance), 1e-300) for one in (by_noise, by_runs)]
    more = np.sqrt(np.maximum(sizes[0] / sizes[1], 1.0))

    def dof(gradients: np.ndarray) -> np.ndarray:
        noise, runs = (np.einsum("mi,ij,mj->m", gradients, one.covariance, gradients)
                       for one in (by_noise, by_runs))  # fmt: skip
        return np.where(noise > runs, by_noise.dof(gradients), by_runs.dof(gradients))

    return replace(by_runs, covariance=by_runs.covariance * np.outer(more, more), dof=dof)


def pressed(bounds: tuple[np.ndarray, np.ndarray], p: np.ndarray) -> tuple[int, ...]:
    """Return the index of each parameter at one of its bounds.

    A distance counts beside the bound itself where that is less than the range: .9 is not at the end of a
    range from 1e-6 to 1e6.
    """
    width = bounds[1] - bounds[0]
    sizes = [np.where(end == 0, width, np.minimum(np.abs(end), width)) for end in bounds]
    ends = zip(bounds, sizes, strict=True)
    near = [np.isfinite(end) & (np.abs(p - end) <= AT_BOUND * size) for end, size in ends]
    return tuple(np.flatnonzero(near[0] | near[1]).tolist())


def _loose(names: tuple[str, ...], std: np.ndarray, found: Determination) -> np.ndarray:
    """Which parameters null directions move by more than their uncertainty, or no recording determines."""
    return np.isin(names, found.structural) | (found.slack(np.eye(len(names))) > std)


def _combinations(
    cost: Cost,
    p: np.ndarray,
    covariance: np.ndarray,
    found: Determination,
    determined: np.ndarray,
    dof_of: Callable[[np.ndarray], float | None],
) -> tuple[tuple[CombinationEstimate, ...], list[str]]:
    """Named combinations that are determined, then linear ones for the rest; and named ones lost."""
    model = cost.summary.model
    index = {name: k for k, name in enumerate(model.names)}
    out, known, lost = [], [], []
    for named in model.combinations:
        value, gradient = combination(model, named).first(p)
        std = _std(gradient, covariance)
        if all(determined[index[n]] or model.parameters[index[n]].width == 0 for n in named.parameters):
            continue
        if std > 0 and found.slack(gradient) <= max(std, 1e-9 * abs(value)):
            dof = dof_of(gradient)
            out.append(CombinationEstimate(named.expression, value, std, named.unit, None, dof))
            known.append(gradient)
        else:
            lost.append(named.expression)
    stacked = np.array(known).T if known else np.zeros((len(p), 0))
    scaled = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    among = np.flatnonzero(_loose(model.names, scaled, found) & (found.scale > 0) & opened(model))
    for gradient in linear_combinations(found.scale, found.null, stacked, among):
        gradient = _readable(gradient, found.scale, covariance)
        std = _std(gradient, covariance)
        if 0 < std < UNDETERMINED * np.abs(gradient * found.scale).max():
            involved = np.flatnonzero(gradient)
            quantity = linear(model, gradient, model.parameters[involved[0]].unit)
            factors = {model.names[k]: float(gradient[k]) for k in involved}
            value, dof = float(gradient @ p), dof_of(gradient)
            out.append(CombinationEstimate(quantity.name, value, std, quantity.unit, factors, dof))
    return tuple(out), lost


def _readable(gradient: np.ndarray, scale: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Leave out terms that cannot move the combination by a quarter of its uncertainty; lead with 1."""
    small = 0.5 * np.abs(gradient) * scale < 0.25 * _std(gradient, covariance)
    kept = np.where(small, 0.0, gradient)
    return kept / kept[np.flatnonzero(kept)[0]] if kept.any() else gradient


def _std(gradient: np.ndarray, covariance: np.ndarray) -> float:
    return float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
