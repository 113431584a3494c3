"""Does a log belong to a calibration: false alarms as often as stated, changes found and named."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import hallsym
from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.inference import FALSE_ALARM, Belonging
from hallsym.inference.belonging import chance_of, welch
from hallsym.log import Log, Noise, write_log
from hallsym.model import Model
from hallsym.simulation import Campaign, NoiseModel, campaign_from

CALIBRATED = 1_000_000
"""Seeds from here on are of logs that are calibrated on."""


@cache
def machine() -> tuple[Model, Campaign, dict[str, float], dict[str, float]]:
    """Model, campaign, true values and noise of the example encoder."""
    model = hallsym.build("rotary")
    example = model.family.example
    assert example is not None
    noise = Noise.given(example.noise, (*model.channels, *model.references)).std
    return model, campaign_from(example.campaign, "example"), dict(example.values), dict(noise)


def log_of(
    seed: int, changes: Mapping[str, float] | None = None, *, louder: float = 1.0, correlation: float = 0.0,
    stated: bool = True,
) -> Log:  # fmt: skip
    """A log of the encoder; `changes`: what is added to its values; `correlation`: of the noise, samples."""
    model, campaign, values, sigma = machine()
    moved = {n: v + (changes or {}).get(n, 0.0) for n, v in values.items() if n in model.names}
    louder_noise = {c: louder * s for c, s in sigma.items()}
    noise = NoiseModel(sigma=louder_noise, correlation_s=correlation * campaign.step_s)
    columns = hallsym.simulate(model, moved, campaign, noise, seed=seed)
    return Log.from_arrays(columns, Noise.given(sigma, tuple(sigma)) if stated else None)


def calibration(seed: int, **how: float | bool) -> hallsym.Fit:
    return hallsym.fit(log_of(CALIBRATED + seed, **how), machine()[0], solver="direct", holdout=())


def judged(known: hallsym.Fit, log: object, **options: float) -> Belonging:
    return hallsym.belonging(hallsym.evaluate(known, log), **options)


@pytest.fixture(scope="module")
def known() -> hallsym.Fit:
    return calibration(0)


@pytest.mark.slow
@pytest.mark.parametrize("how", [{}, {"correlation": 3.0, "stated": False}])
def test_the_limits_hold_their_rate_of_false_alarms(how: dict[str, float]) -> None:
    """Every ten logs have a calibration of their own, so that its errors are averaged."""
    found = []
    for first in range(0, 200, 10):
        own = calibration(first, **how)
        found += [judged(own, log_of(first + k, **how)) for k in range(10)]
    assert sum(not one.belongs for one in found) <= stats.binom.ppf(0.995, 200, FALSE_ALARM)
    least = np.array([len(one.tests) * min(test.p_value for test in one.tests) for one in found])
    assert (least < 0.05).sum() <= stats.binom.ppf(0.995, 200, 0.05)
    assert (least < 0.8).sum() >= stats.binom.ppf(0.001, 200, 0.35)  # and they are not all far inside


def test_every_parameter_that_moved_is_noticed_and_named(known: hallsym.Fit) -> None:
    determined = [k for k in range(len(known.model.names)) if known.determined[k]]
    assert len(determined) > 3
    for k in determined:
        name, moved = known.model.names[k], 12 * float(known.std[k])
        seen = judged(known, log_of(3, {name: moved}))
        assert name in [test.name for test in seen.beyond], name
        assert name in seen.sentence
        change = next(c for c in seen.changes if c.name == name)
        assert change.significant
        assert change.after - change.before == pytest.approx(moved, abs=6 * float(known.std[k]))


@pytest.mark.slow
def test_more_noise_is_residual_error_and_no_parameter(known: hallsym.Fit) -> None:
    found = judged(known, log_of(4, louder=1.5))
    assert [test.name for test in found.beyond] == ["residual error"]
    assert found.refitted == pytest.approx(1.5, rel=0.05)
    assert found.floor == pytest.approx(1.0, rel=0.05)


def test_an_effect_that_is_new_is_residual_error(known: hallsym.Fit) -> None:
    log = log_of(5)
    columns = {c: np.array(log.array(c)) for c in log.columns}
    columns[known.model.channels[0]] *= 1 + 0.02 * np.sin(3 * columns[known.model.references[0]])
    assert "residual error" in [test.name for test in judged(known, columns).beyond]


def test_parameters_that_a_log_does_not_identify_are_said_so() -> None:
    model = hallsym.build("stage31")
    values = hallsym.published.values("table7_estimates")
    campaign, noise = hallsym.paper_campaign(step_s=0.02), hallsym.table8_noise(model)
    known = hallsym.fit(
        hallsym.simulate(model, values, campaign, noise, seed=1), model, solver="direct", holdout=()
    )
    few = replace(campaign, runs=campaign.runs[:5])
    found = judged(known, hallsym.simulate(model, values, few, noise, seed=2))
    assert found.belongs
    assert found.not_identified["b_A"] == "this log does not identify it"
    assert found.not_identified["H1x"] == "the calibration does not determine it"
    tested = {test.name for test in found.tests}
    assert "eta_A" in tested
    assert not tested & set(found.not_identified)
    assert any("H1x*cos(theta_A)" in name for name in tested)  # what is determined of them


def test_limits_share_the_false_alarm(known: hallsym.Fit) -> None:
    for false_alarm in (0.002, 0.05):
        tests = judged(known, log_of(6), false_alarm=false_alarm).tests
        levels = [2 * stats.norm.sf(t.limit) if t.two_sided else stats.norm.sf(t.limit) for t in tests]
        assert len(set(np.round(levels, 12))) == 1
        assert 1 - np.prod(1 - np.array(levels)) == pytest.approx(false_alarm, rel=1e-9)
        for test in tests:
            p = 2 * stats.norm.sf(abs(test.score)) if test.two_sided else stats.norm.sf(test.score)
            assert p == pytest.approx(test.p_value, rel=1e-9)
    for wrong in (0.0, float("nan")):
        with pytest.raises(InputError, match="false alarm must be"):
            judged(known, log_of(6), false_alarm=wrong)


def test_estimated_noise_has_students_reference() -> None:
    dof = welch((0.1, 0.2), (6.0, 9.0))
    expected = stats.ttest_ind_from_stats(
        1.0, 0.1 * np.sqrt(7), 7, 1.5, 0.2 * np.sqrt(10), 10, equal_var=False
    )
    assert chance_of(0.5, (0.1, 0.2), (6.0, 9.0)) == pytest.approx(expected.pvalue, rel=1e-9)
    assert 9 < dof < 15  # more than the smaller, less than both together
    known = chance_of(0.5, (0.1, 0.2), (np.inf, np.inf))
    assert known == pytest.approx(2 * stats.norm.sf(0.5 / np.hypot(0.1, 0.2)), rel=1e-9)


@pytest.mark.slow
def test_the_exit_code_tells_a_script(
    known: hallsym.Fit, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known.save(tmp_path / "calib.json")
    for name, log in (("good", log_of(11)), ("loud", log_of(12, louder=1.5))):
        write_log({c: log.array(c) for c in log.columns}, tmp_path / f"{name}.csv")
    calib, good, loud = (str(tmp_path / n) for n in ("calib.json", "good.csv", "loud.csv"))
    assert main(["evaluate", calib, good]) == 0
    assert "The log belongs to the calibration" in capsys.readouterr().out
    assert main(["evaluate", calib, good, loud]) == 1
    shown = capsys.readouterr().out
    assert "The log does not belong to the calibration" in shown
    assert f"next: hallsym diagnose {loud} --model {calib}" in shown
    assert main(["evaluate", calib, good, str(tmp_path / "none.csv"), "--json"]) == 2
    shown = capsys.readouterr()
    logs = json.loads(shown.out)["logs"]
    assert logs[0]["belonging"]["belongs"] is True
    assert "does not exist" in logs[1]["reason"]
    assert "does not exist" in shown.err
    assert main(["evaluate", good, good]) == 2
    assert main(["evaluate", calib, good, good]) == 2
    assert main(["evaluate", calib, good, "--false-alarm", "2"]) == 2
