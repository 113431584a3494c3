"""Firmware cost, and the text of a diagnosis."""

from dataclasses import replace

import pytest

import hallsym
from hallsym.codegen import cost_of
from hallsym.diagnosis import Diagnosis, Estimate, FoundEffect, Separation, Statement
from hallsym.diagnosis.record import Gap, Metric, NoiseFloor, Shrinkage, SmallerFinding
from hallsym.diagnosis.report import firmware_cost
from hallsym.estimation.calibration import LogRecord
from hallsym.families import effects
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.output import PROSE
from hallsym.report.views import summary

STAGE = effects(STAGE_FAMILY)


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
    listed = firmware_cost(large, late).removeprefix("1 parameter and 12 signals to compute (d1_x_ref_m, ")
    assert listed.count(",") == 2  # two more, and that there are others
    assert listed.endswith(", ...); no C is generated with it")


# -- text ----------------------------------------------------------------------------------------------------


def a_diagnosis(**changes) -> Diagnosis:
    gap = Gap(dict.fromkeys(("x_m", "y_m"), 2e-6), dict.fromkeys(("x_m", "y_m"), 9e-6))
    effect = FoundEffect(
        "height_quadratic", "transducer", "height of each probe",
        {f"bend_{k}": Estimate(-123456.0, 321.0, "1/m2") for k in "ABCDEFGH"}
        | {"tau": Estimate(1.2e-3, 2e-5, "s"), "offset": Estimate(2.5e-6, None, "m")},
        0.0, 0.4, (0.35, 0.45), 0.9, "10 parameters; no C is generated with it",
    )  # fmt: skip
    d = Diagnosis(
        verdict="explained", sentence="The gap is " + "long " * 40,
        noise_floor=NoiseFloor({"x_m": 1e-6, "y_m": 1e-6}, "stated"),
        gap_before=gap, gap_after=gap, metric=Metric(2e-6, 1e-6, 1e-6), ranked=("height_quadratic",),
        groups=(), effects=(effect,),
        shrinkage=Shrinkage(0.4, (0.35, 0.45), 0.9, 10),
        where=(Statement("height Z", "", 0.5, 1e-300, "50 % of the excess goes with height Z", 0.48),),
        remaining=(), separate_by=(Separation(("time_skew", "first_order_lag"), "several speeds", 0.25),),
        validation_runs=(1, 2),
        not_testable={"a": "no temperature logged", "b": "no temperature logged"},
        smaller_findings=(SmallerFinding("time_skew", 0.01, 1e-4),), threshold=0.05, model="stage31",
        log=LogRecord(),
    )  # fmt: skip
    return replace(d, **changes)


def test_the_text_says_everything_within_its_width(monkeypatch: pytest.MonkeyPatch) -> None:
    words = " ".join(summary(a_diagnosis()).split())
    monkeypatch.setenv("COLUMNS", str(PROSE))
    assert max(map(len, summary(a_diagnosis()).splitlines())) <= PROSE
    for said in (
        "noise floor, stated 1 1", "40.0 % (35.0 to 45.0) 90 % < 1e-6", ": The gain bends with height.",
        "bend_A -123456(321) 1/m2", "tau 1.200(20) ms", "offset 0.0025 mm", "no C is generated with it",
        "50 % of the excess goes with height Z 48 % < 1e-6",
        "time_skew, first_order_lag: they are confusable on this log (0.25 sigma). Record several speeds.",
        "a, b: not testable, no temperature logged", "lowers the gap by 1.0 %", "with 10 parameters more",
    ):  # fmt: skip
        assert said in words, said
