"""C for an array that travels over a longer board: absolute place and gap, sensors weighted as they see it.

Independent facts: the finite field of magnetised rectangles at a known pose; hallsym's own decoder, which
fits all readings with that field; a place moves by as much as the mover does, also where sensors come and go.
"""

from functools import cache

import numpy as np
import pytest
from msgspec import structs
from waves import calibrated

import hallsym
from hallsym.errors import InputError
from hallsym.families.halbach.effects import ends
from hallsym.families.halbach.layout import columns
from hallsym.families.halbach.models import halbach
from hallsym.model import on_arrays

VALUES = {"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4, "edges": 1.0}
REACH, GAPS = 0.08, (0.004, 0.007)
FIELD, COVER = 0x40000000, 0x20000000


@cache
def fit_of(count=18, reach=REACH):
    """A board of 18 columns at 10 mm, an array of three periods, a third of it over no sensor at the ends."""
    places = [(j - (count - 1) / 2) * 0.01 for j in range(count)]
    fit = calibrated(ends.array_edges(halbach(columns(places, length_m=0.09))), VALUES, gaps=GAPS, sigma=1e-3)
    return fit.changed(log=structs.replace(fit.log, span={"x_ref_m": (-reach, reach), "z_ref_m": GAPS}))


@cache
def made():
    return hallsym.generate(fit_of())


def read(x, z):
    fit = fit_of()
    return on_arrays(fit.model.reading)(fit.values, [], [x, z], [])[0]


@pytest.mark.slow
def test_readings_give_place_and_gap_back_over_all_of_the_board():
    rng, backend = np.random.default_rng(1), made().backend
    x, z = rng.uniform(-REACH, REACH, 4000), rng.uniform(*GAPS, 4000)
    pose, status = backend.step(read(x, z).astype(np.float32))
    assert not status.any()
    assert (np.abs(pose - [x, z]).max(axis=1) <= list(backend.error_bound.values())).all()
    assert max(backend.error_bound.values()) < 6e-5  # a third of an array is all that is left at the ends
    inner = np.abs(x) < 0.04
    assert np.abs(pose - [x, z])[:, inner].max() < 2e-5


@pytest.mark.slow
def test_nothing_steps_as_sensors_come_and_go():
    x = np.linspace(-REACH, REACH, 16_001)
    pose, _ = made().backend.step(read(x, np.full_like(x, 5e-3)).astype(np.float32))
    off = pose - [x, np.full_like(x, 5e-3)]
    assert np.abs(np.diff(off, axis=1)).max() < 5e-7  # in 10 um of travel


@pytest.mark.slow
def test_the_reference_is_the_decoder_of_the_model():
    x, z = np.array([-0.07, 0.013, 0.055]), np.array([4.2e-3, 5e-3, 6.5e-3])
    assert np.abs(made().decoupler.exact(read(x, z)) - [x, z]).max() < 1e-9


@pytest.mark.slow
def test_no_array_and_an_array_off_the_board_raise_a_flag():
    backend = made().backend
    nothing = np.zeros((len(backend.inputs), 1), dtype=np.float32)
    noise = np.random.default_rng(2).normal(0, 1e-3, (len(backend.inputs), 200)).astype(np.float32)
    for given in (nothing, noise):
        pose, status = backend.step(given)
        assert (status & FIELD == FIELD).all()
        assert np.isfinite(pose).all()
    far = np.array([-0.15, 0.14, 0.16])
    assert (backend.step(read(far, np.full(3, 5e-3)).astype(np.float32))[1] & (FIELD | COVER) != 0).all()
    near = np.clip(read(np.array([0.01]), np.array([1.5e-3])), *np.array(backend.span))
    assert backend.step(near.astype(np.float32))[1] & FIELD


@pytest.mark.slow
def test_what_is_not_generated_is_refused_in_one_sentence():
    with pytest.raises(InputError, match=r"too few sensors see .* to tell x_m and which period"):
        hallsym.generate(fit_of(18, 0.14))
