"""Gains, offsets and places of sensors recovered from campaigns of cuboid magnets (magpylib)."""

import numpy as np
import pytest
from halbach_campaigns import deviations, four_arrays, one_array

WITHIN = 4.0
"""Standard uncertainties."""


def recovered(model, seed):
    pytest.importorskip("magpylib")
    off = np.array(list(deviations(model, seed).values()))
    assert np.abs(off).max() < WITHIN
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.6  # nor are the uncertainties larger than they need be


@pytest.mark.slow
def test_sensors_under_one_array_and_sums_under_four_are_recovered():
    recovered(one_array(rows=1), 100)
    recovered(four_arrays(), 0)
