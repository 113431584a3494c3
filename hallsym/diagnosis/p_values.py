"""P-values, without the import time of scipy.stats.

Block-wise and by signs they hold for noise that is correlated in time, whatever its size in each block."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import bdtrc, chdtrc, chdtri, fdtrc, fdtri, gammainc, stdtr


def statistic_at(p: float, freedom: float) -> float:
    """Return the value that chi-square with `freedom` degrees exceeds with probability `p`."""
    return float(chdtri(freedom, min(max(p, 1e-300), 1.0)))


def beyond(values: np.ndarray, noise: np.ndarray | None = None) -> float:
    """Return the one-sided p-value of the sum of independent `values` being above 0 (Student's t).

    The values are one number per run or block of runs, so that what happens within a run may be correlated.
    `noise`: what of each value the effect itself does not explain, where that is known: a strong effect in
    few runs scatters and is no less certain for it.
    """
    n = len(values)
    if n < 2:
        return 1.0
    rest = values - np.mean(values) if noise is None else noise
    error = float(np.sqrt((rest**2).sum() * n / (n - 1)))
    total = float(np.sum(values))
    if error <= 0.0:
        return 1.0 if total <= 0 else 0.0
    return student(total / error, n - 1)


def exceeds(values: np.ndarray, freedom: int, limit: float, white: np.ndarray) -> float:
    """Return the probability that one of `values` exceeds `limit`, as far as their body says.

    `values`: (n,) squared distances with `freedom` directions; `white`: the same of white noise of variance 1
    that went the same way. Median and upper 5 % (the upper end of its 95 % interval) give the scale and the
    weight of the tails of an F distribution (noise of Student's t), so that noise with heavy tails is
    expected to exceed often.
    """
    ends = 0.5, 0.95 + 1.96 * np.sqrt(0.05 * 0.95 / len(values))
    middle, high = np.quantile(values, np.minimum(ends, 1.0)) / np.quantile(white, [0.5, 0.95])
    if middle <= 0.0:
        return 1.0
    middle, high = middle * statistic_at(0.5, freedom), high * statistic_at(0.05, freedom)

    def heavier(logarithm: float) -> float:
        weight = 10.0**logarithm
        return float(fdtri(freedom, weight, 0.95) / fdtri(freedom, weight, 0.5) - high / middle)

    lightest, heaviest = 4.0, 0.0
    if heavier(lightest) >= 0.0:
        return float(chdtrc(freedom, limit * statistic_at(0.5, freedom) / float(middle)))
    weight = 10.0 ** (brentq(heavier, heaviest, lightest) if heavier(heaviest) > 0.0 else heaviest)
    return float(fdtrc(freedom, weight, limit * float(fdtri(freedom, weight, 0.5)) / float(middle)))


def as_many(count: int, expected: float) -> float:
    """Return the probability of `count` or more rare events where `expected` are (Poisson)."""
    return float(gammainc(count, max(expected, 1e-300))) if count > 0 else 1.0


def as_often(count: int, of: int, each: float) -> float:
    """Return the probability of `count` or more among `of` trials with probability `each` (binomial)."""
    return float(bdtrc(count - 1, of, each)) if count > 0 else 1.0


def student(statistic: float, freedom: int) -> float:
    """Return the one-sided p-value of Student's t."""
    return float(stdtr(freedom, -statistic))


def beyond_one(value: float, others: np.ndarray) -> float:
    """Return the probability that one more of the same kind as `others` exceeds `value` (Student's t)."""
    n = len(others)
    spread = float(np.std(others, ddof=1)) * np.sqrt(1 + 1 / n)
    return student((value - float(others.mean())) / max(spread, 1e-300), n - 1)
