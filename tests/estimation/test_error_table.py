"""The 95 % interval of an rmse holds the truth as often as it says, by simulation."""

import numpy as np
import pytest

from hallsym.estimation.calibration import FEWEST, rmse_interval
from hallsym.estimation.decoding import ErrorTable


def a_table(errors: np.ndarray) -> ErrorTable:
    """Errors (runs, samples) of one output."""
    runs, samples = errors.shape
    squares, peak = (errors**2).sum(axis=1), np.abs(errors).max(axis=1)
    return ErrorTable(("x_m",), tuple(range(runs)), np.full(runs, samples), squares[:, None], peak[:, None])


@pytest.mark.parametrize("runs", [FEWEST, 11, 40])
def test_the_interval_of_an_rmse_holds_the_true_one(runs: int) -> None:
    """Runs whose errors are correlated by .2 and differ by 20 % in size; 1000 logs: 1 sigma is .7 %."""
    rng, spread, held = np.random.default_rng(7), 0.2, 0
    for _ in range(1000):
        size = np.exp(spread * rng.standard_normal((runs, 1)) - spread**2)  # mean square 1
        noise = rng.standard_normal((runs, 30))
        own = rng.standard_normal((runs, 1))
        low, high = rmse_interval(a_table(size * (0.2**0.5 * own + 0.8**0.5 * noise)))["x_m"]
        held += low <= 1 <= high
    assert 0.91 < held / 1000 < 0.975


def test_too_few_runs_and_errors_of_nothing_have_no_interval() -> None:
    rng = np.random.default_rng(8)
    assert rmse_interval(a_table(rng.standard_normal((FEWEST - 1, 30)))) == {}
    assert rmse_interval(a_table(np.zeros((8, 30)))) == {}
