"""C for grids of many single sensors under the four arrays of a mover: 24 readings, and 48.

A status has 32 bits: neighbours among more inputs share one. Independent facts: the bits of numpy's own
arithmetic in float32; a pose is what its readings were computed from.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from firmware import Library, need, passes, written
from msgspec import structs
from waves import calibrated

import hallsym
from hallsym.codegen.backend import COUNT
from hallsym.codegen.decoupler import FLAG_BITS
from hallsym.families.halbach.layout import Sensor, arrays
from hallsym.families.halbach.planar import halbach_planar, pinwheel
from hallsym.model import on_arrays

GRIDS = {24: (6, 1), 48: (6, 2)}
"""Readings: sensors along and across each of the four arrays."""
STROKE, GAPS, TILT, ACCURACY = 0.0125, (0.0045, 0.0085), 0.005, 2e-5


@cache
def fit_of(count):
    along, across = GRIDS[count]
    found, made = arrays(pinwheel()), []
    for array in found.values():
        own, other = array.axis, 1 - array.axis
        for i in range(along * across):
            at = list(array.centre)
            at[own] += (i // across - (along - 1) / 2) * array.wavelength_m / 3
            at[other] += (i % across - (across - 1) / 2) * array.wavelength_m / 3
            made.append(Sensor(f"hall_{len(made)}_0_v", ((at[0], at[1]),), array.name))
    fit = calibrated(
        halbach_planar((*made, *found.values())), {"a1": 0.62, "a5": -6e-4, "rx0": 1e-3}, gaps=GAPS
    )
    span = {c: [-STROKE, STROKE] for c in ("x_ref_m", "y_ref_m")} | {"z_ref_m": list(GAPS)}
    span |= {f"r{a}_ref_rad": [-TILT, TILT] for a in "xyz"}
    return fit.changed(log=structs.replace(fit.log, span=span))


def read(count, poses=60):
    """Random poses (6, s) of the box, and their readings (n, s)."""
    half = np.array([STROKE, STROKE, (GAPS[1] - GAPS[0]) / 2, TILT, TILT, TILT])
    pose = half[:, None] * np.random.default_rng(1).uniform(-1, 1, (6, poses))
    pose[2] += sum(GAPS) / 2
    fit = fit_of(count)
    return pose, on_arrays(fit.model.reading)(fit.values, [], list(pose), [])[0].astype(np.float32)


@cache
def made(count):
    return hallsym.generate(fit_of(count), accuracy=ACCURACY)


@pytest.mark.parametrize("count", [24, pytest.param(48, marks=pytest.mark.slow)])
def test_a_grid_is_decoded_and_a_reading_that_is_none_has_its_bit(count, tmp_path):
    need("gcc")
    code = made(count)
    library = Library(written(code, tmp_path / "fw"), code.decoupler, np.float32)
    pose, inputs = read(count)
    found, status = code.backend.step(inputs)
    assert not status.any()
    assert (np.abs(found - pose).max(axis=1) <= list(code.backend.error_bound.values())).all()
    bits = code.decoupler.input_bits
    own = FLAG_BITS - len(code.decoupler.flags) - code.decoupler.mends
    assert own in (
        27,
        28,
    )  # the others are of the flags: field, tilt, a fault, and a pose without its suspect
    assert len(set(bits)) == min(count, own)
    assert max(bits) < min(1 << own, 1 << count)
    for k in range(count):
        given = inputs[:, k % inputs.shape[1]].copy()
        given[k] = np.nan
        out, said = library.step(given)
        assert said & ((1 << own) - 1) == bits[k]
        assert np.isfinite(out).all()
    out, said = library.step(np.full(count, np.nan, np.float32))
    assert said & ((1 << own) - 1) == sum(set(bits))
    assert out.tobytes() == code.backend.step(np.full((count, 1), np.nan))[0].astype(np.float32).tobytes()


@pytest.mark.parametrize("count", [72, 200])
def test_bits_of_any_number_of_readings_are_shared_by_neighbours(count):
    """Each bit by as many as any other, or one more."""
    d = made(24).decoupler
    bits = replace(d, inputs=tuple(map(str, range(count)))).input_bits
    own = FLAG_BITS - len(d.flags) - d.mends
    assert list(bits) == sorted(bits)
    shared = [bits.count(1 << k) for k in range(own)]
    assert sum(shared) == count
    assert max(shared) - min(shared) <= 1


@pytest.mark.slow
def test_the_self_test_of_48_sensors_tries_each_of_them(tmp_path):
    code = made(48)
    status = code.backend.vectors.status[COUNT : COUNT + 6 * 48].reshape(48, 6)
    assert (status & np.array(code.decoupler.input_bits)[:, None] > 0).all()
    text = str(code.files["decoupler.c"])
    assert "*status |= bit;" in text
    assert "*status += bit;" not in text
    passes(written(code, tmp_path / "fw"))
