"""TDMS, MDF and MCAP: what their own libraries write is read as the same numbers, on one clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_files import LIBRARY, WRITERS, Columns, Rates
from log_samples import refusal, refused, stage_arrays

from hallsym.errors import InputError
from hallsym.log import groups, read_log, write_log
from hallsym.log.groups import GroupedSource
from hallsym.log.isolated import Isolated
from hallsym.log.table import Arrays

SUFFIXES = tuple(WRITERS)
HALL, REFERENCE = "Hall", "Reference"


@pytest.fixture(params=SUFFIXES)
def suffix(request: pytest.FixtureRequest) -> str:
    pytest.importorskip(LIBRARY[request.param])
    return request.param


def topic(suffix: str, name: str) -> str:
    """What a group is called: a topic of ROS has a slash."""
    return f"/{name}" if suffix == ".mcap" else name


def written(path: Path, groups: Rates) -> Path:
    WRITERS[path.suffix](path, groups)
    return path


def sines(
    first: float, rate: float, rows: int, name: str, amplitude: float = 1e-4
) -> tuple[float, float, Columns]:
    t = first + np.arange(rows) / rate
    return first, rate, {name: amplitude * np.sin(2 * np.pi * 3 * t)}


def two_rates(rows: int = 2000) -> Rates:
    """Readings at 1 kHz from zero, a reference at 100 Hz that begins 2.3 ms later."""
    return {
        HALL: sines(0.0, 1000.0, rows, "hall_a_m"),
        REFERENCE: sines(0.0023, 100.0, rows // 10, "x_ref_m"),
    }


def tdms(path: Path, *channels: tuple[str, str, np.ndarray, dict[str, Any]]) -> Path:
    """Write channels of groups in one segment."""
    pytest.importorskip("nptdms")
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject(*channel) for channel in channels])
    return path


@pytest.mark.slow
@pytest.mark.parametrize("limit", [10**9, 100])
def test_names_units_and_numbers_are_those_of_the_file(
    tmp_path: Path, suffix: str, limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(groups, "IN_MEMORY_ROWS", limit)
    small = property(lambda source: source.rows <= limit, lambda source, small: None)
    monkeypatch.setattr(Isolated, "small", small, raising=False)  # another process decides it
    arrays = {name: v for name, v in stage_arrays(samples=150).items() if name != "t_s"}
    log = read_log(written(tmp_path / f"log{suffix}", {HALL: (0.0, 500.0, arrays)}))
    assert (set(log.columns), log.rows, log.runs) == ({"t_s", *arrays}, 600, (0, 1, 2, 3))
    assert log.table.in_memory == (limit > 600)
    assert np.allclose(log.array("t_s"), np.arange(600) / 500, rtol=0, atol=1e-9)
    for name, expected in arrays.items():
        assert np.allclose(log.array(name), expected, rtol=1e-14, atol=0), name
    blocks = list(log.blocks(["x_ref_m", "run"], size=37))
    assert max(len(block.data["run"]) for block in blocks) <= 37
    assert np.array_equal(np.concatenate([b.data["x_ref_m"] for b in blocks]), log.array("x_ref_m"))


@pytest.mark.parametrize("clock", [HALL, REFERENCE, None])
@pytest.mark.parametrize("limit", [10**9, 100])
def test_other_clocks_are_read_as_numpy_reads_them(
    tmp_path: Path, suffix: str, clock: str | None, limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(groups, "IN_MEMORY_ROWS", limit)
    monkeypatch.setattr("hallsym.log.table.CHUNK_ROWS", 64)
    path = written(tmp_path / f"log{suffix}", two_rates(400))
    log = read_log(path, clock=clock and topic(suffix, clock))
    clock = clock or REFERENCE  # the slower one
    rates, other = two_rates(400), REFERENCE if clock == HALL else HALL
    time = {g: first + np.arange(len(next(iter(c.values())))) / rate for g, (first, rate, c) in rates.items()}
    begin, end = max(t[0] for t in time.values()), min(t[-1] for t in time.values())
    inside = (time[clock] >= begin - 1e-12) & (time[clock] <= end + 1e-12)
    own, followed = next(iter(rates[clock][2])), next(iter(rates[other][2]))
    when = np.concatenate([b.data["t_s"] for b in log.blocks(["t_s"], size=33)])
    assert log.rows == inside.sum() == len(when)
    assert np.allclose(when, time[clock][inside], rtol=0, atol=1e-9)
    assert np.allclose(log.array(own), rates[clock][2][own][inside], rtol=1e-12, atol=1e-18)
    found = np.concatenate([b.data[followed] for b in log.blocks([own, followed], size=33)])
    truth = np.interp(when, time[other], rates[other][2][followed])
    assert np.allclose(found, truth, rtol=0, atol=1e-11)
    assert f"at the samples of {topic(suffix, clock)} (--clock)" in " ".join(log.notes)


@pytest.mark.parametrize(
    "names", [("hall_a_m", "status"), ("Probe_v", "Warm_degc"), ("hall_a_m", "Supply_v")]
)
def test_what_is_slow_beside_the_motion_is_no_clock_of_the_rows(names: tuple[str, str]) -> None:
    fast, slow = np.arange(500) * 0.01, np.arange(6) * 1.0
    parts = {"hall": {"t_s": fast, names[0]: fast}, "warm": {"t_s": slow, names[1]: 20 + slow}}
    joined = [groups.Group(name, Arrays(columns)) for name, columns in parts.items()]
    source = GroupedSource("log", "arrays", joined, {}, None, files=True)
    assert source.count() == 500
    assert np.allclose(source.read([names[1]])[names[1]], 20 + fast)


def test_a_long_gap_is_not_bridged(tmp_path: Path) -> None:
    pytest.importorskip("asammdf")
    import asammdf

    t = np.arange(200) / 100
    holes = {2: 0, 60: 3, 120: 6}  # at sample: samples lost
    lost = np.concatenate([np.arange(at + 1, at + 1 + n) for at, n in holes.items()]).astype(int)
    kept = np.setdiff1d(np.arange(200), lost)
    file = asammdf.MDF(version="4.10")
    file.append([asammdf.Signal(np.sin(t[kept]), t[kept], name="x_ref", unit="mm")], acq_name="R")
    file.append([asammdf.Signal(t, t, name="z", unit="mm")], acq_name="H")
    file.save(str(tmp_path / "log.mf4"))
    log = read_log(tmp_path / "log.mf4", clock="H")
    none = np.flatnonzero(np.isnan(log.array("x_ref_m")))
    assert none.tolist() == list(range(121, 127))
    refused(tmp_path / "log.mf4", "x_ref_m", clock="H")
    assert read_log(tmp_path / "log.mf4", clock="H", drop_bad=True).rows == 194


def test_an_angle_that_begins_again_is_read_the_short_way(tmp_path: Path) -> None:
    turn = np.arange(0, 200) * 23.0
    path = tdms(
        tmp_path / "log.tdms",
        ("R", "angle_ref", turn % 360, {"wf_increment": 0.01, "unit_string": "deg"}),
        ("V", "v_sin", np.ones(1991), {"wf_increment": 0.001, "unit_string": "V"}),
    )
    log = read_log(path, clock="V")
    truth = np.deg2rad(np.interp(log.array("t_s"), np.arange(200) / 100, turn))
    off = np.angle(np.exp(1j * (log.array("angle_ref_rad") - truth)))
    assert np.abs(off).max() < 1e-9


def test_groups_of_the_same_channels_are_runs(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mcap":
        pytest.skip("topics are not runs")
    path = written(
        tmp_path / f"log{suffix}", {f"Run {k}": sines(0.0, 100.0, 20 + k, "x_ref_m") for k in (10, 2, 1)}
    )
    log = read_log(path)
    assert log.runs == (1, 2, 10)
    assert [len(log.run(k)["x_ref_m"]) for k in log.runs] == [21, 22, 30]
    assert log.run(2, ["t_s"])["t_s"][:3] == pytest.approx([0, 0.01, 0.02])


def test_units_that_differ_between_files_are_converted_or_refused(tmp_path: Path) -> None:
    for name, unit, size in (("a", "µm", 1e6), ("b", "mm", 1e3)):
        ramp = np.arange(50) * 1e-6 * size
        tdms(tmp_path / f"{name}.tdms", ("G", "IFM X", ramp, {"unit_string": unit}))
    first = read_log(tmp_path / "a.tdms", columns={"x_ref_um": "IFM X"})
    second = read_log(tmp_path / "b.tdms", columns={"x_ref": "IFM X"})
    assert np.allclose(first.array("x_ref_m"), second.array("x_ref_m"), rtol=1e-12, atol=0)
    with refusal("in mm by its header; in the calibration's log it was in um"):
        read_log(tmp_path / "b.tdms", remembered=first.table.mapping)


def test_wrong_clocks(tmp_path: Path, suffix: str) -> None:
    path = written(tmp_path / f"log{suffix}", two_rates(200))
    refused(path, r"has no group 'Hell' \(did you mean", clock="Hell")
    write_log(stage_arrays(), tmp_path / "log.csv")
    with pytest.raises(InputError, match="Option clock must be left out"):
        read_log(tmp_path / "log.csv", clock="Hall")


def test_clocks_that_count_from_different_starts_are_refused(tmp_path: Path) -> None:
    start = np.datetime64("2026-01-01T00:00:00", "us")
    path = tdms(
        tmp_path / "log.tdms",
        ("A", "x_ref_m", np.arange(50.0), {"wf_increment": 0.1, "wf_start_time": start}),
        ("B", "z_m", np.arange(99.0), {"wf_increment": 0.05}),
    )
    refused(path, "count time from different starts", clock="A")


def test_a_clock_that_goes_back_is_refused(tmp_path: Path) -> None:
    time = np.arange(60.0) / 10
    time[30] = 1.0
    path = tdms(
        tmp_path / "log.tdms",
        ("A", "x_ref_m", np.arange(60.0), {}),
        ("A", "Time [s]", time, {}),
        ("B", "z_m", np.arange(99.0), {"wf_increment": 0.05}),
    )
    refused(path, "must rise", clock="B")
