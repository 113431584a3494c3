"""What the data determine: exact null directions, and what is left when an axis is at rest."""

import numpy as np
import pytest
from twins import (
    SIGMAS,
    TRUTH,
    combinations_of_effects,
    cost_on,
    phi,
    record,
    simulated,
    true_model,
    with_noise,
)

from hallsym.estimation import fit
from hallsym.estimation.factors import RunStatistics
from hallsym.estimation.identifiable import (
    determine,
    scales,
    structural_null,
    structural_rank,
)
from hallsym.estimation.likelihood import cost_of
from hallsym.families import build
from hallsym.model import find_features
from hallsym.simulation import Campaign, NoiseModel, Run, paper_campaign, simulate

H = {"H1x", "H1y", "H2x", "H2y", "H3x", "H3y"}


def null_of(model) -> np.ndarray:
    features, state = find_features(model), np.zeros((1, len(model.state)))
    triangles = np.eye(features.size + len(model.channels))[None]
    slopes, centre = np.zeros((1, features.slope_pairs.shape[1])), np.zeros(features.exponents.shape[1])
    summary = RunStatistics(features, centre, (0,), triangles, slopes, np.ones(1), state, state)
    return structural_null(cost_of(summary, dict.fromkeys(model.channels, 1.0)))


@pytest.mark.parametrize(("name", "effects"), combinations_of_effects())
def test_null_directions_leave_readings_alone_and_no_other_does(name, effects):
    """Rank of d reading / d p over random poses, states and zeros, by plain differences of the model."""

    model = build(name, added=effects)
    rng, width = np.random.default_rng(1), scales(model)
    p = rng.uniform(*model.bounds)
    q, s = rng.uniform(-0.3, 0.3, (2, 3, 400))
    columns = []
    for k in range(len(p)):
        step = np.zeros(len(p))
        step[k] = 1e-5 * width[k]
        columns.append((model.readings(p + step, q, s) - model.readings(p - step, q, s)).ravel() / 2e-5)
    singular = np.linalg.svd(np.array(columns).T / np.linalg.norm(columns, axis=1), compute_uv=False)
    null = null_of(model).shape[1]
    assert np.sum(singular < 1e-8 * singular[0]) == null
    # kept singular values are above 1e-9, dropped ones rounding: nothing lies between
    rank, sizes = structural_rank(find_features(model), (True,) * len(model.names))
    assert rank == len(model.names) - null
    assert np.all(sizes[:rank] > 1e-9)
    assert np.all(sizes[rank:] < 1e-14)


def only(runs, sigma=SIGMAS, samples: int = 50, seed: int = 2):
    return simulated(build("stage31"), TRUTH, Campaign(1 / samples, tuple(runs)), sigma, seed)


Z0, RX0, RY0 = 1.5e-4, -2e-4, 1e-4


def test_a_vertical_state_that_never_moves_leaves_only_the_gain_at_it():
    """a, b, c are not determined, eta + a Z0 + b Rx0 + c Ry0 is."""
    setting = {"z_m": Z0, "rx_rad": RX0, "ry_rad": RY0}
    log = only([Run(1.0, setting, run.motion) for run in paper_campaign().runs[:30]])
    found = fit(log, "stage31", solver="direct")
    low, high = found.model.bounds  # what is held stays inside
    assert np.all((low <= found.values) & (found.values <= high))
    determined = dict(zip(found.model.names, found.determined, strict=True))
    assert not any(determined[f"{q}_{k}"] for q in "abc" for k in "ABC")
    assert not any(determined[f"eta_{k}"] for k in "ABC")
    assert all(determined[f"theta_{k}"] for k in "ABC")
    assert set(found.undetermined_by_log) == {f"{q}_{k}" for q in ("a", "b", "c", "eta") for k in "ABC"}
    gains = dict(zip("ABC", phi(TRUTH, np.array([Z0, RX0, RY0])), strict=True))
    for k in "ABC":
        (one,) = [c for c in found.combinations if f"*a_{k}" in c.expression]
        none = dict.fromkeys(found.model.names, 0.0)
        slope = {
            q: eval(one.expression, {"__builtins__": {}}, none | {f"{q}_{k}": 1.0})
            for q in ("eta", "a", "b", "c")
        }
        assert slope["a"] / slope["eta"] == pytest.approx(Z0, rel=1e-3)
        assert slope["b"] / slope["eta"] == pytest.approx(RX0, rel=1e-3)
        assert slope["c"] / slope["eta"] == pytest.approx(RY0, rel=1e-3)
        assert abs(one.value / slope["eta"] - gains[k]) < 4.5 * one.std / abs(slope["eta"])
        assert one.std / abs(slope["eta"]) < 2e-3


def test_an_axis_that_never_turns_leaves_no_lever_arm():
    log = only([run for k, run in enumerate(paper_campaign().runs) if k % 3 != 2])
    found = fit(log, "stage31", solver="direct")
    determined = dict(zip(found.model.names, found.determined, strict=True))
    assert not any(determined[n] for n in H)
    assert all(determined[n] for n in set(found.model.names) - H)
    assert not any("H" in c.expression for c in found.combinations)
    assert set(found.fixed) >= H


def test_noise_alone_is_no_motion():
    """An axis at rest whose reference is noisy determines nothing, however many samples."""
    sigma = {**SIGMAS, "rz_ref_rad": 5e-6}
    log = only([run for k, run in enumerate(paper_campaign().runs) if k % 3 != 2], sigma, samples=400)
    model = true_model()
    found = determine(cost_on(log, model, sigma), model.nominal)
    assert {model.names[k] for k in found.fixed} == H


def test_a_fixed_parameter_is_held_and_is_no_null_direction():
    model = build("stage31", parameters={"theta_A": {"fixed": True}, "H1y": {"fixed": True}})
    found = determine(cost_on(with_noise(record(seed=1)), model), model.vector({"eta_A": 0.87}))
    held = {model.names[k] for k in found.fixed}
    assert {"theta_A", "H1y"} <= held
    assert "H1x" not in held
    assert len(held) == 4


def test_a_planned_campaign_counts_its_motion_whole():
    """Noise-free columns as a plan hold as much as noisy ones do once the noise's share is taken out."""
    from dataclasses import replace

    model, campaign = true_model(), paper_campaign(0.02)
    exact = cost_on(with_noise(simulate(model, TRUTH, campaign, seed=1)), model)
    plan = replace(exact, planned=True).at(model.nominal).information(1.0)
    noisy = [
        cost_on(with_noise(simulate(model, TRUTH, campaign, NoiseModel(SIGMAS), seed=s)), model)
        .at(model.nominal)
        .information(1.0)
        .sum(axis=0)
        for s in range(8)
    ]
    size = np.sqrt(np.outer(*[np.diag(plan.sum(axis=0))] * 2))
    assert (np.abs(np.mean(noisy, axis=0) - plan.sum(axis=0)) / size).max() < 0.01
