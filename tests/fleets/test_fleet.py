"""Fleets: every device has its row, broken ones their reason, a stopped fleet goes on, workers may die."""

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
from fleet_work import TAU, ends_once, recorded, square, truths, write_fleet

import hallsym
from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.families.machine_file import Machine, read_machine
from hallsym.fleets import Failed, completed, devices_of, load_fleet
from hallsym.fleets.fleet import Journal, journal_of
from hallsym.fleets.row import Settings
from hallsym.log import write_log

ROOT = Path(__file__).resolve().parents[2]
COUNT = 24


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """Return a folder of 24 devices, five of them broken in five ways, and their fleet."""
    folder = tmp_path_factory.mktemp("fleet") / "logs"
    known = write_fleet(folder, COUNT)
    far = recorded(known[3] | {"Ax": known[3]["Ax"] + 0.2}, 3)
    write_log(far, folder / "dev3.parquet")
    (folder / "dev7.parquet").write_bytes(b"PAR1 cut short")
    columns = recorded(known[11], 11)
    write_log({n: v for n, v in columns.items() if n != "v_cos_v"}, folder / "dev11.parquet")
    bent = recorded(known[15], 15)
    bent["v_sin_v"] += 0.05 * np.sin(3 * bent["angle_ref_rad"])
    write_log(bent, folder / "dev15.parquet")
    dead = recorded(known[19], 19)
    dead["v_sin_v"][:] = 0.5
    write_log(dead, folder / "dev19.parquet")
    table = folder.parent / "fleet.parquet"
    found = hallsym.fleet(folder, "rotary", output=table, workers=2)
    return folder, known, found, table


# -- rows --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_device_has_its_row_and_broken_ones_say_why(broken):
    _, known, found, _ = broken
    assert found.devices == tuple(f"dev{k}" for k in range(COUNT))
    rows = {row["device"]: row for row in found.rows}
    assert {d for d, row in rows.items() if row["verdict"] == "failed"} == {"dev7", "dev11"}
    assert {rows[d]["verdict"] for d in ("dev15", "dev19")} == {"not described"}
    for device, word in (
        ("dev7", "Parquet"),
        ("dev11", "v_cos_v"),
        ("dev15", "noise floor"),
        ("dev19", "v_sin_v"),
    ):
        assert word in rows[device]["reason"]
        assert len(rows[device]["reason"]) <= 300
    assert set(found.outlying) == {"dev3", "dev7", "dev11", "dev15", "dev19"}
    assert "Ax is" in found.outlying["dev3"]
    for k, truth in enumerate(known):
        if rows[f"dev{k}"]["verdict"] == "good" and k != 3:
            for name in TAU:
                std = rows[f"dev{k}"][f"std:{name}"]
                assert rows[f"dev{k}"][f"value:{name}"] == pytest.approx(truth[name], abs=5 * std)


@pytest.mark.slow
def test_a_row_is_that_of_a_fit(broken):
    folder, _, found, _ = broken
    alone = hallsym.fit(folder / "dev0.parquet", "rotary", solver="direct")
    row = found.rows[0]
    for k, name in enumerate(alone.model.names):
        assert row[f"value:{name}"] == pytest.approx(alone.values[k], abs=1e-4 * alone.std[k])
        assert row[f"std:{name}"] == pytest.approx(alone.std[k], rel=1e-5)


@pytest.mark.slow
def test_the_spread_of_the_good_ones(broken):
    _, known, found, _ = broken
    spread = {s.name: s for s in found.spreads}
    for name in TAU:
        good = [t[name] for k, t in enumerate(known) if k not in (3, 7, 11, 15, 19)]
        # the uncertainties of fits are a tenth of TAU or less, so the truths' own spread is seen to 1 %
        assert spread[name].typical_std < 0.1 * TAU[name]
        assert spread[name].std == pytest.approx(np.std(good, ddof=1), rel=0.05)
    held = [spread[name].interval[0] <= tau <= spread[name].interval[1] for name, tau in TAU.items()]
    assert sum(held) >= 4  # of five intervals of 95 %


@pytest.mark.slow
def test_table_page_and_files_for_the_next_batch(broken, tmp_path, capsys):
    folder, known, found, table = broken
    again = load_fleet(table)
    assert again.devices == found.devices
    assert [s.std for s in again.spreads] == [s.std for s in found.spreads]
    assert not journal_of(table).exists()
    files = [tmp_path / name for name in ("page.html", "next.toml", "tolerances.toml", "fleet.csv")]
    code = main([
        "fleet", *(str(folder / f"dev{k}.parquet") for k in range(10)), "--model", "rotary",
        "--workers", "1", "-o", str(files[3]), "--page", str(files[0]), "--next-machine", str(files[1]),
        "--tolerances", str(files[2]),
    ])  # fmt: skip
    assert code == 3
    text = capsys.readouterr().out
    assert re.search(r"failed +1\b", text)
    assert re.search(r"dev7 +\S", text)
    assert "spread (1 sigma)" in text
    page = files[0].read_text()
    assert page.count("<svg") == 2 * len(load_fleet(files[3]).spreads)
    assert "src=" not in page
    assert "<link" not in page
    machine = read_machine(files[1])
    truth = truths(200, seed=1)
    for name in TAU:
        bounds = machine.parameters[name]
        assert all(bounds["lower"] < t[name] < bounds["upper"] for t in truth)
        assert bounds["nominal"] == pytest.approx(known[0][name], abs=6 * TAU[name])
    assert len(hallsym.read_tolerances(files[2], hallsym.build("rotary"))) == 6
    assert [row["verdict"] for row in load_fleet(files[3]).rows].count("good") == 9


@pytest.mark.slow
def test_a_table_of_logs_carries_names_and_covariates(broken, tmp_path):
    folder, *_ = broken
    table = tmp_path / "devices.csv"
    lines = [f"{folder}/dev{k}.parquet,S-{k},{20.0 + k},{'AB'[k % 2]}" for k in (0, 1)]
    table.write_text("\n".join(["log,device,oven_degc,supplier", *lines]))
    found = hallsym.fleet(table, "rotary", workers=1)
    assert found.devices == ("S-0", "S-1")
    assert found.covariates == ("oven_degc", "supplier")
    assert found.rows[1]["supplier"] == "B"


@pytest.mark.slow
def test_devices_are_diagnosed_and_grouped_by_causes(tmp_path):
    """Two encoders whose field is curved where the magnet is off its axis, and one that is in order."""
    known = truths(3)
    for k, truth in enumerate(known):
        columns = recorded(truth, k, runs=8, samples=250)
        if k > 0:
            columns["v_sin_v"] += 0.01 * np.sin(3 * columns["angle_ref_rad"])
            columns["v_cos_v"] += 0.01 * np.cos(3 * columns["angle_ref_rad"])
        write_log(columns, tmp_path / f"dev{k}.parquet")
    found = hallsym.fleet(tmp_path, "rotary", diagnose=True, workers=1)
    assert [row["verdict"] for row in found.rows] == ["good", "not described", "not described"]
    assert [row["diagnosis"] for row in found.rows] == ["no gap", "explained", "explained"]
    assert found.groups == {"explained: eccentricity": ("dev1", "dev2")}
    assert "With eccentricity it falls" in found.outlying["dev1"]
    text = found.rows[1]["diagnosis_reason"]
    assert "With eccentricity it falls" in text
    mended = hallsym.fleet(tmp_path, "rotary", effects=["eccentricity:form=curved"], diagnose=True, workers=1)
    assert mended.verdicts == {"good": ("dev0", "dev1", "dev2")}
    assert {row["diagnosis"] for row in mended.rows} == {"no gap"}


@pytest.mark.slow
def test_numbers_of_an_effect_that_are_left_open_are_those_of_each_log(tmp_path):
    known = truths(2)
    for k, truth in enumerate(known):
        columns = recorded(truth, k, runs=8, samples=250)
        columns["v_sin_v"] += 0.01 * np.sin(2 * np.pi * (50.0 + 10.0 * k) * columns["t_s"])
        columns["v_cos_v"] += 0.01 * np.sin(2 * np.pi * (50.0 + 10.0 * k) * columns["t_s"])
        write_log(columns, tmp_path / f"dev{k}.parquet")
    found = hallsym.fleet(tmp_path, "rotary", effects=["mains_hum"], workers=1)
    assert [row["verdict"] for row in found.rows] == ["good", "good"]
    assert {row["effects"] for row in found.rows} == {"mains_hum"}


@pytest.mark.slow
def test_a_parameter_at_its_bound_is_named(tmp_path):
    """Others make up for it, so that its device says nothing of how devices differ."""
    write_log(recorded(truths(1)[0] | {"beta": 0.02}, 0), tmp_path / "dev0.parquet")
    found = hallsym.fleet(
        tmp_path, "rotary", machine=Machine(None, {"beta": {"lower": -0.01, "upper": 0.0199}}), workers=1
    )
    assert found.rows[0]["verdict"] == "not described"
    assert found.rows[0]["reason"].startswith("beta ends at its bound, 0.0199")


# -- stopped and resumed -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_fleet_that_was_killed_goes_on_without_loss(tmp_path):
    folder, table = tmp_path / "logs", tmp_path / "fleet.parquet"
    write_fleet(folder, 10)
    words = [sys.executable, "-m", "hallsym", "fleet", str(folder), "--model", "rotary", "-o", str(table),
             "--workers", "1"]  # fmt: skip
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL, start_new_session=True)
    journal, deadline = journal_of(table), time.monotonic() + 120
    while not (journal.exists() and len(journal.read_text().splitlines()) > 4):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    with open(journal, "a") as stream:
        stream.write('{"stamp": "cut sh')
    done = [json.loads(line.partition(" ")[2]) for line in journal.read_text().splitlines()[:-1] if line]
    assert 3 < len(done) < 10
    said: list[str] = []
    found = hallsym.fleet(folder, "rotary", output=table, workers=1, on_progress=said.append)
    assert len(found.rows) == 10
    assert {row["verdict"] for row in found.rows} == {"good"}
    kept = {entry["row"]["seconds"] for entry in done}
    assert kept <= {row["seconds"] for row in found.rows}
    assert len(said) == 10 - len(done)
    assert said[-1] == "devices, 10 of 10"


def test_rows_of_other_options_are_not_gone_on_with(tmp_path):
    log = write_fleet(tmp_path / "logs", 1) and tmp_path / "logs" / "dev0.parquet"
    device, path = devices_of(log)[0], tmp_path / "fleet.journal"
    with Journal(path, Settings("rotary")) as journal:
        journal.add(device, {"verdict": "good"})
    assert Journal(path, Settings("rotary")).done(device) == {"verdict": "good"}
    assert Journal(path, Settings("rotary", diagnose=True)).done(device) is None
    os.utime(log, (0, 0))
    assert Journal(path, Settings("rotary")).done(device) is None


# -- workers -----------------------------------------------------------------------------------------------


def test_work_comes_back_and_what_raises_is_named():
    found = dict(completed(square, range(10, 16), workers=2))
    assert found.pop(13) == Failed("ValueError: thirteen")
    assert found == {n: n**2 for n in (10, 11, 12, 14, 15)}


@pytest.mark.slow
def test_a_process_that_ends_leaves_the_others_and_is_named_when_it_ends_alone(tmp_path):
    work = [(n, str(tmp_path)) for n in (7, *range(7), *range(8, 12))]
    found = {one[0]: result for one, result in completed(ends_once, work, workers=2)}
    assert isinstance(found.pop(5), Failed)
    assert found == {n: n for n in range(12) if n != 5}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_dask_scheduler_loses_a_worker_and_gives_the_same_table(tmp_path):
    distributed = pytest.importorskip("distributed")
    folder = tmp_path / "logs"
    write_fleet(folder, 16)
    port = free_port()
    address, env = f"tcp://127.0.0.1:{port}", {**os.environ, "PYTHONPATH": str(ROOT)}
    start = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", str(port), "--no-dashboard",
             "--host", "127.0.0.1"]  # fmt: skip
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1",
              "--no-dashboard", "--no-nanny", "--host", "127.0.0.1"]  # fmt: skip
    running = [subprocess.Popen(start, cwd=tmp_path, env=env, stderr=subprocess.DEVNULL)]
    try:
        running += [
            subprocess.Popen(worker, cwd=tmp_path, env=env, stderr=subprocess.DEVNULL) for _ in range(2)
        ]
        with distributed.Client(address, timeout=60) as client:
            client.wait_for_workers(2, timeout=120)
        seen: list[str] = []

        def kill_one(said: str) -> None:
            seen.append(said)
            if len(seen) == 5:
                running[1].kill()

        cluster = hallsym.fleet(folder, "rotary", scheduler=address, on_progress=kill_one)
    finally:
        for process in reversed(running):
            process.kill()
            process.wait()
    local = hallsym.fleet(folder, "rotary", workers=2)
    assert len(seen) == 16
    for one, other in zip(cluster.rows, local.rows, strict=True):
        assert {**one, "seconds": 0} == {**other, "seconds": 0}


def free_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


# -- sentences ---------------------------------------------------------------------------------------------


def refused(match: str, sources, **options) -> None:
    with pytest.raises(InputError, match=match):
        hallsym.fleet(sources, workers=1, **options)


def test_what_is_not_there_or_twice_is_one_sentence(tmp_path):
    refused("No log is called", tmp_path / "nothing.csv")
    refused("holds none", tmp_path)
    folder = tmp_path / "logs"
    write_fleet(folder, 1)
    refused("needs logs", [])
    refused("Two devices are called 'dev0'", [folder / "dev0.parquet", folder / "dev0.parquet"])
    refused("did you mean .rotary.", folder, model="rotarry")
    table = tmp_path / "t.csv"
    table.write_text("log,device\n,A\n")
    refused("Row 1", table)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_that_does_not_answer_is_one_sentence(broken, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("hallsym.fleets.workers.ANSWERS", 0.3)
    folder, *_ = broken
    for address in (f"tcp://127.0.0.1:{free_port()}", "no address"):
        with pytest.raises(InputError, match="does not answer"):
            hallsym.fleet(folder, "rotary", scheduler=address)


@pytest.mark.slow
def test_a_log_of_another_model_is_a_row_that_says_so(broken, tmp_path):
    folder, *_ = broken
    other = tmp_path / "odd"
    other.mkdir()
    (other / "log.parquet").write_bytes((folder / "dev2.parquet").read_bytes())
    (other / "meta.json").write_text('{"base_model": "rotary_meng"}')
    found = hallsym.fleet([folder / "dev0.parquet", folder / "dev1.parquet", other], workers=1)
    assert found.model.name == "rotary"
    assert found.outlying == {"odd": "Its model is rotary_meng, not rotary."}
    assert found.good.tolist() == [True, True, False]
    assert found.spreads == ()  # of two devices


def test_devices_are_in_the_order_of_their_numbers(tmp_path):
    for k in (10, 9, 1):
        (tmp_path / f"dev{k}.csv").write_text("x")
    assert [d.name for d in devices_of(tmp_path)] == ["dev1", "dev9", "dev10"]
