"""Effects that a diagnosis found are fitted, saved, read back and decoded with; `--effect` names them."""

import json

import my_effects
import numpy as np
import pytest
from gap_twins import TRUTH, hidden, machine
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import record, simulated

import hallsym
from hallsym.cli.main import main
from hallsym.diagnosis import diagnose, load_effects, model_on
from hallsym.errors import InputError
from hallsym.estimation.decoding import error_tables
from hallsym.estimation.evaluate import judged
from hallsym.estimation.factors import exact, summarise_at
from hallsym.estimation.likelihood import cost_near, cost_of, offsets_of
from hallsym.families import build
from hallsym.families.mechanisms import nonlinearity, port, stop_state, travel
from hallsym.log import Log
from hallsym.model import Parameter
from hallsym.report.views import summary
from hallsym.simulation import Campaign, Run

KINDS = (
    ("mount_slip", "grid"),
    ("hysteresis", "multisine"),
    ("time_skew", "multisine"),
    ("mains_hum", "raster"),
)


def test_the_frequency_of_hum_is_fitted_and_its_error_is_in_that_of_the_phase() -> None:
    wide = build("rotary", added=("mains_hum:frequency_hz=50",))
    truth = {"mains_hum_hz": 50.02, "mains_hum0_sin": 0.01, "mains_hum0_cos": 0.01}
    runs = [Run(2.0, {}, {"angle_rad": lambda t, w=w: w * t}) for w in (9.0, -14.0, 23.0)]
    log = simulated(wide, truth, Campaign(1e-3, tuple(runs)), dict.fromkeys(("v_sin_v", "v_cos_v"), 1e-3))
    found = hallsym.fit(log, wide, solver="direct")
    for name, value in truth.items():
        assert abs(found.value(name) - value) < 4 * found.std[wide.names.index(name)]
    phase, hz = (wide.names.index(name) for name in ("mains_hum1_sin", "mains_hum_hz"))
    assert abs(found.covariance[phase, hz]) > 0.5 * found.std[phase] * found.std[hz]


# -- what is fitted is what was diagnosed ------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("name", "campaign"), KINDS)
def test_a_fit_with_what_was_found_agrees_with_the_diagnosis(name: str, campaign: str, tmp_path) -> None:
    log = hidden(name, campaign, thin=6)
    found = diagnose(log, "stage31")
    assert (found.verdict, found.ranked[0]) == ("explained", name)
    assert found.metric.after < 1.1 * found.metric.floor
    assert found.effects[0].p_value < 1e-3
    assert found.shrinkage.interval[0] <= found.shrinkage.value <= found.shrinkage.interval[1]
    (text,) = [e.text for e in found.effects]
    assert found.next_step[:4] == ("--model", "stage31", "--effect", text)
    assert f"--effect {text}" in summary(found)
    result = hallsym.fit(log, "stage31", effects=(text,), holdout=found.validation_runs, solver="direct")
    assert result.status == "converged"
    after = result.errors.rows()["holdout"]["rmse"]
    for c, value in found.gap_after.rmse.items():
        assert after[c] == pytest.approx(value, rel=0.04)
    for n, estimate in found.effects[0].parameters.items():
        k = result.model.names.index(n)
        assert abs(result.values[k] - estimate.value) < 0.5 * result.std[k]
    # saved, read back, and decoded with
    result.save(tmp_path / "calib.json")
    again = hallsym.load_fit(tmp_path / "calib.json")
    assert again.model.texts == result.model.texts
    assert again.model.names == result.model.names
    noise = result.noise.std
    table = errors_on(result.source or log, again, noise, result.keep).over(found.validation_runs)
    for c, value in after.items():
        assert table["rmse"][c] == pytest.approx(value, rel=1e-3)


def errors_on(log: Log, known: hallsym.Fit, noise: dict[str, float], keep):
    """Errors of fixed parameters, over the samples that the fit counts: spikes and rails may be out."""
    if keep is None:
        return judged(log, known.model, known.values, noise).table
    cost = cost_near(log, known.model, known.values, noise, keep)
    zeros = offsets_of(cost, known.values)
    return error_tables(log, known.model, [(known.values, zeros)], cost.reading_variance, keep, sigma=noise)[
        0
    ]


# -- the cost of tangents is that of the model -------------------------------------------------------------


def test_a_tangent_has_value_and_slope_of_the_exact_cost() -> None:
    """stage31 has summaries of its own: both ways must give one likelihood, wherever they are taken."""
    log = machine("multisine", seed=3, thin=20)
    fit = hallsym.fit(log, "stage31", solver="direct")
    noise = fit.noise.std
    p = fit.values * 1.001
    own = cost_near(log, fit.model, p, noise)
    zeros = dict(zip(own.summary.runs, own.at(p).offsets, strict=True))
    other = cost_of(summarise_at(log, fit.model, p, zeros, noise), noise)
    assert exact(fit.model)
    assert other.at(p).value == pytest.approx(own.at(p).value, rel=1e-7)  # monomials cost digits
    assert np.allclose(other.at(p).offsets, own.at(p).offsets, atol=1e-12)
    scale = np.abs(own.at(p).derivatives()[1]).max()
    assert np.allclose(other.at(p).derivatives()[1], own.at(p).derivatives()[1], atol=1e-6 * scale)


# -- what a log does not show --------------------------------------------------------------------------


def test_what_the_log_does_not_show_or_hold_is_said() -> None:
    log = machine("grid", seed=5, thin=8)
    with pytest.raises(InputError, match=r"mains_hum cannot be found in .*frequency_hz="):
        model_on(log, "stage31", ["mains_hum"])
    with pytest.raises(InputError, match="no temperature logged"):
        model_on(log, "stage31", ["gain_temperature_drift"])
    with pytest.raises(InputError, match="temperature_degc"):
        hallsym.fit(log, "stage31", effects=["gain_temperature_drift:mean_degc=20"])


# -- a play ------------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(1.0, 20.0))
def test_an_unknown_start_of_a_play_is_the_mean_over_all_starts(seed: int, width: float) -> None:
    """Against 801 plays run sample by sample; once the motion has covered a whole loop all are one."""
    u = np.cumsum(np.random.default_rng(seed).standard_normal(200))
    starts = np.linspace(-1, 1, 801)
    z, states = starts.copy(), [starts.copy()]
    for step in np.diff(u) / width:
        z = np.clip(z + step, -1, 1)
        states.append(z.copy())
    weights = np.full(801, 1 / 800)
    weights[[0, -1]] /= 2
    mean, slope = stop_state(travel(u), width)
    assert np.allclose(mean, np.array(states) @ weights, atol=1e-4)
    covered = np.maximum.accumulate(u) - np.minimum.accumulate(u) >= 2 * width
    assert np.all(np.ptp(np.array(states)[covered], axis=1) < 1e-9)
    # the state is smooth in the width but at turning points that just reach the end of the loop
    steps = [
        (stop_state(travel(u), width + h)[0] - stop_state(travel(u), width - h)[0]) / (2 * h)
        for h in (1e-6, 2e-6)
    ]
    smooth = np.abs(steps[0] - steps[1]) < 1e-6
    assert smooth.mean() > 0.9
    assert np.allclose(steps[0][smooth], slope[smooth], atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1])
def test_a_play_of_known_width_is_recovered_and_the_gap_shrinks_as_far_as_it_can(seed: int) -> None:
    """Every run starts in a state of its own, drawn at random: what a decoder cannot know."""
    half = 6e-5
    size = np.random.default_rng(seed).uniform(1.5e-6, 4e-6, 3)[:, None]

    def play(m, rng):
        p, out = m.reading[:, 0] + half * rng.uniform(-1, 1, 3), np.zeros_like(m.reading)
        for k in range(m.reading.shape[1]):
            p = np.clip(p, m.reading[:, k] - half, m.reading[:, k] + half)
            out[:, k] = (p - m.reading[:, k]) / half
        m.reading = m.reading + size * out

    log = machine("multisine", (play,), seed=seed, thin=3, curvature=0.0)
    found = diagnose(log, "stage31")
    width = found.effects[0].parameters["half_width"]
    fit = hallsym.fit(log, "stage31", effects=[found.effects[0].text], solver="direct")
    std = fit.std[fit.model.names.index("half_width")]
    assert abs(fit.value("half_width") - half) < 2.6 * std  # 99 %
    assert width.value == pytest.approx(fit.value("half_width"), abs=0.5 * std)
    # at best the gap is what the same machine leaves without the play
    best = hallsym.fit(machine("multisine", seed=seed, thin=3, curvature=0.0), "stage31", solver="direct")
    metric = {c: (0.35 if c.startswith("r") else 1.0) for c in fit.model.pose}
    left = sum((metric[c] * v) ** 2 for c, v in best.errors.rows()["holdout"]["rmse"].items()) ** 0.5
    achievable = 1 - left / found.metric.before
    assert achievable - 0.03 < found.shrinkage.value < achievable + 0.03


# -- at a bound --------------------------------------------------------------------------------------------


def cubic_up_to(limit: float):
    def tight(model):
        """A cube that the machine's own exceeds."""
        sensed = port("displacement", lambda model: [probe.label for probe in model.layout])
        wide = nonlinearity(model, "tight", "field", sensed, {"tight3_{k}": 3}, 0.5, 0.5e-3)
        return wide.with_parameters(
            {n: {"lower": -limit, "upper": limit} for n in wide.names if "tight" in n}
        )

    return tight


@pytest.mark.slow
def test_a_parameter_at_its_bound_has_no_interval_and_is_said(tmp_path) -> None:
    log = hidden("odd_nonlinearity", "raster", thin=24)  # cubes of about 0.01 to 0.03
    tight = diagnose_only(log, cubic_up_to(0.02))
    (effect,) = tight.effects
    assert effect.name == "tight"
    assert effect.at_bound == ("tight3_B",)
    assert effect.parameters["tight3_B"].std is None
    assert effect.parameters["tight3_A"].std > 0
    assert "tight3_B ended at its bound" in effect.note
    assert effect.note.split(";")[0][:20] in " ".join(summary(tight).split())
    assert json.loads(json.dumps(tight.to_dict()))["effects"][0]["parameters"]["tight3_B"]["std"] is None


def diagnose_only(log: Log, make):
    """Diagnose with one effect alone."""
    from dataclasses import replace

    from hallsym.model.effect import as_effect

    model = build("stage31")
    alone = replace(model, family=replace(model.family, effects=()))
    return diagnose(log, alone, effects=[as_effect(make)])


# -- the command line --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_effect_of_your_own_is_fitted_saved_and_read_back(tmp_path, capsys) -> None:
    log = tmp_path / "log.csv"
    hallsym.write_log(machine("multisine", seed=2, thin=12), log)
    own = ["--effects", my_effects.__file__]
    calib = str(tmp_path / "calib.json")
    words = ["fit", str(log), "--effect", "speed_gain", "--solver", "direct", "-o", calib]
    assert main([*words, *own]) == 0
    assert "speed_gain" in capsys.readouterr().out
    assert main(["evaluate", calib, str(log), *own]) == 0
    capsys.readouterr()
    assert main(["evaluate", calib, str(log)]) == 2
    assert "an effect of your own; give the file that defines it: --effects" in capsys.readouterr().err
    known = hallsym.load_fit(calib, {e.name: e for e in load_effects(own[1])})
    assert abs(known.value("speed_gain")) < 5 * known.std[known.model.names.index("speed_gain")]


def test_a_family_without_a_plain_form_is_fitted_from_its_nominal_values() -> None:
    """A term that is no polynomial of the columns, on a model that no name stands for."""
    from dataclasses import replace

    import casadi as ca

    def wavy(model):
        def step(s, p):
            s["displacement"] = s["displacement"] + p["wave"] * ca.sin(s["displacement"] / 1e-4)

        wave = Parameter("wave", 0.0, -1e-4, 1e-4, "m")
        return replace(model, name="wavy").with_step("field", step, effect="wavy", parameters=(wave,))

    model = wavy(build("stage31"))
    log = Log.from_arrays(record(seed=4))
    fit = hallsym.fit(log, model, solver="direct")
    assert fit.status == "converged"
    k = model.names.index("wave")
    assert abs(fit.values[k]) < 5 * fit.std[k]
    assert fit.value("eta_A") == pytest.approx(TRUTH["eta_A"], abs=5 * fit.std[model.names.index("eta_A")])
