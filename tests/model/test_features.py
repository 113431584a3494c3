"""Features times coefficients are the reading, for every model with its effects, about any centre."""

from itertools import product

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import EPS, combinations_of_effects, inside

from hallsym.errors import InputError
from hallsym.families import build
from hallsym.families.stage.models import stage15
from hallsym.model import find_features

seeds = st.integers(0, 2**32 - 1)
CASES = combinations_of_effects()
FOUND = {case: find_features(build(case[0], added=case[1])) for case in CASES}


@settings(max_examples=15)
@given(seeds)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_features_times_coefficients_are_the_reading(case, seed):
    features = FOUND[case]
    model, rng = features.model, np.random.default_rng(seed)
    p, d = inside(model, rng), rng.uniform(-1e-5, 1e-5, len(model.offsets))
    q, s = rng.uniform(-2e-3, 2e-3, (2, 3))
    near = np.asarray(features.variables(rng.uniform(-2e-3, 2e-3, 3), rng.uniform(-2e-3, 2e-3, 3))).ravel()
    for centre in (np.zeros(len(near)), near, near + rng.uniform(-1, 1, len(near))):
        values = features.values(q, s, centre)[0]
        terms = np.asarray(features.coefficients(p, d, centre)) * values[:, None]
        reading = np.asarray(model.reading(p, d, q, s)).ravel()
        size = np.abs(terms).sum(axis=0)
        # each term has at most a dozen roundings of its own, cancelling parts included in its coefficient
        inner = 1.0 if not centre.any() else 5e3 * 3.0  # largest slope times largest distance from zero
        assert np.all(
            np.abs(terms.sum(axis=0) - reading) <= 32 * EPS * (size + inner * np.abs(values).max() * 3)
        )


def test_features_of_the_articles_model_are_pose_and_one_times_state_and_one():
    names = {"*".join(n for n in (q, s) if n) or "1" for q, s in product(
        ("", "x_m", "y_m", "rz_rad"), ("", "z_m", "rx_rad", "ry_rad")
    )}  # fmt: skip
    features = FOUND["stage31", ()]
    assert {features.label(j) for j in range(features.size)} == names
    assert [features.label(j) for j in range(features.n_zero)] == ["1", "z_m", "rx_rad", "ry_rad"]


@pytest.mark.parametrize(
    ("case", "size", "n_zero"),
    [
        (("stage15", ()), 4, 0),
        (("stage30", ()), 4, 1),
        (("stage31", ()), 16, 4),
        (("stage31_tied", ()), 16, 4),
    ],
)
def test_features_that_carry_zeros_come_first(case, size, n_zero):
    features = FOUND[case]
    assert (features.size, features.n_zero) == (size, n_zero)
    model, rng = features.model, np.random.default_rng(0)
    p = inside(model, rng)
    centre = rng.normal(size=6)
    none, some = np.zeros(len(model.offsets)), np.full(len(model.offsets), 1e-6)
    change = np.asarray(features.coefficients(p, some, centre)) - np.asarray(
        features.coefficients(p, none, centre)
    )
    assert np.array_equal(np.any(change != 0, axis=1), np.arange(size) < n_zero)


@settings(max_examples=25)
@given(seeds)
@pytest.mark.parametrize(
    "case", [("stage15", ()), ("stage31", ()), ("stage31", ("exact_rotation",))], ids=str
)
def test_shift_moves_coefficients_to_another_centre(case, seed):
    """T is the binomial theorem: T(o) c(centre - o) = c(centre), T(0) = 1, T(a) T(b) = T(a + b)."""
    features = FOUND[case]
    model, rng = features.model, np.random.default_rng(seed)
    p, d = inside(model, rng), rng.uniform(-1e-5, 1e-5, len(model.offsets))
    centre, offset, more = rng.uniform(-1e-2, 1e-2, (3, features.exponents.shape[1]))
    here = np.asarray(features.coefficients(p, d, centre - offset))
    there = np.asarray(features.coefficients(p, d, centre))
    T = features.shift(offset)
    assert np.allclose(T @ here, there, rtol=0, atol=64 * EPS * (np.abs(T) @ np.abs(here)).max())
    assert np.array_equal(features.shift(0 * offset), np.eye(features.size))
    both = features.shift(offset) @ features.shift(more)
    assert np.allclose(both, features.shift(offset + more), rtol=1e-13, atol=1e-18)


@settings(max_examples=20)
@given(seeds)
@pytest.mark.parametrize("case", [("stage31", ()), ("stage31", ("exact_rotation",))], ids=str)
def test_slopes_are_derivatives_of_values(case, seed):
    """Central differences; features are polynomials of low degree, so the step may be large."""
    features = FOUND[case]
    rng = np.random.default_rng(seed)
    point, centre = rng.uniform(-1, 1, 6), rng.uniform(-1, 1, features.exponents.shape[1])
    slopes = np.zeros((6, features.size))
    slopes[tuple(features.slope_entries)] = features.slopes(point[:3], point[3:], centre)[0]
    own = np.arange(features.size) >= features.n_zero  # the others are left out
    for column in range(6):
        step = np.eye(6)[column] * 1e-4
        high, low = (features.values((point + e)[:3], (point + e)[3:], centre)[0] for e in (step, -step))
        assert np.allclose(own * (high - low) / 2e-4, slopes[column], rtol=0, atol=1e-7)


def test_a_derived_quantity_keeps_readings_polynomial():
    features = FOUND["stage15", ("exact_rotation",)]
    assert {features.label(j) for j in range(features.size)} >= {
        "1 - cos rz",
        "sin rz",
        "x_m*1 - cos rz",
        "y_m*sin rz",
    }


def replaced(link, change):
    return stage15().with_step(link, lambda s, p: s.__setitem__("displacement", change(s)), effect="odd")


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s["displacement"] + ca.sin(s["x_m"]),
        lambda s: s["displacement"] / (1 + s["z_m"]),
        lambda s: s["displacement"] ** 7,
        lambda s: s["displacement"] + ca.fabs(s["x_m"]) * s["x_m"],
    ],
)
def test_readings_that_are_no_polynomial_are_refused(change):
    with pytest.raises(InputError, match=r"stage15 with effects odd .* Signals\.derive"):
        find_features(replaced("mechanics", change))


@pytest.mark.parametrize(
    "change", [lambda s: ca.fabs(s["displacement"]), lambda s: ca.floor(s["displacement"] * 1e6)]
)
def test_readings_with_kinks_and_steps_are_refused(change):
    """Their second derivative is zero almost everywhere: differentiation alone does not see it."""
    with pytest.raises(InputError):
        find_features(replaced("mechanics", change))
