"""Spread beyond the uncertainty, devices that differ: on numbers that are drawn from the truth."""

from time import process_time

import numpy as np
import pytest
from scipy.special import ndtr

from hallsym.fleets import spread_of
from hallsym.fleets.result import bounds

MEAN, TAU = 0.9, 0.02


def drawn(seed: int, devices: int = 500, tau: float = TAU, size: float = 0.02):
    """Return estimates of devices, their uncertainties, from half to one and a half `size`, and names."""
    rng = np.random.default_rng(seed)
    std = size * rng.uniform(0.5, 1.5, devices)
    values = MEAN + tau * rng.standard_normal(devices) + std * rng.standard_normal(devices)
    return values, std, [f"dev{k}" for k in range(devices)]


def binomial(count: int, chance: float) -> tuple[float, float]:
    """Return what shares of `count` trials are within 3 sigma of a chance."""
    wide = 3 * np.sqrt(chance * (1 - chance) / count)
    return chance - wide, chance + wide


def test_the_spread_is_that_of_the_devices_and_not_of_the_estimates():
    """Over 40 fleets of 500 devices, to 3 sigma."""
    found = [spread_of("gain", "1", *drawn(seed)) for seed in range(40)]
    # a standard deviation is known to 1 / sqrt(2 n) of the scatter's square over its own: 6.6 % of tau each
    assert np.mean([f.std for f in found]) == pytest.approx(TAU, rel=3 * 0.066 / np.sqrt(40))
    assert np.std([f.std for f in found]) < 0.066 * TAU * (1 + 3 / np.sqrt(80))
    stated = np.mean([f.mean_std for f in found])
    assert np.std([f.mean for f in found], ddof=1) == pytest.approx(stated, rel=3 / np.sqrt(80))


@pytest.mark.parametrize("devices", [3, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, 20, 200))])
@pytest.mark.parametrize("size", [0.1, 1.0])
def test_intervals_and_bounds_hold_what_they_say(devices, size):
    """Of 300 fleets: the interval of tau holds it in 95 %, the bounds 9,999 of 10,000 next devices in 95 %.

    And hardly more where the devices are known well: nothing is wider than it must be.
    """
    held = enough = 0
    for seed in range(300):
        values, std, names = drawn(seed, devices, size=size * TAU)
        found = spread_of("gain", "1", values, std, names)
        held += found.interval[0] <= TAU <= found.interval[1]
        low, high = bounds(found)
        spread = np.hypot(TAU, np.median(std))
        outside = ndtr((low - MEAN) / spread) + ndtr((MEAN - high) / spread)
        enough += outside <= 1e-4
    low, high = binomial(300, 0.95)
    assert low <= held / 300 <= high
    assert binomial(300, 0.95)[0] <= enough / 300
    assert size == 1.0 or enough / 300 <= binomial(300, 0.975)[1]


def test_no_spread_where_the_estimates_scatter_as_their_uncertainty_says():
    """tau is nil in every other fleet, its interval begins at nil in 97.5 %."""
    found = [spread_of("gain", "1", *drawn(seed, 60, tau=0.0)) for seed in range(200)]
    low, high = binomial(200, 0.5)
    assert low <= np.mean([f.std == 0 for f in found]) <= high + 0.1  # below the mean more often than above
    assert np.mean([f.interval[0] == 0 for f in found]) >= binomial(200, 0.975)[0]


@pytest.mark.parametrize("devices", [5, *(pytest.param(n, marks=pytest.mark.slow) for n in (10, 100))])
def test_a_good_fleet_has_an_outlying_device_in_one_of_a_hundred(devices):
    found = [bool(spread_of("gain", "1", *drawn(seed, devices, size=0.002)).outlying) for seed in range(400)]
    assert np.mean(found) <= binomial(400, 0.015)[1]


def test_one_of_few_devices_that_is_far_away_is_found():
    """Among six, of which the five others tell their own spread: 20 sigma are 99.9 % of Student's t."""
    values, std, devices = drawn(1, 6, size=0.002)
    values[2] = MEAN + 30 * TAU
    assert set(spread_of("gain", "1", values, std, devices).outlying) == {"dev2"}


def test_broken_devices_are_named_and_leave_the_spread_alone():
    values, std, devices = drawn(3)
    values[[10, 200, 333]] += [0.3, -0.25, 1.0]
    found = spread_of("gain", "1", values, std, devices)
    assert set(found.outlying) == {"dev10", "dev200", "dev333"}
    assert found.outlying["dev200"] < 0 < found.outlying["dev333"]
    assert found.std == pytest.approx(TAU, rel=0.1)
    assert found.devices == 497


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


def test_fifty_thousand_devices_of_two_kinds_take_a_moment():
    """A fifth of them apart: which belong together is found in a few passes, however many there are."""
    values, std, names = drawn(0, 50_000)
    values[::5] += 8 * TAU
    began = process_time()
    found = spread_of("gain", "1", values, std, names)
    assert process_time() - began < 2.0
    assert found.devices + len(found.outlying) == 50_000
