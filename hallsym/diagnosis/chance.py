"""Chi-square probabilities without the import time of scipy.stats."""

from scipy.special import chdtrc, chdtri


def chance(statistic: float, freedom: float) -> float:
    """Return the probability that chi-square with `freedom` degrees exceeds `statistic`."""
    return float(chdtrc(freedom, max(statistic, 0.0)))


def statistic_at(p: float, freedom: float) -> float:
    """Return the value that chi-square with `freedom` degrees exceeds with probability `p`."""
    return float(chdtri(freedom, min(max(p, 1e-300), 1.0)))
