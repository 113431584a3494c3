"""Covariance from the scatter between runs: textbook cases, and coverage of 95 % intervals by simulation."""

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.signal import lfilter
from twins import HALL, SIGMAS, campaign, cost_on, true_model, truth_of, with_noise

from hallsym.estimation.calibration import coverage_factor
from hallsym.estimation.covariance import Octaves, RunScatter, White, estimated, uncertainty
from hallsym.estimation.identifiable import determine
from hallsym.estimation.optimum import refit
from hallsym.log.batches import Batch
from hallsym.simulation import NoiseModel, simulate

SETTINGS = {"57 runs": range(57), "12 runs": range(12), "6 runs": range(6)}


# -- textbook -----------------------------------------------------------------------------------------------


def scatter_of(information: np.ndarray, scores: np.ndarray) -> RunScatter:
    return RunScatter.of(information.copy(), scores)


def test_equal_runs_give_the_standard_error_of_their_mean():
    """One parameter, G runs that know it equally: s^2 / G with G - 1 degrees of freedom."""
    means = np.array([3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0])
    information = np.full((7, 1, 1), 50.0)
    found = scatter_of(information, 50.0 * (means - means.mean())[:, None])
    assert found.covariance(0.0)[0, 0] == pytest.approx(means.var(ddof=1) / 7)
    assert found.degrees_of_freedom_of(np.eye(1)) == pytest.approx([6.0])
    assert found.degrees_of_freedom == pytest.approx(6.0)


def test_parameters_of_separate_runs_have_the_freedom_of_those():
    """Three runs know the first parameter, five the second; their difference is Welch's."""
    information = np.zeros((8, 2, 2))
    information[:3, 0, 0], information[3:, 1, 1] = 20.0, 80.0
    rng = np.random.default_rng(1)
    values = rng.standard_normal(8)
    scores = np.zeros((8, 2))
    scores[:3, 0] = 20.0 * (values[:3] - values[:3].mean())
    scores[3:, 1] = 80.0 * (values[3:] - values[3:].mean())
    found = scatter_of(information, scores)
    each = values[:3].var(ddof=1) / 3, values[3:].var(ddof=1) / 5
    assert np.diag(found.covariance(0.0)) == pytest.approx(each)
    gradients = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    by_noise = np.array([1 / 60, 1 / 400])
    welch = by_noise.sum() ** 2 / (by_noise**2 / [2, 4]).sum()
    assert found.degrees_of_freedom_of(gradients) == pytest.approx([2.0, 4.0, welch])


def test_unequal_runs_have_fewer_degrees_of_freedom():
    """One run that knows nearly everything: its scatter cannot be told."""
    information = np.array([1000.0, 1.0, 1.0, 1.0])[:, None, None]
    dof = scatter_of(information, np.zeros((4, 1))).degrees_of_freedom_of(np.eye(1))
    assert 1.0 <= dof[0] < 1.1


def test_what_one_run_knows_alone_has_the_scatter_of_all():
    """The second parameter stands in one run only: its own scores are nil, the others scatter too much."""
    information = np.zeros((6, 2, 2))
    information[:, 0, 0] = 4.0
    information[5, 1, 1] = 4.0
    scores = np.zeros((6, 2))
    scores[:, 0] = 4.0 * 1.5 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    found = scatter_of(information, scores)
    assert found.covariance(1.0)[1, 1] == pytest.approx(found.ratio / 4.0)
    assert found.degrees_of_freedom_of(np.eye(2))[1] == pytest.approx(found.degrees_of_freedom)
    assert found.degrees_of_freedom == pytest.approx(5.0)


# -- octaves of noise ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("memory", [0.0, 0.5])
def test_slow_octaves_have_the_power_of_an_autoregression(memory):
    """Of unit variance and lag-1 correlation .5: (1 + .5) / (1 - .5) = 3 at slow octaves."""
    rng, runs, n = np.random.default_rng(3), 60, 256
    noise = rng.standard_normal((2, runs, n))
    noise = lfilter([np.sqrt(1 - memory**2)], [1, -memory], noise).reshape(1, 2, -1)
    noise -= np.repeat(noise.reshape(1, 2, runs, n).mean(axis=3), n, axis=2)
    batch = Batch(tuple(range(runs)), {}, tuple(range(0, runs * n + 1, n)))
    octaves = Octaves.of([(batch, noise)], offsets=2)
    power, of_power = octaves.spectrum
    assert octaves.white == (memory == 0.0)
    assert octaves.values.sum() == 2 * runs * (n - 1)
    assert power[-9:] == pytest.approx([(1 + memory) / (1 - memory)] * 9, rel=0.15)
    assert of_power.diagonal()[:-3].max() < 2 / 100  # of 100 degrees of freedom; offsets take the mean


# -- coverage -----------------------------------------------------------------------------------------------


def recording(model, runs, rng: np.random.Generator, kind: str, clean: Mapping[str, np.ndarray]):
    """Noise as stated, or 3 times that; correlated over .1 s; or gains that differ from run to run."""
    here = np.isin(clean["run"], runs)
    out = {c: v[here].copy() for c, v in clean.items()}
    n, factor = int(here.sum()), 3.0 if kind == "3" else 1.0
    memory = np.exp(-0.02 / 0.1)
    for name, sigma in SIGMAS.items():
        noise = rng.standard_normal(n)
        if kind == "correlated":
            noise = lfilter([np.sqrt(1 - memory**2)], [1, -memory], noise)
        out[name] += factor * sigma * noise
    if kind == "gains":
        for name in HALL:
            out[name] *= (1 + 3e-3 * rng.standard_normal(57))[out["run"].astype(int)]
    return with_noise(out)


def coverage(name: str, runs, kind: str, logs: int) -> float:
    """Share of 95 % intervals that hold the truth, over all determined parameters."""
    model, rng, hits = true_model(name), np.random.default_rng(5), []
    clean = simulate(model, truth_of(model), campaign(50), NoiseModel({}), seed=0)
    found = None
    for _ in range(logs):
        cost = cost_on(recording(model, runs, rng, kind, clean), model)
        found = found or determine(cost, model.nominal)
        p = refit(cost, model.nominal, found.fixed)
        told = uncertainty(cost.at(p), found)
        half = coverage_factor(told.degrees_of_freedom) * told.std
        hits.append((np.abs(p - model.nominal) <= half)[told.determined])
    return float(np.mean(np.concatenate(hits)))


def slow_noise(rng: np.random.Generator, n: int, slope: int) -> np.ndarray:
    """White noise, 1/f noise that began long before, or a random walk from 0: power as f^-slope."""
    white = rng.standard_normal(n if slope != 1 else 16 * n)
    if slope != 1:
        return np.cumsum(white) if slope else white
    f = np.fft.rfftfreq(len(white))
    f[0] = np.inf
    return np.fft.irfft(np.fft.rfft(white) / np.sqrt(f), len(white))[:n]


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0, 1, 2])
@pytest.mark.parametrize("runs", [1, 5])
def test_intervals_cover_in_noise_that_goes_on_from_run_to_run(runs, slope):
    """Offset and both amplitudes of four turns a run: 95 % +- 5 %, 300 logs tell each to 1.3 %."""
    rng, n, hits = np.random.default_rng(6), 500, []
    angle = 2 * np.pi * 4 * (np.arange(n) + 0.5) / n
    one = np.stack([np.ones(n), np.cos(angle), np.sin(angle)])
    A, batch = np.tile(one, runs), Batch(tuple(range(runs)), {}, tuple(range(0, runs * n + 1, n)))
    for _ in range(300):
        noise = slow_noise(rng, runs * n, slope)
        error = np.linalg.solve(A @ A.T, A @ noise)
        residual = noise - error @ A
        octaves = Octaves.of([(batch, np.vstack([A, residual])[:, None])])
        scores = residual.reshape(runs, n) @ one.T
        found = estimated(np.tile(one @ one.T, (runs, 1, 1)), scores, White(1.0, 1.0), octaves)
        half = coverage_factor(found.dof(np.eye(3))) * np.sqrt(np.diag(found.covariance))
        hits.append(np.abs(error) <= half)
    assert np.mean(hits, axis=0) == pytest.approx([0.95] * 3, abs=0.05)


MODELS = {"57 runs": "stage31", "12 runs": "stage30", "6 runs": "stage30"}


def test_intervals_cover_of_few_runs():
    """95 % +- 4 %: 60 logs of 6 correlated parameters tell it to about 1.3 %."""
    assert coverage("stage30", range(6), "correlated", 60) == pytest.approx(0.95, abs=0.04)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("runs", "kind"),
    [(n, k) for n in ("6 runs", "12 runs") for k in ("as stated", "3", "correlated", "gains")]
    + [("57 runs", "gains")],
)
def test_intervals_cover_95_percent(runs, kind):
    """Within 1.5 %; 6 runs do not always show that their gains differ: 3.5 % (two of each axis).

    Noise of 57 runs, white or correlated, stands in `test_uncertainty.py`, by parameter.
    """
    wanted = 0.035 if (runs, kind) == ("6 runs", "gains") else 0.015
    assert coverage(MODELS[runs], SETTINGS[runs], kind, 500) == pytest.approx(0.95, abs=wanted)
