"""Two records of one machine: what went, came and changed is what was put in, and nothing else."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from twins import record, with_noise

import hallsym
from hallsym.cli.main import main
from hallsym.diagnosis import compare
from hallsym.report.text.comparison import comparison_text

FLOOR = {"x_m": 1e-6, "y_m": 1e-6, "rz_rad": 1e-6, "source": "stated"}


def effect(name: str, share: float = 0.5, **parameters: tuple[float, float | None]) -> dict:
    return {
        "name": name, "link": "field", "variant": "plain", "p_value": 1e-9, "shrinkage": 0.2,
        "interval": [0.1, 0.3], "share": share, "cost": "1 parameter",
        "parameters": {n: {"value": v, "std": s, "unit": "1"} for n, (v, s) in parameters.items()},
    }  # fmt: skip


def diagnosis(*effects: dict, gap: float = 3e-6, verdict: str = "explained", **more) -> dict:
    rmse = {"x_m": gap / 2, "y_m": gap / 2, "rz_rad": gap}
    return {
        "verdict": verdict, "model": "stage31", "noise_floor": FLOOR,
        "metric": {"before": gap, "after": 1.5e-6, "floor": 1.4e-6},
        "gap_before": {"rmse": rmse, "peak": rmse}, "gap_after": {"rmse": rmse, "peak": rmse},
        "effects": list(effects), "groups": [], "where": [], "ranked": [e["name"] for e in effects],
        "not_testable": {}, "smaller_findings": [], "threshold": 0.05, "sentence": "", "remaining": [],
        "shrinkage": {"value": 0.5, "interval": [0.4, 0.6], "share_closed": 0.9, "parameters_added": 1},
        "separate_by": [], "validation_runs": [2], "log": {}, **more,
    }  # fmt: skip


def test_what_went_what_came_and_what_stayed() -> None:
    before = diagnosis(effect("hysteresis", a=(1.0, 0.1)), effect("mount_slip", b=(2.0, 0.1)))
    after = diagnosis(effect("hysteresis", 0.9, a=(1.05, 0.1)), effect("time_skew", c=(3.0, 0.1)), gap=2e-6)
    changed = compare(before, after)
    assert {e.name: e.state for e in changed.effects} == {
        "mount_slip": "gone", "time_skew": "came", "hysteresis": "stays",
    }  # fmt: skip
    assert changed.gap == (3e-6, 2e-6)
    stayed = changed.effects[-1]
    assert stayed.share == (0.5, 0.9)
    assert [p.name for p in stayed.parameters] == ["a"]


@pytest.mark.parametrize(
    ("change", "expected"), [(0.0, 1.0), (1.96 * np.sqrt(2), 0.05), (2.5758 * np.sqrt(2), 0.01)]
)
def test_the_p_value_is_that_of_a_normal_difference(change: float, expected: float) -> None:
    before, after = diagnosis(effect("e", a=(1.0, 1.0))), diagnosis(effect("e", a=(1.0 + change, 1.0)))
    (parameter,) = compare(before, after).effects[0].parameters
    assert parameter.p_value == pytest.approx(expected, rel=2e-3)


def test_significance_is_shared_by_all_parameters() -> None:
    def named(value: float) -> dict:
        return effect("e", a=(value, 1.0), **{f"b{k}": (0.0, 1.0) for k in range(9)})

    alone = compare(diagnosis(effect("e", a=(0.0, 1.0))), diagnosis(effect("e", a=(3.5, 1.0))))
    among = compare(diagnosis(named(0.0)), diagnosis(named(3.5)))
    assert alone.effects[0].parameters[0].significant
    assert not any(p.significant for p in among.effects[0].parameters)


def test_without_an_uncertainty_nothing_is_said() -> None:
    changed = compare(diagnosis(effect("e", a=(1.0, None))), diagnosis(effect("e", a=(9.0, 0.1))))
    (parameter,) = changed.effects[0].parameters
    assert (parameter.p_value, parameter.significant) == (None, None)
    assert "unknown" in comparison_text(changed)


def test_an_effect_that_is_missing_for_a_reason_says_the_reason() -> None:
    before = diagnosis(*(effect(n) for n in ("time_skew", "gain_temperature_drift", "hysteresis")))
    after = diagnosis(
        effect("first_order_lag"),
        groups=[["first_order_lag", "time_skew"]],
        not_testable={"gain_temperature_drift": "no temperature logged"},
        smaller_findings=[{"name": "hysteresis", "shrinkage": 0.03, "p_value": 1e-9}],
    )
    remarks = {e.name: e.remark for e in compare(before, after).effects}
    assert remarks["time_skew"] == "after, the log cannot tell it from first_order_lag"
    assert remarks["gain_temperature_drift"] == "after, not testable: no temperature logged"
    assert remarks["hysteresis"] == "after, below the threshold: 3 %"


def test_parameters_of_another_form_are_not_compared() -> None:
    other = effect("mount_slip", a=(5.0, 0.1)) | {"variant": "probe B at 12 s"}
    changed = compare(diagnosis(effect("mount_slip", a=(1.0, 0.1))), diagnosis(other))
    assert changed.effects[0].parameters == ()
    assert "form changed" in changed.effects[0].remark


def test_comparing_a_record_with_itself_changes_nothing() -> None:
    one = diagnosis(effect("hysteresis", a=(1.0, 0.1)), effect("mount_slip", b=(2.0, 0.1)))
    changed = compare(one, deepcopy(one))
    assert {e.state for e in changed.effects} == {"stays"}
    assert not any(p.significant for e in changed.effects for p in e.parameters)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"model": "stage30"}, "must be of one model"),
        ({"gap_before": {"rmse": {"angle_rad": 1.0}, "peak": {"angle_rad": 1.0}}}, "the same outputs"),
    ],
)
def test_records_that_do_not_belong_together_are_refused(other: dict, message: str) -> None:
    with pytest.raises(hallsym.InputError, match=message):
        compare(diagnosis(), diagnosis() | other)


def test_files_that_are_no_record_are_refused(tmp_path: Path) -> None:
    good = tmp_path / "good.json"
    good.write_text(json.dumps(diagnosis()))
    for text, message in (
        ("{", "cannot be read as JSON"),
        ("[1]", "something else"),
        ("{}", "something else"),
    ):
        bad = tmp_path / "bad.json"
        bad.write_text(text)
        with pytest.raises(hallsym.InputError, match=message):
            compare(good, bad)
    with pytest.raises(hallsym.InputError, match="does not exist"):
        compare(good, tmp_path / "missing.json")


def test_the_command_prints_and_saves(tmp_path: Path, capsys) -> None:
    paths = [tmp_path / f"{n}.json" for n in ("before", "after", "changed")]
    paths[0].write_text(json.dumps(diagnosis(effect("hysteresis", a=(1.0, 0.1)))))
    paths[1].write_text(json.dumps(diagnosis(gap=1.4e-6, verdict="no gap")))
    command = ["diagnose", "--compare", str(paths[0]), str(paths[1])]
    assert main([*command, "-o", str(paths[2])]) == 0
    assert "gone: hysteresis" in capsys.readouterr().out
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(paths[2].read_text())
    assert main([*command, "some.parquet"]) == 2
    assert main(["diagnose"]) == 2


def test_two_calibrations_of_one_machine(tmp_path: Path) -> None:
    """The same machine again changes nothing; a gain that was moved by 1 % is what changed."""
    paths = []
    for k, factor in enumerate((1.0, 1.0, 1.01)):
        columns = record(seed=k, samples=40)
        columns["hall_b_m"] = columns["hall_b_m"] * factor
        paths.append(tmp_path / f"{k}.json")
        hallsym.fit(with_noise(columns), "stage31", solver="direct").save(paths[-1])
    same, moved = compare(paths[0], paths[1]), compare(paths[0], paths[2])
    assert not any(p.significant for p in same.effects[0].parameters)
    assert "eta_B" in [p.name for p in moved.effects[0].parameters if p.significant]
    assert not any(p.significant for p in moved.effects[0].parameters if p.name.endswith(("_A", "_C")))
    with pytest.raises(hallsym.InputError, match="one of each"):
        compare(paths[0], diagnosis())
