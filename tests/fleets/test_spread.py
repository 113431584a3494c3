"""Spread beyond the uncertainty, devices that differ, trends: on numbers that are drawn from the truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym.fleets import spread_of
from hallsym.fleets.spread import interval_of, random_effects

MEAN, TAU = 0.9, 0.02


def drawn(seed: int, devices: int = 500, tau: float = TAU, size: float = 0.02):
    rng = np.random.default_rng(seed)
    std = size * rng.uniform(0.5, 1.5, devices)
    values = MEAN + tau * rng.standard_normal(devices) + std * rng.standard_normal(devices)
    return values, std, [f"dev{k}" for k in range(devices)]


def test_the_spread_is_that_of_the_devices_and_not_of_the_estimates():
    """Over 40 fleets of 500 devices, to 3 sigma; the scatter of the estimates is 44 % larger."""
    found = [spread_of("gain", "1", *drawn(seed)) for seed in range(40)]
    assert np.mean([f.std for f in found]) == pytest.approx(TAU, rel=0.03)
    assert np.mean([f.scatter for f in found]) == pytest.approx(TAU * np.sqrt(1 + 13 / 12), rel=0.03)
    assert np.std([f.mean for f in found]) == pytest.approx(np.mean([f.mean_std for f in found]), rel=0.35)


def test_its_interval_holds_the_truth_as_often_as_it_says():
    """95 % of 200 fleets of 40 devices, within what 200 can tell."""
    held = 0
    for seed in range(200):
        values, std, _ = drawn(seed, devices=40)
        _, tau = random_effects(values, std)
        low, high = interval_of(values, std, tau)
        held += low <= TAU <= high
    assert 0.91 <= held / 200 <= 0.985


def test_no_spread_where_the_estimates_scatter_as_their_uncertainty_says():
    at_zero = sum(spread_of("gain", "1", *drawn(seed, 60, tau=0.0)).std < 0.005 for seed in range(40))
    assert at_zero >= 30


def test_a_good_fleet_has_an_outlying_device_in_one_of_a_hundred():
    found = [bool(spread_of("gain", "1", *drawn(seed, 100)).outlying) for seed in range(300)]
    assert np.mean(found) <= 0.03


def test_broken_devices_are_named_and_leave_the_spread_alone():
    values, std, devices = drawn(3)
    values[[10, 200, 333]] += [0.3, -0.25, 1.0]
    found = spread_of("gain", "1", values, std, devices)
    assert set(found.outlying) == {"dev10", "dev200", "dev333"}
    assert found.outlying["dev200"] < 0 < found.outlying["dev333"]
    assert found.std == pytest.approx(TAU, rel=0.1)
    assert found.devices == 497


def test_a_drift_over_production_is_found_and_chance_is_not():
    values, std, devices = drawn(4)
    order = np.arange(500.0)
    none = spread_of("gain", "1", values, std, devices, columns={"order": order})
    assert not none.trends[0].significant
    drift = spread_of("gain", "1", values + 4e-5 * order, std, devices, columns={"order": order})
    (trend,) = drift.trends
    assert trend.significant
    assert trend.slope == pytest.approx(4e-5, abs=3 * trend.std)


def test_an_angle_that_repeats_is_spread_about_its_own_mean():
    values, std, devices = drawn(5, tau=0.05)
    turned = (values - MEAN + np.pi) % (2 * np.pi)
    found = spread_of("zero", "rad", turned, std, devices, period=2 * np.pi)
    assert found.std == pytest.approx(0.05, rel=0.1)


def test_devices_that_do_not_determine_it_take_no_part():
    values, std, devices = drawn(6, 20)
    std[3:] = np.nan
    assert spread_of("gain", "1", values, std, devices).devices == 3
    std[2:] = np.nan
    assert spread_of("gain", "1", values, std, devices) is None


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 10.0)), min_size=3, max_size=30),
    st.floats(1e-9, 1e9),
)
def test_units_do_not_matter(pairs, factor):
    x, s = np.array(pairs).T
    mean, tau = random_effects(x, s)
    scaled, wide = random_effects(factor * x, factor * s)
    assert np.isfinite([mean, tau]).all()
    assert tau >= 0
    assert scaled == pytest.approx(factor * mean, rel=1e-4, abs=1e-4 * factor * np.abs(x).max())
    assert wide == pytest.approx(factor * tau, rel=1e-2, abs=1e-2 * factor * s.min())
