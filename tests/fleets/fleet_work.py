"""Logs of simulated encoders, and work that ends the process it runs in: what the tests of fleets share."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from hallsym.families import build
from hallsym.log import Noise, write_log
from hallsym.simulation import NoiseModel, campaign_from, simulate

RUNS, SAMPLES = 4, 150
TAU = {"Vx": 2e-3, "Vy": 2e-3, "Ax": 5e-3, "Ay": 5e-3, "beta": 2e-3}
"""Standard deviation of each parameter over simulated devices, far above the uncertainty of one."""


def truths(devices: int, seed: int = 0) -> list[dict[str, float]]:
    """Return the parameters of simulated devices."""
    rng, example = np.random.default_rng(seed), build("rotary").family.example.values
    return [
        {n: example[n] + s * rng.standard_normal() for n, s in TAU.items()} | {"zero": rng.uniform(-3, 3)}
        for _ in range(devices)
    ]


def recorded(truth: dict[str, float], seed: int, *, runs: int = RUNS, samples: int = SAMPLES):
    """Return the columns that an encoder records, of ramps to and fro."""
    model = build("rotary")
    noise = Noise.given(model.family.example.noise, (*model.channels, *model.references)).std
    entries = [
        {"duration_s": 1.0, "angle_rad": {"kind": "ramp", "rate": 13.0 - 26.0 * (k % 2), "about": 0.7 * k}}
        for k in range(runs)
    ]
    campaign = campaign_from({"step_s": 1.0 / samples, "run": entries}, "the test")
    return simulate(model, truth, campaign, NoiseModel(noise), seed=seed)


def write_fleet(folder: Path, devices: int, **how) -> list[dict[str, float]]:
    """Write the logs of simulated devices, dev0.parquet and so on; return what they are."""
    folder.mkdir(exist_ok=True)
    known = truths(devices)
    for k, truth in enumerate(known):
        write_log(recorded(truth, k, **how), folder / f"dev{k}.parquet")
    return known


def square(number: int) -> int:
    """Return a square; some numbers are refused."""
    if number == 13:
        raise ValueError("thirteen")
    return number**2


def ends_once(job: tuple[int, str]) -> int:
    """Return a number; 7 ends its process the first time, 5 each time, and not before 7 did."""
    number, folder = job
    marker = Path(folder) / "seen7"
    if number == 5 or (number == 7 and not marker.exists()):
        while number == 5 and not marker.exists():
            time.sleep(0.01)
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number
