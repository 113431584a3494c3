"""What a log tells before effects are tried, against logs whose facts are known."""

from types import SimpleNamespace

import numpy as np

from hallsym.diagnosis import POLICY
from hallsym.diagnosis.facts import switched_runs

RUNS, SAMPLES, CHANNELS = 14, 30, 2


def residual_of(offsets: np.ndarray, rng: np.random.Generator) -> SimpleNamespace:
    """A residual of white noise of size 1, with an offset (runs, channels) in each run."""
    run = np.repeat(np.arange(len(offsets)), SAMPLES)
    residual = rng.standard_normal((CHANNELS, len(run))) + offsets[run].T
    return SimpleNamespace(
        run=run, residual=residual, precision=np.eye(CHANNELS), base=SimpleNamespace(policy=POLICY)
    )


def test_a_field_that_is_on_in_some_runs_makes_two_levels():
    on = np.isin(np.arange(RUNS), (3, 4, 6))
    assert switched_runs(residual_of(np.outer(on, [3.0, -2.0]), np.random.default_rng(0))) == (3, 4, 6)


def test_few_runs_have_no_levels():
    assert switched_runs(residual_of(np.zeros((4, 2)), np.random.default_rng(2))) == ()
