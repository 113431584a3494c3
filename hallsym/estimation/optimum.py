"""The optimum of a likelihood: a start by linear least squares, global search, Newton, IPOPT, Gauss-Newton.

A model with run statistics is searched and refined on them. One without is fitted by Gauss-Newton steps, one
pass over the log each.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np

import solvers
from hallsym.estimation.factors import summarise_at
from hallsym.estimation.goodness_of_fit import noise_floor
from hallsym.estimation.identifiable import Coordinates, Determination, determine, scales
from hallsym.estimation.likelihood import Cost, Offsets, Point, cost_near, cost_of, offsets_of
from hallsym.log import UNRELATED, Fault, Log
from hallsym.log.batches import Weigh
from hallsym.model import Model

MOVED = 4.0
"""A column counts as moved when its energy is more than this many times its noise's (rms twice the noise)."""


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Unconstrained coefficients of a merged cost, shape (n_features, n_channels).

    `moved`: which features moved. `unexplained`: (n_channels,) unexplained share of each channel's variance,
    0 for a channel with noise only, in its readings or in what the nominal model expects of this motion.
    """

    coefficients: np.ndarray
    moved: np.ndarray
    unexplained: np.ndarray


def linear_fit(cost: Cost) -> LinearFit:
    """Solve for the coefficients of features that moved; the others keep their nominal value."""
    model = cost.summary.model
    R_f, R_m = (part[0] for part in cost.triangles)
    energy = np.einsum("ij,ij->j", R_f, R_f)
    noise = cost.summary.counts[0] * np.einsum("jj->j", cost.noise_in_features[0])
    moved = energy > MOVED * noise
    nominal = cost.summary.features.first(model.nominal, cost.summary.centre)[0][0]
    size = np.sqrt(np.where(moved, energy, 1.0))
    target = R_m - R_f @ nominal
    change, *_ = np.linalg.lstsq((R_f / size)[:, moved], target, rcond=1e-9)
    coefficients = nominal.copy()
    coefficients[moved] += change / size[moved, None]
    left = target - (R_f / size)[:, moved] @ change
    total = np.einsum("ij,ij->j", R_m, R_m)
    follows = np.einsum("ij,ij->j", followed := R_f @ nominal, followed)
    heard = np.minimum(total, follows) > MOVED * cost.summary.counts[0] * cost.reading_variance
    share = np.einsum("ij,ij->j", left, left) / np.maximum(total, 1e-300)
    return LinearFit(coefficients, moved, np.where(heard, share, 0.0))


def closed_form(cost: Cost, linear: LinearFit) -> np.ndarray:
    """Return the family's closed-form start (nominal values if it has none), shape (n,)."""
    features = cost.summary.features
    if features.model.closed_form is None:
        return features.model.nominal
    # the closed form of a family takes columns from zero, not from the centre of the log
    at_zero = features.shift(-cost.summary.centre) @ linear.coefficients
    named = {features.label(j): at_zero[j] for j in range(features.size)}
    return features.model.closed_form(features.model, named)


FOREIGN = 0.5
"""Unexplained share of a reading's variance above which the reference may be of another recording."""


def unrelated(model: Model, unexplained: np.ndarray, where: str) -> tuple[Fault, ...]:
    """Return the claim that a reference does not belong to the readings, where it explains hardly any."""
    far = [c for c, share in zip(model.channels, unexplained, strict=True) if share > FOREIGN]
    if not far:
        return ()
    explained = 100 * max(1 - float(unexplained[model.channels.index(far[0])]), 0.0)
    return (
        Fault(
            f"{where}: the reference explains only {explained:.0f} % of the variation of {far[0]} "
            "(expected more than 90 %); it does not belong to these readings, or outliers hide that it "
            "does: check file, clock and columns, or fit with --loss auto.",
            UNRELATED, far,
        ),
    )  # fmt: skip


SOLVERS = ("hybrid", "direct", *solvers.EXPLORERS)
"""hybrid is SHTLBO and closed form; direct leaves the global search out; the others replace SHTLBO."""
NEWTON = "newton"
"""As direct, without IPOPT: for trials, whose hypotheses are mostly wrong and may have no optimum."""
BUDGET, SIZE, KEEP = 4040, 40, 3
"""Evaluations and population of the global search; number of its points that are refined."""
WARM: dict[str, Any] = {"mu_init": 1e-9, "bound_push": 1e-9, "bound_frac": 1e-9}
"""IPOPT's barrier for a start that is close already: 4 evaluations instead of 9."""
SCREENED, ELSEWHERE = 100, 2
"""Latin-hypercube points that are evaluated, and how many of the best separated ones are refined too."""
ROUNDING = 1e-14
"""Part of the cost below which the predicted decrease of Newton's method is rounding: values are then good to
1e-5 of their standard uncertainty, with the usual 1e-12 to 4e-4."""


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
    """A solved fit: the costs of all runs and of the fitted ones, the optimum and its identifiability.

    `determination`: before the search, with the parameters that it fixed.
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
    def noise_floor(self) -> dict[str, float]:
        """The error by noise alone, by pose coordinate."""
        return noise_floor(self.point)

    @cached_property
    def everywhere(self) -> Point:
        """The cost of all runs at the optimum."""
        return self.point if self.everything is self.fitted else self.everything.at(self.p)

    @cached_property
    def determined(self) -> Determination:
        """Identifiability from the fitted runs at the optimum, with the parameters that the search fixed."""
        return determine(self.fitted, self.p, self.determination.fixed)

    def offsets(self) -> dict[int, np.ndarray]:
        """Zero displacements of every run, holdout ones included."""
        return offsets_of(self.everything, self.p)


def search(
    fitted: Cost,
    merged: Cost,
    first: np.ndarray,
    found: Determination,
    *,
    solver: str,
    seed: int,
) -> Search:
    """Minimise `fitted` from the start `first` and, unless `solver` is "direct" or `NEWTON`, a global search.

    The global search and its local refinements run on `merged`, where the offsets are projected out and the
    whole population is evaluated at once. Newton's method refines the best of them on the exact cost, which
    from a closed form nearly always converges; where it does not, IPOPT does.
    """
    axes = found.coordinates()
    if len(axes.free) == 0:
        return Search(first, fitted.at(first).value, "converged", "Nothing was left to fit.", 1, 1, 1.0)
    scaled, explored = Scaled(fitted.summary.model, first, axes), None
    if solver not in ("direct", NEWTON):
        problem, rng = scaled.problem(merged), np.random.default_rng(seed)
        # points far from every other start, as evidence that the optimum does not depend on the start
        elsewhere = solvers.screened_starts(problem, SCREENED, ELSEWHERE, rng).x
        explored = solvers.hybrid(
            problem,
            seed=rng,
            starts=np.vstack([scaled.to_unit(first), elsewhere]),
            keep=KEEP,
            budget=BUDGET,
            global_solver="shtlbo" if solver == "hybrid" else solver,
            size=SIZE,
        )
        first = scaled.from_unit(explored.x)
    exact = scaled.problem(fitted)
    endings: list[solvers.Result] = [explored] if explored else []
    endings.append(ended := solvers.newton(exact, scaled.to_unit(first), tolerance=ROUNDING))
    if ended.status != "converged" and solver != NEWTON:
        endings.append(ended := solvers.ipopt(exact, scaled.to_unit(first), **WARM))
    status = "interrupted" if any(s.status == "interrupted" for s in endings) else ended.status
    return Search(
        p=scaled.from_unit(ended.x),
        cost=ended.cost * scaled.samples(fitted),
        status=status,
        message=_message(status, ended, solver),
        evaluations=sum(s.evaluations for s in endings),
        starts=1 if explored is None else len(explored.local),
        share=1.0 if explored is None else float(explored.share),
    )


def searched(
    fitted: Cost, merged: Cost, begin: np.ndarray, *, solver: str = "direct", seed: int = 0
) -> tuple[Determination, Search]:
    """Return the identifiability from `fitted` at the start of a search, and the optimum; `begin`: (n,).

    Undetermined parameters are fixed at their nominal values.
    """
    found, first = begin_at(fitted, begin)
    return found, search(fitted, merged, first, found, solver=solver, seed=seed)


def begin_at(cost: Cost, begin: np.ndarray) -> tuple[Determination, np.ndarray]:
    """Return the identifiability at values (n,), and these within their bounds, the fixed ones nominal."""
    model = cost.summary.model
    first = np.clip(begin, *model.bounds)
    found = determine(cost, first)
    return found, found.begin(model, first)


def _message(status: str, ended: solvers.Result, solver: str) -> str:
    """Meaning of the status, and the remedy in terms of arguments of `fit`."""
    elsewhere = "--solver hybrid" if solver == "direct" else "another --seed"
    if status == "interrupted":
        return "stopped by the user; these are the best values so far"
    if status == "budget":
        return (
            "neither Newton's method nor IPOPT reached an optimum; parameters may be able to "
            f"replace each other on this log (see 'hallsym sensitivity'), or start elsewhere with {elsewhere}"
        )
    if status == "failed":
        return f"the best point found is no optimum; start elsewhere with {elsewhere} ({ended.message})"
    return ended.message


def refit(
    cost: Cost, p: np.ndarray, fixed: Sequence[int], tolerance: float = 1e-12, iterations: int = 200
) -> np.ndarray:
    """Return the optimum of a re-weighted cost near `p`: Newton's method on the statistics, no global search.

    For cross-validation and re-weighted runs; parameters with index in `fixed` stay as in `p`.
    """
    scaled = Scaled(cost.summary.model, np.asarray(p, dtype=float), Coordinates.without(fixed, len(p)))
    problem, begin = scaled.problem(cost), scaled.to_unit(scaled.base)
    found = solvers.newton(problem, begin, tolerance=tolerance, max_iterations=iterations)
    return scaled.from_unit(found.x)


@dataclass(frozen=True, eq=False)
class Scaled:
    """The free parameters in units of their bound width (`scale`), the others where they are fixed.

    `base`: (n,) values of the others, and a point on the gauges of the model. `axes`: which are free.
    """

    model: Model
    base: np.ndarray
    axes: Coordinates

    @property
    def free(self) -> np.ndarray:
        """Index of the free parameters, (m,)."""
        return self.axes.free

    @cached_property
    def scale(self) -> np.ndarray:
        """Widths of their bounds, (m,)."""
        return scales(self.model)[self.free]

    def to_unit(self, p: np.ndarray) -> np.ndarray:
        """Return the free ones of `p` (n,) in units of their width."""
        return (p[self.free] - self._origin) / self.scale

    def from_unit(self, x: np.ndarray) -> np.ndarray:
        """Return all parameters for free ones in units of their width, one point or many rows."""
        p = np.tile(self.base, (*np.shape(x)[:-1], 1)) if np.ndim(x) > 1 else self.base.copy()
        p[..., self.free] = self._origin + x * self.scale
        if len(self.axes.dependent):
            p[..., self.axes.dependent] += (p - self.base)[..., self.free] @ self.axes.follow.T
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
        n, free, axes = self.samples(cost), self.free, self.axes

        def population(x: np.ndarray) -> np.ndarray:
            points = self.from_unit(x)
            if cost.summary.features.n_zero == 0 and len(cost.summary.runs) == max(len(cost.parts), 1):
                return cost.population(points) / n
            return np.array([cost.at(p).value for p in points]) / n

        def derivatives(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
            f, g, H = cost.at(self.from_unit(x)).derivatives()
            return (
                f / n,
                axes.slope(g) * self.scale / n,
                axes.curvature(H) * np.outer(self.scale, self.scale) / n,
            )

        lower, upper = self.model.bounds
        return solvers.Problem(
            population,
            (lower[free] - self._origin) / self.scale,
            (upper[free] - self._origin) / self.scale,
            derivatives=derivatives,
            value=lambda x: cost.at(self.from_unit(x)).value / n,
        )


PASSES, SETTLING = 40, 5
"""Passes over a log, and those before that settle the offsets of runs where the fit begins: a log that the
model describes needs no more, and each pass settles them further."""
DROP = 1e-3
"""Decrease of the cost over the cost per degree of freedom below which there is no further pass: it moves no
parameter by more than 0.03 standard uncertainties."""
REMEDY = (
    "start the effect from other numbers (--effect NAME:number=VALUE; 'hallsym diagnose' finds some) "
    "or leave it out"
)
"""Remedy where passes over the log do not converge."""


@dataclass(frozen=True, eq=False)
class _Pass:
    """The cost of all runs, and of the fitted ones, linearised at `p`.

    `before`: identifiability at the last pass, None in the first.
    """

    everything: Cost
    fitted: Cost
    p: np.ndarray
    before: Determination | None
    solver: str

    @cached_property
    def cost(self) -> float:
        return self.fitted.at(self.p).value

    @cached_property
    def _found(self) -> tuple[Determination, np.ndarray]:
        """Identifiability here, and the start of the search.

        Fixed parameters stay at their values while the rank does not change, else they become nominal.
        """
        found, before, model = determine(self.fitted, self.p), self.before, self.fitted.summary.model
        if before is not None and before.null.shape == found.null.shape:
            return replace(found, fixed=before.fixed, dependent=before.dependent), self.p
        return found, found.begin(model, self.p)

    @property
    def determination(self) -> Determination:
        return self._found[0]

    @cached_property
    def target(self) -> Search:
        """The optimum of the linearised cost inside the bounds."""
        found, begin = self._found
        return search(self.fitted, self.fitted, begin, found, solver=self.solver, seed=0)

    def moved(self, share: float) -> tuple[np.ndarray, Offsets]:
        if share == 1.0:
            return self.target.p, offsets_of(self.everything, self.target.p)
        begin = self._found[1]
        return begin + share * (self.target.p - begin), offsets_of(self.everything, begin)


def optimum(
    log: Log,
    model: Model,
    noise: Mapping[str, float],
    start: np.ndarray,
    holdout: Sequence[int],
    weigh: Weigh | None,
    say: Callable[[str], None],
    solver: str = "direct",
) -> Solution:
    """Minimise the cost of the fitted runs, from `start` (n,), inside the bounds; `solver`: of tangents."""
    number, evaluations, before = count(1), 0, None

    def linearise(at: tuple[np.ndarray, Offsets]) -> _Pass:
        say(f"pass {next(number)} over the log")
        p, offsets = at
        everything = cost_of(summarise_at(log, model, p, offsets, noise, weigh), noise)
        return _Pass(everything, everything.without(holdout), p, before, solver)

    def converged(now: _Pass, gained: float) -> bool:
        nonlocal evaluations, before
        evaluations, before = evaluations + now.target.evaluations, now.determination
        readings = float(now.fitted.summary.counts.sum()) * len(model.channels)
        return now.cost - now.target.cost <= DROP * max(now.cost / readings, 1e-300)

    first = np.clip(np.asarray(start, dtype=float), *model.bounds)
    offsets = offsets_of(cost_near(log, model, first, noise, weigh, SETTLING), first) if model.offsets else {}
    best, outcome = solvers.gauss_newton(linearise, (first, offsets), converged, PASSES)
    found = replace(best.target, evaluations=evaluations)
    if outcome != "converged":
        passes = next(number) - 1
        said = {
            "budget": "the cost still falls",
            "stuck": "no step along the tangent lowers the cost any more",
        }[outcome] + f" after {passes} passes over the log"
        # then the minimum of the tangent is no optimum: return the best point so far
        found = replace(found, p=best.p, cost=best.cost, status="not converged", message=f"{said}; {REMEDY}")
    return Solution(best.everything, best.fitted, best.determination, found)
