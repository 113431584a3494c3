"""A large file is streamed: the same blocks, checks and noise as in memory, in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from log_samples import save, stage_arrays

from hallsym.errors import InputError
from hallsym.log import (
    LogWriter,
    check_log,
    clean_log,
    estimate_noise,
    format_csv,
    format_parquet,
    groups,
    read_log,
    spans,
    write_log,
)
from hallsym.log.batches import batches
from hallsym.log.isolated import Isolated


def nothing_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(format_parquet, "IN_MEMORY_ROWS", 100)
    monkeypatch.setattr(Isolated, "small", property(lambda source: False, lambda source, small: None), False)
    monkeypatch.setattr(groups, "IN_MEMORY_ROWS", 100)
    monkeypatch.setattr(format_csv, "IN_MEMORY_BYTES", 100)


@pytest.fixture
def small_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing_in_memory(monkeypatch)


SUFFIXES = (".parquet", ".csv", ".h5")


@pytest.mark.usefixtures("small_limits")
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("size", [7, 333, 65_536])
def test_streamed_blocks_equal_the_arrays(tmp_path: Path, suffix: str, size: int) -> None:
    arrays = stage_arrays()
    save(arrays, tmp_path / f"log{suffix}")
    log = read_log(tmp_path)
    assert not log.table.in_memory
    blocks = list(log.blocks(["x_ref_m", "run", "hall_a_m"], size=size))
    assert max(len(block.data["run"]) for block in blocks) <= size
    assert all((block.data["run"] == block.run).all() for block in blocks)
    for name in ("x_ref_m", "hall_a_m"):
        assert np.array_equal(np.concatenate([block.data[name] for block in blocks]), arrays[name])
    assert (log.rows, log.runs) == (1600, (0, 1, 2, 3))
    assert np.array_equal(log.array("z_m"), arrays["z_m"])
    assert np.array_equal(log.run(3)["z_m"], arrays["z_m"][1200:])


def test_batches_of_a_streamed_log_are_those_of_one_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays, columns = stage_arrays(), ("x_ref_m", "hall_a_m")
    arrays["run"] = np.repeat([0, 4, 5, 9, 10], [1, 299, 700, 550, 50])
    save(arrays, tmp_path / "log.parquet")
    monkeypatch.setattr(sys.modules["hallsym.log.batches"], "SIZE", 250)
    held = list(batches(read_log(tmp_path), columns))
    assert any(len(batch.runs) > 1 for batch in held)
    nothing_in_memory(monkeypatch)
    log = read_log(tmp_path)
    assert not log.table.in_memory
    for one, other in zip(held, batches(log, columns), strict=True):
        assert (one.runs, one.edges) == (other.runs, other.edges)
        assert all(np.array_equal(one.data[name], other.data[name]) for name in columns)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_checks_do_not_depend_on_streaming(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    arrays = stage_arrays()
    arrays["hall_a_m"][[3, 777]] = np.nan
    arrays["t_s"][900] = 0.0
    arrays["x_ref_m"][500:530] = arrays["x_ref_m"][500]
    save(arrays, tmp_path / f"log{suffix}")
    held = clean_log(read_log(tmp_path))
    nothing_in_memory(monkeypatch)
    streamed = clean_log(read_log(tmp_path))
    assert not streamed.table.in_memory
    assert streamed.notes == held.notes
    assert (streamed.rows, held.rows) == (1567, 1567)
    assert streamed.rows == sum(len(block.data["z_m"]) for block in streamed.blocks(["z_m"], size=50))
    assert np.array_equal(spans(streamed).by_run["hall_a_m"], spans(held).by_run["hall_a_m"])
    channels = ("hall_a_m", "x_ref_m")
    noises = [estimate_noise(log, channels) for log in (streamed, held)]
    assert [noises[0][name].value for name in channels] == [noises[1][name].value for name in channels]


@pytest.mark.usefixtures("small_limits")
def test_streamed_run_that_comes_back(tmp_path: Path) -> None:
    write_log({"run": np.repeat([0, 1, 0], 500), "x_ref_m": np.arange(1500.0)}, tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"Run 0 .* comes back after run 1"):
        check_log(read_log(tmp_path))


_WATCH = """
import sys
from hallsym.log import check_log, read_log
import pyarrow.parquet, numpy

def peak():  # of this process alone: getrusage would carry over that of the parent
    line = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024

before = peak()
log = read_log(sys.argv[1])
if sys.argv[2] == "check":
    assert check_log(log) == []
print(sum(len(block.data["x_ref_m"]) for block in log.blocks()), peak() - before)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
@pytest.mark.slow
@pytest.mark.parametrize("what", ["read", "check"])
def test_memory_of_a_stream_is_bounded(tmp_path: Path, what: str) -> None:
    """Twenty million samples of four columns are 640 MB; a pass takes less than 200 MB above the imports."""
    rng = np.random.default_rng(0)
    path = tmp_path / "log.parquet"
    with LogWriter(path) as writer:
        for run in range(20):
            t = run * 3000.0 + np.arange(1_000_000) * 1e-3
            x = 5e-4 * np.sin(3 * t) + 1e-7 * rng.normal(size=len(t))
            writer.append({"run": np.full(len(t), run), "t_s": t, "x_ref_m": x, "hall_a_m": 0.8 * x})
    command = [sys.executable, "-c", _WATCH, str(path), what]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    rows, megabytes = result.stdout.split()
    assert int(rows) == 20_000_000
    assert float(megabytes) < 200
