"""Profiles beside what they are by definition: the least cost with one quantity fixed."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2
from twins import SIGMAS, cost_on, record, true_model, with_noise

from hallsym.estimation.covariance import Uncertainty, uncertainty
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.likelihood import Cost
from hallsym.estimation.optimum import refit
from hallsym.inference.profiles import normal_enough, profile, skewness
from hallsym.model import Model
from hallsym.model.model import Quantity, combination, linear, parameter

MODEL = true_model()
THRESHOLD = float(chi2.ppf(0.95, 1))


def solved(log_seed: int, factor: float = 1.0, model: Model = MODEL, samples: int = 50):
    """Cost, optimum, what is determined and its uncertainties, with `factor` times the noise."""
    sigma = {c: factor * s for c, s in SIGMAS.items()}
    cost = cost_on(with_noise(record(seed=log_seed, samples=samples, sigma=sigma), sigma), model, sigma)
    found = determine(cost, model.nominal)
    p = refit(cost, model.nominal, found.fixed)
    return cost.anchored(p), p, found, uncertainty(cost.at(p), found)


@cache
def paper() -> tuple[Cost, np.ndarray, Determination, Uncertainty]:
    return solved(11)


def bounded(stds: float):
    """The paper's log with an upper bound of eta_B so many standard uncertainties beyond its optimum."""
    _, p, _, e = paper()
    k = MODEL.names.index("eta_B")
    upper = p[k] + stds * e.std[k]
    tight = MODEL.with_parameters({"eta_B": {"nominal": min(p[k], upper) - 1e-3, "upper": upper}})
    return tight, upper, e.std[k], *solved(11, model=tight)


@cache
def noisy() -> tuple[Cost, np.ndarray, Determination, Uncertainty]:
    """60 times the noise, a third of the motion: intervals are lopsided."""
    return solved(12, factor=60.0)


def rise_at(cost: Cost, p: np.ndarray, held, name: str, value: float) -> float:
    """Least F with one parameter fixed, above the optimum: the definition of a profile."""
    k, at = MODEL.names.index(name), p.copy()
    at[k] = value
    for _ in range(2):
        at = refit(cost, at, (*held, k))
    return cost.at(at).value - cost.at(p).value


# -- profiles --------------------------------------------------------------------------------------------


def test_lopsided_ends_rise_by_the_threshold():
    cost, p, found, _ = noisy()
    worst = 0.0
    for name in ("eta_A", "eta_C", "a_B", "b_C"):
        got = profile(cost, p, parameter(MODEL, name), found=found)
        for side in (got.lower, got.upper):
            if side.status == "reached":
                assert rise_at(cost, p, found.fixed, name, side.value) == pytest.approx(THRESHOLD, rel=3e-4)
        low, high = got.value - got.lower.value, got.upper.value - got.value
        worst = max(worst, abs(high - low) / (high + low))
    assert worst > 0.02  # or the case would show nothing


def test_a_nearly_linear_problem_has_normal_intervals():
    """Sides differ by 1e-4 of the width here; expected and observed information by 1e-3."""
    cost, p, found, e = paper()
    for c, said in zip(MODEL.combinations, e.combinations, strict=True):
        got = profile(cost, p, combination(MODEL, c), found=found, std=said.std)
        half = np.sqrt(THRESHOLD) * said.std
        assert got.ok
        assert got.interval == pytest.approx((said.value - half, said.value + half), abs=0.01 * half)


def test_scale_sets_the_threshold():
    cost, p, found, _ = paper()
    eta = parameter(MODEL, "eta_A")
    one, four = (profile(cost, p, eta, found=found, scale=s) for s in (1.0, 4.0))
    assert four.threshold == pytest.approx(4 * one.threshold)
    assert np.subtract(*four.interval) == pytest.approx(2 * np.subtract(*one.interval), rel=1e-3)


def test_a_bound_before_the_threshold_ends_the_profile():
    tight, upper, _, cost, q, found, _ = bounded(1.0)
    got = profile(cost, q, parameter(tight, "eta_B"), found=found)
    assert (got.lower.status, got.upper.status) == ("reached", "at bound")
    assert got.upper.value == upper
    assert got.rises[-1] == pytest.approx(1.0, rel=0.01)  # one standard uncertainty away
    assert "eta_B" in got.upper.reason


def test_a_parameter_at_its_bound_has_one_side():
    """The side that the likelihood has inside: its end rises by the threshold above the bounded optimum."""
    tight, upper, std, cost, q, found, said = bounded(-2.0)
    assert said.at_bound == ("eta_B",)
    got = profile(cost, q, parameter(tight, "eta_B"), found=found)
    assert (got.lower.status, got.upper.status) == ("reached", "at bound")
    assert got.upper.value == upper
    # (d + 2)^2 - 2^2 = 3.84 in standard uncertainties
    assert upper - got.lower.value == pytest.approx((np.sqrt(4 + THRESHOLD) - 2) * std, rel=0.01)
    # with that parameter pinned another one is not bounded, and its profile may leave the bound
    other = profile(cost, q, parameter(tight, "a_A"), found=found)
    assert other.ok


def test_bounds_of_other_parameters_leave_a_profile_open():
    _, p, found, e = paper()
    a, b = (MODEL.names.index(n) for n in ("eta_A", "eta_B"))
    near = {
        MODEL.names[k]: {"nominal": p[k], "lower": p[k] - 0.2 * e.std[k], "upper": p[k] + 0.2 * e.std[k]}
        for k in (a, b)
    }
    boxed = MODEL.with_parameters(near)
    gradient = np.zeros(len(p))
    gradient[[a, b]] = 1.0
    cost = replace(paper()[0], anchor=None)
    summary = replace(cost.summary, features=replace(cost.summary.features, model=boxed))
    cost = replace(cost, summary=summary)
    got = profile(cost, p, linear(boxed, gradient, "1"), found=found)
    assert (got.lower.status, got.upper.status) == ("open", "open")
    assert got.upper.value == pytest.approx(p[a] + p[b] + 0.2 * (e.std[a] + e.std[b]), rel=1e-9)
    assert "bounds of other parameters" in got.upper.reason
    assert not got.ok


def test_a_profile_that_breaks_is_failed_with_a_reason():
    """A quantity that has no value one standard uncertainty to the right."""
    cost, p, found, e = paper()
    k = MODEL.names.index("eta_A")
    symbol = MODEL.symbols.parameters
    broken = Quantity(
        "root", "1", -np.inf, np.inf, symbol, -ca.sqrt(p[k] + e.std[k] - symbol[k]) / e.std[k] ** 0.5
    )
    got = profile(cost, p, broken, found=found)
    assert got.upper.status == "failed"
    assert "stops at" in got.upper.reason
    assert np.isnan(got.upper.value)
    assert not got.ok
    assert got.lower.status == "reached"


def test_a_better_optimum_is_reported():
    cost, p, found, e = paper()
    k = MODEL.names.index("eta_A")
    off = p.copy()
    off[k] += e.std[k]
    got = profile(replace(cost, anchor=None), off, parameter(MODEL, "eta_A"), found=found)
    assert got.better is not None
    assert cost.at(got.better).value == pytest.approx(cost.at(off).value - got.drop, abs=1e-3)
    assert got.drop > 0.5


# -- skewness --------------------------------------------------------------------------------------------


def test_near_a_bound_the_normal_interval_will_not_do():
    tight, _, _, cost, q, found, said = bounded(1.0)
    k = MODEL.names.index("eta_B")
    quick = skewness(cost, q, parameter(tight, "eta_B"), found=found, std=said.std[k])
    assert not np.isfinite(quick[1])
    assert not normal_enough(quick)
    cost, p, found, e = paper()
    assert normal_enough(skewness(cost, p, parameter(MODEL, "eta_B"), found=found, std=e.std[k]))
