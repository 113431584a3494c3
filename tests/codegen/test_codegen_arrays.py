"""C for several arrays: six coordinates of a mover from the sums of Hall sensors under four arrays.

Independent facts: the field's own equations at a known pose (`waves.planar`: exact rotations, the field
vector turned into the board's axes, every sensor of every sum); the bits of a million samples; instructions
counted in QEMU.
"""

from functools import cache

import numpy as np
import pytest
from msgspec import structs
from waves import calibrated, calibrated_planar

import hallsym
from hallsym.families.halbach import planar
from hallsym.model import on_arrays

LEVEL = {"count": 3, "gaps": (0.0065, 0.0085), "tilt": 0.003, "travel": 0.0135, "across": 3}
TILTED = {"count": 6, "gaps": (0.0065, 0.0085), "tilt": 0.01, "travel": 0.0135, "across": 3}
FAR = {**LEVEL, "travel": 0.06}
CASES = {
    "closed form of 12 sums": (LEVEL, 1e-4),
    "12 sums": (LEVEL, 5e-6),
    "24 sums": (TILTED, 1e-6),
    "many periods": (FAR, 5e-6),
    "another level": (LEVEL, 2e-6),
}
QUICK = "12 sums"


@cache
def fit_of(case):
    if case != "another level":
        return calibrated_planar(**CASES[case][0])
    values = {"a1": 0.62, "a5": -0.01, "rx0": 1e-3, "ry0": -2e-3, "rz0": 5e-4, "x0": 1e-3, "y0": -5e-4}
    log = fit_of(QUICK).log  # of y within a period
    log = structs.replace(log, span={**log.span, "x_ref_m": (-0.04, 0.04)})
    return calibrated(planar.halbach_planar(), values).changed(log=log)


@cache
def made(case):
    return hallsym.generate(fit_of(case), accuracy=CASES[case][1])


def poses(case, count, seed=3):
    box = CASES[case][0]
    rng = np.random.default_rng(seed)
    low, high = box["gaps"]
    half = np.array([box["travel"], box["travel"], (high - low) / 2, *[box["tilt"]] * 3])
    return np.array([0, 0, (low + high) / 2, 0, 0, 0])[:, None] + half[:, None] * rng.uniform(
        -1, 1, (6, count)
    )


def read(case, pose):
    fit = fit_of(case)
    return on_arrays(fit.model.reading)(fit.values, [], list(pose), [])[0]


@pytest.mark.slow
def test_all_six_moving_stay_within_what_the_sums_themselves_resolve():
    """One mover at 10 mrad: less than the .7 um and 1.5 urad that all sensors leave of an independent
    plant."""
    code, pose = made("24 sums"), poses("24 sums", 3000)
    found, _ = code.backend.step(read("24 sums", pose).astype(np.float32))
    rms = np.sqrt(((found - pose) ** 2).mean(axis=1))
    assert (rms[:3] < 4e-7).all()
    assert (rms[3:] < 1.5e-6).all()
