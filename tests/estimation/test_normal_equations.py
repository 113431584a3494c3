"""Normal equations: what is left once the offsets of each run are eliminated."""

import numpy as np
import pytest

from hallsym.estimation.factors import eliminate, inverse, pseudo_inverse, solve

RUNS, OFFSETS, SHARED = 6, 3, 5
UNITS = 10.0 ** np.array([-6, -6, -6, 0, 3, -7, 5, 0])
"""Offsets in um, parameters in their own units: columns that differ by twelve decades."""


def columns(seed: int = 4) -> np.ndarray:
    """Columns [offsets | parameters] of each run, (runs, samples, v)."""
    return np.random.default_rng(seed).standard_normal((RUNS, 40, OFFSETS + SHARED)) * UNITS


def test_an_offset_that_no_sample_shows_stays_where_it_is():
    A = columns()
    A[2, :, 1] = 0.0
    left, follow = eliminate(np.swapaxes(A, 1, 2) @ A, OFFSETS)
    assert np.all(follow[2, 1] == 0.0)
    others = np.delete(A[2], 1, axis=1)
    expected, _ = eliminate(others.T @ others, OFFSETS - 1)
    assert left[2] == pytest.approx(expected, rel=1e-9)


def test_inverses_do_not_depend_on_units():
    A = columns()[0]
    plain = A / UNITS
    outer = np.outer(UNITS, UNITS)
    for invert in (inverse, pseudo_inverse):
        assert invert(A.T @ A) * outer == pytest.approx(invert(plain.T @ plain), rel=1e-9)


def test_singular_equations_have_their_least_norm_solution():
    A = np.array([[2.0, 2.0], [2.0, 2.0]])
    assert solve(A, np.array([[2.0], [2.0]])) == pytest.approx(np.array([[0.5], [0.5]]))
