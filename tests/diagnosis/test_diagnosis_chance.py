"""Significance of faults of samples, and the products of columns that all tests of effects rest on.

Probabilities are held against scipy.stats and against noise without a fault; products against sums of dense
columns, run by run.
"""

from dataclasses import replace

import numpy as np
import pytest
from gap_twins import machine
from scipy import stats
from test_stacked_products import whitened

import hallsym
from hallsym.diagnosis import Base
from hallsym.diagnosis.faults import assignment_p, assignments, exceeds
from hallsym.diagnosis.normal_equations import Columns, normal_equations
from hallsym.diagnosis.scores import candidates
from hallsym.diagnosis.setup import base_of
from hallsym.estimation.decoding import columns_of
from hallsym.families import effects
from hallsym.families.recording import Correction, corrected
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.log import Log, batches
from hallsym.model import Facts

CATALOGUE = tuple(e for e in effects(STAGE_FAMILY).values() if e.diagnosed)


def fitted(log: Log) -> Base:
    return base_of(log, hallsym.fit(log, "stage31", solver="direct", loss="none", accept=["all"]))


@pytest.fixture(scope="module")
def quiet() -> Base:
    return fitted(machine("multisine", seed=5, thin=6))


@pytest.mark.parametrize("weight", [4, 8, 30])
def test_tails_follow_from_the_body_of_heavy_noise(weight: int) -> None:
    rng = np.random.default_rng(weight)
    values = 2 * rng.f(2, weight, 100_000)
    limit = 2 * stats.f.isf(1e-4, 2, weight)
    white = rng.chisquare(2, 100_000)
    assert 1e-4 < exceeds(values, 2, limit, white) < 2e-4  # at the upper end of what the body says
    gaussian = rng.chisquare(2, 100_000)
    assert 1e-4 < exceeds(gaussian, 2, stats.chi2.isf(1e-4, 2), white) < 2e-4


def test_exchanged_channels_are_certain_and_the_right_order_is_not(quiet: Base) -> None:
    assert assignments(3) == 47
    channels = quiet.model.channels
    wrong = corrected(quiet.log, [Correction("exchange", channels[:2])])
    assert assignment_p(quiet, wrong, quiet.log.runs) < 1e-9
    assert assignment_p(quiet, quiet.log, quiet.log.runs) == 1.0


def test_products_are_the_sums_over_dense_columns(quiet: Base) -> None:
    log = quiet.log
    cut = {c: log.array(c) for c in log.columns}
    cut["run"] = np.searchsorted([700, 1900, 2000, 4100], np.arange(log.rows), "right")  # unequal lengths
    base = replace(quiet, log=Log.from_arrays(cut, log.noise, log.meta), offsets={})
    facts = Facts(60.0, log.columns)
    names = {"odd_nonlinearity", "vertical_offset_coupling", "reference_abbe_error", "second_order_rotation"}
    tried, _ = candidates(base, [e for e in CATALOGUE if e.name in names], facts)
    plain = {key: (model, new) for key, (_, _, model, new) in tried.items()}
    t = normal_equations(base, plain)
    work = Columns(base, plain)
    for batch in batches(base.log, columns_of(base.model)):
        white = whitened(work, batch, None)
        for run, part in batch.parts():
            W = white[:, :, part].reshape(len(white), -1)
            z = work.z
            rest = W[z:] - (W[z:] @ np.linalg.pinv(W[:z])) @ W[:z]
            unit = t.runs.index((run,))
            own = slice(0, t.span[""].stop)
            dense = rest @ rest.T
            size = np.sqrt(np.diag(dense))
            for key, span in t.span.items():
                pick = np.r_[own, span, len(dense) - 1] if key else np.r_[own, len(dense) - 1]
                scale = np.outer(size[pick], size[pick])
                difference = dense[np.ix_(pick, pick)] - t.of(key)[unit]
                assert np.abs(difference / scale).max() < 1e-9
