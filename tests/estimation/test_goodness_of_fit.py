"""What a fit leaves is told from noise: significant is a matter of statistics, material one of size."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from twins import COLUMNS, HALL, SIGMAS, cost_on, record, true_model, with_noise

from hallsym import bundled_campaign, fit, read_log
from hallsym.estimation.goodness_of_fit import goodness_of
from hallsym.estimation.optimum import refit
from hallsym.estimation.task import lower_bound
from hallsym.log import Log, Meta, Noise, Sigma

ROOT = Path(__file__).resolve().parents[2]
MODEL = true_model()


def columns_of(log: Log) -> dict[str, np.ndarray]:
    return {name: log.array(name).copy() for name in log.columns}


def goodness(columns: dict[str, np.ndarray], *, noise: Noise | None = None, meta: Meta | None = None, **more):
    """Goodness of fit of Model (31), refitted from Table 7."""
    log = with_noise(columns)
    log = replace(log, noise=noise or log.noise, meta=meta or log.meta)
    return fit(log, MODEL, solver="direct", accept=["all"], **more).goodness


def later(columns: dict[str, np.ndarray], samples: int) -> dict[str, np.ndarray]:
    """The references of every run, `samples` late."""
    out = dict(columns)
    for name in COLUMNS[:3]:
        parts = [columns[name][columns["run"] == run] for run in np.unique(columns["run"])]
        out[name] = np.concatenate([np.r_[np.repeat(v[0], samples), v[:-samples]] for v in parts])
    return out


def louder(columns: dict[str, np.ndarray], factor: float, seed: int = 1) -> dict[str, np.ndarray]:
    """Noise `factor` times the stated one, beside that which is there."""
    rng, more = np.random.default_rng(seed), np.sqrt(factor**2 - 1)
    return {c: v + more * SIGMAS.get(c, 0.0) * rng.standard_normal(len(v)) for c, v in columns.items()}


# -- numbers ------------------------------------------------------------------------------------------------


def test_white_noise_of_the_stated_size_gives_one():
    found = goodness(record(seed=1))
    assert found.degrees_of_freedom == pytest.approx(57 * 49 * 3 - 18, rel=0.35)  # less by chance, never more
    assert found.degrees_of_freedom <= 57 * 49 * 3 - 15
    assert found.scatter == pytest.approx(np.sqrt(2 / found.degrees_of_freedom))
    assert found.cost_per_degree_of_freedom == pytest.approx(1.0, abs=4 * found.scatter)
    assert set(found.by_run) == set(range(57))
    assert list(found.by_channel) == list(HALL)
    assert all(v == pytest.approx(1.0, abs=0.06) for v in found.by_channel.values())
    assert np.mean(np.square(list(found.by_run.values()))) == pytest.approx(1.0, abs=0.06)
    assert not found.significant
    assert not found.material
    assert found.sentence is None


def test_residuals_are_counted_by_run_and_channel():
    """Three times the noise in one channel of one run: 9 there, 1 elsewhere."""
    columns = record(seed=2)
    here = columns["run"] == 30
    rng = np.random.default_rng(3)
    columns["hall_c_m"][here] += np.sqrt(8) * SIGMAS["hall_c_m"] * rng.standard_normal(here.sum())
    cost = cost_on(with_noise(columns), MODEL)
    p = refit(cost, MODEL.nominal, [MODEL.names.index(n) for n in ("H1y", "H2y", "H3x")])
    found = goodness_of(cost.at(p), 18)
    assert (found.worst_run, found.worst_channel) == (30, "hall_c_m")
    C = cost.at(p).covariance[30, 2, 2]  # the reference is noisy too
    expected = np.sqrt(1 + 8 * SIGMAS["hall_c_m"] ** 2 / C)
    assert found.worst == pytest.approx(expected, rel=4 / np.sqrt(2 * 49))
    # the worst of 171 cells is as large by chance in one log of a hundred
    each = found.degrees_of_freedom / 171
    assert found.worst_least**2 == pytest.approx(found.worst**2 * each / chi2.isf(0.01 / 171, each), rel=5e-3)
    assert found.by_channel["hall_c_m"] > max(found.by_channel[c] for c in HALL[:2])
    # an estimated floor may be wrong by 2, but no channel has more noise than in most runs
    assert found.usual == pytest.approx(1.0, abs=0.05)
    odd = replace(found, worst_least=2.0).judged(2.0)
    assert odd.material
    assert not replace(odd, usual=None).material


@pytest.mark.slow
def test_coloured_noise_has_fewer_samples_than_there_are():
    """The expected scatter covers what 20 recordings with correlated noise show."""
    found = [goodness(record(seed=s, correlation_s=0.04), loss="none") for s in range(20)]
    costs = np.array([g.cost_per_degree_of_freedom for g in found])
    assert np.mean([g.degrees_of_freedom for g in found]) < 0.6 * 57 * 49 * 3
    assert costs.std() == pytest.approx(np.mean([g.scatter for g in found]), rel=0.5)


# -- significant and material -------------------------------------------------------------------------------


def test_more_noise_is_significant_and_material_above_the_limit():
    found = goodness(louder(record(seed=4), 1.06))
    assert found.significant
    assert not found.material
    assert found.limit == pytest.approx(1.03 / 0.95)
    more = goodness(louder(record(seed=4), 1.2))
    assert more.material
    said = "The noise is larger than stated: residual error is 1.2 times the noise floor, and that is noise"
    assert more.sentence.startswith(said)


@pytest.mark.slow
def test_an_estimated_floor_follows_the_noise_and_not_a_gap():
    noise = Noise({c: Sigma(s, "estimated") for c, s in SIGMAS.items()})
    columns = record(seed=4)
    for factor in (1.9, 2.2):  # however much larger the noise is than it was taken for
        found = goodness(louder(columns, factor), noise=noise)
        assert found.residual_over_noise == pytest.approx(1.0, abs=0.02)
        assert not found.material
    late = goodness(later(columns, 1), noise=noise)
    assert late.material
    assert "times the noise floor, which was estimated from the log" in late.sentence


def test_a_log_may_ask_for_more():
    asked = goodness(louder(record(seed=4), 1.3), meta=Meta(gap_threshold_rel=0.5))
    assert asked.limit == pytest.approx(1.03 / 0.5)
    assert not asked.material


@pytest.mark.parametrize("runs", [6, 57])
def test_a_reference_that_is_late(runs):
    """By one sample of 10 ms the values are 35 standard deviations off; the fit itself converges."""
    data = columns_of(bundled_campaign())
    few = {c: v[np.isin(data["run"], range(runs))] for c, v in data.items()}
    log = Log.from_arrays(later(few, 1), noise=bundled_campaign().noise)
    found = fit(log, "stage31", solver="direct", accept=["all"])
    assert found.status == "converged"
    assert found.goodness.residual_over_noise > 6
    assert "next: hallsym.diagnose(log" in found.goodness.sentence
    weights = found.model.family.pose_metric.weights(found.model.pose)
    rmse, floor = (list(v.values()) for v in (found.errors.fitted.over()["rmse"], found.noise_floor))
    decoded = np.linalg.norm(weights * rmse) / np.linalg.norm(weights * floor)
    assert found.goodness.residual_over_noise == pytest.approx(decoded, rel=0.02)


def early(by: tuple[float, ...], louder: float = 1.0, bent: float = 0.0) -> Log:
    """18 runs whose readings are early by samples, channel by channel; noise `louder` times, as is stated.

    `bent`: share by which gains grow towards the ends of x, which no model here knows.
    """
    log, rng = bundled_campaign(), np.random.default_rng(1)
    data = {c: v[log.array("run") < 18] for c, v in columns_of(log).items()}
    out, std = dict(data), log.noise.std
    for c, samples in zip(HALL, by, strict=True):
        parts = [data[c][data["run"] == run] for run in range(18)]
        moved = [np.interp(np.arange(len(v)) + samples, np.arange(len(v)), v) for v in parts]
        more = np.sqrt(louder**2 - 1) * std[c] * rng.standard_normal(len(data[c]))
        out[c] = np.concatenate(moved) * (1 + bent * np.abs(data["x_ref_m"]) / 3e-4) + more
    return Log.from_arrays(
        out, Noise({c: Sigma(louder * s if c in HALL else s, "given") for c, s in std.items()})
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("log", "late"),
    [
        ({"by": (0.3, 0.3, 0.3)}, False),  # a lag, or half a sample of a logger
        ({"by": (2.0, 2.0, 2.0)}, True),
        ({"by": (2.0, 2.0, 2.0), "louder": 20.0}, True),  # 1.4 times the variance of noise
    ],
)
def test_a_delay_is_claimed_where_it_explains_the_misfit(log, late):
    found = fit(early(**log), "stage31", solver="direct", loss="none")
    same = {"delay hall_a_m,hall_b_m,hall_c_m -2", "delay x_ref_m,y_ref_m,rz_ref_rad 2"}
    assert [same <= {one.correction, *one.rivals} for one in found.claims] == [True] * late
    assert found.goodness.sentence


def test_a_channel_that_lags_in_one_run_is_named():
    data = columns_of(bundled_campaign())
    late = np.flatnonzero(data["run"] == 5)
    data["hall_a_m"][late[2:]] = data["hall_a_m"][late[:-2]]
    log = Log.from_arrays(data, noise=bundled_campaign().noise)
    found = fit(log, "stage31", solver="direct", accept=["all"]).goodness
    assert (found.worst_run, found.worst_channel) == (5, "hall_a_m")
    assert "worst in run 5, channel hall_a_m" in found.sentence


@pytest.mark.slow
def test_one_run_counts_although_the_whole_does_not():
    """Twice the noise in one run of 57 is 1.03 times the noise overall."""
    columns = record(seed=6, samples=200)
    here = columns["run"] == 12
    rng = np.random.default_rng(1)
    for c in HALL:
        columns[c][here] += 4 * SIGMAS[c] * rng.standard_normal(here.sum())
    found = goodness(columns, loss="none")
    assert found.residual_over_noise < found.limit
    assert found.material
    assert found.worst_run == 12


@pytest.mark.parametrize("logs", [10, pytest.param(300, marks=pytest.mark.slow)], ids=["few", "many"])
def test_simulated_logs_without_a_mistake_raise_no_alarm(logs):
    """At most 1 % of them; correlated noise, Student's noise and a coarse converter among them."""
    kinds = ({}, {"correlation_s": 0.03}, {"degrees_of_freedom": 5.0}, {"adc_step_m": 1e-6}, {})
    alarms = 0
    for seed in range(logs):
        samples = (20, 50, 100)[seed % 3]
        cost = cost_on(with_noise(record(seed=seed, samples=samples, **kinds[seed % len(kinds)])), MODEL)
        p = refit(cost, MODEL.nominal, [MODEL.names.index(n) for n in ("H1y", "H2y", "H3x")])
        alarms += goodness_of(cost.at(p), 18).material
    assert alarms <= 0.01 * logs


# -- what it costs to be this model -------------------------------------------------------------------------


def exact_reference(columns: dict[str, np.ndarray], model) -> tuple:
    """The cost with an exact reference, and its optimum from Table 7."""
    sigma = {c: SIGMAS[c] for c in HALL}
    cost = cost_on(with_noise(columns, sigma), model, sigma)
    held = [model.names.index(n) for n in ("H1y", "H2y", "H3x") if n in model.names]
    return cost, refit(cost, model.nominal, held)


def test_the_lower_bound_is_least_squares_with_free_coefficients():
    """One regression per channel on 1, x, y, rz and each run's own offset, by numpy."""
    model = true_model("stage30")
    columns = record("stage30", seed=8, sigma={c: SIGMAS[c] for c in HALL})
    cost, p = exact_reference(columns, model)
    run = columns["run"].astype(int)
    A = np.column_stack([*(columns[c] * 1e4 for c in COLUMNS[:3]), np.eye(57)[run]])
    squares = sum(np.linalg.lstsq(A, columns[c], rcond=None)[1][0] / SIGMAS[c] ** 2 for c in HALL)
    found = lower_bound(cost.at(p), 9)
    assert found.cost == pytest.approx(squares, rel=1e-9)
    assert found.coefficients == 9
    assert found.expected == pytest.approx(1.0)
    assert found.ratio == pytest.approx(cost.at(p).value / squares, rel=1e-12)
    assert found.near


@pytest.mark.parametrize("name", ["stage31", "stage31_tied", "stage30"])
def test_the_optimum_is_as_near_to_the_bound_as_coefficients_allow(name):
    """Noisy reference, gains that follow the height, tied coefficients: the ratio is that of chi-squares."""
    model = true_model(name)
    result = fit(with_noise(record(name, seed=9)), model, solver="direct")
    found = result.solver.lower_bound
    freedom = result.goodness.degrees_of_freedom
    more = freedom * (found.expected - 1)
    assert found.ratio >= 1
    assert found.ratio == pytest.approx(found.expected, abs=5 * np.sqrt(2 * max(more, 1.0)) / freedom)
    assert found.near


@pytest.mark.slow
def test_a_bound_that_is_in_the_way_costs():
    tight = MODEL.with_parameters({"eta_B": {"nominal": 0.695, "lower": 0.65, "upper": 0.695}})
    free = fit(with_noise(record(seed=8)), MODEL, solver="direct").solver.lower_bound
    result = fit(with_noise(record(seed=8)), tight, solver="direct", accept=["all"])
    found = result.solver.lower_bound
    assert result.at_bound == ("eta_B",)
    assert found.cost == pytest.approx(free.cost, rel=0.01)
    assert found.ratio > 1.5 * free.ratio
    assert not found.near


def test_models_without_exact_statistics_have_no_bound():
    log = read_log(ROOT / "data" / "campaign")
    result = fit(log, "stage31", effects=("time_skew",), solver="direct")
    assert result.solver.lower_bound is None
    assert result.goodness.sentence is None
