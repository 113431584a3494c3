"""Latin hypercube, and starts that are good and apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solvers import Population, Problem, screened_starts
from solvers.driver import best_separated, latin_hypercube


@given(st.integers(1, 60), st.integers(1, 6), st.integers(0, 9))
def test_one_point_in_every_slice_of_every_dimension(n, dim, seed):
    lower, upper = np.full(dim, -3.0), np.linspace(1.0, 7.0, dim)
    x = latin_hypercube(n, lower, upper, np.random.default_rng(seed))
    slices = np.floor((x - lower) / (upper - lower) * n * (1.0 - 1e-12))
    assert (np.sort(slices, axis=0) == np.arange(n)[:, None]).all()


def valleys(x):
    """Three valleys on a line, ever deeper, the second variable fixed."""
    return np.cos(6.0 * np.pi * x[:, 0]) - x[:, 0]


LINE = Problem(valleys, [0.0, 7.0], [1.0, 7.0])


def test_screening_finds_all_valleys_cheapest_first():
    starts = screened_starts(LINE, 400, 3, np.random.default_rng(0), separation=0.2)
    assert starts.x[:, 0] == pytest.approx([5 / 6, 1 / 2, 1 / 6], abs=0.01)
    assert (np.diff(starts.cost) > 0).all()
    assert np.array_equal(starts.cost, valleys(starts.x))


def test_kept_points_are_apart_and_none_better_was_passed_over():
    rng = np.random.default_rng(1)
    box = Problem(valleys, [0.0, 0.0, 5.0], [1.0, 10.0, 5.0])
    x = rng.uniform(box.lower, box.upper, (200, 3))
    kept = best_separated(Population(x, valleys(x)), 12, box, separation=0.15)
    unit = kept.x[:, :2] / [1.0, 10.0]
    distance = np.sqrt(np.square(unit[:, None] - unit).mean(axis=2))
    assert distance[~np.eye(len(kept), dtype=bool)].min() >= 0.15
    assert len(kept) == 12
    for row, cost in zip(x, valleys(x), strict=True):
        cheaper = unit[kept.cost < cost]
        near = np.sqrt(np.square(cheaper - row[:2] / [1.0, 10.0]).mean(axis=1)) < 0.15
        assert cost >= kept.cost[-1] or near.any() or (kept.x == row).all(axis=1).any()


def test_fewer_come_back_when_there_are_no_more():
    collapsed = Population(np.full((20, 2), [0.5, 7.0]), np.zeros(20))
    assert len(best_separated(collapsed, 3, LINE)) == 1
    hopeless = Population(np.full((20, 2), [0.5, 7.0]), np.full(20, np.inf))
    assert len(best_separated(hopeless, 3, LINE)) == 0


def test_infinite_box_is_refused():
    with pytest.raises(ValueError, match="Input upper of Problem, in screened_starts, must be finite"):
        screened_starts(Problem(valleys, [0.0], [np.inf]), 9, 3, np.random.default_rng(0))
