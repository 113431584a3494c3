"""95 % intervals: normal or Student's where good enough, else by profile likelihood or resampled runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation import MANY, coverage_factor
from hallsym.estimation.covariance import BY_RUNS
from hallsym.estimation.factors import inverse
from hallsym.estimation.likelihood import Cost
from hallsym.inference.bootstrap import bootstrap
from hallsym.inference.evidence import Evidence
from hallsym.inference.profiles import Profile, profile, skewness
from hallsym.model.quantities import Quantity, combination, linear, parameter
from hallsym.terminal import Step

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

    def to_dict(self) -> dict[str, Any]:
        """Return the record; an end that is not finite is None."""
        low, high = (float(v) if np.isfinite(v) else None for v in (self.low, self.high))
        return {"low": low, "high": high, "how": self.how, "ends": list(self.ends)}


@dataclass(frozen=True, eq=False)
class Intervals:
    """`std` and interval (`of`) by name of parameter or combination; profiles, and what failed, in sentences.

    `dof`: degrees of freedom of `std`, infinite where the noise is as stated. `method`, `reason`: where
    standard uncertainties come from, and why from there.
    """

    std: Mapping[str, float]
    dof: Mapping[str, float]
    of: Mapping[str, Interval]
    method: str
    reason: str
    profiles: tuple[Profile, ...] = ()
    failures: tuple[str, ...] = ()


def intervals_of(evidence: Evidence, *, profiles: str, say: Callable[[str], None]) -> Intervals:
    """Return the intervals of every determined parameter and combination.

    `profiles`: "auto", "all" or "none".
    """
    if profiles not in CHOICES:
        raise InputError(
            f"Input profiles must be one of {', '.join(CHOICES)}; instead received {profiles!r}."
        )
    quantities, std, dof = _quantities(evidence), _std(evidence), _dof(evidence)
    intervals = {
        q.name: _by_std(q.first(evidence.p)[0], std[q.name], dof[q.name]) for q in quantities if q.name in std
    }
    found = Intervals(std, dof, intervals, evidence.uncertainty.method, evidence.uncertainty.reason)
    if evidence.cost.planned or not quantities:
        return found
    cost = evidence.cost.anchored(evidence.p)
    enough = np.count_nonzero(evidence.cost.weights) >= FEW_RUNS
    if enough and evidence.uncertainty.method == BY_RUNS:
        say(f"refitting {REPLICATES} resampled campaigns")
        found = _resampled(found, evidence, cost, quantities)
    if profiles != "none":
        found = _profiled(found, evidence, cost, quantities, profiles == "all", say)
    return found


def profile_record(profile: Profile) -> dict[str, Any]:
    """Return a profile as a record: its curve (values, rises of -2 log likelihood) and how its ends came."""
    return {
        "of": profile.quantity.name,
        "unit": profile.quantity.unit,
        "value": profile.value,
        "threshold": profile.threshold,
        "values": profile.values.tolist(),
        "rises": profile.rises.tolist(),
        "ends": [
            {
                "value": side.value if np.isfinite(side.value) else None,
                "status": side.status,
                "why": side.reason,
            }
            for side in (profile.lower, profile.upper)
        ],
    }


def _quantities(evidence: Evidence) -> list[Quantity]:
    """Determined parameters and those at a bound, then determined combinations."""
    model, told = evidence.model, evidence.uncertainty
    names = [n for k, n in enumerate(model.names) if told.determined[k] or n in told.at_bound]
    known = {c.expression: c for c in model.combinations}
    out = [parameter(model, name) for name in names]
    for c in told.combinations:
        if c.expression in known:
            out.append(combination(model, known[c.expression]))
        elif c.factors is not None:
            gradient = [c.factors.get(name, 0.0) for name in model.names]
            out.append(linear(model, gradient, c.unit, c.expression))
    return out


def _std(evidence: Evidence) -> dict[str, float]:
    names, told = evidence.model.names, evidence.uncertainty
    std = {n: float(told.std[k]) for k, n in enumerate(names) if told.determined[k]}
    return std | {c.expression: c.std for c in told.combinations}


def _dof(evidence: Evidence) -> dict[str, float]:
    told = evidence.uncertainty
    dof = dict(zip(evidence.model.names, told.degrees_of_freedom.tolist(), strict=True))
    return dof | {c.expression: c.degrees_of_freedom for c in told.combinations}


def _by_std(value: float, std: float, dof: float) -> Interval:
    half = float(coverage_factor(dof)) * std
    return Interval(value - half, value + half, "student" if dof < MANY else "normal")


def _profiled(
    found: Intervals,
    evidence: Evidence,
    cost: Cost,
    quantities: list[Quantity],
    every: bool,
    say: Callable[[str], None],
) -> Intervals:
    """Replace normal intervals by profiles where they are wanted; where one fails the normal one is kept."""
    held, naive = evidence.found.held, _likelihood_std(evidence, quantities)
    intervals, profiles, failures = dict(found.of), [], []
    for k, quantity in enumerate(quantities):
        std = found.std.get(quantity.name)
        dof = found.dof.get(quantity.name, np.inf)
        scale = 1.0 if not std or not naive[k] else (std / naive[k]) ** 2
        scale *= float(coverage_factor(dof) / coverage_factor(np.inf)) ** 2
        if not every and std:
            check = skewness(cost, evidence.p, quantity, held=held, std=std, scale=scale)
            if check.normal:
                continue
        say(Step(f"profile likelihoods, {k + 1} of {len(quantities)} ({quantity.name})", k / len(quantities)))
        result = profile(cost, evidence.p, quantity, held=held, std=std, scale=scale, points=POINTS)
        profiles.append(result)
        ends = (result.lower.status, result.upper.status)
        if result.ok or "open" in ends:
            low, high = result.interval
            intervals[quantity.name] = Interval(low, high, "profile", ends)
        for side in (result.lower, result.upper):
            if side.status == "failed":
                failures.append(f"The profile of {quantity.name} failed: {side.reason}.")
        if result.better is not None:
            failures.append(
                f"The profile of {quantity.name} met a better optimum (cost lower by {result.drop:.3g}): "
                "fit again with --solver hybrid."
            )
    failures = [*found.failures, *failures]
    return replace(found, of=intervals, profiles=tuple(profiles), failures=tuple(failures))


def _likelihood_std(evidence: Evidence, quantities: list[Quantity]) -> np.ndarray:
    """Standard uncertainties that the likelihood alone gives, 0 where it gives none."""
    free = np.flatnonzero(np.diag(evidence.uncertainty.covariance) > 0)
    if not len(free):
        return np.zeros(len(quantities))
    naive = inverse(evidence.information[np.ix_(free, free)])
    gradients = np.array([q.first(evidence.p)[1][free] for q in quantities])
    return np.sqrt(np.maximum(np.einsum("qi,ij,qj->q", gradients, naive, gradients), 0.0))


def _resampled(found: Intervals, evidence: Evidence, cost: Cost, quantities: list[Quantity]) -> Intervals:
    """Replace standard uncertainties and intervals by those of resampled runs."""
    names = evidence.model.names
    held = tuple(sorted({*evidence.found.held, *(names.index(n) for n in evidence.uncertainty.at_bound)}))
    drawn = bootstrap(cost, evidence.p, held, replicates=REPLICATES, seed=0)
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
