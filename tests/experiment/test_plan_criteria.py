"""Optimal design on textbook problems: known designs, brute force."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym.experiment.criteria import CRITERIA, Criterion, choose, criterion

NOTHING = 1e-9


def polynomial(degree: int, places: np.ndarray) -> np.ndarray:
    """Information (places, m, m) of one observation of a polynomial at each place."""
    f = places[:, None] ** np.arange(degree + 1)
    return f[:, :, None] * f[:, None, :]


def criteria(m: int, workspace: np.ndarray | None = None) -> list[Criterion]:
    return [criterion(name, m, np.eye(m)[:, None] if workspace is None else workspace) for name in CRITERIA]


def positive(rng: np.random.Generator, m: int) -> np.ndarray:
    A = rng.normal(size=(m, m + 2)) * 10.0 ** rng.uniform(-2, 2, m)[:, None]
    return A @ A.T


# -- information functions -------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(0.01, 100))
def test_criteria_are_information_functions(seed, m, factor):
    """Homogeneous, concave, growing; and every slope bounds the criterion everywhere."""
    rng = np.random.default_rng(seed)
    a, b, workspace = positive(rng, m), positive(rng, m), rng.normal(size=(5, 2, m))
    for phi in criteria(m, workspace):
        at_a, at_b, between = phi.values(np.array([a, b, 0.5 * (a + b)]))
        assert phi.values(factor * a) == pytest.approx(factor * at_a, rel=1e-6)
        assert between >= 0.5 * (at_a + at_b) * (1 - 1e-6)
        assert phi.values(a + b) >= max(at_a, at_b) * (1 - 1e-6)
        G = phi.slope(a)
        assert np.sum(G * b) >= at_b * (1 - 1e-6)
        assert np.sum(G * a) >= at_a * (1 - 1e-6)


# -- known optimal designs -------------------------------------------------------------------------------

LINE = np.linspace(-1, 1, 21)
# Shares at the ends and the middle of [-1, 1] (Atkinson, Donev & Tobias, Optimum Experimental Designs, 2007)
KNOWN = {1: {-1: 1 / 2, 1: 1 / 2}, 2: {-1: 1 / 3, 0: 1 / 3, 1: 1 / 3}}


@pytest.mark.parametrize("degree", KNOWN)
def test_whole_runs_of_known_designs(degree):
    """60 observations divide as the continuous design says."""
    infos, phi = polynomial(degree, LINE), criterion("D", degree + 1, np.eye(degree + 1)[:, None])
    base = NOTHING * np.eye(degree + 1)
    counts = choose(infos, base, 60, phi, np.random.default_rng(0))
    expected = {place: round(60 * share) for place, share in KNOWN[degree].items()}
    assert {round(LINE[k], 9): int(counts[k]) for k in np.flatnonzero(counts)} == expected


def test_least_worst_variance_is_the_number_of_parameters_over_runs():
    """Kiefer & Wolfowitz: the best design for max f' M^-1 f over the region is D-optimal: m / N."""
    infos = polynomial(2, LINE)
    f = LINE[:, None, None] ** np.arange(3)
    phi, base = criterion("max-u", 3, f), NOTHING * np.eye(3)
    counts = choose(infos, base, 30, phi, np.random.default_rng(0))
    assert {round(LINE[k], 9): int(counts[k]) for k in np.flatnonzero(counts)} == {-1.0: 10, 0.0: 10, 1.0: 10}
    assert float(phi.values(np.tensordot(counts, infos, axes=1))) == pytest.approx(30 / 3, rel=1e-6)


# -- whole runs ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CRITERIA)
@pytest.mark.parametrize("seed", range(4))
def test_the_choice_is_the_best_of_all(name, seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(7, 3, 2))
    infos, base = A @ np.swapaxes(A, 1, 2), NOTHING * np.eye(3)
    phi = criterion(name, 3, rng.normal(size=(6, 1, 3)))
    counts = choose(infos, base, 4, phi, rng)

    def value(picked: np.ndarray) -> float:
        return float(phi.values(base + np.tensordot(picked, infos, axes=1)))

    unit = np.eye(7, dtype=int)
    every = [value(unit[list(p)].sum(axis=0)) for p in combinations_with_replacement(range(7), 4)]
    assert value(counts) == pytest.approx(max(every), rel=1e-9)
