"""The median without its overhead is the median."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hallsym.model.arrays import median, medians

NUMBERS = st.floats(-1e300, 1e300) | st.just(float("nan"))


@given(st.lists(NUMBERS, min_size=1, max_size=60))
def test_it_is_numpys(values: list[float]) -> None:
    before = np.array(values)
    np.testing.assert_array_equal(median(before), np.median(before))
    np.testing.assert_array_equal(before, values)  # and leaves them in their order


def test_there_is_none_of_nothing() -> None:
    assert np.isnan(median(np.array([])))


@given(st.integers(1, 9).flatmap(lambda n: st.lists(st.lists(NUMBERS, min_size=n, max_size=n), min_size=1)))
def test_they_are_those_of_the_rows(rows: list[list[float]]) -> None:
    np.testing.assert_array_equal(medians(np.array(rows)), [median(np.array(row)) for row in rows])
