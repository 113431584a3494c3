"""How far the gap shrinks on runs that took part in neither the fit nor the choice: nested cross-validation.

Groups of runs are left out in turn. Without each, the greedy search is repeated on the products of the other
runs; where it takes another path, the group is judged with what it finds there. Where it takes the same path,
the exact refit is moved to the minimum of the other runs by one Gauss-Newton step. The holdout runs are a
group that was left out from the beginning. So every run judges, and none took part in what it judges.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.refit import Refitted, inside_bounds
from hallsym.diagnosis.regression import FOLDS
from hallsym.diagnosis.scores import Screen

Squares = Mapping[tuple[int, ...], float]
"""Squared decoded errors of each judging run (or of neighbouring runs of a log of very many)."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Squared decoded errors of the judging runs, `before` and `after`, (runs,) each.

    The shrinkage is judged on the logarithm of the ratio: its standard error is that of a jackknife over
    runs, what happens within a run may be correlated.
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

        A new recording has a scatter of its own, as large as that of the runs that judge. `scale`: the gap
        that other repairs leave, over that without them.
        """
        n = len(self.before)
        if n < self.policy.fewest:
            return None
        half = float(stdtrit(n - 1, 1 - self.policy.false_alarm / 2)) * np.sqrt(2) * self.error
        ends = (self.log_ratio + half, self.log_ratio - half)
        return 1 - scale * float(np.exp(ends[0])), 1 - scale * float(np.exp(ends[1]))

    @property
    def p_value(self) -> float:
        """P-value of no decrease, one-sided, by Student's t."""
        n = len(self.before)
        if n < 2 or self.error <= 0:
            return 1.0
        return float(stdtr(n - 1, self.log_ratio / self.error))


def foreseen(fit: Refitted, groups: Sequence[frozenset[int]]) -> dict[tuple[int, ...], float]:
    """Return the squared decoded errors of each run as the other runs foresee them.

    A fitted run is judged by the fit moved to the minimum without its group; the others as they are.
    """
    t = fit.tangents
    fitted = set(fit.fitted.tolist())
    out = {t.runs[u]: float(fit.output[u]) for u in range(len(t.runs)) if u not in fitted}
    for group in groups:
        tested = [u for u in fit.fitted if not group.isdisjoint(t.runs[u])]
        others = [u for u in fit.fitted if group.isdisjoint(t.runs[u])]
        v = np.append(-inside_bounds(fit.base, t.likelihood[others].sum(axis=0)), 1.0)
        out |= {t.runs[u]: float(v @ fit.decoded[u] @ v) for u in tested}
    return out


class Nested:
    """The greedy search, repeated without each group of runs."""

    def __init__(self, runs: Sequence[int], policy: Policy) -> None:
        """Begin the search of every group; `runs` are fitted."""
        self.runs, self.policy = runs, policy
        self.groups = [frozenset(runs[k::FOLDS]) for k in range(min(FOLDS, len(runs)))]
        self.same = set(range(len(self.groups)))
        self.others: dict[tuple[int, ...], float] = {}

    def step(self, screen: Screen, taken: str) -> None:
        """Repeat one step: `taken` is the effect that all runs together chose.

        A group that others would have chosen differently for is judged with that choice, to first order.
        """
        same = sorted(self.same)
        rests = [[run for run in self.runs if run not in self.groups[k]] for k in same]
        for k, rest, choice in zip(same, rests, screen.choices(rests) if same else (), strict=True):
            if choice.name != taken:
                self.same.discard(k)
                self.others |= screen.foreseen(rest, self.groups[k], choice)

    def after(self, fit: Refitted) -> dict[tuple[int, ...], float]:
        """Return the squares of each judging run with everything that was selected without it."""
        return foreseen(fit, self.groups) | self.others
