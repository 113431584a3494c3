"""Many short runs: what is kept per run must stay small, and no run is taken for another's."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hallsym import Log, Noise, build, fit, published, table8_noise

RUNS, SAMPLES = 10_000, 20
MOST_MB = 400.0


def many_runs(runs: int = RUNS) -> Log:
    """Runs at their own height and tilt, each with zero deviations of its own; noise of Table 8."""
    rng, model = np.random.default_rng(12), build("stage31")
    run, t = np.repeat(np.arange(runs), SAMPLES), np.tile(2e-3 * np.arange(SAMPLES), runs)
    frequency = 2 * np.pi * rng.uniform(5, 40, runs)[run]
    pose = [5e-4 * np.sin(frequency * t), 5e-4 * np.cos(frequency * t), 1e-3 * np.sin(0.7 * frequency * t)]
    state = [rng.uniform(low, high, runs)[run] for low, high in ((0, 3e-3), (-1e-3, 1e-3), (-1e-3, 1e-3))]
    zeros = rng.uniform(-1e-5, 1e-5, (len(model.offsets), runs))[:, run]
    reading = model.readings(model.vector(published.values("table7_estimates")), pose, state, zeros)
    columns = dict(zip((*model.references, *model.state), [*pose, *state], strict=True))
    columns |= dict(zip(model.channels, reading, strict=True))
    sigma = table8_noise(model).sigma
    noisy = {c: v + sigma.get(c, 0.0) * rng.standard_normal(len(v)) for c, v in columns.items()}
    return Log.from_arrays({"run": run, "t_s": t, **noisy}, Noise.given(sigma, tuple(noisy)))


def test_runs_whose_gains_follow_their_heights_are_nobody_elses():
    """From 0 to 3 mm a gain falls by half, in a run of 20 samples as in a long one."""
    found = fit(many_runs(400), "stage31", solver="direct")
    assert (found.status, found.notes) == ("converged", ())
    assert not found.goodness.material


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak memory is read from /proc")
def test_ten_thousand_short_runs_are_fitted_in_400_mb():
    """A process of its own: the peak is that of one fit, imports and the log included."""
    command = [sys.executable, __file__]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert said[0] == "converged"
    assert float(said[1]) < MOST_MB


def peak_mb() -> float:
    """Peak memory of this program; `ru_maxrss` would count what the process that started it had, too."""
    status = Path("/proc/self/status").read_text()
    return next(float(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM"))


if __name__ == "__main__":
    found = fit(many_runs(), "stage31")
    print(found.status, peak_mb())
