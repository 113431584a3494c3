"""C for a mover over rows of sensors longer than its arrays: six coordinates, sensors weighted smoothly.

Independent facts: the finite field of magnetised rectangles at a known pose, exact rotations; a pose moves by
as much as the mover does, also where sensors come and go; what says the period changes nothing else.
"""

from functools import cache

import numpy as np
import pytest
from msgspec import structs
from waves import LENGTH, calibrated

import hallsym
from hallsym.codegen.box import box_of
from hallsym.codegen.lowering import rows
from hallsym.families.halbach.effects.planar_ends import array_edges
from hallsym.families.halbach.layout import Array, Sensor
from hallsym.families.halbach.planar import halbach_planar
from hallsym.model import on_arrays

pytestmark = pytest.mark.slow
"""C that takes 15 s to generate: travel in one coordinate, and six without it, are always tested."""

VALUES = {"a1": 0.62, "a5": -6e-4, "edges": 1.0, "rx0": 1e-3, "ry0": -2e-3, "rz0": 5e-4, "x0": 1e-3}
CENTRES = {"X1": (-0.06, 0.07), "X2": (0.06, -0.07), "Y1": (0.07, 0.06), "Y2": (-0.07, -0.06)}
REACH, GAPS, TILT = 0.03, (0.004, 0.007), 0.005
FIELD, TILTED, COVER = 0x40000000, 0x20000000, 0x10000000
ARRAY = 3 * LENGTH


def layout(length=ARRAY):
    """Four arrays of three periods, each over a row of six sums at 20 mm: 100 mm, of which 90 are covered."""
    arrays = [Array(n, LENGTH, n[0].lower(), c, length, 0.12, LENGTH / 4) for n, c in CENTRES.items()]
    sums = []
    for array in arrays:
        for k in range(6):
            at = [(k - 2.5) * 0.02 * (array.axis == j) + array.centre[j] for j in (0, 1)]
            side = [(n - 1) * LENGTH / 3 for n in range(3)]
            places = [(at[0] + s * array.axis, at[1] + s * (1 - array.axis)) for s in side]
            sums.append(Sensor(f"{array.name.lower()}_{k}_v", tuple(places), array.name))
    return (*sums, *arrays)


def fit_of(length=ARRAY, reach=REACH):
    fit = calibrated(array_edges(halbach_planar(layout(length))), VALUES, gaps=GAPS)
    span = {"x_ref_m": [-reach, reach], "y_ref_m": [-reach, reach], "z_ref_m": list(GAPS)}
    span |= {f"r{a}_ref_rad": [-TILT, TILT] for a in "xyz"}
    return fit.changed(log=structs.replace(fit.log, span=span))


@cache
def made():
    return hallsym.generate(fit_of(), accuracy=5e-6)


def poses(count, seed=3):
    rng = np.random.default_rng(seed)
    half = np.array([REACH, REACH, (GAPS[1] - GAPS[0]) / 2, TILT, TILT, TILT])
    middle = np.array([0, 0, sum(GAPS) / 2, 0, 0, 0])
    return middle[:, None] + half[:, None] * rng.uniform(-1, 1, (6, count))


def inputs_of(pose, near=0.0):
    """Readings at poses (6, s), and what says the period, off by `near` [m]."""
    fit = fit_of()
    return np.vstack([on_arrays(fit.model.reading)(fit.values, [], list(pose), [])[0], pose[:2] + near])


def stepped(inputs):
    low, high = made().backend.ends
    return made().backend.step(np.clip(inputs, low, high).astype(np.float32))


def test_what_says_the_period_changes_nothing_else():
    pose = poses(500)
    (a, _), (b, _) = (stepped(inputs_of(pose, near)) for near in (-0.2 * LENGTH, 0.2 * LENGTH))
    assert (a == b).all()


def test_the_decoder_of_the_model_gives_the_same():
    """hallsym's own decoder: weighted least squares of the finite field, from its own start."""
    fit, pose = fit_of(), poses(150)
    inputs = inputs_of(pose)
    weight = [1 / fit.noise.sigmas[c].value ** 2 for c in fit.model.channels]
    run = on_arrays(fit.model.decoded_near)
    found = run(fit.values, [], list(inputs[:-2]), [], weight, list(pose))[0]
    assert np.abs(found - pose).max() < 1e-7
    off = np.abs(stepped(inputs)[0] - found).max(axis=1)
    assert (off <= list(made().backend.error_bound.values())).all()


def test_arrays_that_end_beyond_all_sensors_are_decoded_as_fixed_patches():
    fit = fit_of(length=12 * LENGTH, reach=0.01)
    weight = np.array([1 / fit.noise.sigmas[c].value ** 2 for c in fit.model.channels])
    assert rows.decoupler(fit.model, fit.values, weight, box_of(fit), 2e-5) is None
