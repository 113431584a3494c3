"""Facts of a log that effects may use before they are tried: length, columns, rails, hum, steps.

A reading jumps once, as when a mount slips, within a run or between runs. A step within one run
(`change_points`) is compared with the largest apparent step of each other run, since sign flips have no power
there: noise of any autocorrelation makes such steps in every run, of much the same size.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hallsym.diagnosis.p_values import beyond_one, statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residual_table import ROOM, ResidualTable, means, slices, table_of
from hallsym.diagnosis.residuals import NIL, Base
from hallsym.diagnosis.survey import SEGMENT, Survey
from hallsym.families.mechanisms import CUT, MAINS_HZ, MAINS_REACH_HZ
from hallsym.log.batches import batches
from hallsym.log.core import edges_of
from hallsym.log.quality.scan import FEWEST_SAMPLES
from hallsym.model import Facts


@dataclass(frozen=True)
class ChangePoint:
    """The largest step within a run: channel, instant [s since the log began] and size [its unit].

    `p_value`: of a step as large in any of the runs. `squares`: whitened squares that it explains.
    """

    run: int
    channel: int
    instant_s: float
    size: float
    squares: float
    p_value: float = 1.0


def change_points(*tables: ResidualTable) -> tuple[ChangePoint, ...]:
    """Return the largest step of each run that is long enough, with p-values; none of too few runs.

    Offset and sensitivity step together, as those of a probe that moves do; the run has both of its own.
    `tables`: the residual on fitted and on holdout runs, each of which may step.
    """
    found, levels = list[ChangePoint](), list[float]()
    for r in tables:
        at = np.flatnonzero(np.min(_within(r.run), axis=0) >= FEWEST_SAMPLES)
        if not r.base.timed or not len(at):
            continue
        each = [steps(y, x, r.run, at, lasting=False) for y, x in zip(r.residual, r.sensed, strict=True)]
        explained, size, whole = (np.array(part) for part in zip(*each, strict=True))
        share = explained / np.maximum(whole, 1e-300)
        for part in slices(r.run[at]):
            channel, k = np.unravel_index(int(np.argmax(share[:, part])), share[:, part].shape)
            best, k = float(share[channel, part][k]), k + part.start
            where = int(r.run[at[k]]), int(channel), float(r.columns["campaign_s"][at[k]])
            squares = float(explained[channel, k] / r.variance[channel])
            found.append(ChangePoint(*where, float(size[channel, 0, k]), squares))
            levels.append(float(np.log(max(best, 1e-300) / max(1 - best, 1e-12))))
    if not found or len(found) < tables[0].base.policy.fewest:
        return ()
    p = [len(found) * beyond_one(v, np.delete(levels, k)) for k, v in enumerate(levels)]
    return tuple(replace(s, p_value=min(1.0, value)) for s, value in zip(found, p, strict=True))


EDGE = -2.0 * float(np.log(1.0 - np.sqrt(0.95)))
"""Squares less than the best within which 95 % of steps lie: 7.4; of a smooth parameter it would be 3.8.

They are a random walk on either side of a step (Y.-C. Yao, Ann. Stat. 15 (1987) 1321)."""


def instants(
    r: ResidualTable, holdout: Collection[int], inflation: float
) -> tuple[tuple[int, float, float, float], ...]:
    """Return, for each channel, the instant [s since the log began] at which a step explains most.

    With it, the times of the samples between which the step lies (95 %).

    A step of gain and offset is fitted to the residual, beside a gain of the channel and the mean of each
    run. Holdout runs take no part, except that they decide on which side of the step they lie where fitted
    runs leave that open. The step lies within a fitted run if it explains more there than any step between
    runs, by more than the noise that it leaves: `inflation` is the variance of a slow average of that over
    the variance of white noise of the same size.
    """
    within, _ = _within(r.run)
    first, fitted = within == 0, ~np.isin(r.run, list(holdout))
    between, inside = np.flatnonzero(first), np.flatnonzero(fitted & (within % SEGMENT == 0) & ~first)
    least = statistic_at(r.base.policy.certain / (1 + len(inside)), 2)
    out = []
    for k in range(len(r.residual)):

        def gains(at: np.ndarray, counted: np.ndarray = fitted, k: int = k) -> np.ndarray:
            return steps(r.residual[k] * counted, r.sensed[k] * counted, r.run, at, counted=counted)[0]

        on_sides, inner = gains(between), gains(inside)
        most = float(on_sides.max())
        left = float(((r.residual[k] * fitted) ** 2).sum()) - max(most, inner.max(initial=0.0))
        slow = inflation * left / max(fitted.sum(), 1)
        if inner.max(initial=0.0) > most + least * slow:
            best = inside[np.argmax(inner)]
            near = np.arange(max(best - SEGMENT, 0), min(best + SEGMENT, len(r.run)))
            near = near[(r.run[near] == r.run[best]) & ~first[near]]
            best = near[np.argmax(gains(near))]
        else:
            open_ = on_sides >= most - least * slow  # and not only elsewhere in the log
            index = np.cumsum(np.diff(open_, prepend=False))
            equal = between[index == index[np.argmax(on_sides)]]
            best = equal[np.argmax(gains(equal, np.ones_like(fitted)))]
        out.append((k, *_extent(r, k, int(best), EDGE * slow)))
    return tuple(out)


def _extent(r: ResidualTable, k: int, best: int, worse: float) -> tuple[float, float, float]:
    """Return the time [s since the log began] of a step at sample `best` of channel k, and its limits.

    It comes after the first of these and has come at the second: no step from there on explains less by
    `worse` squares.
    """
    ends = edges_of(r.run)
    own = int(np.searchsorted(ends, best, side="right")) - 1
    near = np.arange(max(ends[max(own - 1, 0)], 1), ends[own + 1])
    explained, _, _ = steps(r.residual[k], r.sensed[k], r.run, near)
    poor, at = explained < explained[near == best] - worse, int(best - near[0])
    first = at - int(np.argmax(np.append(poor[: at + 1][::-1], True))) + 1
    last = at + int(np.argmax(np.append(poor[at:], True))) - 1
    time = r.columns["campaign_s"]
    return float(time[best]), float(time[near[first] - 1]), float(time[near[last]])


def _within(run: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how many samples of its run lie before each sample, and how many from it on."""
    sizes = np.diff(edges_of(run))
    before = np.arange(len(run)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return before, np.repeat(sizes, sizes) - before


def steps(
    y: np.ndarray,
    x: np.ndarray,
    run: np.ndarray,
    at: np.ndarray,
    *,
    counted: np.ndarray | float = 1.0,
    lasting: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the squares of `y` that a step at each sample of `at` explains, its coefficients, all squares.

    `y`, `x`: (n,) residual of a channel and its expected reading, both 0 where a sample is not `counted`.
    Offset and sensitivity step; coefficients (2, k) are theirs. A `lasting` step goes on in all runs after
    that of the sample, beside one sensitivity of all of them. Another ends with its run, which has a
    sensitivity of its own, and its offset is that at the mean of `x` there. Runs have offsets of their own.
    """
    sizes = np.diff(edges_of(run))
    index = np.repeat(np.arange(len(sizes)), sizes)
    own = index[at]

    def later(values: np.ndarray) -> np.ndarray:
        """Sum from each sample to the end of its run."""
        ends = np.cumsum(values[::-1])[::-1]
        return (ends - np.append(ends, 0.0)[np.cumsum(sizes)][index])[at]

    def after(values: np.ndarray) -> np.ndarray:
        """Sum over all runs after that of each sample, as far as the step goes."""
        each = np.bincount(index, values)
        return (np.cumsum(each[::-1])[::-1] - each)[own] * lasting

    def whole(values: np.ndarray) -> np.ndarray:
        """Sum over all samples that share a sensitivity."""
        return np.full(len(at), values.sum()) if lasting else np.bincount(index, values)[own]

    def centred(values: np.ndarray) -> np.ndarray:
        return values - counted * (np.bincount(index, values) / sizes)[index]

    # a step's columns less their mean in its run: of its offset they are 0 in the runs after it
    y, about = centred(y), centred(x)
    if not lasting:  # each of size 1, so that sums over all runs round none away
        own_size, level = (np.sqrt(np.bincount(index, v**2) / sizes) for v in (about, x))
        x = about = about / np.where(own_size > NIL * level, own_size, np.inf)[index]
    size, common = np.maximum(whole(about**2), 1e-300), whole(about * y)
    beside = np.array([later(about), later(x * about) + after(about**2)])
    shared = np.array([later(y), later(x * y) + after(about * y)]) - beside * common / size
    ones = np.broadcast_to(counted, len(y)) * 1.0
    mean = np.array([later(ones), later(x)])
    raw = np.array([[mean[0], mean[1]], [mean[1], later(x**2) + after(about**2)]])
    left = raw - mean[:, None] * mean / sizes[own] - beside[:, None] * beside / size
    squares = np.einsum("iit->it", left)
    seen = squares > NIL * np.einsum("iit->it", raw)  # else rounding
    length = np.where(seen, np.sqrt(np.where(seen, squares, 1.0)), np.inf)
    # columns of length 1 have the eigenvalues 1 + r and 1 - r, along their sum and difference
    correlation, (one, two) = left[0, 1] / length[0] / length[1], shared / length
    values, along = np.array([1 + correlation, 1 - correlation]), np.array([one + two, one - two])
    part = np.where(values > NIL * values.max(axis=0), along / np.maximum(2 * values, NIL), 0.0)
    coefficients = np.array([part[0] + part[1], part[0] - part[1]]) / length
    return (along * part).sum(axis=0), coefficients, whole(y**2) - common**2 / size


# -- two levels of offset among the runs ---------------------------------------------------------------------


def switched_runs(r: ResidualTable) -> tuple[int, ...]:
    """Return the runs whose offset forms a level of its own beside the others; none where runs are too few.

    Offsets are the mean whitened residuals of each run, along the direction in which they differ most; the
    split into two levels is the one that explains most of their squares. Every run, fitted or holdout, is
    assigned by its own offset. The first run is always on the other level.
    """
    edges = edges_of(r.run)
    runs, n = r.run[edges[:-1]], np.diff(edges)
    if len(runs) < r.base.policy.fewest:
        return ()
    mean = means(np.linalg.cholesky(r.precision).T @ r.residual, r.run).T
    mean -= n @ mean / n.sum()
    level = np.linalg.svd(np.sqrt(n)[:, None] * mean, full_matrices=False)[0][:, 0] / np.sqrt(n)
    order = np.argsort(level)
    below, left = np.cumsum((n * level)[order])[:-1], np.cumsum(n[order])[:-1]
    split = 1 + int(np.argmax(below**2 * (1 / left + 1 / (n.sum() - left))))
    sides = set(runs[order[:split]].tolist()), set(runs[order[split:]].tolist())
    return tuple(sorted(sides[int(r.run[0]) in sides[0]]))


def _slips(base: Base, r: ResidualTable, found: Survey) -> tuple[tuple[int, float, float, float], ...]:
    """Return the `instants` at which channels may slip; none where no gain of the channels is fitted."""
    s = base.model.symbols
    channel, parameter = ca.jacobian(s.full(s.gain), s.parameters).sparsity().get_triplet()
    fitted = {k for k, j in zip(channel, parameter, strict=True) if j in base.free}
    if not base.model.offsets or len(fitted) < len(base.model.channels):
        return ()
    return instants(r, base.holdout, found.inflation)


def facts_of(base: Base, found: Survey) -> Facts:
    """Return the facts of the log for effects; searched numbers come from the residual of `base`."""
    model, log, warm = base.model, base.log, "temperature_degc"
    r, every = table_of(base, frozenset(log.runs)), max(1, log.rows // ROOM)
    each = (np.array(b.columns(model.channels))[:, ::every] for b in batches(log, model.channels))
    values = np.hstack(list(each))
    several = len(model.channels) > len(model.pose) and not model.offsets
    return Facts(
        duration_s=max(found.duration_s, 1e-6),
        columns=tuple(c for c in log.columns if base.timed or c != "t_s"),
        temperature=float(log.array(warm).mean()) if warm in log.columns else None,
        extremes=np.vstack([np.quantile(values, [1 - share, share], axis=1) for share in CUT]),
        rails=rails_of(values, base.policy),
        lines_hz=found.lines_hz,
        lines_tried=max(1, round(2 * MAINS_REACH_HZ * len(MAINS_HZ) * found.duration_s)),
        instants=_slips(base, r, found) if r else (),
        instants_tried=len(model.layout) * (min(log.rows, ROOM) // SEGMENT + len(log.runs)),
        on_runs=switched_runs(r) if r and several else (),
        on_runs_tried=2 ** (len(log.runs) - 1),
    )


def rails_of(readings: np.ndarray, policy: Policy) -> tuple[tuple[float, float], ...]:
    """Return lowest and highest value of each channel (K, n) where it repeats; -inf and inf where not."""
    ends = readings.min(axis=1), readings.max(axis=1)
    low, high = (
        np.where((readings == end[:, None]).sum(axis=1) < policy.rail_repeats, none, end).tolist()
        for end, none in zip(ends, (-np.inf, np.inf), strict=True)
    )
    return tuple(zip(low, high, strict=True))
