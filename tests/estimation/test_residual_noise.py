"""Noise that a model leaves: its size whatever its colour, whether it is white, and no gap taken for it."""

from dataclasses import replace

import numpy as np
import pytest
from gap_twins import SIGMA, Motion, machine
from scipy.signal import lfilter

import hallsym
from hallsym.estimation.goodness_of_fit import (
    Residual,
    ResidualNoise,
    _is_known,
    autoregressive,
    noise_at,
    residual_noise,
)
from hallsym.families import build
from hallsym.families.mechanisms import stop_operators
from hallsym.log import Noise

CHANNELS = ("a", "b", "c")


def coloured(rng: np.random.Generator, n: int, samples: float) -> np.ndarray:
    """Noise of unit variance in three channels, correlated over so many samples."""
    rho = np.exp(-1 / samples) if samples else 0.0
    driven = np.sqrt(1 - rho**2) * rng.standard_normal((3, n + 300))
    return lfilter([1.0], [1.0, -rho], driven, axis=1)[:, 300:]


def found(
    noise: np.ndarray, runs: int = 20, functions: int = 40, gap: float = 0.0, stated: float = 1.0
) -> ResidualNoise:
    """The noise of a residual that also holds `gap` times the first of some slow functions of the motion."""
    n = noise.shape[1]
    run, t = np.arange(n) * runs // n, np.arange(n) / n
    columns = np.array([np.cos(np.pi * (k + 1) * t + k) for k in range(functions)])
    used = np.ones(n, bool)
    values = noise + gap * columns[0]
    made = residual_noise(Residual(values, stated**2 * np.eye(3), run, columns, used, offsets=True), CHANNELS)
    assert made is not None
    return made


@pytest.mark.parametrize("samples", [0, 3, 10])
def test_size_and_colour_are_those_of_the_noise(samples: float) -> None:
    """Offsets of 20 runs and 40 functions take a tenth of the slowest noise along: it is given back."""
    rng = np.random.default_rng(0)
    every = [found(coloured(rng, 4000, samples)) for _ in range(12)]
    ratio = np.array([r.ratio for r in every])
    assert ratio.mean() == pytest.approx(1.0, abs=0.015)
    assert (
        sum(r.interval[0] <= 1.0 <= r.interval[1] for r in every) >= 9
    )  # 11.4 expected; 9 or more in 99.7 %
    rho = np.exp(-1 / samples) if samples else 0.0
    assert np.mean([r.correlation for r in every]) == pytest.approx(rho, abs=0.01)
    assert np.mean([r.memory for r in every]) == pytest.approx((1 + rho) / (1 - rho), rel=0.2)


def test_a_residual_is_the_noise_as_estimated_where_nothing_else_can_be_in_it() -> None:
    """Noise read too large and a gap that makes up for it, or noise that is correlated, are looked into."""
    rng, n, gap = np.random.default_rng(4), 8000, 0.5
    smooth = np.sqrt(2) * np.sin(np.arange(n) / 50)
    white, run = coloured(rng, n, 0), np.arange(n) * 20 // n

    def known(values: np.ndarray) -> bool:
        read = {"run": run}, values, np.ones(n, bool)
        return _is_known(read, build("stage31"), np.eye(3))

    assert known(white)
    assert not known(1.05 * white)
    assert not known(np.sqrt(1 - gap**2) * white + gap * smooth)
    assert not known(coloured(rng, n, 0.4))


def test_a_gap_is_no_noise() -> None:
    assert found(coloured(np.random.default_rng(1), 4000, 0), gap=5.0).ratio == pytest.approx(1.0, abs=0.03)


def test_a_line_is_bounded_and_noise_of_a_narrow_band_is_not() -> None:
    """Both repeat with a period of nine samples; the standard error of a kurtosis takes this into account."""
    rng, n = np.random.default_rng(5), 5000
    line = 8 * np.sin(0.7 * np.arange(n) + np.array([[0.0], [1.0], [2.0]]))
    assert found(line + rng.standard_normal((3, n))).bounded
    narrow = lfilter([1.0], [1.0, -2 * 0.97 * np.cos(0.7), 0.97**2], rng.standard_normal((3, n)), axis=1)
    assert not found(narrow).bounded


def test_noise_is_told_against_what_was_stated_channel_by_channel() -> None:
    noise = coloured(np.random.default_rng(2), 4000, 0) * np.array([[1.0], [1.0], [2.0]])
    r = found(noise, stated=0.5)
    assert list(r.by_sensor) == list(CHANNELS)
    assert list(r.by_sensor.values()) == pytest.approx([2.0, 2.0, 4.0], rel=0.05)
    assert r.ratio == pytest.approx(2 * np.sqrt((1 + 1 + 4) / 3), rel=0.03)
    assert r.larger_in == CHANNELS
    assert found(noise, stated=1.0).larger_in == ("c",)


@pytest.mark.slow
def test_whiteness_has_the_rate_that_it_says() -> None:
    rng = np.random.default_rng(3)
    p = np.array([found(rng.standard_normal((3, 600)), functions=30).whiteness_p for _ in range(80)])
    assert (p < 0.05).sum() <= 10  # 4 expected; more than 10 in 0.3 %
    assert 0.35 < p.mean() < 0.65


def test_heavy_tails_are_white_and_correlated_noise_is_not() -> None:
    rng = np.random.default_rng(4)
    assert found(rng.standard_t(3, (3, 4000)) / np.sqrt(3)).white
    assert not found(coloured(rng, 4000, 0.4)).white  # neighbours are correlated by 0.08


def test_spikes_hide_no_correlation() -> None:
    rng = np.random.default_rng(5)
    noise = coloured(rng, 4000, 5)
    spiky = noise + 50 * (rng.random(noise.shape) < 2e-3)
    assert found(spiky).correlation == pytest.approx(found(noise).correlation, abs=0.05)


def test_simulated_noise_is_as_the_model_says() -> None:
    phi = np.array([0.5, 0.2, 0.1])
    made = autoregressive(phi, np.random.default_rng(6).standard_normal((4, 20_000)))[:, 500:]
    assert made.var() == pytest.approx(1.0, abs=0.05)
    past = np.array([made[:, 3 - k : made.shape[1] - k] for k in (1, 2, 3)]).reshape(3, -1)
    assert np.linalg.lstsq(past.T, made[:, 3:].ravel(), rcond=None)[0] == pytest.approx(phi, abs=0.02)


# -- on logs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("campaign", ["grid", "multisine"])
def test_an_estimated_floor_is_right_where_noise_is_correlated(campaign: str) -> None:
    """Differences of neighbouring samples say 0.6 of it (a correlation of .51) and less of slower noise."""
    log = machine(campaign, seed=3, pink=0.0, curvature=0.0, noise="correlated")
    known = hallsym.fit(log, "stage31", solver="direct", accept=["all"])
    guessed = hallsym.fit(replace(log, noise=Noise({})), "stage31", solver="direct", accept=["all"])
    assert guessed.noise_floor == pytest.approx(known.noise_floor, rel=0.05)
    assert guessed.noise["hall_a_m"].source == "estimated"
    assert guessed.goodness.residual_over_noise == pytest.approx(1.0, abs=0.05)
    assert not guessed.goodness.material


@pytest.mark.slow
def test_a_gap_does_not_raise_an_estimated_floor() -> None:
    def cubic(m: Motion, _: np.random.Generator) -> None:
        m.reading = m.reading * (1 + 2e5 * m.reading**2)

    log = machine("multisine", (cubic,), seed=3, pink=0.0, curvature=0.0)
    known = hallsym.fit(log, "stage31", solver="direct", accept=["all"])
    guessed = hallsym.fit(replace(log, noise=Noise({})), "stage31", solver="direct", accept=["all"])
    assert known.goodness.cost_per_degree_of_freedom > 1.4**2
    assert guessed.noise_floor == pytest.approx(known.noise_floor, rel=0.05)


def test_stated_noise_stays_as_stated() -> None:
    log = machine("multisine", seed=3, pink=0.0, curvature=0.0)
    quieter = {c: replace(s, value=s.value / 2) for c, s in log.noise.sigmas.items()}
    fit = hallsym.fit(replace(log, noise=Noise(quieter)), "stage31", solver="direct", accept=["all"])
    assert fit.noise["hall_a_m"].value == SIGMA["hall_a_m"] / 2
    assert fit.likelihood is not None
    left = noise_at(log, fit.likelihood.at(fit.values), fit.noise.std)
    assert left is not None
    assert left.ratio == pytest.approx(2.0, rel=0.03)
    assert left.white


@pytest.mark.parametrize("lengths", [(3, 40, 1, 17), (900,)])
def test_plays_side_by_side_are_plays_one_by_one(lengths):
    rng, widths = np.random.default_rng(5), [0.3, 2.0]
    u = np.cumsum(rng.standard_normal((2, sum(lengths))), axis=1)
    edges = np.cumsum([0, *lengths]).tolist()
    found = stop_operators(u, edges, widths)
    for x, row in zip(u, found, strict=True):
        for w, z in zip(widths, row, strict=True):
            state = 0.0
            expected = []
            for k in range(len(x)):
                state = 0.0 if k in edges else float(np.clip(state + (x[k] - x[k - 1]) / w, -1, 1))
                expected.append(state)
            assert z == pytest.approx(expected, abs=1e-12)
