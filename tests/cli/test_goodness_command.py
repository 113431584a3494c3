"""What `fit`, `evaluate` and their followers say of a model that does not describe its log: exit code 3."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from twins import bundled

from hallsym import bundled_campaign, load_fit, write_log
from hallsym.cli.main import main

CAMPAIGN = Path(__file__).resolve().parents[2] / "data" / "campaign"


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    """Model (30) on a campaign at many heights, saved."""
    path = tmp_path_factory.mktemp("saved") / "plain.json"
    assert main(["fit", str(CAMPAIGN), "--model", "stage30", "--solver", "direct", "-o", str(path)]) == 3
    return path


def test_fit_begins_with_it_and_writes_the_calibration(run, tmp_path):
    path = tmp_path / "calib.json"
    options = ("--model", "stage30", "--solver", "direct", "--holdout", "2,7,12", "--noise", "hall_m=5e-7")
    code, out, err = run("fit", CAMPAIGN, *options, "-o", path)
    assert code == 3
    first = out.splitlines()[0]
    assert first.startswith("The model does not describe this log: residual error is 3.")
    assert first.endswith(
        f"next: hallsym diagnose {CAMPAIGN} --model stage30 --holdout 2,7,12 --noise hall_m=5e-7"
    )
    assert err == ""
    assert load_fit(path).goodness.sentence == first


@pytest.mark.slow
def test_fit_says_it_in_json_and_on_stderr(run):
    code, out, err = run("fit", CAMPAIGN, "--model", "stage30", "--solver", "direct", "--json")
    record = json.loads(out)
    assert code == 3
    assert record["goodness_of_fit"]["material"]
    assert err == f"hallsym: {record['goodness_of_fit']['statement']}\n"
    assert record["solver"]["lower_bound"]["near"]
    assert record["parameters"]["eta_A"]["degrees_of_freedom"] < 46


def test_the_right_model_is_no_news(run):
    code, out, err = run("fit", CAMPAIGN, "--solver", "direct")
    assert (code, err) == (0, "")
    assert out.startswith("The model describes this log: residual error is 1.00 times the noise floor.\n")
    assert out.splitlines()[2].startswith("stage31 on ")
    assert out.splitlines()[-1].startswith("next: hallsym fit")
    assert "x the lower bound, a linear fit with 36 free coefficients" in out
    assert "goodness of fit: cost per degree of freedom 1.01" in out


@pytest.mark.slow
def test_the_next_command_runs_as_it_is_printed(run, plain):
    words = shlex.split(load_fit(plain).goodness.next_command)
    code, out, _ = run(*words[1:])
    assert code == 0
    assert "vertical" in out


@pytest.mark.slow
def test_evaluate_says_it_of_another_log(run, tmp_path):
    """A calibration of the machine as it was, on a log of a channel that reads 2 % less."""
    calibration = tmp_path / "calib.json"
    assert run("fit", CAMPAIGN, "--solver", "direct", "-o", calibration)[0] == 0
    log = bundled_campaign()
    columns = {c: log.array(c).copy() for c in log.columns}
    columns["hall_b_m"] *= 0.98
    write_log(columns, tmp_path / "later.parquet")
    noise = [w for c, s in log.noise.std.items() for w in ("--noise", f"{c}={s}")]
    assert run("evaluate", calibration, CAMPAIGN)[0] == 0
    code, out, err = run("evaluate", calibration, tmp_path / "later.parquet", *noise)
    assert code == 1
    first = out.splitlines()[0]
    assert first.startswith("The calibration does not describe this log: residual error is ")
    assert "channel hall_b_m" in first
    assert f"next: hallsym diagnose {tmp_path / 'later.parquet'} --model {calibration}" in first
    assert err == ""
    code, out, err = run("evaluate", calibration, tmp_path / "later.parquet", *noise, "--json")
    assert (code, err) == (1, f"hallsym: {json.loads(out)['logs'][0]['goodness_of_fit']['statement']}\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "code", "says"),
    [
        (lambda c: {"hall_a_m": 1e3 * c["hall_a_m"]}, 3, "undo it with --correct 'scale hall_a_m mm'"),
        (lambda c: late(c, 2), 3, "'delay x_ref_m,y_ref_m,rz_ref_rad 2'"),
    ],
    ids=["unit", "delay"],
)
def test_evaluate_says_of_a_recording_what_fit_says(run, tmp_path, wrong, code, says):
    """The same sentence on stderr, beside a calibration of the machine as it was."""
    calibration, log = tmp_path / "calib.json", bundled_campaign()
    assert run("fit", CAMPAIGN, "--solver", "direct", "-o", calibration)[0] == 0
    columns = bundled(slice(15))
    write_log(columns | wrong(columns), tmp_path / "wrong.parquet")
    noise = [w for c, s in log.noise.std.items() for w in ("--noise", f"{c}={s}")]
    fitted = run("fit", tmp_path / "wrong.parquet", *noise, "--solver", "direct")
    judged = run("evaluate", calibration, tmp_path / "wrong.parquet", *noise)
    assert (fitted[0], judged[0]) == (code, 1)
    assert re.findall(says, fitted[2])
    assert re.findall(says, judged[2]) == re.findall(says, fitted[2])


def late(columns, samples):
    """The references of every run, some samples late."""
    parts = [np.flatnonzero(columns["run"] == run) for run in np.unique(columns["run"])]
    at = np.concatenate([np.r_[np.repeat(p[0], samples), p[:-samples]] for p in parts])
    return {c: columns[c][at] for c in ("x_ref_m", "y_ref_m", "rz_ref_rad")}


@pytest.mark.slow
def test_what_is_made_of_such_a_calibration_repeats_it(run, plain, tmp_path):
    said = "does not describe"
    code, out, _ = run("budget", plain)
    assert code == 0
    assert f"note: the model of this calibration {said} its log" in out
    assert "next: hallsym diagnose" in out
    code, out, _ = run("sensitivity", plain, CAMPAIGN, "--profiles", "none")
    assert code == 0
    assert out.startswith(f"The model {said} this log")
    code, out, _ = run("codegen", plain, "-o", tmp_path / "code")
    assert code == 0
    assert f"The model of this calibration {said} its log" in out
    code, _, _ = run("report", plain, CAMPAIGN, "-o", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert f"The model {said} this log" in page
    assert 'class="card bad"' in page
    assert re.search(r"<code>.*diagnose.*stage30.*</code>", page)


@pytest.mark.slow
def test_few_degrees_of_freedom_are_said_and_widen_the_intervals(run, plain, tmp_path):
    known = load_fit(plain)
    factor = np.array([p.factor for p in known.params.values()])
    assert np.all(factor[known.determined] > 1.97)
    assert np.sum(factor > 2.05) >= 3  # of parameters that the scatter of few runs tells
    _, out, _ = run("fit", CAMPAIGN, "--model", "stage30", "--solver", "direct")
    factors = r"95 % interval: value \+- 1\.97 to 2\.1\d? x"
    assert re.search(rf"{factors} .* \(Student's t; degrees of freedom 1", out)


def test_a_solver_that_does_not_converge_names_what_can_be_changed(run, monkeypatch):
    """Both methods are stopped after one step; no option 'max_iterations' exists."""
    from hallsym.estimation import optimum

    newton, ipopt = optimum.solvers.newton, optimum.solvers.ipopt

    class Stopped:
        Problem = optimum.solvers.Problem

        @staticmethod
        def newton(problem, x0, **_):
            return newton(problem, x0, max_iterations=1)

        @staticmethod
        def ipopt(problem, x0, **_):
            return ipopt(problem, x0, max_iterations=1)

    monkeypatch.setattr(optimum, "solvers", Stopped)
    code, _, err = run("fit", CAMPAIGN, "--solver", "direct", "--loss", "none")
    assert code == 4
    assert "did not converge (budget)" in err
    assert "--solver hybrid" in err
    assert "max_iterations" not in err
