"""Steps within runs: a reading that jumps once, as a mount that slips makes it.

A step lies in one run, so random signs of the runs say nothing of it. It is held against the largest step
that each other run seems to have: noise of any memory makes such steps in every run, of much the same size.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtr

from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.residual_table import ResidualTable
from hallsym.log.quality.runs import FEWEST_SAMPLES


@dataclass(frozen=True)
class ChangePoint:
    """The largest step within a run: channel, instant [s since the log began] and size [its unit].

    `p_value`: that noise makes as large a step in any of the runs. `squares`: whitened squares that it takes
    off the residual.
    """

    run: int
    channel: int
    instant_s: float
    size: float
    squares: float
    p_value: float = 1.0


def change_points(*tables: ResidualTable) -> tuple[ChangePoint, ...]:
    """Return the largest step of each run that is long enough, with p-values; none of too few runs.

    `tables`: the residual on fitted and on held-out runs, each of which may step.
    """
    found, levels = [], []
    for r in tables:
        edges = np.flatnonzero(np.diff(r.run, prepend=r.run[0] - 1, append=r.run[-1] + 1))
        for low, high in pairwise(edges.tolist()):
            if r.timed and high - low >= 2 * FEWEST_SAMPLES:
                step, level = _largest(r, slice(low, high))
                found.append(step)
                levels.append(level)
    if len(found) < POLICY.fewest:
        return ()
    each = np.array(levels)
    p = [min(1.0, len(each) * _beyond(v, np.delete(each, k))) for k, v in enumerate(each)]
    return tuple(replace(s, p_value=value) for s, value in zip(found, p, strict=True))


def _beyond(value: float, others: np.ndarray) -> float:
    """Return the probability that one more of the same kind as `others` exceeds `value` (Student's t)."""
    n = len(others)
    error = float(others.std(ddof=1)) * np.sqrt(1 + 1 / n)
    return float(stdtr(n - 1, -(value - float(others.mean())) / max(error, 1e-300)))


def _largest(r: ResidualTable, at: slice) -> tuple[ChangePoint, float]:
    """Return the largest step of a run, and the logarithm of its squares over what it leaves of them."""
    x = r.residual[:, at] - r.residual[:, at].mean(axis=1, keepdims=True)
    n, k = x.shape[1], np.arange(FEWEST_SAMPLES, x.shape[1] - FEWEST_SAMPLES + 1)
    sums = np.cumsum(x, axis=1)[:, k - 1]
    explained = sums**2 * n / (k * (n - k))
    whole = (x**2).sum(axis=1)
    share = explained / np.maximum(whole, 1e-300)[:, None]
    channel, place = np.unravel_index(int(np.argmax(share)), share.shape)
    size = -float(sums[channel, place]) * n / (k[place] * (n - k[place]))
    most = float(share[channel, place])
    instant = float(r.columns["campaign_s"][at][k[place]])
    weight = float(1 / np.linalg.inv(r.precision)[channel, channel])
    step = ChangePoint(
        int(r.run[at.start]), int(channel), instant, size, weight * float(explained[channel, place])
    )
    return step, float(np.log(max(most, 1e-300) / max(1 - most, 1e-12)))
