"""A log of a campaign and its fit, of which tests make pages and pictures."""

import pytest
from reports import HOLDOUT
from twins import record, with_noise

from hallsym.estimation import Fit, fit
from hallsym.log import Log


@pytest.fixture(scope="session")
def log() -> Log:
    return with_noise(record(seed=1))


@pytest.fixture(scope="session")
def fitted(log: Log) -> Fit:
    return fit(log, "stage31", solver="direct", loss="none", holdout=HOLDOUT)
