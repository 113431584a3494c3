"""What would separate a group, from the models of its members; firmware cost; the text of a diagnosis."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from gap_twins import listed, machine

import hallsym
from hallsym.codegen import cost_of
from hallsym.diagnosis import Diagnosis, Estimate, FoundEffect, Separation, Statement
from hallsym.diagnosis.confusable import recorded, separation
from hallsym.diagnosis.record import Gap, LogRecord, Metric, NoiseFloor, Shrinkage, SmallerFinding
from hallsym.diagnosis.recordings import Range, range_of, recordings, with_readings
from hallsym.diagnosis.refit import Refitted, refit, with_model
from hallsym.diagnosis.report import firmware_cost, operations
from hallsym.diagnosis.setup import base_of
from hallsym.families import effects
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.log import Log
from hallsym.model import Model
from hallsym.report.text.diagnosis import diagnosis_text
from hallsym.terminal import PROSE

NAMES = ("time_skew", "first_order_lag")
STAGE = effects(STAGE_FAMILY)
TURN = 2 * np.pi


@cache
def grid_log() -> Log:
    return machine("grid", (listed(np.random.default_rng(1))["time_skew"],), seed=1)


def fitted(log: Log, *makes: Callable[[Model], Model]) -> list[Refitted]:
    base = base_of(log, hallsym.fit(log, "stage31", solver="direct", holdout=log.meta.holdout))
    runs = [r for r in log.runs if r not in log.meta.holdout]
    return [refit(with_model(base, make(base.model)), runs) for make in makes]


@cache
def delays() -> list[Refitted]:
    return fitted(grid_log(), *(STAGE[name] for name in NAMES))


@cache
def delay_or_lag() -> Separation:
    return separation(NAMES, delays(), delays()[0].distance(delays()[1]), 1.5, "what the catalogue says")


def test_one_frequency_does_not_tell_a_delay_from_a_lag_and_a_fast_run_does() -> None:
    s = delay_or_lag()
    assert s.sigma_now is not None
    assert s.sigma_now < 1
    assert s.simulated
    assert "8 Hz" in s.recording
    assert s.sigma is not None
    assert s.runs is not None
    assert s.run_s is not None
    assert s.sigma > 5
    assert (s.runs, s.seconds) == (1, s.run_s)


def test_what_tells_them_apart_grows_with_the_square_of_the_frequency() -> None:
    """A lag lowers the amplitude by (2 pi f tau)^2 / 2, a delay does not; what is linear in f is common."""
    of = {
        text.split(" at ")[1].split(" (")[0]: s
        for text, s in delay_or_lag().tried.items()
        if "her at" in text
    }
    assert of["8 Hz"] / of["4 Hz"] == pytest.approx(4.0, rel=0.25)


def test_an_encoder_is_asked_for_turns() -> None:
    span = Range(
        ("angle_rad",), (), {"angle_rad": 50.0}, {"angle_rad": 0.0}, 1.0, 1e-3, 0.0, 10.0, 25.0, 40.0, TURN
    )
    asked = recordings(span)
    assert len({r.text for r in asked}) == len(asked)
    assert not any(word in r.text for r in asked for word in ("stroke", "Hz", "alone", "together"))
    assert [r.text for r in asked if r.temperature is not None] == [asked[-1].text]
    for r in asked:
        t = np.arange(0, r.run.duration_s, span.step_s)
        place = r.run.position("angle_rad", t)
        speed = np.diff(place) / span.step_s
        assert np.abs(speed).max() <= TURN / 24 / span.step_s * (1 + 1e-9)  # 24 samples a turn
        both = "both directions" in r.text or "to and fro" in r.text
        assert abs(place[-1] - place[0]) < 1.0 if both or "rest" in r.text else place[-1] - place[0] > TURN
        assert both == (speed.min() < -1e-6)
        if "rpm" in r.text and "speeds" not in r.text:
            assert float(r.text.split(" at ")[1].split()[0]) == pytest.approx(
                60 * speed.max() / TURN, rel=0.01
            )
        if "swings" in r.text:
            assert np.ptp(place) == pytest.approx(TURN / 20, rel=0.05)  # 18 deg


def test_nothing_is_told_apart_where_nothing_moves() -> None:
    assert all(s < 0.05 for text, s in delay_or_lag().tried.items() if "at rest" in text or "still" in text)


def test_a_recording_made_with_one_member_leaves_the_other_as_much_as_was_said() -> None:
    """The other member, fitted anew to log and recording at once, all its parameters, not to first order."""
    one, other = delays()
    span = range_of(one.base)
    (pick,) = [r for r in recordings(span) if "together at 4 Hz" in r.text]
    ahead = recorded(span, [pick], one.base)
    log = one.base.log
    names = [c for c in log.columns if c in ahead.columns]
    known = {r for unit in one.fitted for r in one.tangents.runs[unit]}
    old = np.isin(log.array("run"), list(known))
    new = ahead.array("run") == 1
    both = {c: np.concatenate([log.array(c)[old], ahead.array(c)[new]]) for c in names}
    both["run"][-int(new.sum()) :] = 1000
    whole = with_readings({c: v for c, v in both.items() if c not in one.base.model.channels}, one.base)
    zeros = dict.fromkeys(whole.runs, np.zeros(3))
    again = replace(other.base, log=whole, zeros=zeros, keep=None, holdout=frozenset())
    left = refit(again, list(whole.runs)).cost
    assert left == pytest.approx(delay_or_lag().tried[pick.text] ** 2 * 1.5, rel=0.15)


def test_time_and_temperature_are_told_apart_by_a_temperature_cycle() -> None:
    arrays = {c: grid_log().array(c) for c in grid_log().columns}
    t = arrays["t_s"]
    arrays["temperature_degc"] = 20 + 4 * t / t[-1]
    gain = 1 + 0.01 * (t / t[-1] - 0.5)
    for c in ("hall_a_m", "hall_b_m", "hall_c_m"):
        arrays[c] = arrays[c] * gain
    log = Log.from_arrays(arrays, grid_log().noise, grid_log().meta)
    fits = fitted(
        log,
        lambda model: STAGE["gain_time_drift"](model, duration_s=float(t[-1])),
        lambda model: STAGE["gain_temperature_drift"](model, mean_degc=22.0),
    )
    s = separation(("gain_time_drift", "gain_temperature_drift"), fits, fits[0].distance(fits[1]), 1.5, "")
    assert s.sigma_now is not None
    assert s.sigma_now < 1
    assert "temperature cycle" in s.recording
    assert s.runs == 1


def test_recordings_stay_inside_what_the_log_moved() -> None:
    span = range_of(delays()[0].base)
    t = np.arange(0, 8, span.step_s)
    for r in recordings(span):
        for axis in (*span.pose, *span.vertical):
            moved = np.abs(r.run.position(axis, t) - span.centre[axis] * (axis in span.vertical))
            assert moved.max() <= 1.3 * span.amplitude[axis]


# -- firmware cost -----------------------------------------------------------------------------------------


def test_the_firmware_cost_counts_parameters_instructions_and_signals() -> None:
    small, large = hallsym.build("stage30"), hallsym.build("stage31")
    # three products, three sums and three entries per probe more
    assert cost_of(large).operations - cost_of(small).operations == 18
    assert cost_of(large).moves - cost_of(small).moves == 9
    a, b = cost_of(small).instructions, cost_of(large).instructions
    said = firmware_cost(small, large)
    assert said == f"9 parameters; C about {a} -> {b} instructions, parameter table 100 -> 136 B"
    late = STAGE["time_skew"](large)
    assert firmware_cost(large, late).startswith("1 parameter; decoding")
    listed = firmware_cost(large, late).partition("12 signals to compute (d1_x_ref_m, ")[2]
    assert listed.count(",") == 2  # two more, and that there are others
    assert listed.endswith(", ...)")


# -- text ----------------------------------------------------------------------------------------------------


def a_diagnosis(**changes) -> Diagnosis:
    gap = Gap(dict.fromkeys(("x_m", "y_m"), 2e-6), dict.fromkeys(("x_m", "y_m"), 9e-6))
    effect = FoundEffect(
        "height_quadratic", "transducer", "height of each probe",
        {f"bend_{k}": Estimate(-123456.0, 321.0, "1/m2") for k in "ABCDEFGH"}
        | {"tau": Estimate(1.2e-3, 2e-5, "s"), "offset": Estimate(2.5e-6, None, "m")},
        0.0, 0.4, (0.35, 0.45), 0.9, "10 parameters; decoding 98 -> 680 operations",
    )  # fmt: skip
    d = Diagnosis(
        verdict="explained", sentence="The gap is " + "long " * 40,
        noise_floor=NoiseFloor({"x_m": 1e-6, "y_m": 1e-6}, "stated"),
        gap_before=gap, gap_after=gap, metric=Metric(2e-6, 1e-6, 1e-6), ranked=("height_quadratic",),
        groups=(), effects=(effect,),
        shrinkage=Shrinkage(0.4, (0.35, 0.45), 0.9, 10),
        where=(Statement("height Z", "", 0.5, 1e-300, "50 % of the excess goes with height Z", 0.48),),
        remaining=(), separate_by=(delay_or_lag(),), validation_runs=(1, 2),
        not_testable={"a": "no temperature logged", "b": "no temperature logged"},
        smaller_findings=(SmallerFinding("time_skew", 0.01, 1e-4),), threshold=0.05, model="stage31",
        log=LogRecord(),
    )  # fmt: skip
    return replace(d, **changes)


def test_the_text_says_everything_within_its_width() -> None:
    text = diagnosis_text(a_diagnosis())
    assert max(map(len, text.splitlines())) <= PROSE
    words = " ".join(text.split())
    for said in (
        "noise floor, stated 1 1", "height_quadratic transducer 40.0 % (35.0 to 45.0) 90 % < 1e-6",
        "bend_A -123456(321) 1/m2", "tau 1.200(20) ms", "offset 0.0025 mm", "decoding 98 -> 680 operations",
        "50 % of the excess goes with height Z (p < 1e-6; holdout runs 48 %)",
        "This log cannot tell apart: time_skew, first_order_lag", "one such run is enough for 5 sigma",
        "not testable: a, b: no temperature logged", "time_skew 1.0 %", "with 10 parameters more",
    ):  # fmt: skip
        assert said in words, said


def test_operations_are_those_of_the_decoded_pose() -> None:
    """Generated C has one statement per operation, beside those that fetch inputs and constants."""
    model = hallsym.build("stage30")
    inputs = model.decoded.sx_in()
    code = ca.CodeGenerator("pose")
    code.add(ca.Function("pose", inputs, [ca.cse(model.decoded.call(inputs)[0])]))
    values = re.findall(r"^\s*a\d+=(.*);$", code.dump(), re.M)
    work = [v for v in values if not v.startswith("arg[") and not re.fullmatch(r"-?[\d.e+-]+", v)]
    assert operations(model) == len(work)
