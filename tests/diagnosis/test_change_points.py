"""Steps within runs: found where they are, also in a holdout run, and not in noise with a memory.

Facts used: a mount that moves once makes a reading step at one instant; noise makes steps of much the same
size in every run.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_twins import machine
from scipy.signal import lfilter

from hallsym.diagnosis import POLICY, Diagnosis, diagnose
from hallsym.diagnosis.facts import change_points, instants, steps
from hallsym.diagnosis.residual_table import ResidualTable
from hallsym.log import Log

RUNS, SAMPLES = 20, 250


def table(residual: np.ndarray) -> ResidualTable:
    """A table of one sensor, runs of equal length, 10 ms a sample."""
    n = residual.shape[1]
    run = np.arange(n) // SAMPLES
    time, sensed = {"campaign_s": 0.01 * np.arange(n)}, np.sin(0.07 * np.arange(n))[None]
    base = SimpleNamespace(covariance=np.eye(1), policy=POLICY, timed=True)
    return ResidualTable(base, run, residual, sensed, residual, time, np.ones((1, 1, n)), run, run, run)


def noise(rng: np.random.Generator, memory: float) -> np.ndarray:
    a = np.exp(-1 / memory)
    return lfilter([np.sqrt(1 - a * a)], [1, -a], rng.standard_normal((1, RUNS * SAMPLES)), axis=1)


@pytest.mark.parametrize("memory", [3.0, *(pytest.param(m, marks=pytest.mark.slow) for m in (0.1, 10.0))])
def test_steps_of_noise_are_as_rare_as_their_p_values(memory: float) -> None:
    """400 logs: a share of 5 % has a standard deviation of 1.1 %."""
    rng = np.random.default_rng(7)
    least = [min(s.p_value for s in change_points(table(noise(rng, memory)))) for _ in range(400)]
    assert np.mean(np.array(least) < 0.05) < 0.09


def test_a_step_is_found_at_its_instant_with_its_size() -> None:
    rng = np.random.default_rng(8)
    x = noise(rng, 3.0)
    when = 7 * SAMPLES + 100
    x[0, when : 8 * SAMPLES] += 6.0
    found = min(change_points(table(x)), key=lambda s: s.p_value)
    assert (found.run, found.channel) == (7, 0)
    assert found.instant_s == pytest.approx(0.01 * when, abs=0.03)
    assert found.size == pytest.approx(6.0, abs=1.0)
    assert found.p_value < 1e-3


def test_a_step_of_the_sensitivity_alone_is_found_in_a_run_that_moves_about_zero() -> None:
    """Eight runs, as many as a short campaign has; the offset does not step at all."""
    x = noise(np.random.default_rng(11), 3.0)[:, : 8 * SAMPLES]
    when = 5 * SAMPLES + 120
    moved = table(x)
    x[0, when : 6 * SAMPLES] += 8.0 * moved.sensed[0, when : 6 * SAMPLES]
    found = min(change_points(table(x)), key=lambda s: s.p_value)
    assert (found.run, found.p_value < POLICY.certain) == (5, True)
    assert found.instant_s == pytest.approx(0.01 * when, abs=0.1)


def test_a_step_of_a_run_at_rest_is_that_of_its_mean_whatever_other_runs_move_by() -> None:
    """A constant reading has no sensitivity to step: the squares are those of a two-sample test."""
    n, k = 8 * SAMPLES, np.arange(20, SAMPLES - 20)
    run, y = np.arange(n) // SAMPLES, noise(np.random.default_rng(12), 1.0)[0, :n]
    x = np.where(run == 3, 1e-4, 10.0 ** (run - 9.0) * np.sin(0.07 * np.arange(n)))
    explained, _, whole = steps(y, x, run, 3 * SAMPLES + k, lasting=False)
    rest = y[run == 3] - y[run == 3].mean()
    later = np.cumsum(rest[::-1])[::-1][k]
    np.testing.assert_allclose(explained, later**2 * SAMPLES / (k * (SAMPLES - k)), rtol=1e-9)
    np.testing.assert_allclose(whole, rest @ rest)


def test_too_few_runs_have_no_steps() -> None:
    x = noise(np.random.default_rng(9), 1.0)[:, : 5 * SAMPLES]
    assert change_points(table(x)) == ()


@pytest.mark.parametrize(
    ("runs", "memory", "begins", "rests", "holdout", "earliest", "latest"),
    [
        # a few samples of the run before, which noise with a memory makes fit, do not move it there
        pytest.param(RUNS, 30.0, 8 * SAMPLES, None, {7}, 8 * SAMPLES, 8 * SAMPLES, id="between runs"),
        # eight runs are too few to say that this one steps more than others do
        pytest.param(8, 3.0, 4 * SAMPLES + 60, None, {2, 5}, 4 * SAMPLES, 4 * SAMPLES + 120, id="in a run"),
        # run 7 shows no gain, so that the slip is before or after it; run 8, which is held out, has it
        pytest.param(RUNS, 3.0, 8 * SAMPLES, 7, {8}, 7 * SAMPLES, 8 * SAMPLES, id="beside a run at rest"),
    ],
)
def test_a_slip_is_put_where_it_is(runs, memory, begins, rests, holdout, earliest, latest) -> None:
    at = np.arange(runs * SAMPLES)
    sensed = np.sin(0.07 * at)[None] * (at // SAMPLES != rests)
    for seed in range(10):
        x = noise(np.random.default_rng(seed), memory)[:, : len(at)] + 2.0 * sensed * (at >= begins)
        # noise of a memory: a slow average of white noise varies twice that many times less
        found = replace(table(x), sensed=sensed)
        ((channel, instant_s, low, high),) = instants(found, holdout, inflation=2 * memory)
        larger = instants(replace(found, residual=16 * x), holdout, inflation=2 * memory)
        assert larger == ((channel, instant_s, low, high),)  # the noise is that of the residual
        assert channel == 0
        assert low < instant_s <= high
        assert 0.01 * earliest - 1e-9 <= instant_s <= 0.01 * latest + 1e-9


def test_95_of_100_slips_lie_between_the_stated_times() -> None:
    """By an independent simulation: the gain of readings with white noise of the stated size steps."""
    n, inside, rng = 8 * SAMPLES, 0, np.random.default_rng(12)
    sensed = np.sin(0.07 * np.arange(n))[None]
    for _ in range(200):
        when = int(rng.integers(4 * SAMPLES + 20, 5 * SAMPLES - 20))
        x = rng.standard_normal((1, n)) + 0.6 * sensed * (np.arange(n) >= when)
        found = table(x)
        # between two samples nothing is known of when
        ((_, _, low, high),) = instants(replace(found, sensed=sensed), holdout={2, 5}, inflation=1.0)
        inside += low <= 0.01 * (when - 0.5) <= high
    assert 0.9 <= inside / 200 <= 1.0


def slipped(run: int, *, gain: float) -> tuple[Log, float]:
    """A machine whose probe B moves by 20 um in the middle of a run, and has another gain from then on."""
    log = machine("multisine", seed=31, thin=6)
    columns = {c: log.array(c).copy() for c in log.columns}
    inside = np.flatnonzero(columns["run"] == run)
    when = float(columns["t_s"][inside[len(inside) // 2]])
    after = columns["t_s"] >= when
    columns["hall_b_m"] = columns["hall_b_m"] * (1 + gain * after) + 20e-6 * after
    return Log.from_arrays(columns, log.noise, log.meta), when - float(columns["t_s"][0])


@pytest.fixture(scope="module")
def held_out() -> tuple[Diagnosis, int, float]:
    log = machine("multisine", seed=31, thin=6)
    run = min(log.meta.holdout)
    changed, when = slipped(run, gain=0.02)
    return diagnose(changed, "stage31"), run, when


@pytest.mark.slow
def test_a_slip_within_a_holdout_run_is_named_at_its_instant(held_out) -> None:
    """The run that slips is fitted, since its offset is known from itself alone; the others judge."""
    d, run, when = held_out
    assert (d.verdict, d.ranked[0]) == ("explained", "mount_slip")
    assert run not in d.validation_runs
    (slip,) = (e for e in d.effects if e.name == "mount_slip")
    assert float(slip.text.rpartition("=")[2]) == pytest.approx(when, abs=0.1)


@pytest.mark.slow
def test_the_next_run_judges_in_the_place_of_one_that_slips() -> None:
    """The other holdout run lies before the slip and cannot show it."""
    changed, _ = slipped(6, gain=0.02)
    d = diagnose(changed, "stage31", holdout=(2, 6))
    assert d.validation_runs == (2, 7)
    assert (d.verdict, d.ranked[0]) == ("explained", "mount_slip")


@pytest.mark.slow
def test_a_step_in_a_fitted_run_is_a_gap_though_the_others_do_not_show_it() -> None:
    log = machine("multisine", seed=31, thin=6)
    columns = {c: log.array(c).copy() for c in log.columns}
    inside = np.flatnonzero(columns["run"] == 5)
    columns["hall_b_m"][inside[len(inside) // 2 :]] += 5e-6
    d = diagnose(Log.from_arrays(columns, log.noise, log.meta), "stage31")
    assert d.verdict == "unexplained"
    assert "worst in run 5, channel hall_b_m" in d.sentence
    assert "mount_slip explains it, but does not lower the error" in d.sentence
    assert d.metric.after == d.metric.before
    assert not d.next_step
