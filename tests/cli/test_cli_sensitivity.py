"""`hallsym sensitivity`: tables, JSON, exit codes, bad input."""

import json

import pytest

from hallsym import bundled_campaign, fit, write_log


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A log, its calibration, and a campaign at one height."""
    folder = tmp_path_factory.mktemp("sensitivity")
    log = bundled_campaign()
    write_log({c: log.array(c) for c in log.columns}, folder / "log.csv")
    from hallsym import read_log

    fit(read_log(folder / "log.csv"), "stage31", solver="direct", holdout=[2, 7]).save(folder / "calib.json")
    (folder / "level.toml").write_text(
        "step_s = 0.01\n[[trajectory]]\nduration_s = 2.0\n"
        'x_m = { kind = "sine", amplitude = 300e-6, frequency_hz = 1.0 }\n'
        'y_m = { kind = "sine", amplitude = 500e-6, frequency_hz = 1.5 }\n'
        'rz_rad = { kind = "sine", amplitude = 300e-6, frequency_hz = 2.5 }\n'
    )
    return folder


def test_report_names_verdicts_null_directions_and_method(run, folder, tmp_path):
    code, out, err = run("sensitivity", folder / "calib.json", folder / "log.csv", "-o", tmp_path / "r.json")
    record = json.loads((tmp_path / "r.json").read_text())
    assert (record["model"], record["planned"]) == ("stage31", False)
    assert (code, err) == (0, "")
    assert out.startswith("55 runs of ")  # the calibration's two held-out runs stay out
    assert "structural rank 18 of 21" in out
    assert "H1x, H1y: only H1x*cos(theta_A) + H1y*sin(theta_A)" in out
    assert out.count("not determined from any recording") == 6
    assert "uncertainty: likelihood (scores of the 55 runs" in out
    assert "165 zero deviations, eliminated" in out


@pytest.mark.slow
def test_profiles_of_all_are_in_the_record(run, folder):
    _, out, _ = run("sensitivity", folder / "calib.json", folder / "log.csv", "--profiles", "all", "--json")
    record = json.loads(out)
    assert len(record["profiles"]) == 18
    for entry in record["profiles"]:
        assert [end["status"] for end in entry["ends"]] == ["reached", "reached"]
    interval, std = record["parameters"]["a_A"]["interval"], record["parameters"]["a_A"]["std"]
    assert interval["how"] == "profile"
    assert interval["high"] - interval["low"] == pytest.approx(2 * 1.96 * std, rel=0.1)


def test_a_plan_by_model_and_by_calibration(run, folder):
    code, out, _ = run("sensitivity", "--model", "stage31", "--plan")
    assert code == 0
    assert "57 runs of the paper's campaign will determine" in out
    code, out, err = run("sensitivity", folder / "calib.json", "--plan", folder / "level.toml")
    assert code == 3
    assert "does not determine a_A" in err
    assert "practical rank 9 of 21" in out
