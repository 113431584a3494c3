"""What a survey of a residual finds by itself, against machines whose hum, memory and samples are known."""

import numpy as np
import pytest

import hallsym
from hallsym.diagnosis import POLICY
from hallsym.diagnosis.curves import lack_of_fit
from hallsym.diagnosis.faults import faults, without_tail
from hallsym.diagnosis.refit import refit
from hallsym.diagnosis.setup import base_of, split
from hallsym.diagnosis.survey import Survey, memory_of_recording, survey
from hallsym.estimation.calibration import coverage_factor
from hallsym.log import Log, Noise

SIGMA = 5e-4
SPEEDS = np.array([3.0, -3.0, 5.0, -5.0, 8.0, -8.0])
STEP_S, PAUSE_S, RUNS, SAMPLES = 4e-3, 7.3, 6, 256


def nothing(t):
    return 0.0 * t


def encoder(step_s=STEP_S, runs=RUNS, samples=SAMPLES, seed=1, *, added=nothing, turned=nothing, noise=None):
    """An encoder turning at six speeds: `added(t)` in the voltage of its sine [V], `turned(t)` [rad]."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), samples)
    t = np.tile(np.arange(samples) * step_s, runs) + run * (samples * step_s + PAUSE_S)
    angle = SPEEDS[run % 6] * t
    white = rng.normal(0, SIGMA, (2, len(t))) if noise is None else noise(rng, len(t))
    true = angle + turned(t)
    voltages = np.array([np.sin(true) + added(t), np.cos(true)]) + white
    columns = {"run": run, "t_s": t, "v_sin_v": voltages[0], "v_cos_v": voltages[1], "angle_ref_rad": angle}
    stated = {"v_sin_v": SIGMA, "v_cos_v": SIGMA, "angle_ref_rad": 1e-6}
    return Log.from_arrays(columns, Noise.given(stated, tuple(columns)))


def based(log):
    return base_of(log, hallsym.fit(log, "ellipse", solver="direct", loss="none", accept=["all"]))


def surveyed(log) -> Survey:
    base = based(log)
    return survey(base, frozenset(log.runs))


@pytest.mark.parametrize("step_s", [4e-3, 12e-3])  # 12 ms show 50 Hz as 33 Hz
@pytest.mark.parametrize("hz", [49.37, 50.02, 61.4])
def test_hum_is_found_as_exactly_as_the_whole_log_tells(step_s, hz):
    log = encoder(step_s, added=lambda t: 4 * SIGMA * np.sin(2 * np.pi * hz * t + 1))
    found = surveyed(log).lines_hz[hz > 55]
    assert abs(found - hz) < 0.04 / (RUNS * (SAMPLES * step_s + PAUSE_S))


def slow(rng, n):
    """Noise of first order, a correlation of 0.8 between neighbours."""
    x = np.empty((2, n))
    x[:, 0], drive = rng.standard_normal(2), rng.standard_normal((2, n))
    for k in range(1, n):
        x[:, k] = 0.8 * x[:, k - 1] + 0.6 * drive[:, k]
    return SIGMA * x


def test_memory_ends_where_correlation_is_chance():
    coloured = surveyed(encoder(noise=slow, samples=2000))
    assert coloured.inflation == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.25)
    assert coloured.autocorrelation[1] == pytest.approx(0.8, abs=0.03)
    assert surveyed(encoder(samples=2000)).inflation < 1.1


def ringing(rng, n):
    """Noise behind a resonance of 41 Hz, of which 2 % are left after 130 samples of 4 ms."""
    out, w = np.zeros((2, n)), 2 * np.pi * 41 * STEP_S
    a, b, drive = 2 * 0.97 * np.cos(w), -(0.97**2), rng.standard_normal((2, n))
    for k in range(2, n):
        out[:, k] = a * out[:, k - 1] + b * out[:, k - 2] + drive[:, k]
    return SIGMA * out / out.std()


def white(rng, n):
    return SIGMA * rng.standard_normal((2, n))


@pytest.mark.parametrize(("noise", "least", "most"), [(white, 0, 10), (ringing, 60, 333)])
def test_slices_of_a_recording_tell_how_long_its_noise_remembers(noise, least, most):
    """Of every second slice of 40 samples, so also where the noise remembers longer than a slice."""
    log, held = split(encoder(runs=1, samples=4000, noise=noise), POLICY)
    base = based(log)
    assert least <= memory_of_recording(base, frozenset(set(log.runs) - set(held))) <= most


@pytest.mark.parametrize(("hz", "seen"), [(31.25, True), (5.0, False)])
def test_a_tone_is_a_line_that_is_no_drift(hz, seen):
    log = encoder(samples=1024, turned=lambda t: 0.5 * SIGMA * np.sin(2 * np.pi * hz * t))
    found = lack_of_fit(based(log), log.runs)
    assert (found.tones > 0.01) == seen


def test_readings_late_by_several_samples_are_no_spikes():
    """Four samples at 8 rad/s are .13 rad: the chord is 16 sigma from the tangent."""
    log = encoder(samples=512)
    source = np.arange(log.rows) - 4 * (np.arange(log.rows) % 61 == 60)
    columns = {c: log.array(c)[source] if c.startswith("v_") else log.array(c) for c in log.columns}
    base = based(Log.from_arrays(columns, log.noise))
    names = [f.name for f in faults(base, survey(base, frozenset(log.runs)), tested=40)]
    assert names == ["dropped_samples"]


def changed(log: Log, column: str, values: np.ndarray) -> Log:
    return Log.from_arrays({**{c: log.array(c) for c in log.columns}, column: values}, log.noise)


def test_steps_of_a_converter_are_measured_although_the_log_rounds_them():
    step, rounding = 8.9373e-4, 2.0**-15
    log = encoder()
    coarse = step * np.round(log.array("v_sin_v") / step)
    found = surveyed(changed(log, "v_sin_v", rounding * np.round(coarse / rounding)))
    assert found.adc_step[0] == pytest.approx(step, rel=3e-4)


def test_spikes_of_five_standard_deviations_are_left_out_and_noise_is_not():
    log = encoder(samples=512)
    spikes = np.arange(log.rows) % 50 == 25
    noisy = changed(log, "v_sin_v", log.array("v_sin_v") + 5 * SIGMA * spikes)
    kept = np.concatenate([without_tail(based(noisy))(block) for block in noisy.blocks()])
    assert kept[spikes].mean() < 0.3
    assert kept[~spikes].mean() > 0.995


def pink(rng, n):
    """A quarter of the variance is 1/f noise, of each run its own."""
    waves = np.fft.rfft(rng.standard_normal((2, n // SAMPLES, SAMPLES)))
    drift = np.fft.irfft(waves / np.sqrt(np.arange(waves.shape[2]).clip(1)), SAMPLES).reshape(2, n)
    return SIGMA * (np.sqrt(0.75) * rng.standard_normal((2, n)) + 0.5 * drift / drift.std())


@pytest.mark.slow
@pytest.mark.parametrize("noise", [white, slow, pink])
def test_estimates_scatter_as_much_as_a_fit_and_a_refit_say(noise):
    """Of five runs, too few to tell from their scatter that noise is not white."""
    model, z = hallsym.build("ellipse"), []
    for seed in range(40):
        log = encoder(runs=5, seed=seed, noise=noise)
        fit = hallsym.fit(log, model, solver="direct", loss="none", accept=["all"])
        again = refit(base_of(log, fit), log.runs)
        covariance, dof = again.uncertainty()
        assert np.sqrt(np.diag(covariance)) == pytest.approx(fit.std, rel=0.01)
        assert coverage_factor(dof) == pytest.approx(coverage_factor(fit.degrees_of_freedom), rel=0.01)
        z.append((again.values() - model.nominal) / fit.std)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)
