"""The tests of `watch`: a log's own fit beside the calibration, in what they leave and in each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtri

from hallsym.errors import InputError
from hallsym.estimation import Fit, GoodnessOfFit, noise_at
from hallsym.estimation.calibration import coverage_factor
from hallsym.estimation.covariance import BY_RUNS
from hallsym.estimation.normal_equations import SINGULAR, pseudo_inverse, unit_scale
from hallsym.inference import Estimate, ParameterChange, changes, welch
from hallsym.watching.result import PARAMETER, RESIDUAL, TOGETHER, WatchTest

SMALLEST = np.finfo(float).tiny
"""Least p-value, so that its score is a number."""


@dataclass(frozen=True)
class Colour:
    """What the noise of a log is beside white Gaussian noise; that of its calibration is taken to be alike.

    `inflation`: variance of a mean square over that of white Gaussian noise: samples over independent ones.
    `memory`: variance of a slow average over that of white noise, by which an uncertainty from the likelihood
    is too small; 1 where the noise may be white. `correlation`: of neighbouring samples.
    """

    inflation: float = 1.0
    memory: float = 1.0
    correlation: float = 0.0


def colour_of(found: Fit) -> Colour:
    """Return the colour of the noise that a fit leaves; white where the log is too short to tell."""
    if found.likelihood is None or found.source is None:
        return Colour()
    left = noise_at(found.source, found.likelihood.at(found.values), found.noise.std, found.keep)
    if left is None:
        return Colour()
    error = 2 * np.log(left.interval[1] / left.ratio) / coverage_factor(np.inf)  # relative, of the square
    inflation = 0.5 * error**2 * left.samples * len(found.model.channels)
    return Colour(max(1.0, float(inflation)), 1.0 if left.white else left.memory, left.correlation)


@dataclass(frozen=True, eq=False)
class Compared:
    """The calibration beside a log's own fit: `changes` of what both determine, `tests`, what is left out."""

    changes: tuple[ParameterChange, ...]
    tests: tuple[WatchTest, ...]
    left: dict[str, str]


def compared(known: Fit, after: Fit, colour: Colour, false_alarm: float) -> Compared:
    """Test a log by its fit `after` against the calibration; all tests share one false alarm (Sidak)."""
    factors = tuple(1.0 if f.covariance_method == BY_RUNS else colour.memory for f in (known, after))
    one, two, left = _estimates(known, after, (factors[0], factors[1]))
    single = [name for name in one if name in known.model.names]
    level = 1 - (1 - false_alarm) ** (1 / (len(one) + 1 + (len(single) > 1)))
    changed = changes(one, two, level, (_freedom(known), _freedom(after)))
    tests = [_residual(known, after, colour, level)]
    if len(single) > 1:
        tests += _together(known, after, (factors[0], factors[1]), single, level)
    return Compared(changed, (*tests, *(_parameter(change, level) for change in changed)), left)


def goodness(found: Fit) -> GoodnessOfFit:
    """Return what a fit leaves."""
    if found.goodness is None:
        raise InputError("A fit must say what it leaves; fit the log again.")
    return found.goodness


def _estimates(
    known: Fit, after: Fit, factors: tuple[float, float]
) -> tuple[dict[str, Estimate], dict[str, Estimate], dict[str, str]]:
    """Return what both determine, parameters and combinations, and why other parameters are not compared.

    `factors`: by which the variances of the two are multiplied.
    """
    one, two, left = {}, {}, {}
    more = tuple(np.sqrt(factors).tolist())
    for k, name in enumerate(known.model.names):
        unit = known.model.parameters[k].unit
        if name in known.held and name in after.held and known.model.parameters[k].width == 0:
            continue
        if not known.determined[k]:
            left[name] = "the calibration does not determine it"
        elif name in after.at_bound or name in known.at_bound:
            left[name] = "it is at a bound"
        elif not after.determined[k]:
            left[name] = "this log does not identify it"
        else:
            one[name] = Estimate(float(known.values[k]), more[0] * float(known.std[k]), unit)
            two[name] = Estimate(float(after.values[k]), more[1] * float(after.std[k]), unit)
    both = {c.expression for c in known.combinations} & {c.expression for c in after.combinations}
    for found, out, factor in ((known, one, more[0]), (after, two, more[1])):
        named = {c.expression: Estimate(c.value, factor * c.std, c.unit) for c in found.combinations}
        out.update({name: named[name] for name in named if name in both})
    return one, two, left


def _freedom(found: Fit) -> dict[str, float]:
    own = dict(zip(found.model.names, found.degrees_of_freedom.tolist(), strict=True))
    return own | {c.expression: c.degrees_of_freedom for c in found.combinations}


def _parameter(change: ParameterChange, level: float) -> WatchTest:
    p = 1.0 if change.p_value is None else change.p_value
    return _test(PARAMETER, change.name, p, level, np.sign(change.after - change.before))


def _residual(known: Fit, after: Fit, colour: Colour, level: float) -> WatchTest:
    """Test whether the log leaves more than the calibration left: the ratio of two variances."""
    new, old = goodness(after), known.goodness
    dof = _independent(after, new, colour)
    if old is None:
        p = float(chdtrc(dof, new.cost_per_degree_of_freedom * dof))
    else:
        ratio = new.cost_per_degree_of_freedom / max(old.cost_per_degree_of_freedom, SMALLEST)
        p = float(fdtrc(dof, _independent(known, old, colour), ratio))
    return _test(RESIDUAL, RESIDUAL, p, level, 1.0, one_sided=True)


def _independent(found: Fit, left: GoodnessOfFit, colour: Colour) -> float:
    """Return the degrees of freedom of what a fit leaves: by its runs, or by the colour if those are fewer.

    A few runs cannot show how a mean square scatters.
    """
    fitted = 1 - len(found.log["holdout"]) / max(found.log["runs"], 1)
    readings = fitted * found.log["rows"] * len(found.model.channels)
    return max(1.0, min(left.degrees_of_freedom, readings / colour.inflation))


def _together(
    known: Fit, after: Fit, factors: tuple[float, float], names: Sequence[str], level: float
) -> list[WatchTest]:
    """Test all parameters at once: a change along which they are correlated shows in none alone."""
    at = [known.model.names.index(name) for name in names]
    covariance = (factors[0] * known.covariance + factors[1] * after.covariance)[np.ix_(at, at)]
    moved, scale = (after.values - known.values)[at], unit_scale(covariance)
    distance = float(moved @ pseudo_inverse(covariance) @ moved)
    count = int(np.linalg.matrix_rank(covariance * np.outer(scale, scale), rtol=SINGULAR, hermitian=True))
    dof = min(
        welch((known.std[k], after.std[k]), (known.degrees_of_freedom[k], after.degrees_of_freedom[k]))
        for k in at
    )
    if not np.isfinite(dof):
        p = float(chdtrc(count, distance))
    elif dof > count:
        p = float(fdtrc(count, dof - count + 1, distance * (dof - count + 1) / (dof * count)))
    else:
        return []
    return [_test(TOGETHER, TOGETHER, p, level, 1.0, one_sided=True)]


def _test(kind: str, name: str, p: float, level: float, sign: float, *, one_sided: bool = False) -> WatchTest:
    """Return a test on the scale of a normal distribution."""
    half = 1.0 if one_sided else 0.5
    score = float(-ndtri(max(half * p, SMALLEST))) * float(sign or 1.0)
    return WatchTest(kind, name, p, score, float(-ndtri(half * level)))
