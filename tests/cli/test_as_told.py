"""What a message tells a user to do, done as it is told."""

import shlex

import numpy as np
import pytest

import hallsym
from hallsym.cli import BAD_INPUT, NOT_DESCRIBED, OK
from hallsym.cli.main import main

NAMES = "Zeit [ms];Sonde A [mm];Sonde B [mm];Sonde C [mm];Höhe [mm];Rx [mrad];Ry [mrad];X Laser [mm]"
NAMES += ";Y Laser [mm];Rz Laser [mrad]"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A file a run, decimal commas, probe C inverted in one of eight runs."""
    folder, rng = tmp_path_factory.mktemp("bench") / "runs", np.random.default_rng(5)
    folder.mkdir()
    t = np.arange(100) * 0.01
    for run in range(1, 9):
        x, y, rz = (
            a * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for a, f in ((0.8, 2), (0.7, 3), (1.5, 5))
        )
        rest = [0.1 * np.sin(2 * np.pi * t) + rng.uniform(-1, 1) for _ in range(3)]
        probes = [0.9 * (y + 0.1975 * rz), 0.8 * (y - 0.1975 * rz), 0.85 * (x - 0.36 * rz)]
        probes[2] = -probes[2] if run == 7 else probes[2]
        noisy = [[*probes, x, y, rz][k] + 1e-3 * rng.standard_normal(len(t)) for k in range(6)]
        rows = np.transpose([1e3 * t, *noisy[:3], *rest, *noisy[3:]])
        text = "\n".join(";".join(f"{v:.6f}" for v in row) for row in rows).replace(".", ",")
        (folder / f"lauf_{run}.csv").write_text(f"{NAMES}\n{text}\n", encoding="utf-8")
    return folder


@pytest.mark.slow
def test_a_bad_run_is_undone_in_every_command_by_the_words_of_the_claim(runs, capsys, monkeypatch):
    monkeypatch.chdir(runs.parent)
    assert main(["info", "runs", "--write"]) == OK
    assert "remove the #" not in capsys.readouterr().out  # no unit is open
    fit = "fit runs --model stage30 --column columns.toml --solver direct -o c.json"
    assert main(shlex.split(fit)) == NOT_DESCRIBED
    told = next(line for line in capsys.readouterr().out.split("\n") if "; next: " in line)
    words = shlex.split(told.partition("; next: hallsym ")[2])
    assert words[-2:] == ["--correct", "sign hall_c_m in 7"]
    assert main(words) == OK
    assert "stage30 on runs: " in capsys.readouterr().out
    assert main(["evaluate", "c.json", "runs"]) != OK
    assert main(["evaluate", "c.json", "runs", *words[-2:]]) == OK
    assert main(["report", "c.json", "runs", *words[-2:]]) == OK


def test_a_column_file_that_somebody_corrected_is_not_replaced(runs, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for code in (OK, OK):  # the same text again is no loss
        assert main(["info", str(runs), "--write"]) == code
    corrected = (tmp_path / "columns.toml").read_text() + "# mine\n"
    (tmp_path / "columns.toml").write_text(corrected)
    capsys.readouterr()
    assert main(["info", str(runs), "--write"]) == BAD_INPUT
    assert "columns.toml exists" in capsys.readouterr().err
    assert (tmp_path / "columns.toml").read_text() == corrected


def test_a_machine_says_which_probes_are_looked_for(runs, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    places = (("d", [0.1, 0.0], [0, 1]), ("e", [-0.1, 0.0], [0, 1]), ("f", [0.1, -0.1], [1, 0]))
    form = '[[probes]]\nchannel = "hall_{}_m"\nposition_m = {}\nsenses = {}\n'
    (tmp_path / "m.toml").write_text("".join(form.format(*place) for place in places))
    assert main(["info", str(runs), "--machine", "m.toml", "--write"]) == OK
    assert 'hall_d_mm = "Sonde A"' in (tmp_path / "columns.toml").read_text()


def test_a_unit_beside_that_of_the_files_of_runs_is_said(runs):
    log = hallsym.read_log(runs, columns={"hall_a_m": "Sonde A"})
    assert "Column 'Sonde A' is read in m as stated; its header says mm." in log.notes


@pytest.mark.parametrize(
    ("given", "said"),
    [({"holdout": 2}, "a list of runs"), ({"holdout": "2"}, "a list of runs"), ({"seed": -1}, "0 or more"),
     ({"effects": "time_skw"}, "'time_skw'"), ({"corrections": "sine x_m"}, "'sine x_m'")],
)  # fmt: skip
def test_an_argument_of_another_kind_is_named(given, said):
    with pytest.raises(hallsym.InputError, match=said):
        hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct", **given)


def test_two_files_have_the_clock_for_which_their_columns_were_named(capsys, monkeypatch, tmp_path):
    """A name without its unit, as people write it, must not change whose samples are the rows."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(300) * 2e-3
    ends = [[f"{1e3 * u:.0f},{np.sin(9 * u):.6f},{np.cos(9 * u):.6f}" for u in t[::2]],
            [f"{u:.6f}\t{np.degrees(9 * u):.6f}" for u in t]]  # fmt: skip
    for name, head, rows in zip("ab", ("time_ms,u1_mV,u2_mV", "Time [s]\tAngle [deg]"), ends, strict=True):
        (tmp_path / f"{name}.txt").write_text("\n".join([head, *rows, ""]))
    assert main(["info", "a.txt", "--join", "b.txt", "--write"]) == OK
    words = shlex.split(capsys.readouterr().out.partition("next: hallsym ")[2])
    draft = (tmp_path / "columns.toml").read_text().replace("u1_mV", "u1").replace("u2_mV", "u2")
    (tmp_path / "columns.toml").write_text(draft)
    assert main([*words, "--solver", "direct"]) != BAD_INPUT


def test_a_column_that_is_missed_is_said_to_hold_words(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    rows = [f"{k},{np.sin(0.1 * k):.6f},{np.cos(0.1 * k):.6f},{0.1 * k:.6f}" for k in range(200)]
    rows[70] = "70,OVLD,0.75,7.0"
    (tmp_path / "log.csv").write_text("\n".join(["t_ms,Sin [V],Cos [V],Angle [rad]", *rows, ""]))
    assert main(["info", "log.csv", "--model", "rotary", "--write"]) == OK
    said = " ".join(capsys.readouterr().out.split())
    assert "no column is like v_sin_v; name theirs in columns.toml" in said
    assert "Line 72, column 'Sin' of log.csv must be a number; it is 'OVLD'" in said
