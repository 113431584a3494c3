"""Studies of tolerances, which are computed once."""

import numpy as np
import pytest

from hallsym.families import build
from hallsym.uncertainty.tolerances import Tolerances, Workspace, tolerances


@pytest.fixture(scope="session")
def model():
    return build("stage15")


@pytest.fixture(scope="session")
def somewhere() -> Workspace:
    rng = np.random.default_rng(5)
    return Workspace(
        rng.uniform(-1, 1, (3, 7)) * np.array([[3e-4], [5e-4], [3e-4]]), rng.uniform(-2e-4, 2e-4, (3, 7))
    )


@pytest.fixture(scope="session")
def paper(model) -> Tolerances:
    return tolerances(model, seed=0, samples=256)
