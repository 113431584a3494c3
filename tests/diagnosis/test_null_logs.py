"""Logs without a gap: the rate of false findings is the one that p-values state, whatever the noise.

The benchmark of null logs asks the same of many more. Bounds are those that a right diagnosis leaves with a
probability of 0.1 %.
"""

import sys
from pathlib import Path

import pytest
from scipy.stats import binomtest, kstest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from bench_diagnosis_nulls import settings, tried

LOGS, FIRST, LEVEL, SELDOM = 64, 50_000, 0.05, 1e-3


@pytest.fixture(scope="module")
def rows() -> list[dict]:
    """White, coloured and heavy noise, stated and estimated, a stage and an encoder, 8 to 24 runs."""
    return [tried(*setting) for setting in settings(LOGS, FIRST) if setting[2] < 57]


@pytest.mark.parametrize(
    ("kind", "machine", "runs", "stated", "seed"),
    [
        ("vibration", "rotary", 8, False, 30007),  # as steady as a tone in few short runs
        ("vibration", "stage", 8, False, 50367),  # the references' noise makes an acceleration of its own
        # tails heavier than the body says, and no spikes
        pytest.param("t3", "stage", 24, False, 30219, marks=pytest.mark.slow),
        # of one recording: rings for three slices, hum if slices are independent
        pytest.param("vibration", "rotary", 1, False, 49, marks=pytest.mark.slow),
        # a field that is on in some slices
        pytest.param("ar10", "rotary", 1, False, 122, marks=pytest.mark.slow),
    ],
)
def test_noise_of_few_runs_is_no_gap(kind, machine, runs, stated, seed):
    row = tried(kind, machine, runs, stated, seed)
    assert (row["verdict"], row["effects"]) == ("no gap", [])


@pytest.mark.slow
def test_one_in_twenty_recordings_has_a_p_value_below_five_per_cent():
    kinds = ("white", "ar3", "ar10", "t3", "vibration")
    p = [tried(*setting)["p"] for setting in settings(32, 70_000, kinds, (1,))]
    assert binomtest(sum(x < LEVEL for x in p), len(p), LEVEL).pvalue > SELDOM
    assert kstest(p, "uniform").pvalue > SELDOM


@pytest.mark.slow
def test_one_in_twenty_null_logs_has_a_p_value_below_five_per_cent(rows):
    p = [row["p"] for row in rows]
    below = sum(x < LEVEL for x in p)
    assert binomtest(below, len(p), LEVEL).pvalue > SELDOM
    assert kstest(p, "uniform").pvalue > SELDOM


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "machine"),
    [
        ("understated", "stage"),  # the references are as loud as what is left
        ("wander", "rotary"),  # lasts for a run: runs without offsets are one recording
    ],
)
def test_noise_that_the_statement_leaves_out_has_no_small_p_value_more_often(kind, machine):
    drawn = [s for s in settings(48, 97_000, (kind,)) if s[1] == machine and s[2] < 57]
    p = [tried(*setting)["p"] for setting in drawn]
    assert binomtest(sum(x < LEVEL for x in p), len(p), LEVEL, alternative="greater").pvalue > SELDOM


@pytest.mark.slow
def test_no_effect_is_named_and_hardly_a_place(rows):
    assert [row["effects"] for row in rows if row["effects"]] == []
    for false in (
        [row["where"] for row in rows if row["where"]],
        [row["verdict"] for row in rows if row["verdict"] != "no gap"],
    ):
        assert binomtest(len(false), len(rows), LEVEL, alternative="greater").pvalue > SELDOM, false
