"""95 % intervals: normal or Student's where good enough, else by profile likelihood or resampled runs."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hallsym.errors import require
from hallsym.estimation.calibration import MANY, coverage_factor
from hallsym.estimation.covariance import BY_RUNS
from hallsym.estimation.factors import inverse
from hallsym.estimation.likelihood import Cost
from hallsym.inference.bootstrap import bootstrap
from hallsym.inference.evidence import Evidence
from hallsym.inference.profiles import Profile, normal_enough, profile, skewness
from hallsym.model.model import Quantity, combination, linear, parameter
from hallsym.output import Step

CHOICES = ("auto", "all", "none")
REPLICATES = 1000
"""Bootstrap refits when white noise does not explain the scatter between runs."""
FEW_RUNS = 20
"""Runs from which on resampled ones show what their scatter does; fewer repeat each other too often."""
POINTS = 6
"""Further points per side of a profile, for its picture."""


@dataclass(frozen=True)
class Interval:
    """A 95 % interval, in the unit of its quantity.

    `how`: "normal", "student" (t, where degrees of freedom are few), "profile" or "block bootstrap".
    `ends`: "reached", or for a profile "at bound" (the bounds end it), "open" (the data never object inside
    the bounds) or "failed", one per side.
    """

    low: float
    high: float
    how: str
    ends: tuple[str, str] = ("reached", "reached")


@dataclass(frozen=True, eq=False)
class Intervals:
    """`std` and interval (`of`) by name of parameter or combination; profiles, and what failed, in sentences.

    `method`, `reason`: where standard uncertainties come from, and why from there.
    """

    std: Mapping[str, float]
    of: Mapping[str, Interval]
    method: str
    reason: str
    profiles: tuple[Profile, ...] = ()
    failures: tuple[str, ...] = ()


def intervals_of(evidence: Evidence, *, profiles: str, say: Callable[[str], None]) -> Intervals:
    """Return the intervals of every determined parameter and combination.

    `profiles`: "auto", "all" or "none".
    """
    require(profiles in CHOICES, "Input profiles", f"one of {', '.join(CHOICES)}", profiles, CHOICES)
    told, asked = evidence.uncertainty, list(_asked(evidence))
    std, intervals = {}, {}
    for quantity, own, dof in asked:
        if own is not None:
            value, half = quantity.first(evidence.p)[0], float(coverage_factor(dof)) * own
            how = "student" if dof < MANY else "normal"
            std[quantity.name] = own
            intervals[quantity.name] = Interval(value - half, value + half, how)
    found = Intervals(std, intervals, told.method, told.reason)
    if evidence.cost.planned or not asked:
        return found
    cost = evidence.cost.anchored(evidence.p)
    if told.method == BY_RUNS and np.count_nonzero(cost.weights) >= FEW_RUNS:
        say(f"refitting {REPLICATES} resampled campaigns")
        found = _resampled(found, evidence, cost, [quantity for quantity, *_ in asked])
    if profiles != "none":
        found = _profiled(found, evidence, cost, asked, profiles == "all", say)
    return found


Asked = tuple[Quantity, float | None, float]
"""A quantity, its standard uncertainty (None where it is at a bound) and the degrees of freedom of that."""


def _asked(evidence: Evidence) -> Iterator[Asked]:
    """Yield determined parameters and those at a bound, then determined combinations."""
    model, told = evidence.model, evidence.uncertainty
    for k, name in enumerate(model.names):
        if told.determined[k] or name in told.at_bound:
            std = float(told.std[k]) if told.determined[k] else None
            yield parameter(model, name), std, float(told.degrees_of_freedom[k])
    known = {c.expression: c for c in model.combinations}
    for c in told.combinations:
        if c.expression in known:
            yield combination(model, known[c.expression]), c.std, c.degrees_of_freedom
        elif c.factors is not None:
            gradient = [c.factors.get(name, 0.0) for name in model.names]
            yield linear(model, gradient, c.unit, c.expression), c.std, c.degrees_of_freedom


def _profiled(
    found: Intervals,
    evidence: Evidence,
    cost: Cost,
    asked: list[Asked],
    every: bool,
    say: Callable[[str], None],
) -> Intervals:
    """Replace normal intervals by profiles where they are wanted; where one fails the normal one is kept."""
    free = np.flatnonzero(np.diag(evidence.uncertainty.covariance) > 0)
    naive = np.zeros((len(evidence.p),) * 2)  # covariance that the likelihood alone gives
    naive[np.ix_(free, free)] = inverse(evidence.information[np.ix_(free, free)])
    held, intervals, profiles, failures = evidence.found.held, dict(found.of), [], [*found.failures]
    for k, (quantity, _, dof) in enumerate(asked):
        std, slope = found.std.get(quantity.name), quantity.first(evidence.p)[1]
        variance, scale = float(slope @ naive @ slope), 1.0
        if std and variance > 0:
            scale = std**2 / variance
        scale *= float(coverage_factor(dof) / coverage_factor(np.inf)) ** 2
        if std and not every:
            ratios = skewness(cost, evidence.p, quantity, held=held, std=std, scale=scale)
            if normal_enough(ratios):
                continue
        say(Step(f"profile likelihoods, {k + 1} of {len(asked)} ({quantity.name})", k / len(asked)))
        result = profile(cost, evidence.p, quantity, held=held, std=std, scale=scale, points=POINTS)
        profiles.append(result)
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
    return replace(found, of=intervals, profiles=tuple(profiles), failures=tuple(failures))


def _resampled(found: Intervals, evidence: Evidence, cost: Cost, quantities: list[Quantity]) -> Intervals:
    """Replace standard uncertainties and intervals by those of resampled runs."""
    names = evidence.model.names
    held = {*evidence.found.held, *(names.index(n) for n in evidence.uncertainty.at_bound)}
    drawn = bootstrap(cost, evidence.p, sorted(held), replicates=REPLICATES, seed=0)
    std, intervals, failures = dict(found.std), dict(found.of), []
    for quantity in (q for q in quantities if q.name in std):
        std[quantity.name] = drawn.std_of(quantity)
        intervals[quantity.name] = Interval(*drawn.interval(quantity), "block bootstrap")
    if drawn.singular:
        failures.append(
            f"{drawn.singular} of {REPLICATES} resampled campaigns do not determine the parameters and "
            "were left out: the intervals are too short; record more runs."
        )
    method = f"block bootstrap, {REPLICATES} refits, runs as blocks"
    return replace(found, std=std, of=intervals, method=method, failures=tuple(failures))
