"""P-values, without the import time of scipy.stats.

Block-wise they hold for noise that is correlated in time, whatever its size in each block."""

import numpy as np
from scipy.special import bdtrc, chdtri, stdtr


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
    return float(stdtr(n - 1, -total / error))


def beyond_one(value: float, others: np.ndarray) -> float:
    """Return the probability that one more of the same kind as `others` exceeds `value` (Student's t)."""
    n = len(others)
    spread = float(np.std(others, ddof=1)) * np.sqrt(1 + 1 / n)
    return float(stdtr(n - 1, (float(others.mean()) - value) / max(spread, 1e-300)))


def as_often(count: int, of: int, each: float) -> float:
    """Return the probability of `count` or more among `of` trials with probability `each` (binomial)."""
    return float(bdtrc(count - 1, of, each)) if count > 0 else 1.0
