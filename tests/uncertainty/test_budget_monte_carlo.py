"""Propagation of distributions: examples of JCGM 101 with their printed results, and positions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from test_budget_position import SOMEWHERE, fitted
from twins import with_arrays

from hallsym.errors import InputError
from hallsym.report.results.budget import comparison_table
from hallsym.uncertainty import (
    Budget,
    Settings,
    Source,
    budget_monte_carlo,
    position_budget,
    position_monte_carlo,
)
from hallsym.uncertainty.inputs import independent_inputs
from hallsym.uncertainty.monte_carlo import decoded_at_random, propagate, tolerance


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def rectangular(*widths: float) -> Budget:
    """Sources with the standard uncertainties `widths`."""
    sources = [Source.rectangular(f"{k}", np.sqrt(3) * w, "1") for k, w in enumerate(widths)]
    return Budget("y", "1", tuple(sources))


# -- examples of the Supplement --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("std", "digits", "expected"),
    [(0.35e-3, 2, 0.005e-3), (0.35e-3, 1, 0.05e-3), (2.0, 1, 0.5), (2.0, 2, 0.05), (0.0996, 2, 0.005)],
)
def test_the_tolerance_of_7_9_2(std, digits, expected):
    assert tolerance(std, digits) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("widths", "end", "digits_of_end", "verdict"),
    [(None, 3.92, 2, "confirmed"), ((1, 1, 1, 1), 3.88, 2, "confirmed"),
     ((1, 1, 1, 10), 17.0, 1, "not confirmed")],
    ids=["9.2.2", "9.2.3", "9.2.4"],
)  # fmt: skip
def test_additive_models_of_9_2(widths, end, digits_of_end, verdict):
    """Four inputs, normal and rectangular, Tables 2 to 4: [-3.88, 3.88] confirmed, [-17.0, 17.0] not."""
    normal = Budget("y", "1", tuple(Source(f"{k}", 1.0, "1") for k in range(4)))
    found = budget_monte_carlo(rectangular(*widths) if widths else normal, rng())
    widths = widths or (1, 1, 1, 1)
    assert found.linear.std == pytest.approx(np.linalg.norm(widths))
    half_unit = 0.5 * 10.0**-digits_of_end
    assert np.abs(found.interval) == pytest.approx([end, end], abs=half_unit + 2 * max(found.scatter))
    assert found.verdict == verdict
    assert found.stable


@pytest.mark.parametrize(
    ("x1", "linear", "mean", "std", "shortest"),
    [(0.0, 0.0, 50, 50, (0, 150)), (0.010, 100, 150, 112, (0, 367)), (0.050, 500, 2551, 502, (1590, 3543))],
)
def test_mismatch_of_9_4(x1, linear, mean, std, shortest):
    """dY = X1^2 + X2^2 with u 0.005, Table 6, in 1e-6: where the linear result is 0 it cannot hold."""

    def measure(generator, n):
        a, b = generator.normal(x1, 0.005, n), generator.normal(0.0, 0.005, n)
        return (a**2 + b**2)[None]

    said = Budget("dY", "1", (Source("x", 2 * x1 * 0.005, "1"),), level=0.95, value=x1**2)
    assert said.std == pytest.approx(linear * 1e-6)
    (found,) = propagate(measure, [said], rng(), trials=300_000)
    # exact: a non-central chi2 of 2 degrees of freedom
    exact = stats.ncx2(2, max((x1 / 0.005) ** 2, 1e-12))
    unit = 25e-6
    assert found.mean == pytest.approx(unit * exact.mean(), abs=5 * found.scatter[0])
    assert found.std == pytest.approx(unit * exact.std(), abs=5 * found.scatter[1])
    assert found.interval == pytest.approx(unit * exact.ppf([0.025, 0.975]), abs=5 * max(found.scatter))
    # printed with the scatter of its own 1e6 trials: 1 % of the width of the interval
    wide = 0.01 * (shortest[1] - shortest[0])
    own = 0.5 + 5e6 * np.hypot(found.scatter[:2], found.scatter[:2]).max()  # theirs is no larger than ours
    assert [1e6 * found.mean, 1e6 * found.std] == pytest.approx([mean, std], abs=own)
    assert 1e6 * np.array(found.shortest) == pytest.approx(shortest, abs=wide)
    assert found.verdict == "not confirmed"
    assert found.shortest[1] - found.shortest[0] <= found.interval[1] - found.interval[0]


# -- the procedure ---------------------------------------------------------------------------------------


def test_adaptive_trials_stop_when_stable_and_more_digits_need_more():
    numbers = [budget_monte_carlo(rectangular(1.0, 1.0), rng(), digits=digits).trials for digits in (1, 2)]
    assert numbers[0] < numbers[1]


def test_too_few_trials_leave_it_undecided():
    """u 0.99 with two digits asks for 0.5 %; 10 000 trials know the ends to 5 %."""
    found = budget_monte_carlo(Budget("y", "1", (Source("a", 0.99, "1"),)), rng(), trials=10_000)
    assert found.verdict == "undecided"


def test_the_stated_scatter_is_that_of_repetitions():
    """chi2 of 40 repetitions: a variance ratio outside 0.40 and 2.0 has a probability below 1e-3."""
    budget = rectangular(1.0, 2.0)
    found = [budget_monte_carlo(budget, rng(seed), trials=10_000) for seed in range(40)]
    ends = np.array([[c.mean, c.std, *c.interval] for c in found])
    said = np.mean([np.square(c.scatter) for c in found], axis=0)
    ratio = ends.var(axis=0, ddof=1) / said
    assert np.all((ratio > 0.40) & (ratio < 2.0)), ratio


def test_correlated_normal_sources():
    sources = (
        Source("a", 3.0, "1", sensitivity=-1.0),
        Source("b", 4.0, "1"),
        Source.rectangular("c", 1, "1"),
    )
    correlation = np.array([[1, 0.9, 0], [0.9, 1, 0], [0, 0, 1.0]])
    found = budget_monte_carlo(Budget("y", "1", sources, correlation=correlation), rng(), trials=200_000)
    assert found.std == pytest.approx(np.sqrt(9 + 16 - 2 * 0.9 * 12 + 1 / 3), abs=5 * found.scatter[1])
    shaped = (Source.rectangular("a", 3.0, "1"), *sources[1:])
    with pytest.raises(InputError, match="only where they are normal"):
        budget_monte_carlo(Budget("y", "1", shaped, correlation=correlation), rng())


# -- positions -------------------------------------------------------------------------------------------

FULL = Settings(
    averaged=4,
    adc_step=60e-9,
    zero_averaged=100,
    zero_at={"x_m": 1e-4, "z_m": -1e-4},
    state_std={"z_m": 1e-7, "rx_rad": 1e-6},
    scale_std={"x_m": 5e-6},
)


@pytest.mark.parametrize("effects", [(), ("exact_rotation",)], ids=str)
@pytest.mark.parametrize("settings", [Settings(), FULL], ids=["default", "full"])
def test_the_linear_budget_of_a_position_is_confirmed(effects, settings):
    known = fitted("stage31", *effects)
    found = position_monte_carlo(known, SOMEWHERE, settings, rng=rng(), trials=60_000, digits=1)
    for column, c in found.items():
        assert c.verdict == "confirmed", column
        assert c.mean == pytest.approx(SOMEWHERE[column], abs=5 * c.scatter[0] + 1e-3 * c.std)
        # second-order terms are of the order of u relative to the gain: far below 1 %
        assert c.std == pytest.approx(c.linear.std, rel=0.01)


def test_each_source_alone_has_the_scatter_it_is_given():
    """Every input by itself, through the decoder: 5000 draws know u to 1 %, five times that is allowed."""
    known = with_arrays(fitted(), covariance=1e-12 * fitted().covariance)
    every = position_budget(known, SOMEWHERE, FULL)
    names = [s.name for s in every["x_m"].sources[1:]]
    listed = independent_inputs(known, FULL)
    assert [i.source.name for i in listed] == names
    for k, entry in enumerate(listed):
        alone = pytest.MonkeyPatch()
        with alone.context() as patch:
            patch.setattr(
                "hallsym.uncertainty.monte_carlo.independent_inputs", lambda *_, entry=entry: (entry,)
            )
            drawn = decoded_at_random(known, SOMEWHERE, FULL)(rng(k), 5000)
        for i, budget in enumerate(every.values()):
            stated = abs(budget.sources[1 + k].contribution)
            assert drawn[i].std() == pytest.approx(stated, rel=0.05, abs=1e-5 * budget.std), entry


def test_the_linear_result_fails_near_a_zero_of_the_gain():
    """phi of B is 0.07 +- 0.004 at 4 mm: the reciprocal of the gain is skewed."""
    at = {"x_m": 2e-4, "y_m": 3e-4, "z_m": 4.2e-3}
    found = position_monte_carlo(fitted(), at, Settings(zero_averaged=100), rng=rng(), trials=60_000)
    assert found["y_m"].verdict == "not confirmed"
    assert found["y_m"].std > found["y_m"].linear.std
    assert "not confirmed" in comparison_table([found["y_m"]]).text


def test_a_covariance_from_few_runs_has_longer_tails():
    few = with_arrays(
        fitted(), covariance=1e3 * fitted().covariance,
        degrees_of_freedom=np.full(len(fitted().values), 5.0),
    )  # fmt: skip
    budget = position_budget(few, SOMEWHERE, replace(FULL, level=0.95))["x_m"]
    assert budget.factor > 2.3
    found = position_monte_carlo(few, SOMEWHERE, FULL, rng=rng(), trials=40_000)["x_m"]
    normal = position_monte_carlo(
        with_arrays(few, degrees_of_freedom=fitted().degrees_of_freedom),
        SOMEWHERE,
        FULL,
        rng=rng(),
        trials=40_000,
    )["x_m"]
    assert found.interval[1] - found.interval[0] > 1.15 * (normal.interval[1] - normal.interval[0])
