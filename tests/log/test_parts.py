"""A log in parts: a folder or URL of Parquet files is one log, and a fit of it that of one file."""

import hashlib
import shutil
import tracemalloc

import numpy as np
import pytest
from twins import record

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.estimation import evaluate, fit, summarise
from hallsym.estimation.run_statistics import joined
from hallsym.families import build
from hallsym.log import PartsWriter, read_log, write_log


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Return a recording, as one file and in parts of about 1000 samples, of whole runs."""
    folder = tmp_path_factory.mktemp("parts")
    columns = record(seed=4, samples=60)
    write_log(columns, folder / "whole.parquet")
    with PartsWriter(folder / "dataset", 1000) as writer:
        for run in np.unique(columns["run"]):
            inside = columns["run"] == run
            writer.append({n: v[inside] for n, v in columns.items()})
    return folder


@pytest.fixture
def streamed(monkeypatch):
    """Let no log be small enough to be kept in memory."""
    monkeypatch.setattr("hallsym.log.parts.IN_MEMORY_ROWS", 0)
    monkeypatch.setattr("hallsym.log.format_parquet.IN_MEMORY_ROWS", 0)


NOISE = {"hall_m": 5e-7, "x_ref_m": 1e-6, "y_ref_m": 1.4e-6, "rz_ref_rad": 5e-7, "z_m": 1e-8, "rx_rad": 8e-8,
         "ry_rad": 8e-8}  # fmt: skip


def test_parts_are_whole_runs_and_one_log(dataset):
    whole, parts = read_log(dataset / "whole.parquet"), read_log(dataset / "dataset")
    assert len(list((dataset / "dataset").glob("part-*.parquet"))) == 4
    assert parts.rows == whole.rows
    assert parts.runs == whole.runs
    for column in whole.columns:
        assert np.array_equal(parts.array(column), whole.array(column))


def test_the_digest_of_parts_is_that_of_their_files(dataset):
    folder = dataset / "dataset"
    files = sorted(folder.glob("part-*.parquet"))
    digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    assert read_log(folder).sha256 == hashlib.sha256(" ".join(digests).encode()).hexdigest()


@pytest.mark.usefixtures("streamed")
def test_streamed_parts_give_bitwise_the_run_statistics_of_one_file(dataset):
    model = build("stage31")
    whole = summarise(read_log(dataset / "whole.parquet", noise=NOISE), model)
    parts = summarise(read_log(dataset / "dataset", noise=NOISE), model)
    assert np.array_equal(parts.triangles, whole.triangles)
    each = [
        summarise(read_log(path, noise=NOISE), model, centre=whole.centre)
        for path in sorted((dataset / "dataset").glob("part-*.parquet"))
    ]
    assert np.array_equal(joined(each).triangles, whole.triangles)


def test_fit_and_evaluation_are_those_of_one_file(dataset):
    whole = fit(read_log(dataset / "whole.parquet", noise=NOISE), "stage31", solver="direct")
    parts = fit(read_log(dataset / "dataset", noise=NOISE), "stage31", solver="direct")
    assert parts.values == pytest.approx(whole.values, rel=1e-10, abs=1e-14)
    one, other = (evaluate(whole, dataset / name).table for name in ("whole.parquet", "dataset"))
    assert other.squares == pytest.approx(one.squares, rel=1e-10)


def test_parts_under_a_url(dataset):
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    for path in (dataset / "dataset").glob("*.parquet"):
        memory.pipe(f"/lab/run1/{path.name}", path.read_bytes())
    found = read_log("memory://lab/run1", noise=NOISE)
    assert found.rows == read_log(dataset / "whole.parquet").rows
    assert fit(found, "stage31", solver="direct").status == "converged"
    with pytest.raises(InputError, match="there is none"):
        read_log("memory://lab/nothing")


def test_simulate_writes_parts_and_commands_read_them(tmp_path, capsys):
    out, calib = str(tmp_path / "dataset"), str(tmp_path / "calib.json")
    assert main(["simulate", "--seed", "1", "--step", "0.02", "--part-rows", "800", "-o", out]) == 0
    assert len(list((tmp_path / "dataset").glob("part-*.parquet"))) == 4
    assert main(["fit", out, "--solver", "direct", "-o", calib]) in (0, 3)
    assert main(["evaluate", calib, out]) == 0
    assert main(["sensitivity", calib, out]) in (0, 3)
    capsys.readouterr()
    assert main(["simulate", "--seed", "1", "--step", "0.02", "--part-rows", "800", "-o", out]) == 2
    assert "must be empty" in capsys.readouterr().err


def refused(path, match: str) -> None:
    with pytest.raises(InputError, match=match) as error:
        read_log(path)
    assert len(str(error.value)) <= 300


def test_a_missing_or_odd_part_is_one_sentence(dataset, tmp_path):
    names = [f"part-{k:05d}.parquet" for k in range(4)]

    def copied(*left_out: str):
        folder = tmp_path / "-".join(left_out or ("all",))
        shutil.copytree(dataset / "dataset", folder)
        for name in left_out:
            (folder / name).unlink()
        return folder

    refused(copied(names[1]), "Part 1 of .* is missing")
    refused(copied(names[3]), "must have 4 parts")
    odd = copied()
    columns = {n: v for n, v in record(seed=1, samples=5).items() if n != "hall_c_m"}
    write_log({**columns, "run": columns["run"] + 900}, odd / names[2])
    refused(odd, "part-00002.parquet has no hall_c_m")
    (odd / names[2]).write_bytes(b"PAR1")
    refused(odd, "complete Parquet file")


@pytest.mark.slow
def test_five_million_samples_in_parts_are_fitted_in_bounded_memory(tmp_path):
    """The same numbers as the single pass to 1e-10; Python holds less than 64 MB at any time."""
    out, one = str(tmp_path / "dataset"), str(tmp_path / "one.parquet")
    words = ["simulate", "--seed", "1", "--step", "1e-5", "--duration", "0.9"]
    assert main([*words, "--part-rows", "1000000", "-o", out]) == 0
    assert main([*words, "-o", one]) == 0
    whole = fit(read_log(one, noise=NOISE), "stage31", solver="direct", loss="none")
    tracemalloc.start()
    parts = fit(read_log(out, noise=NOISE), "stage31", solver="direct", loss="none")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert parts.log["rows"] == 57 * 90_000
    assert parts.values == pytest.approx(whole.values, rel=1e-10, abs=1e-14)
    assert peak < 64e6
