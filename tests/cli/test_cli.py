"""The command line: bad input gets one sentence and an exit code, good input tables and JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from hallsym import build, bundled_campaign, load_fit, write_log
from hallsym.families.recording import MISTAKES, read_correction

CASES = Path(__file__).parents[3] / "shared" / "cases"


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    log = bundled_campaign()
    return {name: log.array(name) for name in log.columns}


@pytest.fixture
def written(columns, tmp_path):
    """Write the bundled campaign, changed by a function, and return its path."""

    def write(change=None, name="log.parquet") -> Path:
        changed = {name: values.copy() for name, values in columns.items()}
        changed = (change(changed) if change else None) or changed
        write_log(changed, tmp_path / name)
        return tmp_path / name

    return write


# -- logs that cannot be used ----------------------------------------------------------------------------


@pytest.mark.slow
def test_info_shows_the_first_rows_and_suggests_a_column_file(run, written, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = written(name="log.csv")
    head, _, body = path.read_text().partition("\n")
    names = head.replace("hall_a_m", "HallA [m]").replace("x_ref_m", "IFM X [m]").replace(",", ";")
    path.write_text(f"{names}\n{body.replace(',', ';')}")
    code, out, _ = run("info", path)
    assert code == 0
    assert "5700 samples in 57 runs" in out.partition("\n")[0]
    assert "\nread as UTF-8, columns separated by semicolons" in out
    assert "HallA [m]" in out
    code, out, _ = run("info", path, "--write")
    assert code == 0
    assert 'hall_a_m = "HallA"' in out
    assert "Check columns.toml." in out
    assert f"next: hallsym fit {path} --column columns.toml" in " ".join(out.split())
    assert run("fit", path, "--solver", "direct")[0] == 2
    options = ("--column", "columns.toml", "--solver", "direct", "-o", "calib.json")
    assert run("fit", path, *options)[0] == 0
    for command in ("evaluate", "report", "sensitivity"):
        code, out, err = run(command, "calib.json", path)
        assert code in (0, 3), err


def renamed(d):
    d["halla_m"] = d.pop("hall_a_m")


def with_nan(d):
    d["hall_b_m"][[100, 200]] = np.nan
    d["y_ref_m"][300] = np.inf


EXCHANGED = "exchange hall_a_m hall_b_m"


def swapped(d):
    d["hall_a_m"], d["hall_b_m"] = d["hall_b_m"], d["hall_a_m"]


def short(d):
    keep = (d["run"] != 5) | (np.arange(len(d["run"])) < 504)
    return {name: values[keep] for name, values in d.items()}


@pytest.mark.parametrize(
    ("change", "words"),
    [(renamed, ["hall_a_m", "halla_m", "--column"]), (with_nan, ["NaN", "row", "--drop-bad"])],
)
def test_what_goes_wrong_in_a_lab(refused, written, tmp_path, change, words):
    output = tmp_path / "calib.json"
    output.write_text("what the user had")
    said = refused("fit", written(change), "-o", output)
    for word in words:
        assert word in said
    assert output.read_text() == "what the user had"


@pytest.mark.parametrize(("change", "words"), [(with_nan, ["--drop-bad"]), (short, [])])
def test_what_is_left_out_or_of_no_harm_is_a_note(run, written, change, words):
    code, out, _ = run("fit", written(change), *words, "--solver", "direct")
    assert code == 0
    assert "note:" in out


def test_exchanged_channels_can_be_put_right(run, written):
    path = written(swapped)
    code, out, err = run("fit", path, "--solver", "direct")
    assert code == 3
    assert out.startswith("claim: ")
    assert f"--correct '{EXCHANGED}'" in err.splitlines()[0]
    code, out, _ = run("fit", path, "--correct", EXCHANGED, "--solver", "direct", "--json")
    found, expected = json.loads(out), {"eta_A": 0.8671, "eta_B": 0.7049, "eta_C": 0.8632}
    assert code == 0
    for name, value in expected.items():
        entry = found["parameters"][name]
        assert abs(entry["value"] - value) < 5 * entry["std"]
    assert (found["corrections"], found["claims"]) == ([EXCHANGED], [])


# -- logs that leave something open ----------------------------------------------------------------------


def test_a_vertical_state_that_never_moves(run, written):
    def flat(d):
        keep = np.max(np.abs([d["z_m"], d["rx_rad"], d["ry_rad"]]), axis=0) < 1e-6
        return {name: values[keep] for name, values in d.items()}

    code, out, err = run("fit", written(flat), "--solver", "direct", "--json")
    assert code == 3
    assert "a_A" in err
    parameters = json.loads(out)["parameters"]
    assert not any(parameters[f"{q}_{k}"]["determined"] for q in "abc" for k in "ABC")
    assert all(parameters[f"eta_{k}"]["determined"] for k in "ABC")


# -- options ---------------------------------------------------------------------------------------------


def test_a_machine_file_sets_bounds_and_fixes(run, written, tmp_path):
    machine = tmp_path / "machine.toml"
    machine.write_text("[parameters.theta_A]\nfixed = true\n[parameters.H1y]\nnominal = 0.35\n")
    code, out, _ = run("fit", written(), "--machine", machine, "--solver", "direct", "--json")
    parameters = json.loads(out)["parameters"]
    assert code == 0
    assert parameters["theta_A"]["value"] == 0
    assert parameters["H1y"]["value"] == 0.35


def test_a_full_disk_leaves_the_old_calibration(refused, written, tmp_path, monkeypatch):
    output = tmp_path / "calib.json"
    output.write_text("what the user had")

    def full(*_):
        raise OSError(28, "No space left on device")

    path = written()
    monkeypatch.setattr("os.fsync", full)
    assert "disk is full" in refused("fit", path, "--solver", "direct", "-o", output)
    assert output.read_text() == "what the user had"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["calib.json", "log.parquet"]


# -- what good input gives -------------------------------------------------------------------------------


def test_json_has_every_field_and_agrees_with_the_saved_file(run, written, tmp_path):
    path = tmp_path / "calib.json"
    code, out, _ = run("fit", written(), "--holdout", "2,7,12", "-o", path, "--json")
    found = json.loads(out)
    assert code == 0
    assert found == json.loads(path.read_text())
    assert (found["model"], len(found["combinations"])) == ("stage31", 3)
    assert (found["parameters"]["H1x"]["determined"], found["parameters"]["H1x"]["std"]) == (False, None)
    assert set(found["errors"]["holdout"]["rmse"]) == {"x_m", "y_m", "rz_rad"}
    assert found["noise"]["hall_a_m"]["source"] == "estimated"
    assert found["status"] == "converged"
    assert found["seconds"] > 0
    assert load_fit(path).to_dict() == found


@pytest.mark.slow
def test_evaluate_reproduces_the_fit_and_reads_the_channels_that_it_resolved(run, written, tmp_path):
    log, path = written(swapped), tmp_path / "calib.json"
    _, out, _ = run("fit", log, "-o", path, "--solver", "direct", "--correct", EXCHANGED, "--json")
    fitted = json.loads(out)["errors"]["fitted"]
    code, out, _ = run("evaluate", path, log, "--json")
    found = json.loads(out)["logs"][0]["errors"]
    assert code == 0
    for what in ("rmse", "peak"):
        assert found[what] == pytest.approx(fitted[what], rel=1e-9)
    _, out, _ = run("evaluate", path, log, "--by-run")
    assert sum(line.startswith("run ") for line in out.splitlines()) == 57


def test_info_lists_the_forms_of_corrections(run):
    code, out, _ = run("info", "corrections", "--json")
    forms = json.loads(out)["corrections"]
    assert code == 0
    assert "exchange COLUMN COLUMN [in RUNS]" in forms
    _, out, _ = run("info", "corrections")
    examples = [line for line in out.splitlines() if line.startswith("    ")]
    assert [line.split()[0] for line in examples] == [form.split()[0] for form in forms]
    assert [read_correction(line.split("  ")[2].strip()).kind for line in examples] == list(MISTAKES)


@pytest.mark.parametrize("name", ["stage31", "model31", "rotary_meng"])
def test_info_explains_a_model(run, name):
    code, out, _ = run("info", name)
    assert code == 0
    record = json.loads(run("info", name, "--json")[1])
    model = build(name)
    assert [p["name"] for p in record["parameters"]] == list(model.names)
    assert all(p["unit"] and p["meaning"] for p in (*record["parameters"], *record["offsets"]))
    assert [p["column"] for p in record["pose"]] == list(model.pose)
    assert "hysteresis" in record["can_take"]
    assert not set(model.effects) & set(record["can_take"])
    for entry in (*record["parameters"], *record["offsets"]):
        assert entry["meaning"] in out
    assert ("repeats every 6.28319 rad" in out) == bool(model.period)


@pytest.mark.slow
def test_demo_prints_the_papers_steps(run, tmp_path):
    code, out, _ = run("demo", "-o", tmp_path / "demo", "--json")
    steps = {s["step"]: s for s in json.loads(out)["steps"]}
    assert code == 0
    designed = steps["nominal values, Model (15), Z = +-250 um"]["here"]["rmse"]
    final = steps["Model (31), holdout runs"]
    # the paper's step: Table 2 to Table 8
    assert designed["y_m"] == pytest.approx(44e-6, rel=0.03)
    assert designed["rz_rad"] == pytest.approx(88e-6, rel=0.03)
    for name, value in final["here"]["rmse"].items():
        assert value == pytest.approx(final["paper"]["rmse"][name], rel=0.06)
    each = steps["Model (30), each height by itself"]["here"]["rmse"]
    assert all(each[name] < designed[name] / 10 for name in designed)
    assert {p.name for p in (tmp_path / "demo").iterdir()} == {"calib.json", "errors_by_setting.png"}


def test_ctrl_c_in_the_global_stage_keeps_the_best_so_far(run, written, tmp_path, monkeypatch):
    from hallsym.estimation.likelihood import Cost

    whole, calls = Cost.population, []

    def interrupted(self, points):
        calls.append(len(points))
        if len(calls) == 5:
            raise KeyboardInterrupt
        return whole(self, points)

    monkeypatch.setattr(Cost, "population", interrupted)
    path = tmp_path / "calib.json"
    code, _, err = run("fit", written(), "-o", path)
    assert code == 130
    assert "interrupted" in err
    assert load_fit(path).status == "interrupted"


# -- logs of machines that nobody here fitted to ---------------------------------------------------------


@pytest.mark.skipif(not CASES.exists(), reason="the independent cases are not beside this checkout")
@pytest.mark.parametrize(
    "case",
    [pytest.param(f"dev_{k:03d}", marks=pytest.mark.slow if k % 5 else ()) for k in range(1, 16)],
)
def test_independent_campaigns(run, case):
    """Errors on holdout runs are those of the base model's best fit, computed independently."""
    label = json.loads((CASES / "labels.json").read_text())[case]
    code, out, _ = run("fit", CASES / "dev" / case, "--accept", "all", "--json")
    found = json.loads(out)
    gap, floor = (
        np.linalg.norm([size * (0.35 if c == "rz_rad" else 1.0) for c, size in sizes.items()])
        for sizes in (found["errors"]["fitted"]["rmse"], found["noise_floor"])
    )
    assert code == (3 if gap / floor > found["goodness_of_fit"]["limit"] else 0)
    assert [note for note in found["notes"] if "meta.json states" not in note] == []
    for name, value in label["noisy"]["before"]["output_rmse"].items():
        assert found["errors"]["holdout"]["rmse"][name] == pytest.approx(value, rel=0.06)


def test_a_table_that_wraps_has_the_noise_of_its_steps(run, tmp_path):
    """Full steps of 1.8 deg from 336.6 deg on, as exact as they are commanded, and an encoder of 14 bits."""
    at = (336.6 + 1.8 * np.arange(200)) % 360
    count = np.round((at + 2.0) / 360 * 16384 + np.random.default_rng(0).normal(0, 1, 200)) % 16384
    table = np.column_stack([at, count])
    np.savetxt(tmp_path / "knots.csv", table, delimiter=",", header="ref_angle_deg,raw_count", comments="")
    names = ("angle_ref_deg=ref_angle_deg", "angle_count=raw_count,counts_per_turn=16384")
    words = [word for name in names for word in ("--column", name)]
    code, out, _ = run("info", tmp_path / "knots.csv", *words)
    assert code == 0
    reference, reading = (line.split() for line in out.splitlines() if line.startswith("angle_"))
    assert reference[4:] == ["0", "deg", "estimated"]
    assert 0.3 < float(reading[4]) / np.degrees(2 * np.pi / 16384) < 3
