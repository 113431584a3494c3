"""A summary keeps what a least-squares cost can ask of a run, however the samples arrive."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import SIGMAS, Chopped, cost_on, record, true_model, with_noise

from hallsym.estimation.factors import RunStatistics, summarise
from hallsym.estimation.identifiable import determine
from hallsym.estimation.likelihood import cost_of
from hallsym.estimation.optimum import refit
from hallsym.log import Log

EXACT_STATE = {**SIGMAS, "z_m": 0.0, "rx_rad": 0.0, "ry_rad": 0.0}
"""State noise weighs by the distance from the centre: 70/rad x 80 nrad x .5 mm = 3 nm of 500 nm."""
SAME = 1e-10
"""QR keeps 1e-16 of 500 um, 2e-10 of a residual's 0.5 um, and rounding does not add up."""


@pytest.fixture(scope="module")
def log() -> Log:
    return with_noise(record(seed=3, samples=40))


@pytest.fixture(scope="module")
def model():
    return true_model()


def value(summary: RunStatistics, p: np.ndarray, sigma=EXACT_STATE) -> float:
    return cost_of(summary, sigma).at(p).value


@settings(max_examples=5)
@given(st.lists(st.integers(4, 60), min_size=1, max_size=3))
def test_block_size_does_not_matter(log, model, sizes):
    whole, pieces = summarise(log, model), summarise(Chopped(log, sizes), model)
    p = model.nominal * 1.001
    assert pieces.runs == whole.runs
    assert np.array_equal(pieces.counts, whole.counts)
    assert np.array_equal(pieces.first_state, whole.first_state)
    assert value(pieces, p) == pytest.approx(value(whole, p), rel=SAME)
    assert value(pieces, p, SIGMAS) == pytest.approx(value(whole, p, SIGMAS), rel=1e-4)


def test_a_metre_of_common_offset_changes_nothing(log, model):
    """The zeros of the runs absorb it: cost and optimum stay within 1e-6 standard deviations."""
    columns = {c: log.array(c) for c in log.columns}
    moved = with_noise({c: v + (1.0 if c in ("x_ref_m", "y_ref_m") else 0.0) for c, v in columns.items()})
    near, far = cost_on(log, model), cost_on(moved, model)
    held = determine(near, model.nominal).fixed
    p = refit(near, model.nominal, held)
    free = [k for k in range(len(p)) if k not in held]
    information = near.at(p).information(1.0).sum(axis=0)[np.ix_(free, free)]
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    assert np.all(np.abs(refit(far, p, held) - p)[free] < 1e-6 * std)
    # a change of every whitened residual by 1e-6 changes F = sum of squares by 2e-6 F at most
    assert far.at(p).value == pytest.approx(near.at(p).value, rel=2e-6)


def test_weight_zero_is_a_missing_sample(log, model):
    columns = {c: log.array(c) for c in log.columns}
    keep = np.random.default_rng(1).random(log.rows) < 0.7
    short = with_noise({c: v[keep] for c, v in columns.items()})
    masked = {run: keep[columns["run"] == run].astype(float) for run in log.runs}
    weighed = summarise(log, model, weigh=lambda block: masked[block.run])
    kept = summarise(short, model)
    p = model.nominal * 1.001
    assert np.array_equal(weighed.counts, kept.counts)
    assert value(weighed, p) == pytest.approx(value(kept, p), rel=SAME)


def test_runs_shorter_than_their_features_are_summarised(log, model):
    columns = {c: log.array(c) for c in log.columns}
    first = np.concatenate([np.flatnonzero(columns["run"] == r)[: 3 + r % 4] for r in log.runs])
    summary = summarise(with_noise({c: v[first] for c, v in columns.items()}), model)
    assert summary.triangles.shape == (57, 6, summary.features.size + 3)  # the longest has 6 samples
    assert np.isfinite(value(summary, model.nominal))


@pytest.mark.parametrize("name", ["stage15", "stage30", "stage31", "stage31_tied"])
def test_merged_is_exact_where_the_vertical_state_is_constant_in_a_run(name):
    """As its docstring says: the zeros eliminated from each run are all that is projected out."""
    log = with_noise(record(name, seed=5, samples=40, sigma=EXACT_STATE))
    model = true_model(name)
    only_readings = {c: s for c, s in SIGMAS.items() if c.startswith("hall")}
    summary = summarise(log, model)
    for p in (model.nominal, 1.01 * model.nominal):
        exact = value(summary, p, only_readings)
        assert value(summary.merged(), p, only_readings) == pytest.approx(exact, rel=1e-9)


def test_merged_is_a_lower_bound_where_the_state_moves(log, model):
    summary = summarise(log, model)
    only_readings = {c: s for c, s in SIGMAS.items() if c.startswith("hall")}
    exact, merged = (
        value(summary, model.nominal, only_readings),
        value(summary.merged(), model.nominal, only_readings),
    )
    # three zeros are fitted where four times three features are projected out: of 120 residuals, 9 fewer
    assert 0.88 * exact < merged <= exact
