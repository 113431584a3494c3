"""Injections are as large as they say, their noise is like the log's, what is called findable is found."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_twins import Inject, U, add, gains, machine

import hallsym
from hallsym.cli.main import main
from hallsym.diagnosis import Base, diagnose, prepare
from hallsym.families import effects
from hallsym.families.faults import ages
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.log import Log, Noise
from hallsym.power import DetectionPower, detection_power
from hallsym.power.detection import NO_EFFECT, RATIOS, Bench, curve_point
from hallsym.power.injection import Injection, generator, injections, sized
from hallsym.power.simulated_machine import (
    SimulatedMachine,
    machine_of,
    on_part,
    readings_of,
    simulated_noise,
)
from hallsym.report.content import printed
from hallsym.report.results.power import power_content

CATALOGUE = tuple(e for e in effects(STAGE_FAMILY).values() if e.diagnosed)
FLOOR = 1.4e-6


@cache
def quiet(seed: int = 3, **options) -> Log:
    """A machine without a gap, short enough for a test."""
    return machine("multisine", seed=seed, thin=8, pink=0.0, curvature=0.0, **options)


def base_on(log: Log) -> Base:
    return prepare(log, "stage31").base


@cache
def bench() -> tuple[SimulatedMachine, dict[str, Injection], dict[str, str]]:
    truth = machine_of(base_on(quiet()), FLOOR)
    made, reasons = injections(truth, CATALOGUE, lambda name: generator(0, name))
    return truth, made, reasons


# -- sizes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["odd_nonlinearity", "time_skew", "saturation", "adc_quantisation"])
def test_the_gap_of_an_injection_is_what_a_fit_of_the_noise_free_log_leaves(name: str) -> None:
    truth, made, _ = bench()
    amount, gap_m = sized(truth, made[name], 1.3)
    log = truth.log(made[name].make(amount, 0.0))
    rows = hallsym.fit(log, "stage31", solver="direct", loss="none").errors.rows()["holdout"]["rmse"]
    metric = np.sqrt(rows["x_m"] ** 2 + rows["y_m"] ** 2 + (0.35 * rows["rz_rad"]) ** 2)
    assert gap_m == pytest.approx(metric, rel=0.05)
    # by definition of the ratio, and as near as the search goes
    assert gap_m == pytest.approx(FLOOR * np.sqrt(1.3**2 - 1), rel=0.03)


def test_a_fault_that_comes_in_large_steps_has_no_size_between_them() -> None:
    truth, made, _ = bench()
    clean = truth.recording.clean
    (judged,) = truth.base.holdout if len(truth.base.holdout) == 1 else (min(truth.base.holdout),)
    hit = np.zeros(clean.shape)
    hit[0, np.flatnonzero(truth.recording.run == judged)[50]] = 1e-3
    stepped = replace(made["outliers"], make=lambda amount, noise: clean + noise + hit * (amount > 1e-4))
    assert "comes in steps" in sized(truth, stepped, 1.07)
    assert sized(truth, replace(stepped, make=lambda *_: clean * np.nan), 1.07) == (
        "its readings are not finite on this log"
    )


def test_what_cannot_be_seen_says_why() -> None:
    truth, made, reasons = bench()
    assert reasons["gain_temperature_drift"] == "no temperature logged"
    assert reasons["vertical_gain_coupling"] == "it is part of stage31"
    assert "absorb it" in sized(truth, made["reference_scale_error"], 1.07)
    assert "at the bounds" in sized(truth, made["second_order_rotation"], 2.0)


def test_a_stale_reading_ages_until_its_hold_ends_and_not_beyond_its_run() -> None:
    begins = np.array([0, 1, 0, 0, 0, 0, 1, 0], bool)
    run = np.array([0, 0, 0, 0, 0, 0, 0, 1])
    assert ages(begins, np.full(8, 3), run).tolist() == [0, 1, 2, 3, 0, 0, 1, 0]


# -- noise -------------------------------------------------------------------------------------------------


def like(log: Log):
    base = base_on(log)
    return base, simulated_noise(base, log.runs)


LONG = np.repeat(np.arange(20), 1000)


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_white_noise_is_as_large_as_it_is_whatever_was_stated(factor: float) -> None:
    sigmas = {c: replace(s, value=s.value / factor) for c, s in quiet().noise.sigmas.items()}
    base, noise = like(replace(quiet(), noise=Noise(sigmas)))
    drawn, reference = noise.draw(LONG, np.random.default_rng(0))
    assert len(noise.coefficients) == 0
    assert noise.ratio == pytest.approx(factor, rel=0.05)
    assert drawn.std(axis=1) == pytest.approx([factor * base.sigma[c] for c in base.model.channels], rel=0.06)
    for c in base.model.references:  # the reference is noisy too
        assert reference[c].std() == pytest.approx(factor * base.sigma[c], rel=0.06)


def test_correlated_residuals_give_noise_that_is_as_correlated() -> None:
    _, noise = like(machine("multisine", seed=3, thin=2, pink=0.0, curvature=0.0, noise="correlated"))
    drawn, reference = noise.draw(LONG, np.random.default_rng(0))
    rows = np.vstack([drawn, *reference.values()])
    # the twin's noise is autoregressive with 0.8, every second sample of which is taken
    assert [np.corrcoef(row[1:], row[:-1])[0, 1] for row in rows] == pytest.approx([0.8**2] * 6, abs=0.05)
    # each run begins with noise of full size
    starts, _ = noise.draw(np.arange(400), np.random.default_rng(1))
    assert starts.std(axis=1) == pytest.approx(drawn.std(axis=1), rel=0.15)


def test_the_true_motion_is_smooth_and_an_axis_at_rest_rests() -> None:
    log = machine("grid", seed=3, thin=3, pink=0.0, curvature=0.0)
    truth = machine_of(base_on(log), FLOOR)
    first = truth.columns["run"] == log.runs[0]  # y moves alone
    assert np.ptp(truth.columns["x_ref_m"][first]) == 0.0
    logged, true = log.array("y_ref_m")[first], truth.columns["y_ref_m"][first]
    assert np.std(logged - true) == pytest.approx(0.3e-6, rel=0.3)


# -- a long log -------------------------------------------------------------------------------------------


def test_a_part_is_stretches_at_the_full_rate_with_offsets_and_side_of_their_run() -> None:
    base = base_on(machine("multisine", seed=3, thin=2, pink=0.0, curvature=0.0))
    rows = base.log.rows // 3
    part = on_part(base, rows)
    assert part.log.rows == pytest.approx(rows, rel=0.3)
    at = np.searchsorted(base.log.array("t_s"), part.log.array("t_s"))
    logged, own = base.log.array("run")[at].astype(int), part.log.array("run").astype(int)
    assert (np.diff(at)[np.diff(own) == 0] == 1).all()
    for run, stretch in set(zip(logged.tolist(), own.tolist(), strict=True)):
        assert (run in base.holdout) == (stretch in part.holdout)
        assert part.offsets[stretch] == pytest.approx(base.offsets[run])
    clean = readings_of(base, base.model, base.p)[:, at]
    assert readings_of(part, part.model, part.p) == pytest.approx(clean, abs=1e-12)


# -- trials ------------------------------------------------------------------------------------------------


def stubbed(monkeypatch, answers) -> None:
    """Replace the blind diagnosis by answers, so that only the book-keeping is tested."""
    monkeypatch.setattr(Bench, "diagnosed", lambda self, log, name: answers(name))


def test_bounds_are_those_of_clopper_and_pearson() -> None:
    """Known bounds: 20 of 20 is at least 83.16 %, 18 of 20 is 68.3 to 98.8 %."""
    found = [curve_point(1.3, np.arange(20) < k, np.zeros(20, bool)) for k in (20, 18, 0)]
    every, most, none = ((point.low, point.high) for point in found)
    assert every == (pytest.approx(0.8316, abs=1e-4), 1.0)
    assert most == (pytest.approx(0.683, abs=1e-3), pytest.approx(0.9877, abs=1e-4))
    assert none == (0.0, pytest.approx(1 - every[0]))


@pytest.mark.slow
def test_a_curve_counts_trials_and_nine_in_ten_are_found(monkeypatch) -> None:
    said = iter(["no gap", "other"] + ["found"] * 8 + ["group"] + ["found"] * 9)  # largest size first

    def answers(name: str):
        if name == NO_EFFECT:
            return "no gap", "noise larger than stated", ()
        outcome = next(said)
        return outcome, "no gap" if outcome == "no gap" else "explained", (name,)

    stubbed(monkeypatch, answers)
    s = detection_power(quiet(), "stage31", names=["odd_nonlinearity"], ratios=(1.1, 1.5), repeats=10)
    small, large = s.effect("odd_nonlinearity").curve
    assert (small.trials, small.found, small.noticed) == (10, 0.9, 1.0)
    assert (large.trials, large.found, large.noticed) == (10, 0.9, 0.9)
    assert s.effect("odd_nonlinearity").ratio == 1.1
    assert s.false_alarms == 0  # larger noise is no gap
    assert "interval of the rate: 0 to 17 %" in printed(power_content(s))
    assert "90 % (55-100)" in printed(power_content(s))


def test_an_interrupt_keeps_what_was_done(monkeypatch) -> None:
    def answers(name: str):
        if name == "time_skew":
            raise KeyboardInterrupt
        return ("no gap", "no gap", ()) if name == NO_EFFECT else ("found", "explained", (name,))

    stubbed(monkeypatch, answers)
    s = detection_power(quiet(), "stage31", names=["odd_nonlinearity", "time_skew"], repeats=1)
    assert not s.complete
    assert (s.effect("odd_nonlinearity").status, s.effect("time_skew").status) == ("found", "not run")
    assert "INTERRUPTED" in printed(power_content(s))
    assert "not run: time_skew" in printed(power_content(s))


@pytest.mark.slow
def test_leaving_effects_out_changes_no_draw(monkeypatch) -> None:
    stubbed(monkeypatch, lambda name: ("no gap", "no gap", ()))
    one, two = (
        detection_power(quiet(), "stage31", names=names, ratios=(1.3,), repeats=2, seed=5)
        for names in (["hysteresis"], ["odd_nonlinearity", "hysteresis"])
    )
    sizes = [[t.size for t in s.effect("hysteresis").trials] for s in (one, two)]
    assert sizes[0] == sizes[1]
    assert sizes[0][0] != sizes[0][1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"names": ["hysterisis"]}, "did you mean 'hysteresis'"),
        ({"ratios": (1.0, 2.0)}, "above 1"),
        ({"repeats": 0}, "1 or more"),
    ],
)
def test_bad_input_is_one_sentence(options: dict, message: str) -> None:
    with pytest.raises(hallsym.InputError, match=message):
        detection_power(quiet(), "stage31", **options)


def test_the_command(monkeypatch, tmp_path, capsys) -> None:
    stubbed(monkeypatch, lambda name: ("no gap", "no gap", ()))
    log, out = tmp_path / "log.parquet", tmp_path / "out.json"
    hallsym.write_log(quiet(), log)
    noise = [f"--noise={c}={s.value}" for c, s in quiet().noise.sigmas.items()]
    command = ["diagnose", str(log), "--power"]
    assert main([*command, "time_skew,outliers", "--repeats", "1", *noise, "-o", str(out)]) == 0
    assert "time_skew" in capsys.readouterr().out
    assert [e["name"] for e in json.loads(out.read_text())["effects"]] == ["time_skew", "outliers"]
    assert main([*command, "nonsense"]) == 2


# -- it agrees with what a diagnosis then finds ------------------------------------------------------------


def bent(size: dict[str, float], order: int) -> Inject:
    """A power of the reading typed a second time; `size` by probe."""
    c = np.array([size[k] for k in "ABC"])[:, None]
    return add(lambda m: gains(m.state) * c * m.felt**order / U ** (order - 1))


TYPED = {"odd_nonlinearity": 3, "even_nonlinearity": 2}


def kept(s: DetectionPower, name: str, campaign: str, seed: int, **options) -> None:
    """What is found at a size must be found at twice that size in fresh logs, injected by other code."""
    row, order = s.effect(name), TYPED[name]
    assert row.status == "found", (name, row)
    size = {k.removeprefix(f"{name}{order}_"): 2 * v for k, (v, _) in row.size.items()}
    found = diagnose(machine(campaign, (bent(size, order),), seed=seed, **options))
    assert (found.verdict, found.ranked[0]) == ("explained", name)


@pytest.mark.slow
def test_what_it_calls_findable_is_found() -> None:
    options = {"thin": 4, "temperature": True}
    s = detection_power(machine("multisine", seed=21, **options), "stage31", names=list(TYPED), repeats=1)
    assert s.false_alarms == 0
    assert json.loads(json.dumps(s.to_dict(), allow_nan=False))["complete"]
    assert {e.name for e in s.effects if e.status == "found"} == set(TYPED)
    for name in TYPED:
        kept(s, name, "multisine", 31, **options)


@pytest.mark.slow
def test_a_part_does_not_change_the_answer() -> None:
    """Of sizes that are no chance with fewer samples either."""
    log = machine("raster", seed=41, thin=1)
    names, sizes = ["odd_nonlinearity", "time_skew"], RATIOS[1:2]
    full, short = (
        detection_power(log, "stage31", names=names, ratios=sizes, rows=rows, repeats=1)
        for rows in (log.rows, 11_000)
    )
    assert short.rows < full.rows / 2
    for name in names:
        one, two = full.effect(name), short.effect(name)
        assert (one.status, one.ratio) == (two.status, two.ratio)
