"""P-values of all tests of a log, from sign flips of the runs' scores.

Without an effect the score of a run, the product of its candidate columns with its residual, is as likely
positive as negative, whatever the noise within the run: autocorrelated, heavy-tailed or larger in one run
than in another. So the signs of whole runs (of stretches, where runs are few) are drawn at random, and the
statistic of every variant of every effect is computed for each draw. The p-value of an effect is the share of
draws in which the maximum statistic exceeds its own (Westfall and Young 1993).

The score is the effective one: the model's parameters are projected out of the candidate's columns, so that
the residual may be that of a fit (Hemerik, Goeman and Finos 2020); it is fitted again with each draw. Its
scale is the part of the scores of whole runs that the candidate, fitted to these signs, does not explain: a
real effect leaves little, also one that few runs show. Noise that extends from one stretch to the next
changes score and scatter of a run in the same way, so the statistic has the distribution of independent
stretches (the subcluster wild bootstrap of MacKinnon and Webb 2018).
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.special import bdtrc, chdtri, log_ndtr, ndtri, stdtr

from hallsym.diagnosis.normal_equations import NormalEquations
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residuals import NIL
from hallsym.estimation.factors import pseudo_inverse


def statistic_at(p: float, freedom: float) -> float:
    """Return the value that chi-square with `freedom` degrees exceeds with probability `p`."""
    return float(chdtri(freedom, min(max(p, 1e-300), 1.0)))


def beyond(values: np.ndarray, noise: np.ndarray | None = None) -> float:
    """Return the one-sided p-value of the sum of independent `values` being above 0 (Student's t).

    The values are one number per run or block of runs, so that samples within a run may be correlated.
    `noise`: the part of each value that the effect does not explain, where known: a strong effect in few runs
    scatters and is no less certain.
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


FLIPS = 1999
"""Random signs that are drawn: p-values go down to 0.0005, and one of 0.05 is good to 0.005."""


def stretch(samples: float, runs: int, policy: Policy) -> int | None:
    """Return the samples of a unit for so many samples in so many runs; None where a unit is a run."""
    units = policy.fewest_units
    return None if runs >= units else max(1, int(-(-samples // (runs * -(-units // runs)))))


def clusters(run: np.ndarray, policy: Policy, memories: float = 0.0) -> np.ndarray:
    """Return the cluster of each unit (units,): its run, or an independent part of it.

    `run`: (units,) of each, in order. `memories`: length of a unit in correlation lengths of the residual.
    Where runs are few there are at least as many parts as an estimate of scatter needs.
    """
    _, index, inverse, counts = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
    long = (counts * memories / policy.memories).astype(int)
    parts = np.clip(long, -(-policy.fewest // len(counts)), counts)[inverse]
    within = np.arange(len(run)) - index[inverse]
    return np.unique(inverse * len(run) + within * parts // counts[inverse], return_inverse=True)[1]


def memory(autocorrelation: np.ndarray, policy: Policy) -> float:
    """Return the correlation length of a residual in samples, infinity if it exceeds the lags given.

    `autocorrelation`: at lags 0, 1, ...
    """
    ended = np.flatnonzero(autocorrelation < policy.forgotten)
    return float(ended[0]) if len(ended) else np.inf


@lru_cache(maxsize=4)
def drawn(units: int) -> np.ndarray:
    """Return signs (1 + FLIPS, units), the observed ones first, all 1; the same for all tests of a log."""
    rng, signs = np.random.default_rng(units), np.ones((1 + FLIPS, units), dtype=np.int8)
    for row in signs[1:]:
        row[:] = 2 * rng.integers(0, 2, units) - 1
    return signs


class SignFlips:
    """The score of each unit, and its sum under random signs.

    `kept`: part of the explained squares that is not due to the references' noise, 0 to 1, of each candidate
    whose statistic is known.
    """

    def __init__(
        self,
        t: NormalEquations,
        runs: Sequence[int],
        noise: np.ndarray,
        policy: Policy,
        *,
        memories: float = 0.0,
        joined: bool = False,
    ) -> None:
        """Take the products of some runs, the model's own parameters as fitted to them.

        `noise`: (units, columns) products of columns and residual by the references' noise. `memories`: as in
        `clusters`. `joined`: whether noise continues from run to run, since runs have no offsets.
        """
        self.units, self.kept = t.units(runs), dict[str, float]()
        self.t, self.own = t, t.span[""].stop
        n, M = self.own, t.likelihood[self.units]
        total = M.sum(axis=0)
        self.shared = noise[self.units]
        self.JJ = pseudo_inverse(total[:n, :n])
        self.known = M[:, :n, :n]
        self.b = self.JJ @ (total[:n, -1] - self.shared[:, :n].sum(axis=0))
        self.left = M[:, :n, -1] - self.known @ self.b - self.shared[:, :n]
        run = np.unique([t.runs[u][0] * (not joined) for u in self.units], return_inverse=True)[1]
        cluster = clusters(run, policy, memories)
        self.cluster = np.arange(cluster.max() + 1)[:, None] == cluster
        self.offsets: np.ndarray | None = None
        if t.offsets is not None and len(self.cluster) > run.max() + 1:
            # those of a run are fitted to all of it
            self.offsets = t.offsets[self.units]
            left = self.offsets[:, :, -1] - self.offsets[:, :, :n] @ self.b
            together = run[np.argmax(self.cluster, axis=1)][:, None] == run
            self.offsets_left = together[:, :, None] * left  # (clusters, units, z)

    def statistic(self, key: str) -> np.ndarray | None:
        """Return the statistic (1 + FLIPS,) of a candidate, None where the model absorbs all of it.

        First the observed one, then with random signs: the squared score over the part of the clusters'
        scores that the candidate does not explain. It is transformed by a power to be symmetric, with mean 0
        and variance 1, so that statistics of all effects are comparable.
        """
        found = self._effective(key)
        if found is None:
            return None
        n, (M, at, P, V) = self.own, found
        columns = self._columns(key, at)
        to_own = M[:, at, :n]
        across = to_own - P.T @ self.known  # (units, k, n) left of T'J
        score = (M[:, at, -1] - to_own @ self.b - self.left @ P - self.shared[:, columns]) @ V
        gram = V.T @ (M[:, at[:, None], at] - to_own @ P - P.T @ across.swapaxes(1, 2)) @ V
        # how the rest (clusters, k, units) of each cluster's score follows the signs of all units
        of = np.tensordot(self.cluster, gram, 1) @ score.T
        of += V.T @ np.tensordot(self.cluster, across, 1) @ (self.JJ @ self.left.T)
        if self.offsets is not None:
            to_offsets = (self.offsets[:, :, columns] - self.offsets[:, :, :n] @ P) @ V
            of += np.einsum("gzk,guz->gku", np.tensordot(self.cluster, to_offsets, 1), self.offsets_left)
        rest = (self.cluster[:, None] * score.T - of).reshape(-1, len(score))
        total, shared = M[:, :, -1].sum(axis=0), self.shared.sum(axis=0)
        seen = (total[at] - P.T @ total[:n]) @ V
        noise = (shared[columns] - P.T @ shared[:n]) @ V
        self.kept[key] = float(min(((seen - noise) ** 2).sum() / max((seen**2).sum(), 1e-300), 1.0))
        signs = drawn(len(self.units))
        squares = ((signs @ score) ** 2).sum(axis=1)
        beside = ((signs @ (rest.T @ rest)) * signs).sum(axis=1)
        return standardised(squares / np.maximum(beside, NIL * (score**2).sum()))

    def _columns(self, key: str, at: np.ndarray) -> np.ndarray:
        """Return where columns `at` of a candidate's products lie among those of all candidates."""
        return self.t.span[key].start + at - self.own

    def _effective(self, key: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Return products (units, p, p) of a candidate, which of its columns the model leaves something of,
        what of each is the model's own (n, k), and what makes the rest orthonormal (k, directions)."""
        n, M = self.own, self.t.of(key)[self.units]
        total = M.sum(axis=0)
        P = self.JJ @ total[:n, n:-1]
        G = total[n:-1, n:-1] - P.T @ total[:n, n:-1]
        seen = np.diag(G) > NIL * np.maximum(np.diag(total)[n:-1], 1e-300)
        if not seen.any():
            return None
        G = G[np.ix_(seen, seen)]
        d = np.sqrt(np.diag(G))
        values, V = np.linalg.eigh(G / np.outer(d, d))
        some = values > NIL * values[-1]
        return M, n + np.flatnonzero(seen), P[:, seen], V[:, some] / np.sqrt(values[some]) / d[:, None]


def standardised(q: np.ndarray) -> np.ndarray:
    """Return positive statistics as a power that makes them symmetric, with mean 0 and variance 1.

    The first one, the observed one, takes no part in mean and variance.
    """
    logarithm = np.log(np.maximum(q, 1e-300))
    logarithm -= np.median(logarithm)
    drawn = logarithm[1:] - logarithm[1:].mean()
    # the skewness of exp(a x) is that of x and 3 a times its standard deviation, to first order in a
    power = max(0.0, -float((drawn**3).mean()) / (3 * max(float((drawn**2).mean()), 1e-300) ** 2))
    x = np.exp(power * logarithm) if power else logarithm
    return np.asarray((x - x[1:].mean()) / max(float(x[1:].std()), 1e-300))


def of_products(q: np.ndarray, run: np.ndarray, policy: Policy) -> np.ndarray:
    """Return the statistic (1 + FLIPS,) of products `q` (units, units) of the units' scores, observed first.

    `run`: (units,) where each lies. Products within a cluster, and of neighbours in the same run, are left
    out, so that noise that extends from one to the next does not count. The sum is given as the normal score
    of a gamma distribution with the mean, variance and skewness of its sign flips.
    """
    k, cluster = np.arange(len(q)), clusters(run, policy)
    near = (np.abs(k[:, None] - k) <= 1) & (run[:, None] == run)
    q = np.where(near | (cluster[:, None] == cluster), 0.0, q)
    signs = drawn(len(q))
    return of_sums(((signs @ q) * signs).sum(axis=1), *moments(q), enough=len(q) >= policy.fewest)


def moments(q: np.ndarray) -> tuple[float, float]:
    """Return variance and third moment of a sum of products without diagonal over random signs."""
    return 2 * float((q**2).sum()), 8 * float(np.einsum("ij,ji->", q @ q, q))


def of_sums(sums: np.ndarray, variance: float, third: float, *, enough: bool) -> np.ndarray:
    """Return sums (1 + FLIPS,) of products over signs as normal scores; -inf where there is no evidence.

    `enough`: whether there are enough units to say anything.
    """
    if variance <= 0 or not enough:
        return np.full(len(sums), -np.inf)
    skewness = max(third / variance**1.5, NIL)
    x = np.cbrt(np.maximum(1 + skewness / 2 * sums / np.sqrt(variance), 0.0))  # Wilson and Hilferty 1931
    return np.asarray(6 / skewness * (x - 1) + skewness / 6)


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
    """Return the statistic of a variant whose numbers were found by another search among `tried` values.

    The observed one counts as the largest of so many; with random signs the same numbers are kept, and their
    statistic stands for that of the largest.
    """
    if tried <= 1:
        return z
    out = z.copy()
    out[0] = -float(ndtri(max(-np.expm1(tried * log_ndtr(z[0])), 1e-300)))
    return out


class Joint:
    """Tests that share the same sign flips, corrected for each other."""

    def __init__(self, statistics: Sequence[np.ndarray]) -> None:
        """Take the statistics of all tests, (draws,) each, the observed one first; without any, p is 1."""
        self.top = np.max(statistics, axis=0) if len(statistics) else np.array([np.inf])

    def p_value(self, statistic: float) -> float:
        """Return the share of draws in which the largest statistic of all is as large as one."""
        return float((self.top >= statistic - NIL).mean())
