"""P-values from random signs: uniform without an effect whatever the noise is like, small with one.

Products of columns are made in plain numpy, without a gap; the share of p-values below 5 % is held against
the binomial distribution.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_twins import machine as stage
from scipy import stats
from test_diagnosis_rotary import machine as encoder
from test_diagnosis_rotary import third

import hallsym
from hallsym.diagnosis import POLICY, diagnose
from hallsym.diagnosis.measurement_error import shared_noise
from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.p_values import Joint, SignFlips, clusters, searched
from hallsym.diagnosis.scores import candidates
from hallsym.diagnosis.setup import base_of
from hallsym.families import effects
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.log import Log
from hallsym.model import Facts


def products(columns, residual, own, runs, size, candidates, each=1):
    """Products of [own | candidates | residual] by unit, `each` in a run."""
    stack = np.vstack([columns, residual]).reshape(len(columns) + 1, runs, size)
    M = np.einsum("aru,bru->rab", stack, stack)
    last = len(columns)
    span = {"": slice(0, own)} | {str(s): s for s in (slice(a, b) for a, b in candidates)}

    def of(key):
        at = np.r_[:own, span[key], last]
        return M[:, at[:, None], at]

    at = np.r_[:own, last]
    return SimpleNamespace(
        likelihood=M[:, at[:, None], at], of=of, span=span, offsets=None,
        runs=tuple((k // each,) for k in range(runs)),
        units=lambda wanted: np.arange(runs),
    )  # fmt: skip


def p_values(flips):
    """The p-value of each candidate, corrected for all."""
    each = [flips.statistic(key) for key in flips.t.span if key]
    return [Joint(each).p_value(z[0]) for z in each]


def of_five(seed, size, runs=30, samples=40):
    """The p-values of five candidates of 1 to 3 columns; the third has an effect of `size`."""
    rng = np.random.default_rng(seed)
    n = runs * samples
    t = np.arange(n)
    columns = np.array(
        [np.cos(2 * np.pi * t * f / samples + rng.uniform(0, 6)) for f in rng.uniform(0.2, 3, 14)]
    )
    columns[4] *= np.repeat(np.arange(runs) < 2, samples)  # an effect that two runs show
    residual = rng.standard_normal(n) + size * columns[6]
    t = products(columns, residual, 4, runs, samples, [(4, 5), (5, 6), (6, 8), (8, 11), (11, 14)])
    return p_values(SignFlips(t, range(runs), np.zeros((len(t.runs), len(columns))), POLICY))


def test_noise_that_wanders_over_whole_runs_is_no_effect():
    """Stretches of six runs take signs; what they have in common within a run is not that many numbers."""
    runs, each, samples = 6, 4, 10
    p = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = runs * each * samples
        speed = np.repeat(rng.uniform(0.5, 1.5, runs) * (-1.0) ** np.arange(runs), each * samples)
        columns = np.array([np.ones(n), speed, speed**2, rng.standard_normal(n)])
        noise = np.repeat(rng.standard_normal(runs), each * samples) + rng.standard_normal(n)
        t = products(columns, noise, 1, runs * each, samples, [(1, 2), (2, 3), (3, 4)], each)
        p.append(min(p_values(SignFlips(t, range(runs), np.zeros((len(t.runs), len(columns))), POLICY))))
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    assert stats.binomtest(int((np.array(p) <= 0.05).sum()), len(p), 0.05).pvalue > 1e-3


def test_an_effect_is_certain_and_what_it_resembles_is_not():
    p = of_five(1, size=0.3)
    assert p[2] < 0.01
    assert min(*p[:2], *p[3:]) > 0.05


def test_numbers_that_were_searched_count():
    z = np.append(3.0, np.random.default_rng(0).standard_normal(499))
    assert searched(z, 1) is z
    assert searched(z, 100)[0] == pytest.approx(stats.norm.isf(1 - (1 - stats.norm.sf(3.0)) ** 100))
    assert searched(np.append(30.0, z), 1e6)[0] == pytest.approx(stats.norm.isf(1e6 * stats.norm.sf(30.0)))
    assert np.isfinite(searched(np.append(50.0, z), 1e6)[0])


def test_parts_of_a_run_that_are_four_memories_long_scatter_by_themselves():
    three_each = np.repeat(np.arange(8), 3)
    assert len(set(clusters(three_each, POLICY, 4.0))) == 24
    assert list(clusters(three_each, POLICY, 3.9)[:6]) == [0, 0, 1, 2, 2, 3]
    assert list(clusters(three_each, POLICY, 1.0)) == list(three_each)
    recording = np.zeros(50, dtype=int)
    assert len(set(clusters(recording, POLICY))) == POLICY.fewest
    assert list(np.bincount(clusters(recording, POLICY, 0.8))) == [5] * 10


def test_the_least_p_value_is_stated():
    d = diagnose(encoder(third), "ellipse")
    assert d.significance.p_value == d.significance.least == 0.0005
    assert (d.significance.unit, d.significance.units) == ("stretch", 24)
    assert d.effects[0].p_value == 0.0005


def test_noise_that_columns_share_with_the_residual_is_measured():
    """A cubic column and a reading that is linear: the mean product of cube and noise, 3 u^2 s^2."""
    log = stage("multisine", seed=3, thin=20)
    names = ("x_ref_m", "y_ref_m", "rz_ref_rad")
    fitted = base_of(log, hallsym.fit(log, "stage31", solver="direct", loss="none", accept=["all"]))
    base = replace(fitted, sigma={**fitted.sigma, **dict.fromkeys(names, 5e-6)})
    chosen = [e for e in effects(STAGE_FAMILY).values() if e.name == "odd_nonlinearity"]
    tried, _ = candidates(base, chosen, Facts(60.0, log.columns))
    plain = {key: (c.model, c.new) for key, c in tried.items()}
    found = shared_noise(base, plain, normal_equations(base, plain), None).sum(axis=0)
    columns, rng, draws = {c: log.array(c) for c in log.columns}, np.random.default_rng(0), []
    for _ in range(12):
        by = {c: base.sigma[c] * rng.standard_normal(log.rows) for c in names}
        both = [columns | {c: columns[c] + sign * by[c] for c in names} for sign in (1, 0, -1)]
        moved = [replace(base, log=Log.from_arrays(c, log.noise, log.meta)) for c in both]
        up, middle, down = (normal_equations(b, plain).whitened.border.sum(axis=0)[-1, :-1] for b in moved)
        draws.append(0.5 * (up + down) - middle)
    mean, error = np.mean(draws, axis=0), np.std(draws, axis=0) / np.sqrt(len(draws))
    certain = np.abs(mean) > 20 * error
    assert certain[fitted.model.names.index("eta_A") :].sum() >= 3
    assert found[certain] == pytest.approx(mean[certain], rel=0.2)  # one draw of 1600 samples
