"""Closed curves as candidates of a plan: within the ranges, no faster than sines, and what they gain."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from twins import SIGMAS, TRUTH

from hallsym.cli.main import main
from hallsym.estimation import fit
from hallsym.experiment import candidates, closed_curves, paper_ranges, plan
from hallsym.families import build
from hallsym.log import Log
from hallsym.report.text import plan_text
from hallsym.simulation import NoiseModel, is_closed, read_campaign, simulate, write_campaign

MODEL = build("stage31")
REACH = {"x_m": 3e-4, "y_m": 5e-4, "rz_rad": 3e-4}
COARSE = replace(paper_ranges(), step_s=0.02, levels=2, noise=SIGMAS, trajectories=("combined", "curves"))


@pytest.fixture(scope="module")
def planned():
    return plan(replace(COARSE, seconds_per_run=4.0), MODEL, TRUTH, runs=10)


@pytest.mark.parametrize(("duration_s", "fastest_hz"), [(1.0, 3.0), (10.0, 3.0), (2.0, 0.7)])
def test_curves_are_closed_within_the_ranges_and_no_faster_than_sines(duration_s, fastest_hz):
    found = list(closed_curves(REACH, duration_s, fastest_hz))
    assert found
    for following in found:
        assert is_closed(following.curve)
        t = np.linspace(0.0, duration_s, 20001)
        h = t[1]
        for axis, signal in following.signals().items():
            p, limit = signal(t) / REACH[axis], 2 * np.pi * fastest_hz
            assert np.abs(p).max() <= 1 + 1e-12
            assert np.abs(np.diff(p)).max() <= limit * h * (1 + 1e-6)
            assert np.abs(np.diff(p, 2)).max() <= (limit * h) ** 2 * (1 + 1e-3)


def test_there_are_tours_spirals_and_rasters_where_there_is_time():
    kinds = {f.name.partition("_")[0] for f in closed_curves(REACH, 10.0, 3.0)}
    assert kinds == {"corners", "spiral", "raster"}
    assert not list(closed_curves(REACH, 0.01, 3.0))
    assert not list(closed_curves({"angle_rad": 3.0}, 10.0, 3.0))  # no coordinate of a curve


def test_a_long_tour_stays_at_every_corner_and_moves_one_axis_at_a_time():
    tour = next(f for f in closed_curves(REACH, 10.0, 3.0) if f.name == "corners_x_y_rz")
    points = tour.curve(np.linspace(0, 1, 4001)) / list(REACH.values())
    for corner in product((-1, 1), repeat=3):
        assert np.abs(points - corner).max(axis=1).min() < 1e-9
    assert np.all(np.sum(np.abs(points) < 1 - 1e-9, axis=1) <= 1)
    assert points.var(axis=0).min() > 0.8  # of a sine it is 0.5


def test_curves_are_tried_only_where_asked_for():
    plain = replace(COARSE, trajectories=paper_ranges().trajectories)
    assert "curves" not in plain.trajectories
    assert all(c.run.follows is None for c in candidates(plain, MODEL))
    assert plan(plain, MODEL, TRUTH, runs=8).sines is None
    assert any(c.run.follows for c in candidates(COARSE, MODEL))


def test_the_plan_says_what_curves_gain_against_sines_only(planned):
    sines = planned.sines
    assert planned.curves == 10
    assert planned.choice.value > 1.5 * sines.other.value
    alone = plan(replace(planned.study.ranges, trajectories=("combined",)), MODEL, TRUTH, runs=10)
    assert sines.other.value == pytest.approx(alone.choice.value, rel=1e-3)
    assert np.median(sines.other.std / planned.std) > 1.2
    assert sines.runs_same_value < 10
    assert "curves are worth it: 10 of 10 runs follow one" in plan_text(planned)
    record = planned.to_dict()["curves"]
    assert record["runs_with_curves"] == 10
    assert record["sines_only"]["runs_same_value"] == sines.runs_same_value


def test_the_plan_says_where_curves_are_worth_nothing():
    short = replace(COARSE, seconds_per_run=1.0, frequencies_hz=(0.6, 0.7, 0.8))
    found = plan(short, MODEL, TRUTH, runs=10)
    assert found.curves == 0
    assert "curves are not worth it here" in plan_text(found)


def test_what_a_plan_with_curves_promises_is_what_a_fit_of_its_recording_states(planned, tmp_path):
    write_campaign(planned.campaign, tmp_path / "next.toml")
    campaign = read_campaign(tmp_path / "next.toml")
    columns = simulate(MODEL, TRUTH, campaign, NoiseModel(SIGMAS), seed=4)
    found = fit(Log.from_arrays(columns), "stage31", solver="direct", loss="none")
    stated = dict(zip(MODEL.names, np.sqrt(np.diag(found.covariance)), strict=True))
    ratios = [stated[n] / s for n, s in zip(planned.names, planned.std, strict=True) if n in stated]
    assert len(ratios) > 10
    assert np.allclose(ratios, 1.0, atol=0.1)


def test_the_command_tries_curves(capsys, tmp_path):
    words = ["plan", "--like-paper", "--curves", "--runs", "10", "-o", str(tmp_path / "n.toml"), "--json"]
    assert main(words) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["curves"]["runs_with_curves"] > 0
    assert any(run.follows for run in read_campaign(tmp_path / "n.toml").runs)


@pytest.mark.slow
def test_refits_scatter_less_with_curves_by_what_the_plan_says():
    kinds = (*paper_ranges().trajectories, "curves")
    found = plan(replace(COARSE, levels=5, seconds_per_run=4.0, trajectories=kinds), MODEL, TRUTH, runs=12)
    sines = plan(replace(found.study.ranges, trajectories=kinds[:-1]), MODEL, TRUTH, runs=12)

    def scatter(campaign):
        values = []
        for seed in range(100):
            columns = simulate(MODEL, TRUTH, campaign, NoiseModel(SIGMAS), seed=seed)
            fitted = fit(Log.from_arrays(columns), "stage31", solver="direct", loss="none")
            values.append([fitted.value(name) for name in found.names if name in MODEL.names])
        return np.std(values, axis=0, ddof=1)

    measured = np.median(scatter(sines.campaign) / scatter(found.campaign))
    assert measured == pytest.approx(np.median(sines.std / found.std), rel=0.05)
