"""Effects of motion are simulated with the columns that they need: rates that no log holds."""

import numpy as np
import pytest

from hallsym.families import build
from hallsym.simulation import NoiseModel, campaign_from, simulate


def test_a_lag_delays_what_is_read():
    """A first-order lag of 1 ms under a sweep at 1 Hz: readings are those of 1 ms before."""
    run = {"duration_s": 1.0, "x_m": {"kind": "sine", "amplitude": 5e-4, "frequency_hz": 1.0}, "z_m": 5e-3}
    campaign = campaign_from({"step_s": 1e-3, "run": [run]}, "a sweep")
    model = build("halbach", added=("first_order_lag",))
    late, now = (simulate(model, {"tau_lag": tau}, campaign, NoiseModel({}), seed=1) for tau in (1e-3, 0.0))
    assert set(late) == {"run", "t_s", *model.channels, *model.references}
    inside = slice(20, -20)
    before = now["col_0_v"][:-1][inside]
    assert late["col_0_v"][1:][inside] == pytest.approx(before, abs=2e-5)
    assert np.abs(late["col_0_v"] - now["col_0_v"]).max() > 2e-4
