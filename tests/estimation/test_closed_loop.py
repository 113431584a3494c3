"""A machine that moves with the noise of its reference: the residual and the gains."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import hallsym

STEP, SAMPLES, RUNS = 1e-3, 2000, 8
STROKE, NOISE = 20e-6, 2e-6  # m; much noise on a small stroke, so that its bias is seen
QUIET = 1e-9


def recorded(followed: float) -> tuple[hallsym.Log, float, np.ndarray]:
    """A log whose loop follows `followed` of the noise of x in each sample; c of (S10), and the noise."""
    rng = np.random.default_rng(5)
    model, truth = hallsym.build("stage15"), hallsym.published.values("table7_estimates")
    t = np.arange(SAMPLES) * STEP
    noise = lfilter([1], [1, -0.5], rng.standard_normal((RUNS, SAMPLES + 100)))[:, 100:]
    noise *= NOISE / noise.std()
    astray = lfilter([0, followed], [1, followed - 1], noise)
    campaign = hallsym.paper_campaign(step_s=STEP)
    runs = []
    for off in astray:
        motion = {
            axis: lambda at, k=k: STROKE * np.sin(k * at) for axis, k in (("y_m", 9.0), ("rz_rad", 5.0))
        }
        motion["x_m"] = lambda at, off=off: STROKE * np.sin(2 * np.pi * at) - np.interp(at, t, off)
        runs.append(
            replace(campaign.runs[0], duration_s=SAMPLES * STEP, motion=motion, offsets=(0.0, 0.0, 0.0))
        )
    values = {name: value for name, value in truth.items() if name in model.names}
    level = dict.fromkeys((*model.channels, *model.references), QUIET)
    columns = hallsym.simulate(
        model, values, replace(campaign, runs=tuple(runs)), hallsym.NoiseModel(level), seed=1
    )
    columns["x_ref_m"] = columns["x_ref_m"] + noise.ravel()
    share = float(np.mean(columns["x_ref_m"] * noise.ravel()) / NOISE**2)
    stated = hallsym.Noise.given({**level, "x_ref_m": NOISE}, tuple(level))
    return hallsym.Log.from_arrays(columns, noise=stated), share, noise


@pytest.mark.parametrize("followed", [0.0, 0.1, 0.5])
def test_a_gain_is_off_by_the_noise_that_the_loop_follows(followed):
    log, share, noise = recorded(followed)
    fit = hallsym.fit(log, "stage15", solver="direct", loss="none")
    off = fit.value("eta_C") / hallsym.published.values("table7_estimates")["eta_C"] - 1
    motion = np.var(log.array("x_ref_m"))
    sampled = 3 * NOISE / np.sqrt(motion * noise.size / 3)  # neighbours correlate by 0.5: a third tells
    assert off == pytest.approx((1 - share) * NOISE**2 / motion, abs=sampled)
    # probe C senses x, and its residual holds all of the noise, in a loop or not
    left = fit.to_dict()["goodness_of_fit"]["by_channel"]["hall_c_m"]
    assert left == pytest.approx(1.0, abs=0.03)
