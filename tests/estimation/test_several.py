"""Several logs of one device: exactly the fit of all runs, with each log's own noise and parameters."""

import numpy as np
import pytest
from twins import SIGMAS, TRUTH, campaign, record, truth_of, with_noise

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.estimation import fit, load_fit
from hallsym.estimation.factors import joined, summarise
from hallsym.estimation.likelihood import Sharing, cost_of, joint_cost, own_name
from hallsym.families import build
from hallsym.log import Log, Meta, write_log
from hallsym.simulation import NoiseModel, simulate

SMALL = 30


def moved(seed: int, **changes: float) -> dict[str, np.ndarray]:
    """Return a recording of the stage with some parameters changed."""
    model = build("stage31")
    truth = truth_of(model) | changes
    return simulate(model, truth, campaign(SMALL), NoiseModel(SIGMAS), seed=seed)


def together(*parts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return recordings as one, their runs renumbered."""
    apart = [{**p, "run": p["run"] + 1000 * k} for k, p in enumerate(parts)]
    return {name: np.concatenate([p[name] for p in apart]) for name in apart[0]}


@pytest.fixture(scope="module")
def logs() -> list[dict[str, np.ndarray]]:
    return [record(seed=1, samples=SMALL), record(seed=2, samples=SMALL)]


# -- exactly one fit ---------------------------------------------------------------------------------------


def test_logs_with_shared_parameters_are_one_log(logs):
    one = fit(with_noise(together(*logs)), "stage31", solver="direct")
    several = fit([with_noise(log) for log in logs], "stage31", solver="direct")
    assert several.values == pytest.approx(one.values, rel=1e-9, abs=1e-12)
    assert several.std == pytest.approx(one.std, rel=1e-6, nan_ok=True)
    assert several.solver.cost == pytest.approx(one.solver.cost, rel=1e-12)
    assert several.solver.lower_bound.ratio == pytest.approx(one.solver.lower_bound.ratio)
    assert several.goodness.cost_per_degree_of_freedom == pytest.approx(
        one.goodness.cost_per_degree_of_freedom
    )
    for row in ("designed", "fitted"):
        assert several.error_rows[row]["rmse"] == pytest.approx(one.error_rows[row]["rmse"], rel=1e-9)
    assert [c.value for c in several.combinations] == pytest.approx([c.value for c in one.combinations])


def test_parts_with_other_centres_or_a_run_in_two_parts_are_not_joined():
    columns, model = record(seed=3, samples=20), build("stage31")
    one = summarise(with_noise(columns), model)
    with pytest.raises(ValueError, match="each run"):
        joined([one, one])
    with pytest.raises(ValueError, match="one centre"):
        joined([one, summarise(with_noise(columns), model, centre=one.centre + 1.0)])


# -- own noise and own parameters --------------------------------------------------------------------------


def test_each_log_counts_by_its_own_noise(logs):
    """A log of ten times the noise adds a hundredth of the information."""
    sigma = {c: 10 * s for c, s in SIGMAS.items()}
    quiet, loud = with_noise(logs[0]), with_noise(record(seed=2, samples=SMALL, sigma=sigma), sigma)
    alone = fit(quiet, "stage31", solver="direct", loss="none")
    both = fit([quiet, loud], "stage31", solver="direct", loss="none")
    known = alone.determined & both.determined
    assert both.covariance_record.method == alone.covariance_record.method == "likelihood"
    assert both.std[known] == pytest.approx(alone.std[known] / np.sqrt(1.01), rel=2e-3)
    assert [part.noise["hall_a_m"].value for part in both.by_log] == pytest.approx([
        quiet.noise["hall_a_m"].value, 10 * quiet.noise["hall_a_m"].value
    ])  # fmt: skip


def test_a_gain_before_and_after_a_repair():
    found = fit(
        [with_noise(moved(1)), with_noise(moved(2, eta_A=TRUTH["eta_A"] + 0.01))],
        "stage31", solver="direct", per_log=["eta_A"],
    )  # fmt: skip
    change, sigma = found.joint.change("eta_A", "1", "2")
    assert change == pytest.approx(0.01, abs=4 * sigma)
    assert sigma < 2e-4
    assert [part.value("eta_A") for part in found.by_log] == pytest.approx(
        [TRUTH["eta_A"], TRUTH["eta_A"] + 0.01], abs=5e-4
    )
    assert found.value("eta_A") == found.by_log[1].value("eta_A")
    assert found.by_log[0].value("eta_B") == found.by_log[1].value("eta_B")
    assert own_name("eta_A", "2") in found.joint.names
    assert found.goodness.cost_per_degree_of_freedom == pytest.approx(1.0, abs=0.1)


def test_own_parameters_of_all_are_fits_by_themselves(logs):
    """With nothing shared each log is fitted alone."""
    found = fit([with_noise(log) for log in logs], "stage31", solver="direct", per_log=["*"], loss="none")
    for log, part in zip(logs, found.by_log, strict=True):
        alone = fit(with_noise(log), "stage31", solver="direct", loss="none")
        known = alone.determined & part.determined
        assert part.values[known] == pytest.approx(alone.values[known], rel=1e-6, abs=1e-9)
        assert part.std[known] == pytest.approx(alone.std[known], rel=0.05)


def test_derivatives_of_the_joint_cost():
    """Central differences of value and gradient, an own and a shared parameter."""
    model = build("stage31")
    logs = [with_noise(record(seed=s, samples=SMALL)) for s in (1, 2)]
    first = summarise(logs[0], model)
    summaries = [first, summarise(logs[1], model, centre=first.centre)]
    costs = [cost_of(s, log.noise.std) for s, log in zip(summaries, logs, strict=True)]
    numbers = [{r: r + 1000 * g for r in s.runs} for g, s in enumerate(summaries)]
    sharing = Sharing.of(model, ["eta_A", "a_B"], ["x", "y"])
    joint = joint_cost(sharing, costs, numbers)
    p = sharing.joint.vector({n: TRUTH[n.partition("[")[0]] for n in sharing.joint.names})
    value, gradient, hessian = joint.at(p).derivatives()
    assert value == pytest.approx(sum(c.at(sharing.of_log(g, p)).value for g, c in enumerate(costs)))
    for name in ("eta_A[x]", "eta_A[y]", "a_B[y]", "theta_C"):
        k = sharing.joint.names.index(name)
        h = 1e-4 * max(abs(p[k]), 1e-2)
        high, low = (joint.at(p + sign * h * np.eye(len(p))[k]).derivatives() for sign in (1, -1))
        assert gradient[k] == pytest.approx((high[0] - low[0]) / (2 * h), rel=1e-3, abs=1e-2 / h * 1e-6)
        assert hessian[:, k] == pytest.approx(
            (high[1] - low[1]) / (2 * h), rel=1e-3, abs=1e-4 * hessian[k, k]
        )
    assert joint.information(p) == pytest.approx(joint.at(p).information().sum(axis=0))


def test_outliers_of_one_log_are_taken_out_of_it(logs):
    bad = {n: v.copy() for n, v in logs[1].items()}
    bad["hall_a_m"][[100, 500, 900]] += 3e-3
    clean = fit([with_noise(log) for log in logs], "stage31", solver="direct")
    found = fit([with_noise(logs[0]), with_noise(bad)], "stage31", solver="direct")
    known = clean.determined
    assert np.abs((found.values - clean.values) / clean.std)[known].max() < 0.5
    assert any("3 of" in note and note.startswith("2:") for note in found.notes)


def test_a_held_out_log_changes_nothing_and_is_judged(logs):
    alone = fit([with_noise(logs[0])], "stage31", solver="direct")
    judged = fit([with_noise(logs[0])], "stage31", solver="direct", holdout_logs=[with_noise(logs[1])])
    assert np.array_equal(judged.values, alone.values)
    last = judged.by_log[-1]
    assert judged.logs[-1].held_out
    assert last.error_rows["fitted"] is None
    assert last.error_rows["holdout"]["rmse"]["x_m"] == pytest.approx(1.36e-6, rel=0.1)


def test_runs_of_the_same_number_are_told_apart(logs):
    numbers = fit([with_noise(log) for log in logs], "stage31", solver="direct").logs
    assert numbers[0].runs[0] == 100
    assert numbers[1].runs[12] == 212


# -- files, commands, sentences ----------------------------------------------------------------------------


def test_the_command_and_the_calibration_it_writes(tmp_path, capsys, logs):
    paths = [str(tmp_path / f"{name}.parquet") for name in ("before", "after")]
    for path, log in zip(paths, logs, strict=True):
        write_log(log, path)
    out = str(tmp_path / "calib.json")
    words = ["--solver", "direct", "--noise", "hall_m=5e-7", "--per-log", "eta_A", "-o", out]
    assert main(["fit", *paths, *words]) in (0, 3)
    text = capsys.readouterr().out
    assert "eta_A by log" in text
    assert "stage31 on 2 logs" in text
    assert (tmp_path / "calib.before.json").is_file()
    known = load_fit(out)
    assert [log.name for log in known.logs] == ["before", "after"]
    assert known.logs[1].parameters["eta_A"].value == known.value("eta_A")
    assert load_fit(tmp_path / "calib.before.json").value("eta_A") != known.value("eta_A")
    assert main(["evaluate", out, paths[0]]) == 0
    assert main(["info", out]) == 0


def refused(*logs, match: str, **options) -> None:
    with pytest.raises(InputError, match=match) as error:
        fit(list(logs), solver="direct", **options)
    assert len(str(error.value)) <= 300
    assert "\n" not in str(error.value)


def test_logs_that_are_not_of_one_device_are_one_sentence(logs):
    first, second = (with_noise(log) for log in logs)
    refused(match="no log", model="stage31")
    refused(first, second, model="stage31", per_log=["gain_A"], match="no parameter 'gain_A'")
    refused(first, model="stage31", per_log=["eta_A"], match="two logs at least")
    refused(first, second, model="stage31", holdout=[999], match="Holdout run 999")
    refused(first, model="stage31", per_log=["eta_A"], holdout_logs=[second], match="two logs at least")
    refused(first, second, model="stage31", per_log=["eta_A"], holdout_logs=[first], match="holdout log")
    late = ["hysteresis:half_width_m=6e-05"]
    refused(first, second, model="stage31", effects=late, match="no run statistics")
    device = [Log(log.table, log.noise, Meta(device=name)) for log, name in ((first, "A7"), (second, "B2"))]
    refused(*device, model="stage31", match="different devices, 'A7' and 'B2'")
    named = [
        Log(log.table, log.noise, Meta(base_model=m)) for log, m in ((first, "stage31"), (second, "stage30"))
    ]
    refused(*named, match="different models, stage31")


def test_units_that_differ_between_files_are_one_sentence():
    angle = np.linspace(0.0, 12.0, 2000)
    rng = np.random.default_rng(1)

    def encoder(scale: float) -> Log:
        sin, cos = (scale * (f(angle) + 1e-4 * rng.standard_normal(len(angle))) for f in (np.sin, np.cos))
        return Log.from_arrays({
            "run": np.zeros(len(angle), dtype=int), "t_s": np.arange(len(angle)) * 1e-3,
            "v_sin_v": sin, "v_cos_v": cos, "angle_ref_rad": angle,
        })  # fmt: skip

    fit([encoder(5.0), encoder(6.0)], "rotary", solver="direct")  # another air gap
    refused(encoder(5.0), encoder(5e-3), model="rotary", match="Units differ between files")
