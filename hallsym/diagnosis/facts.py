"""What effects may know of a log before they are tried: length, columns, rails, hum, change points."""

from collections.abc import Collection
from functools import lru_cache

import casadi as ca
import numpy as np

from hallsym.diagnosis.change_points import solved
from hallsym.diagnosis.p_values import statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residual_table import ROOM, ResidualTable, residual_table
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.sign_flips import FLIPS
from hallsym.diagnosis.survey import SEGMENT, Survey
from hallsym.families.mechanisms import CUT, MAINS_HZ, MAINS_REACH_HZ
from hallsym.log import Log
from hallsym.log.batches import batches
from hallsym.model import Facts, Model


def instants(r: ResidualTable, holdout: Collection[int], slow: float) -> tuple[tuple[int, float], ...]:
    """Return, for each channel, the instant [s since the log began] at which a step explains most.

    A step of gain and offset is taken off the residual, beside a gain of the channel and the mean of each
    run. Held-out runs take no part, but say on which side of it they lie where the others leave it open, like
    their zero deviation. It lies within a run, a fitted one, if it explains more there than any between runs
    does by more than noise: `slow` is the variance of a slow average of the whitened residual.
    """
    first = np.diff(r.run, prepend=r.run[0] - 1) != 0
    within = np.arange(len(r.run)) - np.flatnonzero(first)[np.cumsum(first) - 1]
    fitted = ~np.isin(r.run, list(holdout))
    between, inside = np.flatnonzero(first), np.flatnonzero(fitted & (within % SEGMENT == 0) & ~first)
    noise = np.diag(np.linalg.inv(r.precision)) * slow * statistic_at(r.policy.certain / (1 + len(inside)), 2)
    out = []
    for k in range(len(r.channels)):
        gains, inner = (step_gains(r, k, fitted, at) for at in (between, inside))
        most = float(gains.max())
        if inner.max(initial=0.0) > most + noise[k]:
            best = inside[np.argmax(inner)]
            near = np.arange(max(best - SEGMENT, 0), min(best + SEGMENT, len(r.run)))
            near = near[(r.run[near] == r.run[best]) & ~first[near]]
            best = near[np.argmax(step_gains(r, k, fitted, near))]
        else:
            open_ = gains >= most - noise[k]  # and not only elsewhere in the log
            index = np.cumsum(np.diff(open_, prepend=False))
            equal = between[index == index[np.argmax(gains)]]
            best = equal[np.argmax(step_gains(r, k, np.ones_like(fitted), equal))]
        out.append((k, float(r.columns["campaign_s"][best])))
    return tuple(out)


def step_gains(r: ResidualTable, k: int, counted: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the squares that a step of channel k at each sample of `at` takes off the `counted` ones."""
    _, run, sizes = np.unique(r.run, return_inverse=True, return_counts=True)
    n = sizes[run[at]]
    y, x = r.residual[k] * counted, r.sensed[k] * counted

    def later(values: np.ndarray) -> np.ndarray:
        """Sum from each sample to the end of its run."""
        ends = np.cumsum(values[::-1])[::-1]
        return (ends - np.append(ends, 0.0)[np.cumsum(sizes)][run])[at]

    def after(values: np.ndarray) -> np.ndarray:
        """Sum over all runs after that of each sample."""
        sums = np.bincount(run, values)
        return (np.cumsum(sums[::-1])[::-1] - sums)[run[at]]

    def centred(values: np.ndarray) -> np.ndarray:
        return values - counted * (np.bincount(run, values) / sizes)[run]

    # a step's columns less their mean in its run: of its offset they are 0 in the runs after it
    y, about = centred(y), centred(x)
    whole = max(float(about @ about), 1e-300)
    beside = np.array([later(about), later(x * about) + after(about**2)])
    shared = np.array([later(y), later(x * y) + after(about * y)]) - beside * float(about @ y) / whole
    means = np.array([later(counted * 1.0), later(x)])
    raw = np.array([[means[0], means[1]], [means[1], later(x**2) + after(about**2)]])
    left = raw - means[:, None] * means / n - beside[:, None] * beside / whole
    return solved(left, raw, shared)[0]


# -- two levels of offset among the runs ---------------------------------------------------------------------


def switched_runs(r: ResidualTable) -> tuple[tuple[int, ...], float]:
    """Return the runs whose offset forms a level of its own beside the others, and the p-value of two levels.

    None where runs are too few. Offsets are the mean whitened residuals of each run, along the direction in
    which they differ most; the split into two levels is the one that explains most of their squares. A run of
    either side says of itself, held out or not, on which level it lies. The first run is always on the other
    level. The p-value is the share of as many Gaussian offsets that split as well by chance.
    """
    runs, index, n = np.unique(r.run, return_inverse=True, return_counts=True)
    if len(runs) < r.policy.fewest:
        return (), 1.0
    whitened = np.linalg.cholesky(r.precision).T @ r.residual
    mean = np.array([np.bincount(index, row) for row in whitened]).T / n[:, None]
    level = _levels(mean[None], n)
    share, split = _two_levels(level, n)
    chance = _shares_by_chance(tuple(n.tolist()), len(r.residual))
    order = np.argsort(level[0])
    sides = set(runs[order[: split[0]]].tolist()), set(runs[order[split[0] :]].tolist())
    p = (1 + np.count_nonzero(chance >= share[0])) / (1 + len(chance))
    return tuple(sorted(sides[int(r.run[0]) in sides[0]])), float(p)


@lru_cache(maxsize=4)
def _shares_by_chance(n: tuple[int, ...], channels: int) -> np.ndarray:
    """Return the shares of `_two_levels` (FLIPS,) where the offsets of runs of n samples are Gaussian."""
    rng, size = np.random.default_rng(len(n)), np.array(n)
    mean = (rng.standard_normal((len(n), channels)) / np.sqrt(size)[:, None] for _ in range(FLIPS))
    return np.array([_two_levels(_levels(m[None], size), size)[0][0] for m in mean])


def _levels(mean: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return offsets (draws, runs) of the means (draws, runs, K) of n samples each, along what differs most.

    Their unit is of no account.
    """
    mean = mean - (n @ mean / n.sum())[:, None]
    vectors, _, _ = np.linalg.svd(np.sqrt(n)[:, None] * mean, full_matrices=False)
    return np.asarray(vectors[:, :, 0] / np.sqrt(n))


def _two_levels(level: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the squares of offsets (draws, runs) that two levels explain best, and where the
    offsets by size are split."""
    order = np.argsort(level, axis=1)
    below, left = (
        np.cumsum(np.take_along_axis(np.broadcast_to(values, level.shape), order, axis=1), axis=1)[:, :-1]
        for values in (n * level, n)
    )
    explained = below**2 * (1 / left + 1 / (n.sum() - left))
    best = explained.argmax(axis=1)
    whole = np.maximum((n * level**2).sum(axis=1), 1e-300)
    return np.take_along_axis(explained, best[:, None], axis=1)[:, 0] / whole, 1 + best


def _slips(base: Base, r: ResidualTable, found: Survey) -> tuple[tuple[int, float], ...]:
    """Return the instants at which channels may slip; none where no gain of the channels is fitted."""
    s = base.model.symbols
    channel, parameter = ca.jacobian(s.full(s.gain), s.parameters).sparsity().get_triplet()
    fitted = {k for k, j in zip(channel, parameter, strict=True) if j in base.free}
    if not base.model.zeros or len(fitted) < len(base.model.channels):
        return ()
    return instants(r, base.holdout, found.variance * found.inflation)


def facts_of(base: Base, found: Survey) -> Facts:
    """Return what effects may know of the log; searched numbers come from the residual of `base`."""
    model, log = base.model, base.log
    r, values = residual_table(base, log.runs), _readings(log, model)
    several = len(model.channels) > len(model.pose) and not model.zeros
    on_runs, on_runs_p = switched_runs(r) if r and several else ((), 1.0)
    return Facts(
        duration_s=max(found.duration_s, 1e-6),
        columns=tuple(c for c in log.columns if base.timed or c != "t_s"),
        temperature=_mean(log, "temperature_degc") if "temperature_degc" in log.columns else None,
        extremes=np.vstack([np.quantile(values, [1 - share, share], axis=1) for share in CUT]),
        rails=rails_of(values, base.policy),
        lines_hz=found.lines_hz,
        lines_tried=max(1, round(2 * MAINS_REACH_HZ * len(MAINS_HZ) * found.duration_s)),
        instants=_slips(base, r, found) if r else (),
        instants_tried=len(model.layout) * (min(log.rows, ROOM) // SEGMENT + len(log.runs)),
        on_runs=on_runs,
        on_runs_tried=2 ** (len(log.runs) - 1),
        on_runs_p=on_runs_p,
    )


def _mean(log: Log, column: str) -> float:
    sums = [(b.data[column].sum(), len(b)) for b in batches(log, (column,))]
    return float(sum(s for s, _ in sums) / sum(n for _, n in sums))


def _readings(log: Log, model: Model) -> np.ndarray:
    """Return the readings, evenly thinned to about `ROOM` samples, (K, n)."""
    thin = max(1, log.rows // ROOM)
    return np.hstack([np.array(b.columns(model.channels))[:, ::thin] for b in batches(log, model.channels)])


def rails_of(readings: np.ndarray, policy: Policy) -> tuple[tuple[float, float], ...]:
    """Return lowest and highest value of each channel (K, n) where it repeats; -inf and inf where not."""
    ends = readings.min(axis=1), readings.max(axis=1)
    low, high = (
        np.where((readings == end[:, None]).sum(axis=1) < policy.rail_repeats, none, end).tolist()
        for end, none in zip(ends, (-np.inf, np.inf), strict=True)
    )
    return tuple(zip(low, high, strict=True))
