"""Does a log belong to a calibration: false alarms as often as stated, changes found and named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from watched_logs import alarms, calibration, log_of, machine

import hallsym
from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.inference import Estimate, changes, welch
from hallsym.log import write_log
from hallsym.watching import FALSE_ALARM, Watch


@pytest.fixture(scope="module")
def known() -> hallsym.Fit:
    return calibration(0)


@pytest.mark.slow
def test_logs_that_belong_are_rarely_called_changed() -> None:
    found, least = alarms(20)
    assert found <= stats.binom.ppf(0.999, 20, FALSE_ALARM)
    assert (least < 0.1).sum() <= stats.binom.ppf(0.999, 20, 0.1)
    assert (least < 0.8).sum() >= stats.binom.ppf(0.001, 20, 0.35)  # and they are not all far inside


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", [{}, {"stated": False}, {"correlation": 3.0}, {"correlation": 3.0, "stated": False}]
)
def test_the_limits_hold_their_rate_of_false_alarms(how: dict[str, float]) -> None:
    found, least = alarms(600, **how)
    assert found <= stats.binom.ppf(0.995, 600, FALSE_ALARM)
    assert (least < 0.05).mean() <= stats.binom.ppf(0.995, 600, 0.05) / 600


def test_a_parameter_that_moved_is_named(known: hallsym.Fit) -> None:
    name = next(n for k, n in enumerate(known.model.names) if known.determined[k])
    std = float(known.std[known.model.names.index(name)])
    seen = hallsym.watch(known, [log_of(1), log_of(2, {name: 15 * std})])
    assert [log.verdict for log in seen.logs] == ["belongs", "changed"]
    moved = [c for c in seen.logs[1].changes if c.significant]
    assert name in [c.name for c in moved]
    change = next(c for c in moved if c.name == name)
    assert change.after - change.before == pytest.approx(15 * std, abs=6 * std)
    assert name in seen.logs[1].sentence
    assert seen.logs[0].sentence.startswith("all ")


def test_every_parameter_that_moved_is_noticed(known: hallsym.Fit) -> None:
    for k, name in enumerate(known.model.names):
        if known.determined[k]:
            seen = hallsym.watch(known, log_of(3, {name: 12 * float(known.std[k])}))
            assert name in [test.name for test in seen.logs[0].beyond], name


def test_more_noise_is_residual_error_and_no_parameter(known: hallsym.Fit) -> None:
    (log,) = hallsym.watch(known, log_of(4, louder=1.5)).logs
    assert [test.name for test in log.beyond] == ["residual error"]
    assert log.refitted == pytest.approx(1.5, rel=0.05)
    assert log.floor == pytest.approx(1.0, rel=0.05)
    assert "x the noise" in log.sentence


def test_an_effect_that_is_new_is_residual_error(known: hallsym.Fit) -> None:
    log = log_of(5)
    columns = {c: np.array(log.array(c)) for c in log.columns}
    channel = known.model.channels[0]
    columns[channel] *= 1 + 0.02 * np.sin(3 * columns[known.model.references[0]])
    (seen,) = hallsym.watch(known, columns).logs
    assert "residual error" in [test.name for test in seen.beyond]


def test_parameters_that_a_log_does_not_identify_are_said_so() -> None:
    model = hallsym.build("stage31")
    values = hallsym.published.values("table7_estimates")
    campaign, noise = hallsym.paper_campaign(step_s=0.02), hallsym.table8_noise(model)
    known = hallsym.fit(
        hallsym.simulate(model, values, campaign, noise, seed=1), model, solver="direct", holdout=()
    )
    few = replace(campaign, runs=campaign.runs[:5])
    (log,) = hallsym.watch(known, hallsym.simulate(model, values, few, noise, seed=2)).logs
    assert log.verdict == "belongs"
    assert log.not_identified["b_A"] == "this log does not identify it"
    assert log.not_identified["H1x"] == "the calibration does not determine it"
    tested = {test.name for test in log.tests}
    assert "eta_A" in tested
    assert not tested & set(log.not_identified)
    assert any("H1x*cos(theta_A)" in name for name in tested)  # what is determined of them


def test_limits_share_the_false_alarm(known: hallsym.Fit) -> None:
    for false_alarm in (0.002, 0.05):
        (log,) = hallsym.watch(known, log_of(6), false_alarm=false_alarm).logs
        levels = [2 * stats.norm.sf(t.limit) if t.two_sided else stats.norm.sf(t.limit) for t in log.tests]
        assert len(set(np.round(levels, 12))) == 1
        assert 1 - np.prod(1 - np.array(levels)) == pytest.approx(false_alarm, rel=1e-9)
        for test in log.tests:
            p = 2 * stats.norm.sf(abs(test.score)) if test.two_sided else stats.norm.sf(test.score)
            assert p == pytest.approx(test.p_value, rel=1e-9)


def test_estimated_noise_has_students_reference() -> None:
    one, two = {"a": Estimate(1.0, 0.1, "m")}, {"a": Estimate(1.5, 0.2, "m")}
    (change,) = changes(one, two, 0.05, ({"a": 6.0}, {"a": 9.0}))
    dof = welch((0.1, 0.2), (6.0, 9.0))
    expected = stats.ttest_ind_from_stats(
        1.0, 0.1 * np.sqrt(7), 7, 1.5, 0.2 * np.sqrt(10), 10, equal_var=False
    )
    assert change.p_value == pytest.approx(expected.pvalue, rel=1e-9)
    assert 9 < dof < 15  # more than the smaller, less than both together
    (change,) = changes(one, two, 0.05)
    assert change.p_value == pytest.approx(2 * stats.norm.sf(0.5 / np.hypot(0.1, 0.2)), rel=1e-9)


def test_a_bad_log_does_not_stop_the_others(known: hallsym.Fit, tmp_path: Path) -> None:
    write_log({"run": np.zeros(9), "t_s": np.arange(9.0), "x_ref_m": np.ones(9)}, tmp_path / "other.csv")
    seen = hallsym.watch(known, [tmp_path / "none.csv", tmp_path / "other.csv", log_of(7)])
    assert [log.verdict for log in seen.logs] == ["not judged", "not judged", "belongs"]
    assert seen.summary().startswith("1 of 3 logs could be judged; all of them belong to the calibration")
    assert "does not exist" in seen.logs[0].reason
    assert "has no column" in seen.logs[1].reason


def test_bad_input_is_one_sentence(known: hallsym.Fit, tmp_path: Path) -> None:
    for logs, more, says in (
        ([], {}, "must be a log"),
        ([tmp_path / "a.csv", tmp_path / "a.csv"], {}, "given twice"),
        (log_of(8), {"false_alarm": 0.0}, "false alarm must be"),
        (log_of(8), {"false_alarm": float("nan")}, "false alarm must be"),
    ):
        with pytest.raises(InputError, match=says) as error:
            hallsym.watch(known, logs, **more)
        assert str(error.value).endswith(".")


def test_results_are_shown_and_saved(known: hallsym.Fit, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    seen = hallsym.watch(known, [log_of(9), log_of(10, louder=1.5)])
    assert isinstance(seen, Watch)
    assert "1 changed" in repr(seen)
    assert "residual error" in seen.summary()
    frame = seen.to_dataframe()
    assert set(frame["test"]) >= {"residual error", "parameters together"}
    assert frame["beyond"].sum() == 1
    seen.save(tmp_path / "watch.json")
    assert json.loads((tmp_path / "watch.json").read_text())["changed"] == ["The log"]
    assert seen.plot().axes


def test_the_exit_code_tells_a_script(
    known: hallsym.Fit, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known.save(tmp_path / "calib.json")
    for name, log in (("good", log_of(11)), ("loud", log_of(12, louder=1.5))):
        write_log({c: log.array(c) for c in log.columns}, tmp_path / f"{name}.csv")
    calib, good, loud = (str(tmp_path / n) for n in ("calib.json", "good.csv", "loud.csv"))
    assert main(["watch", calib, good]) == 0
    assert "the log belongs" in capsys.readouterr().out
    written = ["-o", str(tmp_path / "w.json"), "--plots", str(tmp_path / "charts")]
    assert main(["watch", calib, good, loud, *written]) == 1
    shown = capsys.readouterr().out
    assert "1 of 2 logs do not belong" in shown
    assert f"next: hallsym diagnose {loud} --model {calib}" in shown
    assert (tmp_path / "charts" / "watch.png").stat().st_size > 1000
    assert main(["watch", calib, good, str(tmp_path / "none.csv"), "--json"]) == 2
    shown = capsys.readouterr()
    assert json.loads(shown.out)["logs"][0]["verdict"] == "belongs"
    assert "does not exist" in shown.err
    assert main(["watch", good, good]) == 2
    assert main(["watch", calib, good, "--false-alarm", "2"]) == 2


def test_the_machine_of_these_tests_has_several_parameters() -> None:
    model, campaign, _, _ = machine()
    assert len(model.names) > 3
    assert len(campaign.runs) > 1
