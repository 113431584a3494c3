"""Sobol indices: the design and the indices of scalars by SALib, those of a whole field of errors beside it.

First index S_j = V(E(y | p_j)) / V(y): the share of the variance that goes away when p_j is known. Total
index T_j = E(V(y | all but p_j)) / V(y): the share that stays when all others are known. Estimators: Saltelli
et al., Comput. Phys. Commun. 181 (2010) 259, doi:10.1016/j.cpc.2009.09.018, Table 2 (b) and (f). For a field
y(t), numerators and denominator are averaged over t before the division (Gamboa et al., Electron. J. Stat. 8
(2014) 575, doi:10.1214/14-EJS895): large errors count as such, wherever they are.
"""

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError

COVERAGE = 1.96
RESAMPLES = 200


@dataclass(frozen=True, eq=False)
class Indices:
    """First and total indices of one output, (n,) each, with half widths of their 95 % intervals."""

    first: np.ndarray
    total: np.ndarray
    first_half: np.ndarray
    total_half: np.ndarray

    @property
    def widest(self) -> float:
        """Largest half width of an interval."""
        return float(max(self.first_half.max(initial=0.0), self.total_half.max(initial=0.0)))


def design(n: int, samples: int, seed: int) -> np.ndarray:
    """Return Saltelli's design on the unit cube, shape (samples, n + 2, n): A, A with column j of B, B.

    Scrambled Sobol points (SALib). `samples` must be a power of two, which keeps them balanced.
    """
    problem = {"num_vars": n, "names": [str(j) for j in range(n)], "bounds": [[0.0, 1.0]] * n}
    sampler = _salib("SALib.sample.sobol")
    points = sampler.sample(problem, samples, calc_second_order=False, seed=seed)
    return np.asarray(points).reshape(samples, n + 2, n)


def scalar_indices(y: np.ndarray, seed: int) -> Indices:
    """Return the indices of a scalar output by SALib, `y` (samples, n + 2) as `design` has the rows."""
    n = y.shape[1] - 2
    if _constant(y):
        return _nothing(n)
    problem = {"num_vars": n, "names": [str(j) for j in range(n)], "bounds": [[0.0, 1.0]] * n}
    found = _salib("SALib.analyze.sobol").analyze(
        problem,
        y.ravel(),
        calc_second_order=False,
        num_resamples=RESAMPLES,
        seed=seed + 1,  # SALib takes 0 for "no seed"
    )
    return Indices(*(np.asarray(found[key]) for key in ("S1", "ST", "S1_conf", "ST_conf")))


@dataclass(frozen=True, eq=False)
class Moments:
    """Means over the field for each base sample: numerators (samples, n) and variance (samples,)."""

    first: np.ndarray
    total: np.ndarray
    variance: np.ndarray


def moments(y: np.ndarray, mean: np.ndarray) -> Moments:
    """Return the moments of a field, `y` (samples, n + 2, points), about its mean (points,)."""
    A, AB, B = y[:, 0] - mean, y[:, 1:-1] - mean, y[:, -1] - mean
    points = y.shape[2]
    change = AB - A[:, None]
    return Moments(
        first=np.einsum("st,sjt->sj", B, change) / points,  # 2010, Table 2 (b)
        total=np.einsum("sjt,sjt->sj", change, change) / (2 * points),  # 2010, Table 2 (f)
        variance=(np.einsum("st,st->s", A, A) + np.einsum("st,st->s", B, B)) / (2 * points),
    )


def field_indices(m: Moments, seed: int) -> Indices:
    """Return the indices of a field; intervals by the bootstrap over base samples, as SALib does."""
    samples, n = m.first.shape
    variance = m.variance.mean()
    if not variance > 0:
        return _nothing(n)
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(samples, np.full(samples, 1 / samples), RESAMPLES) / samples
    again = (counts @ m.variance)[:, None]
    halves = [COVERAGE * ((counts @ part) / again).std(axis=0, ddof=1) for part in (m.first, m.total)]
    return Indices(m.first.mean(axis=0) / variance, m.total.mean(axis=0) / variance, *halves)


def _constant(y: np.ndarray) -> bool:
    return float(np.ptp(y)) <= 1e-12 * float(np.abs(y).max(initial=0.0))


def _nothing(n: int) -> Indices:
    return Indices(*(np.zeros(n) for _ in range(4)))


def _salib(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            "Sobol indices need SALib, which is not installed; run: pip install 'hallsym[sobol]'."
        ) from error
