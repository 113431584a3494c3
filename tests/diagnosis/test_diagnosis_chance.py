"""Significance of faults of samples, and the products of columns that all tests of effects rest on.

Probabilities are held against scipy.stats and against noise without a fault; products against sums of dense
columns, run by run.
"""

import numpy as np
import pytest
from gap_twins import faulty, machine

import hallsym
from hallsym.diagnosis import POLICY, Base
from hallsym.diagnosis.faults import assignment_p, assignments, faults, of_samples
from hallsym.diagnosis.setup import base_of
from hallsym.diagnosis.survey import Survey, survey
from hallsym.families.recording import Correction, corrected
from hallsym.log import Log

TESTED = 30


def p_values(found: Survey) -> dict[str, float]:
    return {f.name: f.p_value for f in of_samples(found, POLICY)} | {"adc_quantisation": found.step_p}


def fitted(log: Log) -> Base:
    return base_of(log, hallsym.fit(log, "stage31", solver="direct", loss="none", accept=["all"]))


@pytest.fixture(scope="module")
def quiet() -> Base:
    return fitted(machine("multisine", seed=5, thin=6))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["outliers", "dropped_samples", "clock_jitter", "adc_quantisation"])
def test_p_values_of_faults_come_from_the_samples(name: str) -> None:
    log = machine("multisine", (faulty(np.random.default_rng(1))[name],), seed=1)
    base = fitted(log)
    found = survey(base, frozenset(base.log.runs))
    first = faults(base, found, TESTED)[0]
    assert (first.name, first.p_value < 1e-4) == (name, True)
    # less of the log is less certain
    part = survey(base, frozenset(base.log.runs[:1]))
    assert p_values(part).get(name, 1.0) >= p_values(found)[name]


def test_exchanged_channels_are_certain_and_the_right_order_is_not(quiet: Base) -> None:
    assert assignments(3) == 47
    channels = quiet.model.channels
    wrong = corrected(quiet.log, [Correction("exchange", channels[:2])])
    assert assignment_p(quiet, wrong, quiet.log.runs) < 1e-9
    assert assignment_p(quiet, quiet.log, quiet.log.runs) == 1.0
