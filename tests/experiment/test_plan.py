"""Planning for the stage: information derived a second time, what a plan may touch, what it promises."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import COLUMNS, SIGMAS, TRUTH, phi, pm, with_noise

from hallsym.errors import InputError
from hallsym.estimation.factors import summarise
from hallsym.estimation.identifiable import determine
from hallsym.estimation.likelihood import cost_of
from hallsym.estimation.optimum import refit
from hallsym.experiment import CRITERIA, paper_ranges, plan
from hallsym.experiment.ranges import candidates
from hallsym.experiment.study import planned_cost
from hallsym.families import build
from hallsym.model.influence import influence
from hallsym.simulation import Campaign, NoiseModel, Run, paper_campaign, simulate, sine

MODEL = build("stage31")
AXES = (*MODEL.pose, *MODEL.state)
TIED = {**{n: v for n, v in TRUTH.items() if n in build("stage31_tied").names}, "x0": 0.12, "y0": -0.02}
COARSE = replace(paper_ranges(), step_s=0.02, levels=3, noise=SIGMAS)
"""The paper's ranges on a slow clock."""
TABLE6 = paper_campaign(0.02)


@pytest.fixture(scope="module")
def planned():
    return plan(COARSE, MODEL, TRUTH)


# -- the information of a run ----------------------------------------------------------------------------


def second_information(run: Run, step_s: float) -> np.ndarray:
    """J' C^-1 J of one run, its zeros eliminated, from the article's PM and phi and finite differences."""
    t = np.arange(round(run.duration_s / step_s)) * step_s
    columns = {axis: run.position(axis, t) for axis in AXES}
    q = np.array([columns[axis] for axis in AXES[:3]])
    state = np.array([columns[axis] for axis in AXES[3:]])

    def reading(p, q=q, state=state, d=0.0):
        v = dict(zip(MODEL.names, p, strict=True))
        return phi(v, state) * (pm(v) @ q + d)

    def slope(function, at, step):
        return np.array(
            [
                (function(at + h) - function(at - h)) / (2 * s)
                for s, h in zip(step, np.diag(step), strict=True)
            ]
        )

    p = MODEL.vector(TRUTH)
    by_p = slope(reading, p, 1e-6 * np.maximum(np.abs(p), 1.0))  # (n, channels, samples)
    by_zero = np.array([phi(TRUTH, state) * unit[:, None] for unit in np.eye(3)])
    full = np.concatenate([by_p, by_zero])
    steps = [1e-6 * unit[:, None] for unit in np.eye(3)]
    by_q = [reading(p, q=q + h) - reading(p, q=q - h) for h in steps]
    by_state = [reading(p, state=state + h) - reading(p, state=state - h) for h in steps]
    J = np.array(by_q + by_state) / 2e-6  # (columns, channels, samples)
    sigma = np.array([SIGMAS[c] for c in COLUMNS])
    C = np.diag([SIGMAS[c] ** 2 for c in MODEL.channels]) + np.einsum("ckt,clt,c->kl", J, J, sigma**2) / len(
        t
    )
    F = np.einsum("akt,kl,blt->ab", full, np.linalg.inv(C), full)
    n = len(p)
    return F[:n, :n] - F[:n, n:] @ np.linalg.solve(F[n:, n:], F[n:, :n])


@pytest.mark.parametrize("k", [0, 4, 20, 38])
def test_information_of_a_planned_run_is_what_a_second_derivation_gives(k):
    run = TABLE6.runs[k]
    moved = replace(run, motion={**run.motion, "z_m": sine(1e-4, 2.0), "rz_rad": sine(2e-4, 3.0)})
    for tried in (run, moved):
        cost, factor = planned_cost([tried], 0.02, MODEL, TRUTH, SIGMAS)
        found = factor[0] * cost.at(MODEL.vector(TRUTH)).information(0.0)[0]
        expected = second_information(tried, 0.02)
        size = np.sqrt(np.diag(expected))
        size[size == 0] = 1.0
        assert np.abs((found - expected) / np.outer(size, size)).max() < 1e-5


# -- candidates ------------------------------------------------------------------------------------------


def test_candidates_are_settings_times_trajectories():
    """27 settings; 3 one-axis, 4 combined."""
    found = candidates(COARSE, MODEL)
    assert len(found) == 27 * 7
    assert len({c.run.name for c in found}) == len(found)
    places = {tuple(c.run.setting[a] for a in AXES[3:]) for c in found}
    expected = {(z, rx, ry) for z in (-250, 0, 250) for rx in (-500, 0, 500) for ry in (-500, 0, 500)}
    assert {tuple(round(1e6 * v) for v in place) for place in places} == expected


zones = st.lists(
    st.dictionaries(
        st.sampled_from(AXES),
        st.tuples(st.floats(-6e-4, 6e-4), st.floats(0, 6e-4)).map(lambda v: (v[0], v[0] + v[1])),
        min_size=1,
    ),
    max_size=2,
).map(tuple)


@settings(max_examples=40, deadline=None)
@given(zones, st.tuples(st.floats(-4e-4, 2e-4), st.floats(0, 5e-4)))
def test_no_candidate_leaves_its_ranges_or_enters_an_excluded_zone(zones, z):
    box = COARSE.box | {"z_m": (z[0], z[0] + z[1])}
    ranges = replace(COARSE, box=box, excluded=zones, frequencies_hz=(1.0, 2.0, 3.0, 4.0))
    try:
        found = candidates(ranges, MODEL)
    except InputError:  # the zones may hold everything
        found = ()
        assert zones
    t, tiny = np.linspace(0, 1, 81), 1e-12
    for candidate in found[::7]:
        path = {axis: candidate.run.position(axis, t) for axis in AXES}
        for axis in AXES:
            low, high = box[axis]
            assert low - tiny <= path[axis].min() <= path[axis].max() <= high + tiny
        for zone in zones:
            inside = [(low + tiny < path[a]) & (path[a] < high - tiny) for a, (low, high) in zone.items()]
            assert not np.any(np.logical_and.reduce(inside))


# -- plans -----------------------------------------------------------------------------------------------


def test_a_plan_has_the_runs_it_says_and_says_how_good_it_is(planned):
    assert len(planned.campaign.runs) == 57
    assert sum(n for n, _, _ in planned.groups()) == 57
    assert planned.names[:3] == ("eta_A", "eta_B", "eta_C")
    assert len(planned.names) == 18  # of 21: H enters through three lever arms
    assert not {"H1x", "H1y"} & set(planned.names)
    assert np.all(planned.std > 0)


def test_the_best_settings_for_gains_that_are_linear_are_the_corners(planned):
    """A gain that is linear in Z, Rx, Ry is a plane: its D-optimal points are the corners of the box."""
    for run in planned.campaign.runs:
        place = [run.setting[axis] * 1e6 for axis in AXES[3:]]
        assert np.allclose(np.abs(place), (250, 500, 500))


def value_of(study, runs):
    """Return the criterion of the best choice of so many runs."""
    return study.value(study.information(study.choose(runs)))


def of_table_6(study):
    """Information (m, m) of the paper's campaign."""
    cost, factor = planned_cost(TABLE6.runs, TABLE6.step_s, MODEL, TRUTH, SIGMAS)
    each = cost.at(MODEL.vector(TRUTH)).information(0.0)
    return study.basis.T @ np.tensordot(factor, each, axes=1) @ study.basis


def test_a_plan_is_smaller_than_table_6_in_as_many_runs_and_as_good_in_8(planned):
    study = planned.study
    other = of_table_6(study)
    assert np.all(study.std(other) > 1.5 * planned.std)
    assert np.all(study.position(other) > 3 * planned.position)
    assert value_of(study, 7) < study.value(other) <= value_of(study, 8)


def test_more_runs_are_never_worse_and_the_same_seed_gives_the_same_plan(planned):
    values = [value_of(planned.study, n) for n in (6, 9, 14, 24, 57)]
    assert np.all(np.diff(values) > 0)
    again = plan(COARSE, MODEL, TRUTH, runs=12, seed=3).counts
    assert np.array_equal(again, plan(COARSE, MODEL, TRUTH, runs=12, seed=3).counts)


def test_nothing_inside_the_ranges_is_less_certain_than_the_plan_says(planned):
    """The worst position uncertainty is found at corners: 300 random poses have none that is larger."""
    rng = np.random.default_rng(0)
    low, high = np.array([COARSE.box[axis] for axis in AXES]).T
    pose, state = np.split(rng.uniform(low, high, (300, 6)).T, [3])
    slopes = influence(MODEL, MODEL.vector(TRUTH), [np.zeros(300)] * 3, list(pose), list(state)).parameters
    inverse = np.linalg.inv(planned.study.information(planned.counts))
    rows = slopes @ planned.study.basis
    u = np.sqrt(np.einsum("som,mk,sok->so", rows, inverse, rows))
    assert np.all(u.max(axis=0) <= planned.position)
    assert np.all(u.max(axis=0) > 0.3 * planned.position)


def test_each_criterion_is_best_at_its_own():
    plans = {name: plan(COARSE, MODEL, TRUTH, runs=12, criterion=name) for name in CRITERIA}
    for name, own in plans.items():
        values = {other: own.study.value(p.study.information(p.counts)) for other, p in plans.items()}
        assert max(values, key=values.__getitem__) == name


def test_the_point_of_the_tied_coupling_needs_a_slope():
    """With gains that do not follow the height nothing shows where the height is measured."""
    model = build("stage31_tied")
    assert "x0" in plan(COARSE, model, TIED).names
    flat = TIED | dict.fromkeys(("a_A", "a_B", "a_C"), 0.0)
    with pytest.raises(InputError, match=r"determines .*(x0|y0)"):
        plan(COARSE, model, flat)


def test_fixed_parameters_are_left_out():
    model = MODEL.with_parameters({"theta_A": {"nominal": 0.0, "lower": 0.0, "upper": 0.0}})
    fixed = plan(COARSE, model, {n: v for n, v in TRUTH.items() if n != "theta_A"})
    assert "theta_A" not in fixed.names
    assert "H1x" in fixed.names  # the lever arm of a probe that is not turned
    assert "H1y" not in fixed.names


# -- after a log -----------------------------------------------------------------------------------------


def recorded(campaign: Campaign, seed: int = 0):
    return with_noise(simulate(MODEL, TRUTH, campaign, NoiseModel(SIGMAS), seed=seed))


def test_a_plan_adds_what_the_log_lacks():
    """A log at one height says nothing of the slopes: the plan goes to other heights."""
    level = recorded(Campaign(0.02, tuple(Run(1.0, {}, run.motion) for run in TABLE6.runs[:12])))
    more = plan(COARSE, MODEL, TRUTH, runs=6, after=level)
    assert more.recorded == 12
    assert more.before is not None
    assert more.before.std is None
    assert {n[0] for n in more.before.parameters} <= {"a", "b", "c"}
    assert more.after.std is not None
    assert all(any(run.setting[axis] for axis in AXES[3:]) for run in more.campaign.runs)
    alone = plan(COARSE, MODEL, TRUTH, runs=6)
    assert np.all(more.std < alone.std * (1 + 1e-9))


def test_a_log_of_many_heights_leaves_little_to_add():
    log = recorded(TABLE6)
    more = plan(COARSE, MODEL, TRUTH, runs=3, after=log)
    cost = cost_of(summarise(log, MODEL), SIGMAS)
    p = MODEL.vector(TRUTH)
    only = more.study.basis.T @ cost.at(p).information(1.0).sum(axis=0) @ more.study.basis
    assert np.allclose(only, more.study.known, rtol=1e-12)
    assert np.all(more.std < more.study.std(only))
    assert more.after.std < more.before.std


# -- refused ---------------------------------------------------------------------------------------------


def refused(match: str, **changes) -> None:
    options = {k: changes.pop(k) for k in ("runs", "minutes", "criterion", "model") if k in changes}
    with pytest.raises(InputError, match=match):
        plan(replace(COARSE, **changes), options.pop("model", MODEL), TRUTH, **options)


def test_plans_that_cannot_be_are_refused_in_one_sentence():
    planar = {axis: COARSE.box[axis] for axis in AXES[:3]}
    refused("No admissible setting", excluded=({"z_m": (-1.0, 1.0)},))
    refused("from low to high", box=COARSE.box | {"z_m": (1e-4, -1e-4)})
    refused("x, y or Rz", box={"z_m": (-1e-4, 1e-4)})
    refused("2 runs are too few .* at least 4", runs=2)
    refused("determines .*a_A", box=planar)
    refused("too short for one run", minutes=0.01, reset_s=10.0)
    refused("reset_s", minutes=10.0)
    refused("did you mean 'max-u'", criterion="maxu")
    refused("half the sampling rate", frequencies_hz=(1.0, 26.0))
    refused("half a period", seconds_per_run=0.1)
    refused("Noise of hall_a_m", noise={"x_ref_m": 1e-6})
    refused("hall_q_m", noise={"hall_q_m": 1e-6})
    refused("cannot be made of 1 freq", frequencies_hz=(1.0,), trajectories=("combined",))
    with pytest.raises(InputError, match="'runs' or 'minutes'"):
        plan(replace(COARSE, runs=None), MODEL, TRUTH)


def test_minutes_hold_the_runs_and_the_resets_between_them():
    """10 minutes of 1 s runs, 19 s apart: 30 runs and 29 resets take 581 s; 31 would take 601 s."""
    timed = replace(COARSE, reset_s=19.0, runs=None)
    assert timed.allowed(None, 10.0) == 30
    assert timed.allowed(None, 601 / 60) == 31
    assert timed.allowed(7, 10.0) == 7
    assert plan(timed, MODEL, TRUTH, minutes=10.0).minutes == pytest.approx(581 / 60)


# -- what is promised holds ------------------------------------------------------------------------------


def scatter(campaign: Campaign, seeds: int, gradients: np.ndarray) -> np.ndarray:
    """Standard deviation of the fitted quantities over simulated recordings of a campaign."""
    p, found = MODEL.vector(TRUTH), []
    for seed in range(seeds):
        cost = cost_of(summarise(recorded(campaign, seed), MODEL), SIGMAS)
        held = determine(cost, p).fixed
        found.append(refit(cost, p, held))
    return np.std(np.array(found) @ gradients.T, axis=0, ddof=1)


@pytest.mark.slow
def test_refits_of_simulated_recordings_scatter_as_planned(planned):
    """Both campaigns: std, and their ratio, within 4 sigma of a standard deviation from 200 fits."""
    seeds = 200
    slack = 4 / np.sqrt(2 * (seeds - 1))
    gradients, other = planned.study.gradients, planned.study.std(of_table_6(planned.study))
    a = scatter(planned.campaign, seeds, gradients)
    b = scatter(TABLE6, seeds, gradients)
    assert np.all(np.abs(a / planned.std - 1) < slack)
    assert np.all(np.abs(b / other - 1) < slack)
    assert np.all(np.abs(b / a * planned.std / other - 1) < np.sqrt(2) * slack)
    assert np.median(b / a) > 2
