"""Pictures of an evaluation and of a diagnosis show the errors that the commands state."""

from pathlib import Path

import numpy as np
import pytest
from twins import record, with_noise

from hallsym.cli.main import main
from hallsym.diagnosis import examine, prepare
from hallsym.estimation import Fit, evaluate, fit
from hallsym.log import Log
from hallsym.report import data
from hallsym.report import figures as plots

ROOT = Path(__file__).resolve().parents[2]
CAMPAIGN = ROOT / "data" / "campaign"
CALIBRATION = ROOT / "tests" / "golden" / "calib.json"


@pytest.fixture(scope="module")
def calibration() -> Fit:
    return fit(with_noise(record(seed=1)), "stage31", solver="direct", loss="none")


@pytest.fixture(scope="module")
def other() -> Log:
    return with_noise(record(seed=2))


def test_errors_that_are_drawn_are_those_of_the_evaluation(calibration: Fit, other: Log) -> None:
    """Zero deviations are those of the log that is evaluated, not of the one that was fitted."""
    found = evaluate(calibration, other)
    seen = data.look_over(found.decoded, found.applied)
    assert seen.runs == found.table.runs
    assert seen.fitted.squares == pytest.approx(found.table.squares, rel=1e-6)
    assert seen.fitted.peak == pytest.approx(found.table.peak, rel=1e-6)
    assert data.held_out(found.applied) == ()


def test_the_command_draws_an_evaluation(tmp_path: Path, capsys) -> None:
    words = ["evaluate", str(CALIBRATION), str(CAMPAIGN), "--plots", str(tmp_path), "--plot-format", "svg"]
    assert main(words) == 0
    names = {"measured", "errors_before_after", "errors_by_setting"}
    assert {path.stem for path in tmp_path.iterdir()} == names
    assert f"wrote {tmp_path / 'measured.svg'}" in capsys.readouterr().out
    for path in tmp_path.iterdir():
        assert "data/campaign, golden/calib.json" in path.read_text(encoding="utf-8")


def turned(wave: float) -> Log:
    """72 knots of a turn, whose readings have `wave` [rad] of four waves a turn."""
    a = np.arange(72) * 2 * np.pi / 72
    angle = a + wave * np.sin(4 * a) + np.random.default_rng(4).normal(0, 2e-4, 72)
    return Log.from_arrays({"angle_ref_rad": a, "angle_rad": angle})


@pytest.fixture(scope="module")
def examined():
    return examine(prepare(turned(4e-3), "rotary"))


def test_errors_with_the_effects_are_those_of_the_diagnosis(examined) -> None:
    found, first = examined.diagnosis, examined.fit
    versions = [data.version_of(base, "it") for base in (examined.before, examined.after)]
    survey = data.compared(data.look_over(examined.before.log, first, first.keep), first, *versions)
    for table, gap in ((survey.nominal, found.gap_before), (survey.fitted, found.gap_after)):
        assert table.over(found.validation_runs)["rmse"] == pytest.approx(gap.rmse, rel=1e-6)
    assert np.all(survey.fitted.count == survey.nominal.count)


def test_pictures_of_a_diagnosis(examined, tmp_path: Path) -> None:
    written = plots.save_diagnosis(examined, plots.Place(tmp_path, "svg", "log.csv, rotary"))
    assert [path.stem for path in written] == ["errors_before_after", "gap"]
    assert all("log.csv, rotary" in path.read_text(encoding="utf-8") for path in written)


def test_a_log_without_a_gap_has_pictures_too(tmp_path: Path) -> None:
    quiet = examine(prepare(turned(0.0), "rotary"))
    assert quiet.after is None
    stems = [path.stem for path in plots.save_diagnosis(quiet, tmp_path)]
    assert stems[:2] == ["errors_before_after", "gap"]


def test_comparing_draws_nothing(capsys) -> None:
    assert main(["diagnose", "--compare", "a.json", "b.json", "--plots", "pictures"]) == 2
    assert "leave --plots out" in capsys.readouterr().err
