"""Passes over a log in parts that workers make: the numbers of one pass, bit by bit, in bounded memory."""

import importlib.util
import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from twins import record

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.estimation import evaluate, fit, summarise
from hallsym.families import build
from hallsym.log import PartsWriter, read_log, write_log
from hallsym.workers import Done, Workers

NOISE = {"hall_m": 5e-7, "x_ref_m": 1e-6, "y_ref_m": 1.4e-6, "rz_ref_rad": 5e-7, "z_m": 1e-8, "rx_rad": 8e-8,
         "ry_rad": 8e-8}  # fmt: skip
BENCHMARK = Path(__file__).parents[1] / "benchmarks" / "bench_parts.py"


def written(folder: Path, columns: dict[str, np.ndarray], rows: int = 1000) -> Path:
    with PartsWriter(folder, rows) as writer:
        for run in np.unique(columns["run"]):
            inside = columns["run"] == run
            writer.append({n: v[inside] for n, v in columns.items()})
    return folder


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Return a stage's recording in four parts."""
    return written(tmp_path_factory.mktemp("shared") / "dataset", record(seed=4, samples=60))


@pytest.fixture
def sent(monkeypatch) -> list[int]:
    """Do work here, as processes would: it is pickled on its way; return the parts in the order of work."""
    numbers: list[int] = []

    def completed(call, work, *, workers, scheduler) -> Iterator[Done]:
        assert (workers, scheduler) == (2, None)
        for one in reversed(list(work)):  # results come in any order
            numbers.append(one.number)
            yield Done(one, pickle.loads(pickle.dumps(call))(pickle.loads(pickle.dumps(one))))

    monkeypatch.setattr("hallsym.estimation.parts.completed", completed)
    return numbers


def test_a_fit_by_workers_is_bitwise_that_of_one_pass(dataset, sent):
    one = fit(read_log(dataset, noise=NOISE), "stage31", solver="direct")
    assert sent == []
    two = fit(read_log(dataset, noise=NOISE, workers=Workers(2)), "stage31", solver="direct")
    assert sent == 2 * [3, 2, 1, 0]  # run statistics, error tables
    assert np.array_equal(two.values, one.values)
    assert np.array_equal(two.covariance, one.covariance)
    assert two.error_rows == one.error_rows
    assert two.zeros.keys() == one.zeros.keys()
    first, other = (evaluate(one, read_log(dataset, workers=w)) for w in (None, Workers(2)))
    assert np.array_equal(first.table.squares, other.table.squares)
    assert first.table.span == other.table.span
    assert len(sent) > 12


@pytest.mark.usefixtures("sent")
def test_what_is_left_out_of_a_log_is_left_out_of_its_parts(tmp_path):
    """Samples that are not finite, a run whose reading is dead, and rows of a frozen stretch."""
    columns = record(seed=5, samples=60)
    columns["hall_b_m"][[7, 1203, 3000]] = np.nan
    columns["hall_a_m"][columns["run"] == np.unique(columns["run"])[30]] = 0.0
    folder, model = written(tmp_path / "dataset", columns), build("stage31")
    one, two = (
        summarise(read_log(folder, noise=NOISE, drop_bad=True, workers=w), model) for w in (None, Workers(2))
    )
    assert one.counts.sum() == len(columns["run"]) - 63
    for name in ("triangles", "slopes", "counts", "first_state", "mean_state"):
        assert np.array_equal(getattr(one, name), getattr(two, name)), name


@pytest.mark.usefixtures("sent")
def test_changed_bounds_and_effects_go_with_the_model(dataset):
    asked = {
        "effects": ["cross_axis_sensitivity"],
        "parameters": {"H1x": {"nominal": 0.12}},
        "solver": "direct",
    }
    one, two = (
        fit(read_log(dataset, noise=NOISE, workers=w), "stage30", **asked) for w in (None, Workers(2))
    )
    assert np.array_equal(two.values, one.values)


def refused(match: str, call) -> None:
    with pytest.raises(InputError, match=match) as error:
        call()
    assert len(str(error.value)) <= 300


@pytest.mark.usefixtures("sent")
def test_what_cannot_be_shared_out_is_one_sentence(dataset, tmp_path):
    columns = record(seed=4, samples=60)
    write_log(columns, tmp_path / "one.parquet")
    refused("share a log in parts", lambda: read_log(tmp_path / "one.parquet", workers=Workers(2)))
    refused("must be 1 or more", lambda: Workers(0))
    cut = tmp_path / "cut"
    cut.mkdir()
    half = len(columns["run"]) // 2 + 10
    for k, part in enumerate((slice(0, half), slice(half, None))):
        write_log({n: v[part] for n, v in columns.items()}, cut / f"part-{k}.parquet")
    log = read_log(cut, noise=NOISE, workers=Workers(2))
    refused("stands in parts 1 and 2", lambda: fit(log, "stage31", solver="direct"))

    def mine(model):
        return model.with_step("electronics", lambda signals, values: None, effect="mine")

    log = read_log(dataset, noise=NOISE, workers=Workers(2))
    with_own = build("stage31", own={"mine": mine}, added=("mine",))
    refused("not hallsym's own", lambda: summarise(log, with_own))


@pytest.mark.slow
def test_commands_share_a_log_out(dataset, tmp_path, capsys):
    calib = str(tmp_path / "calib.json")
    noise = [word for name, value in NOISE.items() for word in ("--noise", f"{name}={value}")]
    for words in (
        ["fit", str(dataset), "--model", "stage31", "--solver", "direct", "-o", calib],
        ["evaluate", calib, str(dataset)],
        ["sensitivity", calib, str(dataset)],
    ):
        said = []
        for workers in ([], ["--workers", "2"]):
            assert main([*words, *noise, *workers, "--json"]) in (0, 3)
            said.append(capsys.readouterr().out)
        assert [line for line in said[0].splitlines() if "seconds" not in line] == [
            line for line in said[1].splitlines() if "seconds" not in line
        ]
    assert main(["fit", str(dataset), "--workers", "0"]) == 2
    assert "1 or more" in capsys.readouterr().err


@pytest.mark.slow
def test_two_workers_of_1_gb_fit_what_streams(tmp_path):
    """The path of the benchmark, which does the same with 200 million samples."""
    spec = importlib.util.spec_from_file_location("bench_parts", BENCHMARK)
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    bench.write(tmp_path / "dataset", 2_200_000)
    one, two, difference = bench.compared(tmp_path / "dataset")
    assert one["rows"] == 2_200_000
    assert difference <= bench.AGREE
    assert two["workers_cpu"] > 0
    assert two["worker_mb"] < 400
