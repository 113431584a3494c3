"""The diagnosis names what a hidden machine has, keeps quiet without a gap, and admits what it lacks."""

import json
from dataclasses import replace

import numpy as np
import pytest
from gap_twins import faulty, listed, machine, unlisted
from twins import record, with_noise

import hallsym
from hallsym.campaign import paper_campaign
from hallsym.computed import HALVES, extended, rate, widest_half
from hallsym.diagnosis import Variant, diagnose, diagnosis_text, load_effects, user_effect
from hallsym.diagnosis.engine import base_of
from hallsym.diagnosis.refit import refit, with_model
from hallsym.diagnosis.tangent import tangents
from hallsym.families import stage_effects as se
from hallsym.log import Log, Meta
from hallsym.model import Model, Parameter

NAMED = (
    ("odd_nonlinearity", "raster"),
    ("hysteresis", "multisine"),
    ("gain_temperature_drift", "multisine"),
    ("mount_slip", "grid"),
    ("mains_hum", "raster"),
)


def hidden(name: str, campaign: str, seed: int = 1, kind=listed, **options) -> Log:
    effect = kind(np.random.default_rng(seed))[name]
    return machine(campaign, (effect,), seed=seed, temperature="temperature" in name, **options)


@pytest.mark.parametrize(("name", "campaign"), NAMED)
def test_a_hidden_effect_is_named_and_closes_the_gap(name: str, campaign: str) -> None:
    found = diagnose(hidden(name, campaign))
    assert (found.verdict, found.ranked[0]) == ("explained", name)
    assert found.metric["after"] < 1.1 * found.metric["floor"]
    low, high = found.shrinkage["interval"]
    assert low <= found.shrinkage["value"] <= high


@pytest.mark.parametrize("name", faulty(np.random.default_rng(0)))
def test_a_fault_of_samples_is_named(name: str) -> None:
    found = diagnose(hidden(name, "multisine", kind=faulty))
    assert (found.verdict, found.ranked[0]) == ("explained", name)


@pytest.mark.parametrize("name", ["bump", "ripple", "wander"])
def test_what_no_catalogue_lists_is_unexplained(name: str) -> None:
    found = diagnose(hidden(name, "raster", kind=unlisted))
    assert found.verdict == "unexplained"
    assert found.remaining


@pytest.mark.parametrize("noise", ["white", "heavy", "correlated"])
def test_noise_alone_is_no_gap(noise: str) -> None:
    found = diagnose(machine("multisine", seed=5, noise=noise))
    assert (found.verdict, found.ranked, found.groups) == ("no gap", (), ())


def test_two_effects_are_both_found() -> None:
    effects = listed(np.random.default_rng(3))
    log = machine("raster", (effects["odd_nonlinearity"], effects["mains_hum"]), seed=3)
    found = diagnose(log)
    assert found.verdict == "explained"
    assert set(found.ranked[:2]) == {"odd_nonlinearity", "mains_hum"}


def test_delay_and_lag_at_one_frequency_are_a_group_with_what_would_separate_them() -> None:
    found = diagnose(hidden("time_skew", "grid"))
    assert set(found.groups[0]) == {"time_skew", "first_order_lag"}
    assert "frequenc" in found.separate_by[0].recording
    assert found.separate_by[0].factor > 1


def test_the_papers_own_step_from_model_30_to_31() -> None:
    log = replace(with_noise(record(seed=4, samples=80)), meta=Meta(holdout=tuple(range(2, 57, 5))))
    found = diagnose(log, "stage30")
    assert (found.verdict, found.ranked[0]) == ("explained", "vertical_gain_coupling")
    refitted = hallsym.fit(log, "stage31", solver="direct").errors.rows()["holdout"]["rmse"]
    for name, value in found.gap_after["rmse"].items():
        assert value == pytest.approx(refitted[name], rel=0.05)


def test_the_record_is_json_and_says_what_could_not_be_tested() -> None:
    found = diagnose(machine("multisine", seed=2))
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    for key in ("verdict", "noise_floor", "gap_before", "gap_after", "ranked", "groups", "effects", "where",
                "separate_by", "validation_runs"):  # fmt: skip
        assert key in data
    assert data["not_testable"]["gain_temperature_drift"] == "no temperature logged"
    assert data["not_testable"]["reference_scale_error"].startswith("the model's own parameters absorb it")
    assert "no gap" in diagnosis_text(found)


def speed_gain(model: Model) -> Model:
    """Gain that follows the speed of x."""
    slope = Parameter("speed_gain", 0.0, -100.0, 100.0, "s/m")

    def step(s, p) -> None:
        s["gain"] = s["gain"] * (1 + p["speed_gain"] * s["d1_x_ref_m"])

    wide = model.with_columns(rate("x_ref_m"))
    return wide.with_step("transducer", step, effect="speed_gain", parameters=(slope,))


def test_a_users_effect_is_found_and_a_broken_one_stops_nothing() -> None:
    def inject(m, _) -> None:
        m.reading = m.reading * (1 + 5.0 * np.gradient(m.pose[0], 0.002))

    def broken(model: Model) -> Model:
        raise ValueError("oops")

    def nonsense(model: Model) -> int:
        return 3

    log = machine("multisine", (inject,), seed=6)
    found = diagnose(log, effects=[user_effect(f) for f in (speed_gain, broken, nonsense)])
    assert (found.verdict, found.ranked[0]) == ("explained", "speed_gain")
    assert found.effects[0].parameters["speed_gain"].value == pytest.approx(5.0, rel=0.05)
    assert found.not_testable["broken"] == "raised ValueError: oops"
    assert "must return a Model" in found.not_testable["nonsense"]


def test_effects_are_read_from_a_file(tmp_path) -> None:
    path = tmp_path / "mine.py"
    path.write_text("def mine(model):\n    'doc'\n    return model\n\nEFFECTS = (mine,)\n")
    (effect,) = load_effects(path)
    assert (effect.name, effect.meaning) == ("mine", "doc")
    assert isinstance(effect.variants(hallsym.build("stage31"), None)[0], Variant)
    path.write_text("EFFECTS = 3\n")
    with pytest.raises(hallsym.InputError, match="must define EFFECTS"):
        load_effects(path)


def test_too_few_runs_to_hold_any_out() -> None:
    log = machine("multisine", seed=1)
    with pytest.raises(hallsym.InputError, match="too few to hold any out"):
        diagnose(log, holdout=range(7))


def test_rates_do_not_depend_on_how_a_log_is_cut_into_blocks() -> None:
    model = hallsym.build("stage31").with_columns(rate("x_ref_m"), rate("x_ref_m", 2))
    log = machine("multisine", seed=1, thin=1)
    whole = extended(Log.from_arrays({c: log.array(c) for c in log.columns}, log.noise), model)
    parts = extended(log, model)
    for name in ("d1_x_ref_m", "d2_x_ref_m"):
        one = np.concatenate([b.data[name] for b in whole.blocks((name,), 1 << 16)])
        cut = np.concatenate([b.data[name] for b in parts.blocks((name,), 900)])
        inner = np.abs(one - cut) / one.std()
        assert np.median(inner) < 1e-9
        assert inner.max() < 0.05


def test_the_window_of_a_rate_is_as_wide_as_the_motion_allows() -> None:
    t, rng = np.arange(2000) * 0.002, np.random.default_rng(0)
    halves = [
        widest_half(3e-4 * np.sin(2 * np.pi * f * t) + 3e-7 * rng.standard_normal(2000), 3e-7)
        for f in (0.5, 5.0, 30.0)
    ]
    assert halves == sorted(halves, reverse=True)
    assert halves[0] > 4 * halves[2] >= HALVES[0]


def test_tangents_predict_what_a_refit_finds() -> None:
    log = hidden("even_nonlinearity", "multisine")
    result = hallsym.fit(log, "stage31", solver="direct")
    base = base_of(log, result)
    runs = [r for r in log.runs if r not in log.meta.holdout]
    start = refit(base, runs)
    wide = se.nonlinearity("even_nonlinearity", (2,))(start.base.model)
    new = [n for n in wide.names if n not in base.model.names]
    t = tangents(start.base, {"e": (wide, new)})
    M = t.likelihood[t.units(runs)].sum(axis=0)
    linear = np.linalg.lstsq(M[:-1, :-1], M[:-1, -1], rcond=1e-12)[0]
    expected = M[-1, -1] - M[:-1, -1] @ linear
    assert refit(with_model(start.base, wide), runs).cost == pytest.approx(expected, rel=0.02)


def test_paper_campaign_without_a_gap() -> None:
    columns = hallsym.simulate(
        hallsym.build("stage31"), hallsym.published.values("table7_estimates"), paper_campaign(0.01),
        hallsym.table8_noise(hallsym.build("stage31")), seed=2,
    )  # fmt: skip
    assert diagnose(Log.from_arrays(columns), "stage31").verdict == "no gap"


def test_many_runs_are_pooled_and_change_nothing_of_the_sums() -> None:
    log = machine("multisine", seed=1)
    arrays = {c: log.array(c) for c in log.columns}
    arrays["run"] = (arrays["run"] * 23 + np.arange(log.rows) % 1334 // 60).astype(int)
    short = Log.from_arrays(arrays, log.noise, replace(log.meta, holdout=tuple(range(5, 160, 23))))
    result = hallsym.fit(short, "stage31", solver="direct")
    base = base_of(short, result)
    t = tangents(base, {})
    assert len(t.runs) <= 2 * 64 + 1 < len(short.runs)
    assert sorted(run for unit in t.runs for run in unit) == sorted(short.runs)
    held = t.units(short.meta.holdout)
    assert sorted(run for k in held for run in t.runs[k]) == sorted(short.meta.holdout)
