"""Files, names and sizes that broke a command once: each ends in one sentence, or in what it says."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from twins import bundled

import hallsym
from hallsym.cli.main import main

CAMPAIGN = "[[run]]\nduration_s = 1\nx_m = 1e-6\n"
AXES = '[[trajectory]]\nduration_s = 1\nx_m = { kind = "sine", amplitude = 1e-4, frequency_hz = 1 }\n'


SETTINGS = "".join(f"[[setting]]\nz_m = {k}e-9\n" for k in range(20000))


def columns():
    return bundled(slice(0, 12, 2))


@pytest.fixture
def log(tmp_path):
    hallsym.write_log(columns(), tmp_path / "log.csv")
    return tmp_path / "log.csv"


# -- values ----------------------------------------------------------------------------------------------


def test_a_column_without_a_number_is_shown_without_extent(run, tmp_path):
    found = columns()
    found["z_m"] = np.full(len(found["run"]), np.nan)
    hallsym.write_log(found, tmp_path / "log.csv")
    record = json.loads(run("info", tmp_path / "log.csv", "--json")[1])
    assert record["columns"]["z_m"]["min"] is None
    assert record["columns"]["hall_a_m"]["min"] < 0
    assert any("z_m" in note for note in record["notes"])


@pytest.mark.filterwarnings("ignore")
def test_a_time_of_1e308(run, tmp_path):
    found = columns()
    found["t_s"] = found["t_s"].copy()
    found["t_s"][-1] = 1e308
    hallsym.write_log(found, tmp_path / "log.csv")
    for words, code in ((("info",), 0), (("fit", "--solver", "direct"), 3)):
        seen, out, _ = run(*words, tmp_path / "log.csv")
        assert seen == code
        assert "a step of 1e+308 s" in out


@pytest.mark.parametrize("ids", [2**53, 0.5, np.nan])
def test_run_numbers_that_are_none(refused, tmp_path, ids):
    found, arrow = columns(), pytest.importorskip("pyarrow")
    found["run"] = found["run"].astype("u8") + np.uint64(ids) if ids > 1 else found["run"] + ids
    pytest.importorskip("pyarrow.parquet").write_table(arrow.table(found), tmp_path / "log.parquet")
    assert "whole run numbers up to 2^53" in refused("info", tmp_path / "log.parquet")


def test_booleans_are_no_readings(refused, tmp_path):
    from scipy.io import savemat

    found = columns()
    savemat(tmp_path / "log.mat", found | {"hall_a_m": found["hall_a_m"] > 0})
    assert re.search("hall_a_m.*bool", refused("fit", tmp_path / "log.mat"))


# -- HDF5 ------------------------------------------------------------------------------------------------


def grouped(path, short=0):
    h5py, found = pytest.importorskip("h5py"), columns()
    with h5py.File(path, "w") as file:
        for k, run in enumerate(np.unique(found["run"])):
            for name, values in found.items():
                part = values[found["run"] == run]
                if name != "run":
                    file[f"run_{run}/{name}"] = part[: len(part) - short * (name == "z_m") * (k == 1)]


def test_a_run_group_whose_columns_are_not_equally_long_is_refused(refused, tmp_path):
    grouped(tmp_path / "log.h5")
    assert main(["info", str(tmp_path / "log.h5")]) == 0
    grouped(tmp_path / "log.h5", short=7)
    assert "must be equally long; they have" in refused("info", tmp_path / "log.h5")


def test_soft_links_are_followed_and_others_are_named(run, tmp_path):
    h5py, path = pytest.importorskip("h5py"), tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        for k, (name, values) in enumerate(columns().items()):
            file[f"raw/channel{k}"] = values
            file[name] = h5py.SoftLink(f"/raw/channel{k}")
        file["again"] = h5py.SoftLink("/")
        file["raw/again"] = file["raw"]
        file["temperature_degc"] = h5py.SoftLink("/nowhere")
    record = json.loads(run("info", path, "--json")[1])
    assert record["rows"] == len(columns()["run"])
    assert len(record["runs"]) == 6
    assert "Column temperature_degc is left out: it is a link to nothing." in record["notes"]


@pytest.mark.parametrize("chunks", [(65536,), None])
def test_1e10_rows_that_were_never_written(refused, tmp_path, chunks):
    with pytest.importorskip("h5py").File(tmp_path / "log.h5", "w") as file:
        for name in columns():
            file.create_dataset(name, shape=(10**10,), chunks=chunks, dtype="f8")
    refused("info", tmp_path / "log.h5")


def test_a_sparse_text_file(refused, tmp_path):
    with open(tmp_path / "log.csv", "wb") as stream:
        stream.write(b"run,t_s,hall_a_m\n1,0,1e-6\n")
        stream.truncate(10**10)
    if os.stat(tmp_path / "log.csv").st_blocks > 1000:
        pytest.skip("this file system has no sparse files")
    assert "in lines of at most" in refused("info", tmp_path / "log.csv")


# -- names -----------------------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_a_pipe_is_not_waited_for(refused, log, tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    for arguments in (
        ["info", "PIPE"], ["evaluate", "PIPE", log], ["fit", log, "--machine", "PIPE"],
        ["trajectory", "PIPE"],
        ["fit", log, "--column", "PIPE"], ["fit", log, "--effects", "PIPE", "--effect", "mine"],
    ):  # fmt: skip
        words = [tmp_path / "pipe.csv" if a == "PIPE" else a for a in arguments]
        assert "is a pipe or a device" in refused(*words)


# -- campaigns and other TOML ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"step_s = 1e-12\n{CAMPAIGN}", "Samples .* at most 2e\\+07 .* received 1000000000000"),
        (CAMPAIGN.replace("= 1\n", "= 1e30\n"), "Samples .* at most 2e\\+07"),
        (SETTINGS + AXES, "Runs .* at most 10000 .* received 20000"),
        (f"step_s = {'1' * 400}\n{CAMPAIGN}", "'step_s' of .* must be a positive number"),
        (f"step_s = {'[' * 5000}{']' * 5000}\n", "nested too deeply"),
    ],
)  # fmt: skip
def test_campaigns_that_cannot_be(refused, tmp_path, text, words):
    (tmp_path / "c.toml").write_text(text)
    for arguments in (
        ["info"],
        ["sensitivity", "--plan"],
        ["simulate", "--seed", "1", "-o", tmp_path / "o.csv"],
    ):
        assert re.search(words, refused(*arguments, tmp_path / "c.toml"))


def probes(position):
    """Three probes, the first of which stands at `position`."""
    rows = zip("abc", (position, [-0.2, 0.4], [0.2, 0.36]), ([0, 1], [0, 1], [1, 0]), strict=True)
    return {"probes": [{"channel": f"hall_{k}_m", "position_m": at, "senses": s} for k, at, s in rows]}


@pytest.mark.parametrize(
    ("meta", "words"),
    [
        *((probes(at), "") for at in ([197.5, 0.4], [True, 0.4], "12", [0.2], [float("nan"), 0.2])),
        ({"noise_1sigma": {"hal_m": 1e-7}}, "did you mean 'hall_m'"),
        ({"validaton_runs": [1]}, "did you mean 'validation_runs'"),
    ],
)
def test_what_a_meta_file_cannot_say(refused, log, tmp_path, meta, words):
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    assert words in refused("fit", tmp_path)


# -- outputs ---------------------------------------------------------------------------------------------


def test_an_output_that_is_an_input_is_refused_under_every_name(run, refused, log, tmp_path):
    before, calib, machine = log.read_bytes(), tmp_path / "calib.json", tmp_path / "m.toml"
    assert run("fit", log, "--solver", "direct", "-o", calib)[0] in (0, 3)
    machine.write_text("[parameters.eta_A]\nnominal = 0.9\n")
    (tmp_path / "soft.json").symlink_to(log)
    os.link(log, tmp_path / "hard.json")
    for arguments in (
        *(["fit", log, "-o", tmp_path / name]
          for name in (log, "soft.json", "hard.json", f"../{tmp_path.name}/log.csv")),
        ["report", calib, log, "-o", calib], ["report", calib, log, "-o", log],
        ["simulate", "--seed", "1", "--values", calib, "-o", calib],
        ["fit", log, "--machine", machine, "-o", machine],
        ["sensitivity", calib, log, "-o", log], ["diagnose", log, "-o", log],
    ):  # fmt: skip
        assert "which would be lost" in refused(*arguments)
    assert log.read_bytes() == before


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("arguments", [["--version"], ["info"], ["info", "LOG", "--json"], ["--help"]])
def test_a_full_standard_output(log, arguments):
    with open("/dev/full", "w", encoding="utf-8") as full:
        words = [sys.executable, "-m", "hallsym", *(str(log) if a == "LOG" else a for a in arguments)]
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r"hallsym: Cannot .*standard output: the disk is full.*\n", done.stderr), done.stderr


READY = """
import sys
import hallsym.cli.program as command
sys.argv = ["hallsym", "fit", sys.argv[1]]
print("ready", flush=True)
sys.exit(command.program())
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_while_libraries_are_loaded_is_one_sentence(log):
    words = [sys.executable, "-c", READY, str(log)]
    child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.05)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=60)
    assert "Traceback" not in said, said
    assert said.count("\n") <= 1


def test_a_mistake_of_ours_is_not_called_bad_input(run, log, monkeypatch):
    import hallsym.cli.info

    monkeypatch.setattr(hallsym.cli.info, "_about_log", lambda *_: {}["x_m"])
    code, _, said = run("info", log)
    assert (code, said.count("\n")) == (70, 1)
    assert said.startswith("hallsym: This is a mistake in hallsym, not in your input: KeyError")
    monkeypatch.setenv("HALLSYM_DEBUG", "1")
    assert "Traceback" in run("info", log)[2]
