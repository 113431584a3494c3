"""The largest value of the noise's spectrum: no column collects more of the noise, however slow it is.

Signs of runs have no power where one run, or four, carry an effect. So the squares that a candidate takes off
the residual are held against chi-square as well, times that value. The spectrum is that of an autoregression
of what the best effect leaves, and at one period a run, which so few lags do not know, what is seen there.
What is not in the catalogue stays in it and raises it.
"""

from collections.abc import Iterable

import numpy as np
from scipy.linalg import solve_toeplitz

from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residuals import Base, pieces

ORDER = 20
"""Lags of the autoregression: a resonance, and the beginning of 1/f noise within a run."""
LEAST = 1e-9
"""P-value by chi-square that is not gone below: nobody knows the tails of real noise so far out."""


def spectrum_peak(base: Base, runs: Iterable[int]) -> float:
    """Return the largest value of the spectrum of the whitened residual: 1 for white noise as assumed.

    At least 1, and infinity where heavy tails make it no measure of what a column collects.
    """
    products, count, fourth, slow, rows = np.zeros(ORDER + 1), 0, 0.0, 0.0, 0
    for piece in pieces(base, frozenset(runs)):
        x = np.where(piece.used, piece.residual, 0.0)
        for lag in range(min(ORDER + 1, x.shape[1])):
            products[lag] += float((x[:, lag:] * x[:, : x.shape[1] - lag]).sum())
        once = np.exp(-2j * np.pi * np.arange(x.shape[1]) / x.shape[1])
        slow += float((np.abs(x @ once) ** 2).sum()) / x.shape[1]
        rows += len(x)
        count += x.size
        fourth += float((x**4).sum())
    rho = products / max(count, 1)  # biased, so that it is positive definite
    if not rho[0] > 0 or fourth / count > base.policy.heavy * rho[0] ** 2:
        return np.inf
    phi = solve_toeplitz(rho[:-1] + NIL * rho[0] * (np.arange(ORDER) == 0), rho[1:])
    turn = np.exp(-1j * np.outer(np.linspace(0, np.pi, 512), np.arange(1, ORDER + 1)))
    fast = float(rho[0] - phi @ rho[1:]) / float((np.abs(1 - turn @ phi) ** 2).min())
    return max(1.0, fast, slow / rows)
