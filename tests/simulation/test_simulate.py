"""A twin records what its model reads, plus noise of the kind and size that was asked for."""

import numpy as np
import pytest
from twins import COLUMNS, EPS, HALL, SIGMAS, TRUTH, campaign, phi, pm

from hallsym.errors import InputError
from hallsym.estimation.decoding import error_tables
from hallsym.families.stage.models import stage31
from hallsym.log import Log
from hallsym.simulation import (
    Campaign,
    NoiseModel,
    Run,
    paper_campaign,
    simulate,
    simulate_blocks,
    table8_noise,
)
from hallsym.simulation import machine as simulation

MODEL = stage31()
LONG = Campaign(1e-3, (Run(200.0, {}, {}, (0.0, 0.0, 0.0)),))
"""200 000 samples at rest: every column is its noise."""


def noise_at_rest(noise: NoiseModel, seed: int = 0) -> dict[str, np.ndarray]:
    return simulate(MODEL, TRUTH, LONG, noise, seed=seed)


def test_without_noise_the_readings_are_the_articles_equation():
    """m = phi (PM q + delta / phi(0)): the deviation is stated in reading space at the reset."""
    columns = simulate(MODEL, TRUTH, campaign(40), seed=0)
    for k, run in enumerate(campaign(40).runs):
        one = columns["run"] == k
        q, s = (np.array([columns[c][one] for c in part]) for part in (COLUMNS[:3], COLUMNS[3:]))
        d = np.array(run.offsets) / phi(TRUTH, s[:, 0])
        expected = phi(TRUTH, s) * (pm(TRUTH) @ q + d[:, None])
        found = np.array([columns[c][one] for c in HALL])
        assert np.allclose(found, expected, rtol=0, atol=16 * EPS * 1e-3)


@pytest.mark.parametrize(
    "noise",
    [
        NoiseModel(SIGMAS),
        NoiseModel(SIGMAS, correlation_s=0.1),
        NoiseModel(SIGMAS, degrees_of_freedom=4),
        NoiseModel(outlier_share=0.1),
    ],
)
def test_the_same_seed_gives_the_same_log_and_another_seed_another(noise):
    one, two, other = (simulate(MODEL, TRUTH, campaign(10), noise, seed=s) for s in (1, 1, 2))
    assert all(np.array_equal(one[c], two[c]) for c in one)
    assert all(not np.array_equal(one[c], other[c]) for c in HALL)


def test_undrawn_deviations_have_the_stated_spread():
    runs = tuple(Run(0.004, {"z_m": 1e-4}, {}) for _ in range(2000))
    columns = simulate(MODEL, TRUTH, Campaign(2e-3, runs, zero_spread_m=3e-6), seed=0)
    assert np.array_equal(columns["hall_a_m"][::2], columns["hall_a_m"][1::2])  # one per run
    for c in HALL:  # at rest a reading is the deviation itself; 4 sigma of a spread from 2000: 6.3 %
        assert np.std(columns[c][::2]) == pytest.approx(3e-6, rel=0.064)


def test_wrong_number_of_deviations_is_refused():
    with pytest.raises(InputError, match="3 zero deviations"):
        simulate(MODEL, TRUTH, Campaign(1e-3, (Run(0.1, {}, {}, (0.0,)),)), seed=0)


@pytest.mark.parametrize("correlation", [0.0, 0.05])
def test_streaming_is_in_memory(monkeypatch, correlation):
    """Blocks of one run each; a run longer than a block goes on where it stopped."""
    noise = NoiseModel(SIGMAS, correlation_s=correlation)
    whole = simulate(MODEL, TRUTH, campaign(30), noise, seed=5)
    blocks = list(simulate_blocks(MODEL, TRUTH, campaign(30), noise, seed=5))
    assert all(len(set(b["run"])) == 1 for b in blocks)
    assert all(np.array_equal(np.concatenate([b[c] for b in blocks]), whole[c]) for c in whole)
    exact = simulate(MODEL, TRUTH, campaign(30), seed=5)
    monkeypatch.setattr(simulation, "BLOCK", 7)
    short = list(simulate_blocks(MODEL, TRUTH, campaign(30), seed=5))
    assert max(len(b["run"]) for b in short) == 7
    for c in exact:
        assert np.array_equal(np.concatenate([b[c] for b in short]), exact[c])


def test_each_column_has_its_own_white_noise():
    """200 000 samples: a standard deviation is known to 0.16 %, a correlation to 0.0022 (1 sigma each)."""
    columns = noise_at_rest(NoiseModel(SIGMAS))
    for name, sigma in SIGMAS.items():
        assert np.std(columns[name]) == pytest.approx(sigma, rel=4 * 0.0016)
        assert abs(np.mean(columns[name])) < 4 * sigma / np.sqrt(200_000)
        lag = np.corrcoef(columns[name][1:], columns[name][:-1])[0, 1]
        assert abs(lag) < 4 * 0.0023
    mutual = np.corrcoef([columns[c] for c in SIGMAS]) - np.eye(len(SIGMAS))
    assert np.abs(mutual).max() < 4.5 * 0.0023


def test_correlated_noise_has_its_time_constant_and_variance():
    """AR(1): correlation exp(-lag / tau). With tau = 50 samples 2000 are independent: 3 % (1 sigma)."""
    tau = 0.05
    columns = noise_at_rest(NoiseModel(SIGMAS, correlation_s=tau))
    for name, sigma in SIGMAS.items():
        x = columns[name]
        assert np.std(x) == pytest.approx(sigma, rel=0.07)
        steps = np.std(x[1:] - x[:-1]) / sigma
        assert steps == pytest.approx(np.sqrt(2 * (1 - np.exp(-1e-3 / tau))), rel=4 * 0.0016)
        lag = np.corrcoef(x[50:], x[:-50])[0, 1]
        assert lag == pytest.approx(np.exp(-1), abs=0.08)


def test_students_t_has_the_stated_variance_and_its_tails():
    """5 degrees of freedom: kurtosis 9; share beyond 4 sigma 0.0036 x (Gaussian 6e-5)."""
    from scipy.stats import t

    columns = noise_at_rest(NoiseModel(SIGMAS, degrees_of_freedom=5.0))
    x = columns["hall_b_m"] / SIGMAS["hall_b_m"]
    # variance of the sample variance: (kurtosis - 1) / n = 8 / 200000, 0.32 % in sigma; 4 of them
    assert np.std(x) == pytest.approx(1.0, rel=0.013)
    expected = 2 * t.sf(4 / np.sqrt(3 / 5), 5)
    assert np.mean(np.abs(x) > 4) == pytest.approx(expected, rel=4 / np.sqrt(200_000 * expected))
    with pytest.raises(InputError, match="more than 2"):
        noise_at_rest(NoiseModel(SIGMAS, degrees_of_freedom=2.0))


def test_outliers_have_their_share_and_size_in_readings_and_references():
    columns = noise_at_rest(NoiseModel(outlier_share=0.1, outlier_size=2e-3))
    for name in (*HALL, *COLUMNS[:3]):
        hit = columns[name] != 0
        assert np.mean(hit) == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 200_000))
        assert 1.99e-3 < np.abs(columns[name]).max() <= 2e-3
        assert np.std(columns[name][hit]) == pytest.approx(2e-3 / np.sqrt(3), rel=0.02)
    assert all(np.all(columns[name] == 0) for name in COLUMNS[3:])


def test_readings_are_rounded_to_the_adc_step():
    noise = NoiseModel(SIGMAS, adc_step_m=1e-7)
    columns = simulate(MODEL, TRUTH, campaign(40), noise, seed=1)
    fine = simulate(MODEL, TRUTH, campaign(40), NoiseModel(SIGMAS), seed=1)
    for name in HALL:
        counts = columns[name] / 1e-7
        assert np.allclose(counts, np.round(counts), rtol=0, atol=1e-9)
        assert np.abs(columns[name] - fine[name]).max() <= 0.5e-7 * (1 + 1e-9)
    assert all(np.array_equal(columns[name], fine[name]) for name in COLUMNS)


def test_noise_of_an_unknown_column_is_refused():
    with pytest.raises(InputError, match="hall_d_m"):
        noise_at_rest(NoiseModel({"hall_d_m": 1e-6}))


@pytest.mark.parametrize(
    "noise",
    [
        {"sigma": {"hall_a_m": -1e-6}},
        {"sigma": {"hall_a_m": float("nan")}},
        {"correlation_s": -1.0},
        {"outlier_share": 1.5},
        {"outlier_share": -0.1},
        {"adc_step_m": -1e-7},
    ],
)
def test_noise_that_cannot_be_is_refused(noise):
    with pytest.raises(InputError):
        NoiseModel(**noise)


def test_table_8_noise_leaves_table_8s_errors_with_the_true_parameters():
    """1.3919, 1.5381, 2.3057 (um, um, urad) within 2 %: 28 500 samples know them to 0.4 %."""
    log = Log.from_arrays(simulate(MODEL, TRUTH, paper_campaign(), table8_noise(MODEL), seed=0))
    p = MODEL.vector(TRUTH)
    zeros = {
        k: np.array(run.offsets) / phi(TRUTH, np.array([run.setting[c] for c in ("z_m", "rx_rad", "ry_rad")]))
        for k, run in enumerate(paper_campaign().runs)
    }
    (table,) = error_tables(log, MODEL, [(p, zeros)], np.ones(3))
    assert np.allclose(list(table.over()["rmse"].values()), [1.3919e-6, 1.5381e-6, 2.3057e-6], rtol=0.02)
