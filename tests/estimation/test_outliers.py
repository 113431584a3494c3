"""Spikes go, everything that changes smoothly stays, and clean Gaussian noise is left alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import HALL

from hallsym.estimation.outliers import column_spikes, reject_spikes
from hallsym.log import Block

SIGMA = 1e-6
COVARIANCE = np.eye(3) * SIGMA**2
seeds = st.integers(0, 2**32 - 1)


def block(r: np.ndarray) -> Block:
    """A block whose residual is `r` (3, samples); one column tells how many samples there are."""
    return Block(0, dict(zip(HALL, r, strict=True)))


def spikes(covariance: np.ndarray = COVARIANCE):
    return reject_spikes(lambda b: np.array([b.data[c] for c in HALL]), covariance, column_spikes(HALL), HALL)


def noise(seed: int, n: int = 400) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal((3, n))


@settings(max_examples=25)
@given(seeds, st.lists(st.integers(10, 389), min_size=1, max_size=12, unique=True), st.floats(20, 1e4))
def test_isolated_spikes_go_and_nothing_else(seed, where, size):
    """Spikes of 20 sigma and more, six samples apart; of 1200 Gaussian numbers none is 10 sigma out."""
    where = [k for k in where if all(abs(k - j) > 6 or k == j for j in where)]
    r = noise(seed)
    channel = np.random.default_rng(seed).integers(0, 3, len(where))
    r[channel, where] += size * SIGMA * np.where(np.arange(len(where)) % 2, 1, -1)
    expected = np.ones(400)
    expected[where] = 0.0
    assert np.array_equal(spikes()(block(r)), expected)


@settings(max_examples=20)
@given(seeds, st.floats(1.0, 1e3), st.floats(2.0, 20.0))
def test_a_smooth_gap_is_no_outlier(seed, size, periods):
    """Smooth means: it bends by less than 4 sigma from one sample to the next, however large it is."""
    t = np.arange(400) / 400
    size = min(size, 4.0 / (2 * np.pi * periods / 400) ** 2)
    gap = size * SIGMA * np.sin(2 * np.pi * periods * t)
    assert np.all(spikes()(block(noise(seed) + gap)) == 1.0)


def test_a_column_that_is_exact_but_for_its_digits_has_no_spikes():
    """A slope of 3.43 deg per row, five decimals: most steps are the same to 1e-14, others off by 1e-5."""
    slope = np.round(-3428.57143 + 3.4285714285 * np.arange(2001), 5)
    weigh = column_spikes(("slope",))
    assert np.all(weigh(Block(0, {"slope": slope})) == 1.0)
    assert weigh.wrong_for == {"slope"}
    slope[700] += 5.0  # which hides a spike there, that its residual shows
    assert np.all(weigh(Block(0, {"slope": slope})) == 1.0)


def test_too_many_to_be_spikes_are_none():
    """A reading that jumps at a quarter of its samples does something else; at a twentieth it has spikes."""
    rng = np.random.default_rng(0)
    for share, kept in ((0.25, True), (0.05, False)):
        r = noise(3, 2000)
        hit = rng.random(2000) < share
        r[1, hit] += rng.choice([-1, 1], hit.sum()) * rng.uniform(50, 500, hit.sum()) * SIGMA
        weigh = reject_spikes(
            lambda b: np.array([b.data[c] for c in HALL]), COVARIANCE, lambda b: np.ones(2000), HALL
        )
        weight = weigh(block(r))
        assert np.all(weight == 1.0) == kept
        assert weigh.wrong_for == ({HALL[1]} if kept else set())
        if not kept:
            assert np.all(weight[hit] == 0.0)


def test_more_noise_than_stated_is_no_outlier():
    for factor in (3.0, 30.0):
        assert np.all(spikes()(block(factor * noise(1))) == 1.0)


def test_an_axis_that_sets_off_is_no_spike():
    """At rest, then in motion with more scatter, ringing as it sets off; spikes go in both."""
    gone = 0
    for seed, first, louder in ((0, 100, 15.0), (1, 170, 50.0), (2, 250, 300.0), (3, 120, 100.0)):
        rng = np.random.default_rng(seed)
        at = np.arange(400) - first
        r = noise(seed) * np.select([at < 0, at < 60], [1.0, 5 * louder], louder)
        gone += int(np.sum(spikes()(block(r)) == 0.0))
        reference = np.where(at < 0, 0.0, 1e-5 * at + 1e-6 * rng.standard_normal(400))
        assert np.all(column_spikes(("ref",))(Block(0, {"ref": reference})) == 1.0)
        where = [first - 60, first + 120]  # further from setting off than its neighbourhood reaches
        r[0, where] += 1e5 * SIGMA
        assert not spikes()(block(r))[where].any()
    # noise that is far larger than stated has a few per mille beyond; by one scale for all a quarter would go
    assert gone <= 0.005 * 4 * 400


def test_stated_noise_is_the_least_scale():
    """A block quieter than stated: 9 stated standard deviations are kept, 11 are not."""
    r = 1e-3 * noise(2)
    r[1, 100] += 9 * SIGMA
    r[1, 200] += 11 * SIGMA
    expected = np.ones(400)
    expected[200] = 0.0
    assert np.array_equal(spikes()(block(r)), expected)


def test_where_spikes_abound_small_ones_are_found_too():
    """A tenth spread evenly up to 700 sigma: of those from 6 sigma on 5 in 1000 stay; nothing good goes."""
    left = gone = 0
    for seed in range(20):
        rng, r = np.random.default_rng(seed), noise(seed, 1000)
        hit = rng.random(1000) < 0.1
        size = np.where(hit, rng.uniform(-700, 700, 1000), 0.0)
        kept = spikes()(block(r + SIGMA * np.stack([size, 0 * size, 0 * size]))) > 0
        left, gone = left + int(np.sum(kept & (np.abs(size) > 6))), gone + int(np.sum(~kept & ~hit))
    assert left <= 0.005 * 2000
    assert gone <= 0.001 * 18000
    alone = noise(0)
    alone[1, 200] = 8 * SIGMA  # the same size, where nothing else says that there are spikes
    assert np.all(spikes()(block(alone)) == 1.0)


def test_a_rail_tells_of_no_spikes():
    """Tips cut off at every turn of a raster, with suspects there: of the others none goes."""
    at = np.arange(3000)
    tips = np.maximum(15 * (np.abs((at % 50) - 25.0) - 18), 0) * SIGMA  # 105 sigma high, kinks at both ends
    r = noise(8, 3000) + np.stack([tips, -tips, 0 * tips])
    turns = 12e-6 * np.abs((at % 50) - 25.0) + 1e-6 * np.random.default_rng(2).standard_normal(3000)
    columns = {**dict(zip(HALL, r, strict=True)), "turns": turns}
    suspected = column_spikes(("turns",))(Block(0, columns)) == 0
    assert suspected.any()
    weigh = reject_spikes(
        lambda b: np.array([b.data[c] for c in HALL]), COVARIANCE, column_spikes(("turns",)), HALL
    )
    assert np.all(weigh(Block(0, columns))[~suspected] == 1)


@pytest.mark.parametrize("end", [slice(None), slice(None, None, -1)])
def test_spikes_side_by_side_at_the_end_of_a_run_do_not_vouch_for_each_other(end):
    """Samples 2, 4 and 5 are suspected; 1 and 3 are off and are not: they must not be each other's median."""
    r, flagged = noise(5, 100), 1e-3 * np.random.default_rng(0).standard_normal(100)
    r[1, [1, 2, 3, 4, 5]] += np.array([280, 380, 725, 430, -290]) * SIGMA
    flagged[[2, 4, 5]] += [1.0, -2.0, 3.0]
    columns = {**dict(zip(HALL, r[:, end], strict=True)), "flagged": flagged[end]}
    suspected = column_spikes(("flagged",))(Block(0, columns))[end] == 0
    assert np.array_equal(np.flatnonzero(suspected), [2, 4, 5])
    weigh = reject_spikes(
        lambda b: np.array([b.data[c] for c in HALL]), COVARIANCE, column_spikes(("flagged",)), HALL
    )
    kept = weigh(Block(0, columns))[end]
    assert np.all(kept[[1, 2, 3, 4, 5]] == 0)
    assert np.all(kept[6:] == 1)


@settings(max_examples=20)
@given(seeds, st.sampled_from([0.01, 0.05, 0.1]))
def test_columns_alone_show_most_spikes_and_accuse_few_good_samples(seed, share):
    """A first guess on a noisy sine: nearly all spikes of 100 um and more, few of the good samples."""
    rng = np.random.default_rng(seed)
    n = 1000
    x = 3e-4 * np.sin(2 * np.pi * np.arange(n) / 500) + SIGMA * rng.standard_normal(n)
    hit = rng.random(n) < share
    x[hit] += rng.choice([-1, 1], hit.sum()) * rng.uniform(1e-4, 1e-3, hit.sum())
    weight = column_spikes(("x",))(Block(0, {"x": x, "y": np.zeros(n)}))
    assert np.mean(weight[~hit]) > 0.9  # at a share of .1 every third good sample has a bad neighbour
    assert np.mean(weight[hit]) < 0.03 if hit.any() else True


def test_runs_too_short_to_judge_are_kept():
    for n in (1, 2, 6):
        assert np.all(column_spikes(("hall_a_m",))(block(noise(0, n))) == 1.0)
        assert np.all(spikes()(block(noise(0, n))) == 1.0)
