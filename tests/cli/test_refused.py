"""What cannot be done is refused by every command in one sentence that says what to do, with exit code 2."""

import re
import shlex

import pytest

from tests.sorting.benches import bench, written

RANGES = """
step_s = 0.02
seconds_per_run = 1.0
frequencies_hz = [1.0, 2.0, 3.0]
runs = 8
levels = 2
trajectories = ["combined"]

[range]
x_um = [-300, 300]
y_um = [-500, 500]
rz_urad = [-300, 300]
z_um = [-250, 250]
rx_urad = [-500, 500]
ry_mrad = [-0.5, 0.5]
"""
PLAN = "plan given.toml -o made.toml"
FIT = "fit log.csv --solver direct"
LONG = "x" * 300
SENTENCES = [
    # a file, an option or a value that does not exist
    ("fit log.cvs", "did you mean 'log.csv'"),
    ("evaluate none.json log.csv", "does not exist"),
    ("budget none.json", "does not exist"),
    ("dignose log.csv", "did you mean 'diagnose'.*; see hallsym --help"),
    ("log.csv", "did you mean 'hallsym info log.csv'"),
    ("fit log.csv --modle stage31", "did you mean '--model'.*; see hallsym fit --help"),
    ("fit --holdot=3", "did you mean '--holdout'.*; see hallsym fit --help"),
    ("--verison", "did you mean '--version'.*; see hallsym --help"),
    ("sensitivity --profiles al", "did you mean 'all'.*; see hallsym sensitivity --help"),
    ("fit log.csv --model stage3", "did you mean 'stage31'"),
    ("fit log.csv --effect histeresis", "did you mean 'hysteresis'"),
    ("fit log.csv --solver hybrd", "did you mean 'hybrid'"),
    ("fit log.csv --loss rejct", "did you mean 'reject'"),
    ("fit log.csv --format cvs", "did you mean 'csv'"),
    *((f"fit log.csv {option} ''", f"{option} must not be empty") for option in ("-o", "--plots", "--model")),
    *((f"info '{name}'", "") for name in (LONG, f"{LONG}.csv", f"{'d' * 100}/" * 3 + "a.csv")),
    *((f"{command} 'a{odd}.csv' log.csv", "") for command in ("evaluate", "info") for odd in "\n\x1b\0"),
    (f"{FIT} -o {LONG}.json", ""),
    (f"{FIT} -o 'a\0.json'", ""),
    # fit, simulate
    (f"{FIT} --delimiter ';'", "leave --delimiter out"),
    (f"{FIT} --holdout 99", "99"),
    (f"{FIT} --holdout 5-3", "2,7,12"),
    (f"{FIT} --holdout 0-56", "leave at least one"),
    *((f"{FIT} --holdout {runs}", "--holdout must be run numbers") for runs in ("1-99999999999", "9" * 5000)),
    (f"{FIT} --noise hall_m", "hall_m=5e-7"),
    (f"{FIT} --noise hull_m=1e-6", "hull_m"),
    (f"{FIT} --column hall_a=HallA", "unit"),
    (f"{FIT} --column hall_a_um=HallA", "HallA"),
    (f"{FIT} -o no/such/folder/calib.json", "folder"),
    ("simulate -o made.csv --seed 1 --step -1", "--step"),
    ("simulate -o made.csv --seed -1", "whole number"),
    ("fit log.csv --machine given.toml", "exclude its start", "[parameters.H1x]\nlower = 0.21\nupper = 0.3"),
    ("fit log.csv --machine given.toml", "H1q", "[parameters.H1q]\nlower = 0.1"),
    ("fit log.csv --machine given.toml", "lowre", "[parameters.H1x]\nlowre = 0.1"),
    ("fit log.csv --machine given.toml", r"\[\[probes\]\]", "probes = 3"),
    ("fit log.csv --machine given.toml", "position_m", "[[probes]]\nchannel = 'hall_a_m'"),
    ("fit log.csv --machine given.toml", "TOML", "not toml"),
    # budget
    *((f"budget BUDGET {more}", "belongs to a calibration")
      for more in ("log.csv", "--noise hall_m=1e-7", "--drop-bad", "--at x_um=1")),
    ("budget BUDGET --curve none.json", "does not exist"),
    ("budget calib.json --curve calib.json", "must be a curve of format"),
    ("budget calib.json --curve curve.json --monte-carlo", "leave --curve out"),
    ("budget calib.json --at x_um", "such as x_um=100"),
    ("budget calib.json --at q_um=1", "known are x_m, y_m, rz_rad, z_m"),
    ("budget calib.json --at z_mm=6", "crosses zero"),
    ("budget calib.json --range x_um=0:1", "--range y_m=LOW:HIGH"),
    ("budget calib.json --range x_um=1:0", "from the lesser to the greater"),
    ("budget calib.json --noise z_ref_m=1e-7", "belongs to no column"),
    ("budget calib.json --drop-bad", "about reading a LOG"),
    ("budget calib.json --monte-carlo 10", "10000 or more"),
    # codegen, tolerances
    *((f"codegen calib.json -o o --range {text}", says) for text, says in (
        ("z_um=5:-5", "lesser to the greater"), ("zz_um=1:2", "Unknown key"), ("z_um=a:b", "such as z_um"),
        ("z=1:2", "unit"), ("z_m=-1e9:1e9", "wider than a machine travels"),
        ("hall_a_m=-1e9:1e9", "wider than a machine travels"))),
    ("tolerances --along x_m --set theta_A_deg=0.1", "state its range"),
    ("tolerances --along x_um=-3:3 --set theta_A_km=1", "must end with a unit"),
    ("tolerances --along x_um=-3:3 --samples 32", "machines that are drawn"),
    ("tolerances --along x_um=-3:3", "needs a cause"),
    ("tolerances --set theta_A_deg=0.1", "give --along"),
    ("tolerances --samples 100", "power of two"),
    # sensitivity, sort
    ("sensitivity", "needs a calibration and its log"),
    ("sensitivity calib.json log.csv --plan", "a log or --plan, not both"),
    ("sensitivity calib.json log.csv --model stage30", "belong to --plan"),
    ("sort bench.csv --sets 4", "--model"),
    ("sort bench.csv --model stage31 --sets 400", "90 were sorted"),
    ("sort bench.csv --model stage31 --values a.json --effect quantisation", "--effect"),
    ("sort bench.csv -o a.txt", ".csv"),
    ("sort bench.csv --field 0,475", "unit"),
    ("sort bench.csv --field 0mT,1mT,2mT", "2 readings a row"),
    ("sort bench.csv --column sensor=Name", "no column 'Name'"),
    # plan
    (PLAN, "did you mean 'levels'", RANGES.replace("levels", "levls")),
    (PLAN, "'range' is missing", RANGES[: RANGES.index("[range]")]),
    (PLAN, "'rx' of .* must end with a unit of 'rx'", RANGES.replace("rx_urad", "rx")),
    (PLAN, "must be .lowest, highest", RANGES.replace("z_um = [-250, 250]", "z_um = [250, -250]")),
    (PLAN, "twice", RANGES + "z_m = [0, 1e-4]\n"),
    (PLAN, "levels", RANGES.replace("levels = 2", "levels = 1")),
    (PLAN, "did you mean 'combined'", RANGES.replace('"combined"', '"combine"')),
    (PLAN, "list", RANGES.replace('["combined"]', '"combined"')),
    (PLAN, "hall_m", RANGES + "[noise]\nhall_m = -1e-7\n"),
    (PLAN, "empty", RANGES + "[[exclude]]\n"),
    (PLAN, "x, y or Rz", RANGES.replace("[-300, 300]", "[0, 0]").replace("[-500, 500]", "[0, 0]")),
    (PLAN, r"\[reference\] z_m", RANGES + "[reference]\nz_um = 1\n"),
    (PLAN, "angle_rad, which stage31 has not", RANGES + "angle_deg = [0, 90]\n"),
    (PLAN, "No admissible setting", RANGES + "[[exclude]]\nz_um = [-300, 300]\n"),
    (f"{PLAN} --runs 2", "at least 4", RANGES),
    (f"{PLAN} --minutes 0.01", "too short for one run", "reset_s = 1\n" + RANGES),
    (f"{PLAN} --like-paper", "either", RANGES),
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(stage, tmp_path_factory):
    """The calibration and log of the stage, its curve, and readings of sensors."""
    where = tmp_path_factory.mktemp("refused")
    for name in ("calib.json", "log.csv", "curve.json"):
        (where / name).symlink_to(stage / name)
    written(where / "bench.csv", bench(n=90, repeats=40)[0])
    return where


@pytest.mark.parametrize("case", SENTENCES, ids=lambda case: case[0][:60].replace("\0", "0"))
def test_it_is_one_sentence(case, folder, refused, monkeypatch, request):
    line, words, *text = case
    monkeypatch.chdir(folder)
    (folder / "given.toml").write_text(text[0] if text else "")
    published = request.config.rootpath / "data" / "micromachines2019" / "table2_budget.toml"
    before = sorted(folder.iterdir())
    said = refused(*(str(published) if word == "BUDGET" else word for word in shlex.split(line)))
    assert re.search(words, said)
    assert sorted(folder.iterdir()) == before
