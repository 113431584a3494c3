"""P-values of everything that is tried, from random signs of the runs' scores.

Without an effect the score of a run, what its candidate columns and its residual have in common, is as likely
positive as negative, whatever the noise within a run is like: correlated, heavy in its tails or louder in one
run than in another. So the signs of whole runs (stretches of runs, where there are few) are drawn at random,
and the statistic of every variant of every effect is computed for each draw. An effect is as significant as
the share of draws in which the largest statistic of all exceeds its own (Westfall and Young 1993).

The score is the effective one: the model's own parameters are taken out of the candidate's columns, so that
the residual may be that of a fit (Hemerik, Goeman and Finos 2020). What is fitted takes some of a score with
random signs along; each is divided by the variance that it leaves (De Santis et al. 2022), and by what the
candidate, fitted to these signs, leaves of the scores: an effect that is there leaves little, and one that
few runs show is no less certain for it.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from scipy.special import gammaincc, ndtr, ndtri, stdtr

from hallsym.diagnosis.products import NormalEquations
from hallsym.diagnosis.regression import NIL
from hallsym.estimation import pseudo_inverse

FLIPS = 1999
"""Random signs that are drawn: p-values go down to 0.0005, and one of 0.05 is good to 0.005."""
FEWEST_UNITS = 24
"""Runs from which on runs are the units; of fewer, stretches are, so that there are about as many."""
SAME = 1e-8
"""Part of the largest eigenvalue below which a direction of an effect repeats another one."""


def stretch(samples: float, runs: int) -> int | None:
    """Return the samples of a unit for so many samples in so many runs; None where a unit is a run."""
    return None if runs >= FEWEST_UNITS else max(1, int(-(-samples // (runs * -(-FEWEST_UNITS // runs)))))


def _of_units(t: NormalEquations, noise: Mapping[tuple[int, int], np.ndarray]) -> np.ndarray:
    """Return what is known by run and stretch for each unit, (units, columns)."""
    out = np.zeros((len(t.runs), max(span.stop for span in t.span.values())))
    parts = Counter[int]()
    for unit, runs in enumerate(t.runs):
        for run in runs:
            out[unit] += noise.get((run, parts[run]), 0.0)
            parts[run] += 1
    return out


@lru_cache(maxsize=4)
def drawn(units: int) -> np.ndarray:
    """Return signs (1 + FLIPS, units), the observed ones first, all 1; the same for all tests of a log."""
    signs = np.random.default_rng(units).choice([-1.0, 1.0], (FLIPS, units))
    return np.vstack([np.ones(units), signs])


class SignFlips:
    """The score of each unit, and its sum under random signs."""

    def __init__(
        self, t: NormalEquations, runs: Sequence[int], noise: Mapping[tuple[int, int], np.ndarray]
    ) -> None:
        """Take the products of some runs, the model's own parameters as fitted to them.

        `noise`: what the candidates' columns have in common with the residual by the references' noise.
        """
        self.units = t.units(runs)
        self.t, self.own = t, t.span[""].stop
        n, M = self.own, t.likelihood[self.units]
        total = M.sum(axis=0)
        self.JJ = pseudo_inverse(total[:n, :n])
        values, vectors = np.linalg.eigh(self.JJ)
        self.root = vectors * np.sqrt(np.maximum(values, 0.0))
        self.known = M[:, :n, :n]
        self.b = self.JJ @ total[:n, -1]
        self.left = M[:, :n, -1] - self.known @ self.b
        self.offsets = None if t.offsets is None else t.offsets[self.units]
        self.shared = _of_units(t, noise)[self.units]
        self.drawn = self.JJ @ self.shared[:, :n].sum(axis=0)
        """How far the references' noise has drawn the parameters."""
        self.run = np.unique([t.runs[u][0] for u in self.units], return_inverse=True)[1]

    @property
    def signs(self) -> np.ndarray:
        """(1 + FLIPS, units) signs; those of the first row are the observed ones, all 1."""
        return drawn(len(self.units))

    def statistic(self, key: str) -> np.ndarray | None:
        """Return the statistic (1 + FLIPS,) of a candidate, None where the model absorbs all of it.

        First the observed one, then with random signs: the squared score over its variance, and over what the
        candidate leaves of the scores. It is given as a power of it that is symmetric, with mean 0 and
        variance 1, so that effects of any size and noise of any level compare.
        """
        n, M = self.own, self.t.of(key)[self.units]
        total = M.sum(axis=0)
        P = self.JJ @ total[:n, n:-1]
        G = total[n:-1, n:-1] - P.T @ total[:n, n:-1]
        seen = np.diag(G) > NIL * np.maximum(np.diag(total)[n:-1], 1e-300)
        if not seen.any():
            return None
        at, P, G = n + np.flatnonzero(seen), P[:, seen], G[np.ix_(seen, seen)]
        columns = self.t.span[key].start + np.flatnonzero(seen)  # of all candidates
        d = np.sqrt(np.diag(G))
        values, V = np.linalg.eigh(G / np.outer(d, d))
        kept = values > SAME * values[-1]
        V = V[:, kept] / np.sqrt(values[kept]) / d[:, None]
        to_own = M[:, at, :n]
        across = to_own - P.T @ self.known  # (units, k, n) left of T'J
        score = M[:, at, -1] - to_own @ self.b - self.left @ P
        score -= self.shared[:, columns] - self.shared[:, :n] @ P - across @ self.drawn
        score = score @ V
        gram = V.T @ (M[:, at[:, None], at] - to_own @ P - P.T @ across.swapaxes(1, 2)) @ V
        C = np.tensordot(np.tensordot(across, V, (1, 0)), self.root, (1, 0)).reshape(len(score), -1)
        if self.offsets is not None:
            C = np.hstack([C, self._of_zeros(columns, P, V)])
        total = self.signs @ score
        variance = 1 - ((self.signs @ C) ** 2).sum(axis=1) / V.shape[1]
        taken = (gram @ score[:, :, None])[:, :, 0]
        square = np.tensordot(gram, gram, ([0, 1], [0, 1]))
        rest = (score**2).sum() - 2 * ((self.signs @ taken) * total).sum(axis=1)
        rest += ((total @ square) * total).sum(axis=1)
        q = (total**2).sum(axis=1) / np.maximum(variance, LEAST) / np.maximum(rest, 1e-12 * (score**2).sum())
        return standardised(q)

    def _of_zeros(self, at: np.ndarray, P: np.ndarray, V: np.ndarray) -> np.ndarray:
        """What each unit has in common with the zeros of its run, which were fitted to the run as a whole."""
        assert self.offsets is not None
        own = (self.offsets[:, :, at] - self.offsets[:, :, : self.own] @ P) @ V  # (units, z, k)
        size = own[0].size
        out = np.zeros((len(own), size * (self.run.max() + 1)))
        for u, run in enumerate(self.run):
            out[u, size * run : size * (run + 1)] = own[u].ravel()
        return out


def standardised(q: np.ndarray) -> np.ndarray:
    """Return positive statistics as a power that makes them symmetric, with mean 0 and variance 1.

    The first one, which is the observed one, has no part in what they are standardised by.
    """
    logarithm = np.log(np.maximum(q, 1e-300))
    logarithm -= np.median(logarithm)
    best, least = logarithm, np.inf
    for power in POWERS:
        x = np.exp(power * logarithm) if power else logarithm
        z = (x - x[1:].mean()) / max(float(x[1:].std()), 1e-300)
        skewness = abs(float((z[1:] ** 3).mean()))
        if skewness < least:
            best, least = z, skewness
    return best


POWERS = (0.5, 1 / 3, 0.2, 0.1, 0.0)
"""Powers of which one makes a statistic symmetric: 1/3 for chi-square, less for one with few units in it."""
LEAST = 0.01
"""Least variance of a score with random signs, over that of the observed one.

What a fit to few units leaves nothing of would be divided by rounding."""


FEWEST_SIGNS = 6
"""Units from which on their signs may say something: of fewer all signs alike are no evidence."""
LEAST_SKEW = 0.05
"""Least skewness of the gamma distribution that stands for the one over the signs; 0 would be Gaussian."""


def of_products(q: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Return the statistic (1 + FLIPS,) of products `q` (units, units) of the units' scores, observed first.

    `run`: (units,) where each lies. Products of a unit with itself and with its neighbours in the same run
    are left out, so that noise that goes on from one to the next does not count. The sum is given as the
    normal score of the gamma distribution with the mean, variance and skewness that the signs give it.
    """
    k = np.arange(len(q))
    near = (np.abs(k[:, None] - k) <= 1) & (run[:, None] == run)
    q = np.where(near, 0.0, q)
    signs = drawn(len(q))
    return of_sums(((signs @ q) * signs).sum(axis=1), *moments(q), len(q))


def moments(q: np.ndarray) -> tuple[float, float]:
    """Return variance and third moment of a sum of products without diagonal over random signs."""
    return 2 * float((q**2).sum()), 8 * float(np.einsum("ij,ji->", q @ q, q))


def of_sums(sums: np.ndarray, variance: float, third: float, units: int) -> np.ndarray:
    """Return sums (1 + FLIPS,) of products over signs as normal scores; -inf where there is no evidence."""
    if variance <= 0 or units < FEWEST_SIGNS:
        return np.full(len(sums), -np.inf)
    shape = 4 / max(third / variance**1.5, LEAST_SKEW) ** 2  # gamma with mean 0, variance 1, this skewness
    x = np.maximum(shape + sums / np.sqrt(variance) * np.sqrt(shape), 0.0)
    return np.asarray(-ndtri(np.clip(gammaincc(shape, x), 1e-300, 1 - 1e-16)))


def of_means(values: np.ndarray) -> np.ndarray:
    """Return the statistic (1 + FLIPS,) of the mean of `values` (units,) being above 0, observed first.

    It is the normal score of Student's t, so that many and few units compare.
    """
    n = len(values)
    if n < 2:
        return np.full(1 + FLIPS, -np.inf)
    z = drawn(n) @ values / max(float(np.sqrt((values**2).sum())), 1e-300)
    t = z * np.sqrt((n - 1) / np.maximum(n - z**2, NIL * n))
    return np.asarray(-ndtri(np.clip(stdtr(n - 1, -t), 1e-300, 1 - 1e-16)))


def least_p(units: int) -> float:
    """Return the least p-value that so many units can give: all signs reversed are the same statistic."""
    return max(1 / (FLIPS + 1), 2.0 ** (1 - units))


def searched(z: np.ndarray, tried: float) -> np.ndarray:
    """Return the statistic of a variant whose numbers were searched among `tried` others than were scored.

    The observed one counts as the largest of so many; with random signs the same numbers are kept, and their
    statistic stands for that of the largest.
    """
    if tried <= 1:
        return z
    out = z.copy()
    out[0] = -float(ndtri(-np.expm1(tried * np.log1p(-ndtr(-z[0]))))) if z[0] < MOST else z[0]
    return out


MOST = 8.0
"""Standard deviations beyond which no search makes chance of a statistic (6e-16)."""


class Joint:
    """Tests whose statistics were drawn with the same signs, corrected for each other."""

    def __init__(self, statistics: Sequence[np.ndarray]) -> None:
        """Take everything that is tried, (draws,) each, the observed one first; of nothing, p is 1."""
        self.top = np.max(statistics, axis=0) if len(statistics) else np.array([np.inf])

    def p_value(self, statistic: float) -> float:
        """Return the share of draws in which the largest statistic of all is as large as one."""
        return float((self.top >= statistic - SAME).mean())


def adjusted(statistics: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the p-value of each row, corrected for all rows, and that of the largest of all.

    `statistics`: (variants, draws), the observed one first.
    """
    if not len(statistics):
        return np.zeros(0), 1.0
    top = statistics.max(axis=0)
    p = (top[None, :] >= statistics[:, :1] - SAME).mean(axis=1)
    return p, float(p.min())
