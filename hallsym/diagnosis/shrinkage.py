"""How far the gap shrinks on runs that took part in neither the fit nor the choice: nested cross-validation.

Groups of runs are left out in turn. Without each, every effect stands once more against what else was
refitted for its place, with the others there, and against none: BIC on the other runs chooses. What it
chooses is moved to the minimum of the other runs by one Gauss-Newton step, and judged on the group. The
holdout runs are a group that was left out from the beginning. So every run judges, and none took part in what
it judges.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtri, stdtr, stdtrit

from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.refit import Refitted, inside_bounds
from hallsym.diagnosis.regression import FOLDS
from hallsym.diagnosis.scores import bic

Squares = Mapping[tuple[int, ...], float]
"""Squared decoded errors of each judging run (or of neighbouring runs of a log of very many)."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Squared decoded errors of the judging runs, `before` and `after`, (runs,) each.

    Whole runs are the units: what happens within a run may be correlated.
    """

    before: np.ndarray
    after: np.ndarray
    policy: Policy

    @classmethod
    def of(cls, before: Squares, after: Squares, policy: Policy) -> "Judged":
        """Return two models on the runs that both judge; below `Policy.fewest` there is no interval."""
        runs = [run for run in before if run in after]
        return cls(np.array([before[r] for r in runs]), np.array([after[r] for r in runs]), policy)

    @property
    def log_ratio(self) -> float:
        """Logarithm of the gap after over the gap before."""
        return 0.5 * float(np.log(max(self.after.sum(), 1e-300) / max(self.before.sum(), 1e-300)))

    @property
    def value(self) -> float:
        """The shrinkage, 1 - after / before."""
        return 1 - float(np.exp(self.log_ratio))

    @property
    def error(self) -> float:
        """Standard error of the logarithm, by a jackknife over runs."""
        n = len(self.before)
        without = 0.5 * np.log((self.after.sum() - self.after) / (self.before.sum() - self.before))
        return float(np.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum()))

    def interval(self, scale: float = 1.0) -> tuple[float, float] | None:
        """Return the 95 % interval of the shrinkage on a new recording of as many runs; None of too few.

        A new recording has these runs in another mixture: where each one got better, any mixture does.
        `scale`: the gap that other repairs leave, over that without them.
        """
        n, outside = len(self.before), self.policy.false_alarm
        if n < self.policy.fewest:
            return None
        mixtures = _mixtures(n, outside)
        ratio = np.sqrt((mixtures @ self.after) / np.maximum(mixtures @ self.before, 1e-300))
        low, high = 1 - scale * np.quantile(ratio, [1 - outside / 2, outside / 2])
        return float(low), float(high)

    @property
    def p_value(self) -> float:
        """P-value of no decrease, one-sided, by Student's t."""
        n = len(self.before)
        if n < 2 or self.error <= 0:
            return 1.0
        return float(stdtr(n - 1, self.log_ratio / self.error))


@lru_cache(maxsize=16)
def _mixtures(n: int, outside: float) -> np.ndarray:
    """Return weights (4000, n) of `n` runs in a new recording: a Bayesian bootstrap (Rubin, 1981).

    The ends of a 95 % interval are those of 100 draws on each side. The concentration gives a mean the
    variance of Student's interval for the difference of two recordings.
    """
    wider = float(stdtrit(n - 1, 1 - outside / 2) / ndtri(1 - outside / 2))
    concentration = ((n - 1) / (2 * wider**2) - 1) / n  # below 6 runs none is so wide: nearly one run alone
    return np.random.default_rng(0).dirichlet(np.full(n, max(concentration, 0.01)), 4000)


def groups_of(runs: Sequence[int]) -> list[frozenset[int]]:
    """Return the groups of the fitted runs that are left out in turn."""
    return [frozenset(runs[k::FOLDS]) for k in range(min(FOLDS, len(runs)))]


def foreseen(
    fit: Refitted, groups: Sequence[frozenset[int]], others: Sequence[Refitted] = ()
) -> dict[tuple[int, ...], float]:
    """Return the squared decoded errors of each run as the other runs foresee them.

    A fitted run is judged by the fit moved to the minimum without its group, or by that of the `others` whose
    BIC on the runs without the group is lower by more than a tie; the runs that were not fitted by `fit`.
    """
    t = fit.tangents
    fitted = set(fit.fitted.tolist())
    out = {t.runs[u]: float(fit.output[u]) for u in range(len(t.runs)) if u not in fitted}
    for group in groups:
        moved = [(*_without(one, group), one) for one in (fit, *others)]
        best = min(moved, key=lambda m: m[0])
        _, v, one = moved[0] if moved[0][0] - best[0] < fit.base.policy.as_good else best
        tested = [u for u in one.fitted if not group.isdisjoint(one.tangents.runs[u])]
        out |= {one.tangents.runs[u]: float(v @ one.decoded[u] @ v) for u in tested}
    return out


def _without(fit: Refitted, group: frozenset[int]) -> tuple[float, np.ndarray]:
    """Return BIC and direction (c,) of a fit moved to the minimum of the runs that are not in a group."""
    t = fit.tangents
    rest = [u for u in fit.fitted if group.isdisjoint(t.runs[u])]
    M = t.likelihood[rest].sum(axis=0)
    v = np.append(-inside_bounds(fit.base, M), 1.0)
    readings = float(t.count[rest].sum()) * len(fit.base.model.channels)
    return float(bic(v @ M @ v, readings, len(fit.base.free), readings)), v
