"""The noise estimate is judged by simulation, where the truth is known.

Bounds are those the estimate is meant to keep: 5 % without outliers and 25 % with one sample in ten bad.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from log_samples import stage_arrays

from hallsym.errors import InputError
from hallsym.log import Log, Noise, Sigma, estimate_noise


def ratio(
    seed: int, motion: Any, runs: int = 8, samples: int = 1000, jitter: float = 0.0, **faults: float
) -> float:
    """Estimated over true standard deviation; `motion(t)` is in units of the noise, t in samples."""
    rng = np.random.default_rng(seed)
    n = runs * samples
    t = np.tile(np.arange(samples, dtype=float), runs) + jitter * rng.uniform(-1, 1, n)
    x = motion(t) + rng.normal(size=n)
    bad = rng.random(n) < faults.get("outliers", 0.0)
    x[bad] += faults.get("size", 0.0) * rng.normal(size=bad.sum())
    step = faults.get("step", 0.0)
    x = step * np.round(x / step) if step else x
    keep = rng.random(n) >= faults.get("lost", 0.0)
    run = np.repeat(np.arange(runs), samples)
    log = Log.from_arrays({"run": run[keep], "t_ms": t[keep], "hall_a_um": x[keep] / 1e3})
    return estimate_noise(log, ["hall_a_m"])["hall_a_m"].value * 1e9


def sine(period: float, amplitude: float = 1000.0) -> Any:
    return lambda t: amplitude * np.sin(2 * np.pi * t / period)


def mean_ratio(motion: Any, seeds: int = 8, **options: float) -> float:
    return float(np.mean([ratio(seed, motion, **options) for seed in range(seeds)]))  # type: ignore[arg-type]


MOTIONS = {
    "rest": lambda t: 0.0 * t,
    "slow sine": sine(500),
    "fast sine": sine(40),
    "multi-sine": lambda t: sine(300)(t) + sine(97, 300)(t) + sine(61, 100)(t),
    "drift": lambda t: 20.0 * t + sine(300)(t),
    "ramp and stop": lambda t: 5.0 * np.abs(t - 500),
}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
@pytest.mark.parametrize(
    "faults",
    [
        {},
        {"jitter": 0.3},
        pytest.param({"lost": 0.02}, marks=pytest.mark.slow),
        pytest.param({"runs": 40, "samples": 150}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_unbiased_on_white_noise(motion: Any, faults: dict[str, float]) -> None:
    assert mean_ratio(motion, **faults) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("size", [5.0, 10.0, 30.0, 1000.0])
@pytest.mark.parametrize("period", [500, 60])
def test_outliers_hardly_matter(period: float, size: float) -> None:
    assert 0.95 < mean_ratio(sine(period), outliers=0.1, size=size) < 1.25


@pytest.mark.parametrize("step", [0.2, 1.0, 3.0, 10.0])
def test_adc_step_is_part_of_the_noise(step: float) -> None:
    """White noise plus a step's own step / sqrt(12), whatever hides behind the other."""
    assert mean_ratio(sine(300), step=step) == pytest.approx(np.sqrt(1 + step**2 / 12), rel=0.1)


def test_step_that_hides_the_noise_sets_the_floor() -> None:
    step = 20.0
    assert mean_ratio(sine(800, 100.0), step=step) >= 0.99 * step / np.sqrt(12)


def test_constant_channel_has_none() -> None:
    arrays = stage_arrays()
    arrays["z_m"] = arrays["run"] * 1e-4
    assert estimate_noise(Log.from_arrays(arrays), ["z_m"])["z_m"] == Sigma(0.0, "estimated")


def test_several_channels_without_time() -> None:
    arrays = stage_arrays(samples=2000)
    del arrays["t_s"]
    found = estimate_noise(Log.from_arrays(arrays), ["hall_a_m", "x_ref_m"])
    assert [found[name].value for name in found] == pytest.approx([5e-7, 5e-7], rel=0.05)


def test_too_few_samples_say_so() -> None:
    with pytest.raises(InputError, match=r"Noise of x_ref_m cannot be estimated.*no run has 10 samples"):
        estimate_noise(Log.from_arrays({"x_ref_m": np.arange(6.0)}, name="bench"), ["x_ref_m"])


def test_what_is_given_wins() -> None:
    given = Noise.given({"hall_m": 1.0}, ["hall_a_m", "hall_b_m"])
    both = given.merged(Noise({"hall_a_m": Sigma(2.0, "estimated"), "x_ref_m": Sigma(3.0, "estimated")}))
    assert {name: both[name].value for name in both} == {"hall_a_m": 1.0, "hall_b_m": 1.0, "x_ref_m": 3.0}
    with pytest.raises(InputError, match="channel 'hall_c_m' is not known"):
        both["hall_c_m"]
    assert both.get("hall_c_m") is None


@pytest.mark.parametrize("noise_deg", [0.0, 0.01])
def test_a_reference_that_begins_another_turn_has_no_more_noise_for_it(noise_deg: float) -> None:
    """200 steps of 1.8 deg from 336.6 deg on, which wrap at the 14th."""
    at = (336.6 + 1.8 * np.arange(200) + noise_deg * np.random.default_rng(1).normal(size=200)) % 360
    found = estimate_noise(Log.from_arrays({"angle_ref_deg": at}), ["angle_ref_rad"])["angle_ref_rad"]
    assert np.degrees(found.value) == pytest.approx(noise_deg, rel=0.25, abs=1e-9)
