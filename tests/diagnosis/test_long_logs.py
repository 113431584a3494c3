"""A long log is decimated before it is diagnosed: the answer is that of all samples."""

import sys

import numpy as np
import pytest
from twins import SIGMAS, record, with_noise

from hallsym.diagnosis import Diagnosis, diagnose
from hallsym.log import Log

SAMPLES, EVERY = 400, 3


def bent(cubic: float) -> Log:
    """The twin's campaign, one reading with a cubic error of this size [m]."""
    columns = record(seed=3, samples=SAMPLES)
    x = columns["hall_a_m"] / np.std(columns["hall_a_m"])
    return with_noise(columns | {"hall_a_m": columns["hall_a_m"] + cubic * x**3}, SIGMAS)


def held(log: Log, rows: int, monkeypatch: pytest.MonkeyPatch) -> Diagnosis:
    """Diagnose so many samples at most."""
    monkeypatch.setattr(sys.modules["hallsym.diagnosis.setup"], "CACHED_ROWS", rows)
    return diagnose(log)


@pytest.mark.slow
def test_some_samples_say_what_all_samples_say(monkeypatch: pytest.MonkeyPatch) -> None:
    log = bent(1.5e-6)
    whole, some = (held(log, rows, monkeypatch) for rows in (log.rows, log.rows // EVERY))
    assert (some.verdict, some.ranked) == (whole.verdict, whole.ranked)
    assert whole.ranked == ("odd_nonlinearity",)
    assert some.significance is not None
    assert whole.significance is not None
    assert some.significance.units == whole.significance.units
    assert any(f"every {EVERY}. sample" in note for note in some.notes)
    assert not any("every" in note for note in whole.notes)
    # an rms of n numbers is known to 1 / sqrt(2 n); three coordinates of the pose, of a fifth of the samples
    error = 3 / np.sqrt(2 * 3 * log.rows / EVERY / 5)
    assert abs(some.metric.before / whole.metric.before - 1) < error
    assert abs(some.metric.after / whole.metric.after - 1) < error
    (one,), (other,) = some.effects, whole.effects
    for name, estimate in one.parameters.items():
        known = other.parameters[name]
        assert abs(estimate.value - known.value) < 3 * np.hypot(estimate.std, known.std)
