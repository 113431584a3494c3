"""The diagnosis names what a hidden machine has, keeps quiet without a gap, and admits what it lacks."""

from dataclasses import replace

import numpy as np
import pytest
from gap_twins import faulty, hidden, machine, unlisted
from my_effects import speed_gain

import hallsym
from hallsym.codegen import cost_of, price
from hallsym.diagnosis import Base, diagnose, load_effects
from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.refit import refit, with_model
from hallsym.diagnosis.report import grown
from hallsym.diagnosis.setup import base_of
from hallsym.families import effects
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.families.stage.effects.field import hysteresis
from hallsym.log import Log, Noise, extended
from hallsym.model import Model, Variant
from hallsym.model.derived import rate, run_time, widest_window
from hallsym.model.effect import as_effect

NAMED = (  # others are diagnosed and fitted in test_fit_effects.py
    ("odd_nonlinearity", "raster"),
    ("second_order_rotation", "turning"),
    ("reference_drift", "multisine"),
)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "campaign"), NAMED)
def test_a_hidden_effect_is_named_and_closes_the_gap(name: str, campaign: str) -> None:
    # at 8 mrad the probes move by 3 mm: the twin's small cubic field would be no small one there
    curvature = 0.0 if campaign == "turning" else 0.3
    found = diagnose(hidden(name, campaign, thin=6, curvature=curvature))
    assert (found.verdict, found.ranked[0]) == ("explained", name)
    assert found.metric.after < 1.1 * found.metric.floor
    assert found.effects[0].p_value < 1e-3
    low, high = found.shrinkage.interval
    assert low <= found.shrinkage.value <= high


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clock_jitter", "outliers", "adc_quantisation"])
def test_a_fault_of_samples_is_named(name: str) -> None:
    found = diagnose(hidden(name, "multisine", kind=faulty))
    assert (found.verdict, found.ranked[0]) == ("explained", name)
    if name == "clock_jitter":
        assert found.effects[0].parameters["jitter"].value == pytest.approx(6e-4, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ripple", "speed_gain"])
def test_what_no_catalogue_lists_is_unexplained(name: str) -> None:
    found = diagnose(hidden(name, "raster", kind=unlisted))
    assert found.verdict == "unexplained"
    assert found.unexplained


@pytest.mark.slow
def test_delay_and_lag_at_one_frequency_are_a_group_with_what_would_separate_them() -> None:
    found = diagnose(hidden("time_skew", "grid", thin=6))
    assert set(found.groups[0]) == {"time_skew", "first_order_lag"}
    assert "the same motion at several frequencies" in found.separate_by[0].recording
    assert found.separate_by[0].sigma_now < 5


@pytest.mark.slow
def test_a_users_effect_is_found_and_a_broken_one_stops_nothing() -> None:
    def inject(m, _) -> None:
        m.reading = m.reading * (1 + 5.0 * np.gradient(m.pose[0], 0.002))

    def broken(model: Model) -> Model:
        raise ValueError("oops")

    def nonsense(model: Model) -> int:
        return 3

    log = machine("multisine", (inject,), seed=6, thin=6)
    found = diagnose(log, effects=[as_effect(f) for f in (speed_gain, broken, nonsense)])
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
    """But by noise, in a run whose first block shows another window than all of it (one of eight here)."""
    model = hallsym.build("stage31").with_columns(rate("x_ref_m"), rate("x_ref_m", 2))
    log = machine("multisine", seed=1, thin=1)
    whole = extended(Log.from_arrays({c: log.array(c) for c in log.columns}, log.noise), model)
    parts = extended(log, model)
    for name in ("d1_x_ref_m", "d2_x_ref_m"):
        one = np.concatenate([b.data[name] for b in whole.blocks((name,), 1 << 16)])
        cut = np.concatenate([b.data[name] for b in parts.blocks((name,), 900)])
        inner = np.abs(one - cut) / one.std()
        assert np.median(inner) < 1e-9
        assert np.sqrt((inner**2).mean()) < 0.02


def test_columns_of_short_runs_side_by_side_are_those_of_each_run() -> None:
    log = machine("multisine", seed=1, thin=1)
    short = {c: log.array(c)[:1200] for c in log.columns} | {"run": np.arange(1200) // 30}
    model = hysteresis(hallsym.build("stage31").with_columns(rate("x_ref_m"), run_time()), half_width_m=2e-6)
    many = extended(Log.from_arrays(short, log.noise), model)
    names = tuple(c.name for c in model.computed)
    together, alone = (list(many.blocks(names, size)) for size in (1 << 16, 30))
    assert [b.run for b in together] == [b.run for b in alone] == list(range(40))
    for one, other in zip(together, alone, strict=True):
        for name in names:
            assert one.data[name] == pytest.approx(other.data[name], rel=1e-9, abs=1e-12)


def test_tangents_predict_what_a_refit_finds() -> None:
    log = hidden("even_nonlinearity", "multisine")
    result = hallsym.fit(log, "stage31", solver="direct", accept=["all"])
    base = base_of(log, result)
    runs = [r for r in log.runs if r not in log.meta.holdout]
    start = refit(base, runs)
    wide = effects(STAGE_FAMILY)["even_nonlinearity"](start.base.model)
    new = [n for n in wide.names if n not in base.model.names]
    t = normal_equations(start.base, {"e": (wide, new)})
    M = t.of("e")[t.units(runs)].sum(axis=0)
    linear = np.linalg.lstsq(M[:-1, :-1], M[:-1, -1], rcond=1e-12)[0]
    expected = M[-1, -1] - M[:-1, -1] @ linear
    assert refit(with_model(start.base, wide), runs).cost == pytest.approx(expected, rel=0.02)


def test_the_uncertainty_of_a_log_of_which_pieces_hold_holdout_runs_alone(monkeypatch) -> None:
    """That of the log in one piece, as far as slow octaves of short pieces tell."""
    log = machine("multisine", seed=1)
    fitted = refit(
        base_of(log, hallsym.fit(log, "stage31", solver="direct")), [r for r in log.runs if r != 3]
    )
    whole = np.diag(fitted.uncertainty()[0])
    monkeypatch.setattr("hallsym.diagnosis.normal_equations.ENTRIES", 1)
    assert np.diag(fitted.uncertainty()[0]) == pytest.approx(whole, rel=0.25)


def test_many_runs_are_pooled_and_change_nothing_of_the_sums() -> None:
    log = machine("multisine", seed=1)
    arrays = {c: log.array(c) for c in log.columns}
    arrays["run"] = (arrays["run"] * 23 + np.arange(log.rows) % 1334 // 60).astype(int)
    short = Log.from_arrays(arrays, log.noise, replace(log.meta, holdout=tuple(range(5, 160, 23))))
    result = hallsym.fit(short, "stage31", solver="direct")
    base = base_of(short, result)
    t = normal_equations(base, {})
    assert len(t.runs) <= 2 * 64 + 1 < len(short.runs)
    assert sorted(run for unit in t.runs for run in unit) == sorted(short.runs)
    held = t.units(short.meta.holdout)
    assert sorted(run for k in held for run in t.runs[k]) == sorted(short.meta.holdout)


# -- parts ---------------------------------------------------------------------------------------------------


def fitted(log: Log) -> Base:
    return base_of(log, hallsym.fit(log, "stage31", solver="direct", accept=["all"]))


def test_the_window_of_a_rate_is_as_wide_as_the_motion_allows() -> None:
    t, rng = np.arange(2000) * 0.002, np.random.default_rng(0)
    slow, fast, faster = (
        widest_window(3e-4 * np.sin(2 * np.pi * f * t) + 3e-7 * rng.standard_normal(2000), 3e-7)
        for f in (0.5, 5.0, 30.0)
    )
    assert slow[1] > 2 * fast[1] > 4 * faster[1]


@pytest.mark.parametrize(("order", "within"), [(1, 2e-3), (2, 5e-3)])
def test_rates_of_motion_with_seven_samples_a_period_are_not_too_small(order: int, within: float) -> None:
    """Against the derivative of the sine itself: a slope that is too small makes a lag too large."""
    t, w, rng = np.arange(2000) * 0.006, 2 * np.pi / 0.042, np.random.default_rng(0)
    x = 1e-4 * np.sin(w * t) + 3e-7 * rng.standard_normal(2000)
    log = Log.from_arrays(
        {"run": np.zeros(2000), "t_s": t, "x_ref_m": x}, Noise.given({"x_ref_m": 3e-7}, ("x_ref_m",))
    )
    served = extended(log, hallsym.build("stage31").with_columns(rate("x_ref_m", order)))
    got = np.concatenate([b.data[f"d{order}_x_ref_m"] for b in served.blocks((f"d{order}_x_ref_m",))])
    true = 1e-4 * w**order * np.sin(w * t + order * np.pi / 2)
    assert got @ true / (true @ true) == pytest.approx(1.0, abs=within)


def test_significance_is_honest_for_what_happens_within_a_run() -> None:
    """Sums of correlated samples, one per run: p-values of nothing are uniform."""
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.standard_normal((4000, 11, 60)), axis=2).sum(axis=2)
    p = np.array([beyond(v) for v in values])
    for level in (0.01, 0.05, 0.5):
        assert np.mean(p < level) == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / 4000))


def test_the_firmware_cost_counts_parameters_instructions_and_signals() -> None:
    small, large = hallsym.build("stage30"), hallsym.build("stage31")
    # three products, three sums and three entries per probe more
    assert cost_of(large).operations - cost_of(small).operations == 18
    assert cost_of(large).moves - cost_of(small).moves == 9
    a, b = cost_of(small).instructions, cost_of(large).instructions
    assert grown(small, large) == "9 parameters"
    said = price(small, large, large.nominal)
    assert said == f"C about {a} -> {b} instructions, parameter table 100 -> 136 B"
    late = effects(STAGE_FAMILY)["time_skew"](large)
    listed = grown(large, late).removeprefix("1 parameter and 12 signals to compute (d1_x_ref_m, ")
    assert listed.count(",") == 2  # two more, and that there are others
    assert listed.endswith(", ...)")
    assert price(large, late, late.nominal) == "no C is generated with it"
