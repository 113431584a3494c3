"""C for one decaying wave: place along an array and height over it, from sums of Hall sensors.

Independent facts: the field's own equation at a known place and height (`waves`); the closed form of
Maguire's thesis (2-16 to 2-20) where there is no fifth harmonic; numpy's arctangent and logarithm.
"""

import numpy as np
import pytest
from calibrations import made
from waves import LC, LENGTH

from hallsym.codegen import cost_of
from hallsym.families import halbach


def turned(difference, period=LENGTH):
    return np.abs(difference - period * np.round(difference / period))


# -- place and height ----------------------------------------------------------------------------------------


def test_ideal_sums_are_the_closed_form_of_the_thesis():
    code = made("first harmonic alone")
    a, b = np.random.default_rng(6).uniform(-1.0, 1.0, (2, 20_000)).astype(np.float32)
    c = -(a + b)  # a third of a period apart, sums of one wave add up to nothing
    pose, status = code.backend.step(np.array([a, b, c]))
    bx = np.sqrt(2 / 3) * (a.astype(float) - b / 2.0 - c / 2.0)
    by = np.sqrt(2 / 3) * np.sqrt(3) / 2 * (b.astype(float) - c)
    # readings at 0, 1/3 and 2/3 of the period read cos, cos(t + 2 pi / 3), cos(t + 4 pi / 3) of t = -x / lc
    x = LC * np.arctan2(by, bx)
    z = -LC / 2 * np.log((bx**2 + by**2) / 1.5 / (4 * 0.8875) ** 2)
    clear = status == 0
    assert clear.mean() > 0.2
    assert turned(pose[0] - x)[clear].max() < code.backend.error_bound["x_m"]
    assert np.abs(pose[1] - z)[clear].max() < code.backend.error_bound["z_m"]


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", [1e-7, 2e-8])
def test_an_accuracy_that_is_asked_for_is_kept_by_more_rounds(accuracy):
    code = made("three sums", accuracy=accuracy)
    assert code.decoupler.slack <= accuracy < made("three sums").decoupler.slack
    assert len(code.decoupler.steps) > len(made("three sums").decoupler.steps)
    assert max(code.errors.values()) <= max(code.backend.error_bound.values())
    assert code.backend.record["options"] == {"accuracy": accuracy}


# -- ranges and status ---------------------------------------------------------------------------------------


def test_its_cost_is_counted_without_a_compiler_about_its_typical_gap():
    model = halbach.models.halbach()
    cost = cost_of(model, model.vector({"a1": 0.62, "a5": -6e-4}))  # at a gap of 0 it would not converge
    assert 100 < cost.instructions < 160
