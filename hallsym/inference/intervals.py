"""95 % intervals: normal or Student's where good enough, else by profile likelihood."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from hallsym.errors import require
from hallsym.estimation.calibration import MANY, coverage_factor
from hallsym.estimation.factors import inverse
from hallsym.inference.evidence import Evidence
from hallsym.inference.profiles import Profile, normal_enough, profile, skewness
from hallsym.model.model import Quantity, combination, linear, parameter
from hallsym.output import Step

CHOICES = ("auto", "all", "none")
POINTS = 6
"""Further points per side of a profile, for its picture."""


@dataclass(frozen=True)
class Interval:
    """A 95 % interval, in the unit of its quantity.

    `how`: "normal", "student" (t, where degrees of freedom are few) or "profile".
    `ends`: "reached", or for a profile "at bound" (the bounds end it), "open" (the threshold is not reached
    within the bounds) or "failed", one per side.
    """

    low: float
    high: float
    how: str
    ends: tuple[str, str] = ("reached", "reached")


@dataclass(frozen=True, eq=False)
class Intervals:
    """Interval (`of`) by name of parameter or combination; profiles, and what failed, in sentences."""

    of: Mapping[str, Interval]
    profiles: tuple[Profile, ...] = ()
    failures: tuple[str, ...] = ()


def intervals_of(evidence: Evidence, *, profiles: str, say: Callable[[str], None]) -> Intervals:
    """Return the intervals of every determined parameter and combination.

    `profiles`: "auto" where the normal interval is not good enough, "all" or "none". Where a profile fails
    the normal interval is kept.
    """
    require(profiles in CHOICES, "Input profiles", f"one of {', '.join(CHOICES)}", profiles, CHOICES)
    asked, intervals = list(_asked(evidence)), {}
    for quantity, std, dof in asked:
        if std is not None:
            value, half = quantity.first(evidence.p)[0], float(coverage_factor(dof)) * std
            how = "student" if dof < MANY else "normal"
            intervals[quantity.name] = Interval(value - half, value + half, how)
    if evidence.cost.planned or not asked or profiles == "none":
        return Intervals(intervals)
    cost, known = evidence.cost.anchored(evidence.p), evidence.found
    bounds = [evidence.model.names.index(n) for n in evidence.uncertainty.at_bound]
    axes = known.coordinates(bounds)
    basis = axes.basis(len(evidence.p))
    # covariance that the likelihood alone gives
    naive = basis @ inverse(axes.curvature(evidence.information)) @ basis.T
    found, failures = list[Profile](), list[str]()
    for k, (quantity, std, dof) in enumerate(asked):
        slope = quantity.first(evidence.p)[1]
        variance, scale = float(slope @ naive @ slope), 1.0
        if std and variance > 0:
            scale = std**2 / variance
        scale *= float(coverage_factor(dof) / coverage_factor(np.inf)) ** 2
        if std and profiles == "auto":
            ratios = skewness(cost, evidence.p, quantity, found=known, std=std, scale=scale)
            if normal_enough(ratios):
                continue
        say(Step(f"profile likelihoods, {k + 1} of {len(asked)} ({quantity.name})", k / len(asked)))
        result = profile(cost, evidence.p, quantity, found=known, std=std, scale=scale, points=POINTS)
        found.append(result)
        ends = (result.lower.status, result.upper.status)
        if result.ok or "open" in ends:
            intervals[quantity.name] = Interval(*result.interval, "profile", ends)
        for side in (result.lower, result.upper):
            if side.status == "failed":
                failures.append(f"The profile of {quantity.name} failed: {side.reason}.")
        if result.better is not None:
            failures.append(
                f"The profile of {quantity.name} met a better optimum (cost lower by {result.drop:.3g}): "
                "fit again with --solver hybrid."
            )
    return Intervals(intervals, tuple(found), tuple(failures))


Asked = tuple[Quantity, float | None, float]
"""A quantity, its standard uncertainty (None where it is at a bound) and the degrees of freedom of that."""


def _asked(evidence: Evidence) -> Iterator[Asked]:
    """Yield determined parameters and those at a bound, then determined combinations."""
    model, estimated = evidence.model, evidence.uncertainty
    for k, name in enumerate(model.names):
        if estimated.determined[k] or name in estimated.at_bound:
            std = float(estimated.std[k]) if estimated.determined[k] else None
            yield parameter(model, name), std, float(estimated.degrees_of_freedom[k])
    known = {c.expression: c for c in model.combinations}
    for c in estimated.combinations:
        if c.expression in known:
            yield combination(model, known[c.expression]), c.std, c.dof
        elif c.factors is not None:
            gradient = [c.factors.get(name, 0.0) for name in model.names]
            yield linear(model, gradient, c.unit, c.expression), c.std, c.dof
