"""Resampled runs beside what they stand for: refits that converge, and the scatter of many recordings."""

from functools import cache

import numpy as np
import pytest
from twins import SIGMAS, cost_on, record, true_model, with_noise

from hallsym.errors import InputError
from hallsym.estimation.covariance import uncertainty
from hallsym.estimation.factors import inverse
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.likelihood import Cost, cost_of
from hallsym.estimation.optimum import refit
from hallsym.inference.bootstrap import Bootstrap, bootstrap
from hallsym.model.model import combination, linear, parameter

MODEL = true_model()


@cache
def paper(correlation_s: float = 0.0) -> tuple[Cost, np.ndarray, Determination, Bootstrap]:
    cost = cost_on(with_noise(record(seed=21, correlation_s=correlation_s)), MODEL)
    found = determine(cost, MODEL.nominal)
    p = refit(cost, MODEL.nominal, found.held)
    return cost, p, found, bootstrap(cost, p, found.held, replicates=400, seed=3)


@pytest.mark.slow
@pytest.mark.parametrize("correlation_s", [0.0, 0.1])
def test_draws_are_refits(correlation_s):
    """Every tenth draw, refitted until it converges: the same to 2 % of the standard uncertainty."""
    cost, p, found, drawn = paper(correlation_s)
    free = drawn.std > 0
    off = [
        np.abs(refit(cost.weighted(w), p, found.held) - v)[free] / drawn.std[free]
        for w, v in zip(drawn.weights[::10], drawn.values[::10], strict=True)
    ]
    assert np.max(off) < 0.02
    assert np.median(off) < 0.002


def test_hessians_of_the_runs_add_up():
    cost, p, _, _ = paper()
    weights = np.random.default_rng(1).uniform(0.0, 2.0, 57)
    point = cost.weighted(weights).at(p + 0.01 * (MODEL.bounds[1] - p))
    exact = point.derivatives()[2]
    size = np.sqrt(np.outer(np.abs(np.diag(exact)), np.abs(np.diag(exact))))
    summed = np.tensordot(weights, point.run_hessians, axes=1)
    assert np.abs(summed - exact).max() <= 1e-9 * size.max()
    assert np.all(np.abs(summed - exact)[size > 0] <= 1e-7 * size[size > 0])


def test_white_noise_spreads_as_the_likelihood_says():
    """Some 19 runs tell a gain or an angle: its scatter is known to 1 / sqrt(2 x 19) = 16 % (1 sigma)."""
    cost, p, found, drawn = paper()
    e = uncertainty(cost.at(p), found)
    for name in ("eta_A", "eta_B", "eta_C", "theta_A", "theta_B", "theta_C"):
        k = MODEL.names.index(name)
        assert drawn.std[k] / e.std[k] == pytest.approx(1.0, abs=0.5)


def test_intervals_follow_a_linear_map():
    """Twice a parameter has twice its interval, and a combination its own."""
    _, p, _, drawn = paper()
    k = MODEL.names.index("a_A")
    one, gradient = parameter(MODEL, "a_A"), np.zeros(len(p))
    gradient[k] = 2.0
    two = linear(MODEL, gradient, "1/m")
    assert drawn.interval(two) == pytest.approx(2 * np.array(drawn.interval(one)), rel=1e-9)
    assert drawn.std_of(two) == pytest.approx(2 * drawn.std[k], rel=1e-9)
    assert drawn.std_of(one) == pytest.approx(drawn.std[k], rel=1e-12)
    for c in MODEL.combinations:
        arm = combination(MODEL, c)
        low, high = drawn.interval(arm)
        assert 0.5 * (low + high) == pytest.approx(arm.first(p)[0], rel=1e-12)
        assert high - low == pytest.approx(2 * 2.0032 * drawn.std_of(arm), rel=1e-4)  # t of 56 runs


def test_draws_that_leave_parameters_open_are_counted():
    """Two runs of twelve are at another height: a draw without both, probability .11, says nothing of a."""
    cost = cost_on(with_noise(record(seed=22)), MODEL)
    state = cost.summary.mean_state
    level = [r for r in range(57) if np.abs(state[r, 0] - state[0, 0]) < 1e-5][:10]
    tilted = [r for r in range(57) if r not in level][:2]
    assert len(level) == 10
    few = cost_of(cost.summary.select([cost.summary.runs[r] for r in (*level, *tilted)]), SIGMAS)
    found = determine(few, MODEL.nominal)
    p = refit(few, MODEL.nominal, found.held)
    drawn = bootstrap(few, p, found.held, replicates=300, seed=1)
    expected = 300 * (10 / 12) ** 12
    assert drawn.singular >= expected - 4 * np.sqrt(expected)
    assert len(drawn.values) == 300 - drawn.singular
    for w in drawn.weights[:20]:
        assert len(determine(few.weighted(w), p).held) == len(found.held)

    def many_pairs() -> None:
        for seed in range(40):  # each has a fifth of a chance
            bootstrap(few, p, found.held, replicates=2, seed=seed)

    with pytest.raises(InputError, match="of 2 draws of the 12 runs"):
        many_pairs()


def test_draws_stay_inside_the_bounds():
    _, p, _, _ = paper()
    k, std = MODEL.names.index("eta_B"), paper()[3].std
    tight = MODEL.with_parameters({"eta_B": {"nominal": p[k] - 1e-3, "upper": p[k] + 0.5 * std[k]}})
    cost = cost_on(with_noise(record(seed=21)), tight)
    found = determine(cost, tight.nominal)
    q = refit(cost, tight.nominal, found.held)
    drawn = bootstrap(cost, q, found.held, replicates=40, seed=2)
    upper = tight.bounds[1][k]
    assert np.all(drawn.values[:, k] <= upper)
    assert 0.1 < np.mean(drawn.values[:, k] > upper - 1e-9) < 0.6  # a normal one: .31
    off = [
        refit(cost.weighted(w), q, found.held) - v for w, v in zip(drawn.weights, drawn.values, strict=True)
    ]
    assert np.max(np.abs(off)[:, std > 0] / std[std > 0]) < 0.02
    assert drawn.interval(parameter(tight, "eta_B"))[1] <= upper


def covered(seeds: range) -> tuple[dict[str, list[bool]], dict[str, list[bool]]]:
    """Whether intervals of resampled runs hold the truth, and those of the likelihood, by quantity."""
    resampled: dict[str, list[bool]] = {}
    naive: dict[str, list[bool]] = {}
    truth = MODEL.nominal
    for seed in seeds:
        cost = cost_on(with_noise(record(seed=seed, samples=40, correlation_s=0.1)), MODEL)
        found = determine(cost, truth)
        p = refit(cost, truth, found.held)
        free = np.array([k for k in range(len(p)) if k not in found.held])
        C = np.zeros((len(p), len(p)))
        C[np.ix_(free, free)] = inverse(cost.at(p).information().sum(axis=0)[np.ix_(free, free)])
        drawn = bootstrap(cost, p, found.held, replicates=200, seed=seed)
        determined = uncertainty(cost.at(p), found).determined
        quantities = [parameter(MODEL, n) for n, ok in zip(MODEL.names, determined, strict=True) if ok]
        for q in (*quantities, *(combination(MODEL, c) for c in MODEL.combinations)):
            (value, slope), (low, high) = q.first(p), drawn.interval(q)
            right = q.first(truth)[0]
            resampled.setdefault(q.name, []).append(low <= right <= high)
            naive.setdefault(q.name, []).append(abs(value - right) < 1.96 * np.sqrt(slope @ C @ slope))
    return resampled, naive


@pytest.mark.slow
def test_intervals_cover_where_those_of_the_likelihood_fail():
    """Noise correlated over a tenth of a run, 240 recordings: a coverage is known to 1.5 % (1 sigma)."""
    resampled, naive = covered(range(60_000, 60_240))
    assert len(resampled) == 18
    assert all(len(held) == 240 for held in resampled.values())
    shares = {name: (np.mean(held), np.mean(naive[name])) for name, held in resampled.items()}
    assert all(block >= 0.90 for block, _ in shares.values()), shares
    assert all(white < 0.75 for _, white in shares.values()), shares
    assert 0.93 <= np.mean([block for block, _ in shares.values()]) <= 0.975, shares
