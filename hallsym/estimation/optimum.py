"""Find the optimum of a likelihood on run statistics: global search, IPOPT, and quick refits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

import solvers
from hallsym.estimation.identifiable import Determination, determine_at, scales
from hallsym.estimation.likelihood import Cost, Point
from hallsym.model import Model

SOLVERS = ("hybrid", "direct", *solvers.EXPLORERS)
"""hybrid is SHTLBO, closed form, IPOPT; direct leaves the global search out; the others replace SHTLBO."""
BUDGET, SIZE, KEEP = 4040, 40, 3
"""Evaluations and class size of the global search; how many of its points are refined."""
WARM: dict[str, Any] = {"mu_init": 1e-9, "bound_push": 1e-9, "bound_frac": 1e-9}
"""IPOPT's barrier for a start that is close already: 4 evaluations instead of 9."""
SCREENED, ELSEWHERE = 100, 2
"""Latin-hypercube points that are looked at, and how many of the best that are apart are refined too."""
ROUNDING = 1e-14
"""Part of the cost below which a promise of Newton's method is rounding: values are then good to 1e-5 of
their standard uncertainty, where the usual 1e-12 leaves 4e-4."""
SAME = 1e-6
"""Relative difference of cost within which two optima are the same."""


@dataclass(frozen=True, eq=False)
class Search:
    """How an optimum was found: solver status, starts that were refined and the share that agree."""

    p: np.ndarray
    cost: float
    status: str
    message: str
    evaluations: int
    starts: int
    share: float


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved fit: the costs of all runs and of the fitted ones, the optimum and what is determined there.

    `determination`: what was known before the search, and so what it held.
    """

    everything: Cost
    fitted: Cost
    determination: Determination
    search: Search

    @property
    def p(self) -> np.ndarray:
        """The optimum, shape (n,)."""
        return self.search.p

    @cached_property
    def point(self) -> Point:
        """The cost of the fitted runs at the optimum."""
        return self.fitted.at(self.p)

    @cached_property
    def everywhere(self) -> Point:
        """The cost of all runs at the optimum."""
        return self.point if self.everything is self.fitted else self.everything.at(self.p)

    @cached_property
    def determined(self) -> Determination:
        """What the fitted runs determine at the optimum, for what was held on the way there."""
        return replace(determine_at(self.point), held=self.determination.held)

    def zeros(self) -> dict[int, np.ndarray]:
        """Zero displacements of every run, held-out ones included."""
        return dict(zip(self.everything.summary.runs, self.everywhere.zeros, strict=True))


def search(
    fitted: Cost,
    merged: Cost,
    first: np.ndarray,
    found: Determination,
    *,
    solver: str,
    seed: int,
) -> Search:
    """Minimise `fitted` from the start `first` and, unless `solver` is "direct", from a global search.

    The global search and its local refinements run on `merged`, where the zeros are projected out and the
    whole population is evaluated at once. Newton's method refines the best of them on the exact cost, which
    from a closed form nearly always converges; where it does not, IPOPT does.
    """
    free = np.array([k for k in range(len(first)) if k not in found.held], dtype=int)
    if len(free) == 0:
        return Search(first, fitted.at(first).value, "converged", "Nothing was left to fit.", 1, 1, 1.0)
    scaled, explored = Scaled(fitted.summary.model, first, free, found.scale[free]), None
    if solver != "direct":
        problem, rng = scaled.problem(merged), np.random.default_rng(seed)
        explored = solvers.hybrid(
            problem,
            seed=rng,
            starts=np.vstack([scaled.to_unit(first), *_elsewhere(problem, rng)]),
            keep=KEEP,
            budget=BUDGET,
            global_solver="shtlbo" if solver == "hybrid" else solver,
            same=SAME,
            size=SIZE,
        )
        first = scaled.from_unit(explored.x)
    exact = scaled.problem(fitted)
    stages = [explored] if explored else []
    stages.append(ended := solvers.newton(exact, scaled.to_unit(first), tolerance=ROUNDING))
    if ended.status != "converged":
        stages.append(local := solvers.ipopt(exact, scaled.to_unit(first), **WARM))
        # IPOPT stops within its tolerance; from there Newton's method needs a step or two to reach rounding
        stages.append(solvers.newton(exact, local.x))
        # IPOPT's own verdict is that of a Newton step; where it found none, the steps after it decide
        ended = local if local.status == "converged" else stages[-1]
    status = "interrupted" if any(s.status == "interrupted" for s in stages) else ended.status
    return Search(
        p=scaled.from_unit(stages[-1].x),
        cost=stages[-1].cost * scaled.samples(fitted),
        status=status,
        message=_message(status, ended, solver),
        evaluations=sum(s.evaluations for s in stages),
        starts=1 if explored is None else len(explored.local),
        share=1.0 if explored is None else float(explored.share),
    )


def _message(status: str, ended: solvers.Result, solver: str) -> str:
    """What the status means, and what to do, in terms of what a user of `fit` can change."""
    elsewhere = "--solver hybrid" if solver == "direct" else "another --seed"
    if status == "interrupted":
        return "stopped by the user; these are the best values so far"
    if status == "budget":
        return (
            "neither Newton's method nor IPOPT reached an optimum; parameters may be able to "
            "replace each other on this log (see 'hallsym sensitivity'), or start elsewhere with {elsewhere}"
        )
    if status == "failed":
        return f"the best point found is no optimum; start elsewhere with {elsewhere} ({ended.message})"
    return ended.message


def _elsewhere(problem: solvers.Problem, rng: np.random.Generator) -> np.ndarray:
    """Points far from every other start: the evidence that the optimum does not depend on the start."""
    return solvers.screened_starts(problem, SCREENED, ELSEWHERE, rng).x


def refit(cost: Cost, p: np.ndarray, held: Sequence[int]) -> np.ndarray:
    """Return the optimum of a re-weighted cost near `p`: Newton's method on the statistics, no global search.

    For bootstrap, cross-validation and diagnosis; parameters with index in `held` stay as in `p`.
    """
    scaled = scaled_around(cost.summary.model, p, held)
    return scaled.from_unit(solvers.newton(scaled.problem(cost), scaled.to_unit(scaled.base)).x)


def scaled_around(model: Model, p: np.ndarray, held: Sequence[int]) -> "Scaled":
    """Return the scaled parameters of `model` with those of index in `held` kept as in `p`."""
    free = np.array([k for k in range(len(p)) if k not in held], dtype=int)
    return Scaled(model, np.asarray(p, dtype=float), free, scales(model)[free])


@dataclass(frozen=True, eq=False)
class Scaled:
    """The free parameters in units of their bound width, the others where they are held.

    `base`: (n,) values of the others. `free`: index of the free ones. `scale`: their widths.
    """

    model: Model
    base: np.ndarray
    free: np.ndarray
    scale: np.ndarray

    def to_unit(self, p: np.ndarray) -> np.ndarray:
        """Return the free ones of `p` (n,) in units of their width."""
        return (p[self.free] - self._origin) / self.scale

    def from_unit(self, x: np.ndarray) -> np.ndarray:
        """Return all parameters for free ones in units of their width, one point or many rows."""
        p = np.tile(self.base, (*np.shape(x)[:-1], 1)) if np.ndim(x) > 1 else self.base.copy()
        p[..., self.free] = self._origin + x * self.scale
        return p

    @property
    def _origin(self) -> np.ndarray:
        lower = self.model.bounds[0][self.free]
        return np.where(np.isfinite(lower), lower, self.base[self.free])

    def samples(self, cost: Cost) -> float:
        """Return how many samples count: costs are per sample in `problem`."""
        return float(cost.weights @ cost.summary.counts)

    def problem(self, cost: Cost) -> solvers.Problem:
        """Cost per sample, whole populations at once where the cost is a merged one."""
        n, free = self.samples(cost), self.free

        def population(x: np.ndarray) -> np.ndarray:
            points = self.from_unit(x)
            if cost.by_population:
                return cost.population(points) / n
            return np.array([cost.at(p).value for p in points]) / n

        def derivatives(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
            f, g, H = cost.at(self.from_unit(x)).derivatives()
            return (
                f / n,
                g[free] * self.scale / n,
                H[np.ix_(free, free)] * np.outer(self.scale, self.scale) / n,
            )

        lower, upper = self.model.bounds
        return solvers.Problem(
            population,
            (lower[free] - self._origin) / self.scale,
            (upper[free] - self._origin) / self.scale,
            derivatives=derivatives,
        )
