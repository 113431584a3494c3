"""Every format gives back what was written; every value to the same bits."""

from __future__ import annotations

import contextlib
import re
import tempfile
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from log_samples import STAGE, refusal, save, stage_arrays
from scipy.io import savemat

from hallsym.errors import InputError
from hallsym.log import Log, LogWriter, read_log, write_log

SUFFIXES = (".parquet", ".csv", ".tsv", ".h5", ".mat")
finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip(tmp_path: Path, suffix: str) -> None:
    arrays = stage_arrays()
    path = tmp_path / f"log{suffix}"
    save(arrays, path)
    log = read_log(path)
    assert (set(log.columns), log.rows, log.runs) == (set(STAGE), 1600, (0, 1, 2, 3))
    for name, values in arrays.items():
        assert np.array_equal(log.array(name), values), name
        assert log.array(name).dtype == np.float64
    assert log.notes == ()
    assert np.array_equal(log.run(2)["x_ref_m"], arrays["x_ref_m"][800:1200])


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".h5"])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=hnp.arrays(np.float64, st.integers(1, 40), elements=finite))
def test_any_finite_value_keeps_its_bits(suffix: str, values: np.ndarray) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"log{suffix}"
        save({"run": np.zeros(len(values), int), "x_ref_m": values}, path)
        assert read_log(path).array("x_ref_m").tobytes() == values.tobytes()


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".tsv"])
def test_pieces_are_joined(tmp_path: Path, suffix: str) -> None:
    arrays = stage_arrays(samples=40)
    with LogWriter(tmp_path / f"log{suffix}") as writer:
        for lo in range(0, 160, 13):
            writer.append({name: values[lo : lo + 13] for name, values in arrays.items()})
    assert np.array_equal(read_log(tmp_path / f"log{suffix}").array("hall_b_m"), arrays["hall_b_m"])


def test_csv_with_comments_empty_lines_and_missing_values(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = ["# stage 3", "", " run ,t_s,hall_a_m,x_ref_um", "0,0.0, 1e-6,2", "0,0.002,,3.5", ",,"]
    path.write_text("\n".join([*lines, "0,0.004,-inf,nan", "0,6e-3,1E-7,4", ""]))
    log = read_log(path)
    assert log.columns == ("run", "t_s", "hall_a_m", "x_ref_m")
    assert log.rows == 4
    assert np.array_equal(log.array("hall_a_m"), [1e-6, np.nan, -np.inf, 1e-7], equal_nan=True)


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        (("{x:.3E}", "{x:.3E}"), None),
        (("{x:.3E}", "{x:.3E}"), "exponents written with D"),
        (("{x:g} mV", "{x:g}"), "units behind numbers"),
        (("{x:g}µV", "{x:g} deg"), "units behind numbers"),
        (("0x{x:02X}", "{x:d}"), "hexadecimal numbers"),
    ],
)
def test_numbers_that_are_written_otherwise(tmp_path: Path, cells: tuple[str, str], said: str | None) -> None:
    values = list(range(40, 52)) if said == "hexadecimal numbers" else [1.5 * k - 3.25 for k in range(12)]
    rows = [";".join(cell.format(x=x) for cell in cells) for x in values]
    rows = [row.replace("E", "D") for row in rows] if said == "exponents written with D" else rows
    (tmp_path / "log.csv").write_text("\n".join(["v_sin;angle 2d3", *rows, ""]), encoding="utf-8")
    unit = {"{x:g} mV": "_mv", "{x:g}µV": "_uv"}.get(cells[0], "_v")
    mapped = {f"v_sin{unit}": "v_sin", f"angle_ref_{'deg' if 'deg' in cells[1] else 'rad'}": "angle 2d3"}
    log = read_log(tmp_path / "log.csv", columns=mapped)
    factor = {"_mv": 1e-3, "_uv": 1e-6, "_v": 1.0}[unit]
    assert log.array("v_sin_v") == pytest.approx(factor * np.array(values), rel=1e-3)
    assert log.array("angle_ref_rad") == pytest.approx(
        np.array(values) * (np.pi / 180 if "deg" in cells[1] else 1.0), rel=1e-3
    )
    assert said is None or any(said in note for note in log.notes)


def test_a_table_without_numbers_keeps_its_words(tmp_path: Path) -> None:
    """A unit behind a number in one line is a word: `5 mm` of a column of remarks."""
    rows = [f"{k},{0.5 * k},{'5 mm' if k == 7 else 'ok'}" for k in range(9)]
    (tmp_path / "log.csv").write_text("\n".join(["t_s,x_ref_m,state", *rows, ""]))
    log = read_log(tmp_path / "log.csv")
    assert log.columns == ("run", "t_s", "x_ref_m")
    assert not any("units behind" in note for note in log.notes)


def test_csv_with_byte_order_mark_crlf_and_text_column(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes('\ufeff"t_s",x_ref_m,state\r\n0,1,idle\r\n1,2,move\r\n'.encode())
    log = read_log(path)
    assert log.columns == ("run", "t_s", "x_ref_m")
    assert log.array("x_ref_m").tolist() == [1.0, 2.0]
    said = "No column 'run': a run begins where t_s starts again or text has an empty line or names again."
    assert log.notes == (said,)
    assert log.runs == (0,)


@pytest.mark.parametrize(
    ("names", "coding"),
    [("t [ms];ホールA [um]", "cp932"), ("Time (in ms);x [um]", "utf-8"), ("Stamp [UTC ms];x [um]", "utf-8")],
)
def test_units_of_times_and_words_between_columns(tmp_path: Path, names: str, coding: str) -> None:
    """Statistics below the rows may stand behind an empty cell."""
    rows = [f"{k};{k};{2 * k}" for k in range(9)]
    (tmp_path / "log.csv").write_bytes("\n".join([f"n;{names}", *rows, ";Mean;8", ""]).encode(coding))
    source = read_log(tmp_path / "log.csv").table.source
    time, x = source.names[1:]
    assert names.startswith(f"{time} ")
    assert source.units == {time: "ms", x: "um"}
    assert source.count() == 9


def test_what_is_stated_of_a_csv_file_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t_s;x_ref_m\n0;1,234\n1;2,345\n")
    assert read_log(path, delimiter=";", decimal=",").array("x_ref_m").tolist() == [1.234, 2.345]
    assert read_log(path, decimal=".").array("x_ref_m").tolist() == [1234.0, 2345.0]


def test_float32_becomes_float64(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    values = np.linspace(0, 1e-3, 20, dtype=np.float32)
    fields = [pa.field("run", pa.int16()), pa.field("x_ref", pa.float32(), metadata={"unit": "mm"})]
    table = pa.table([np.zeros(20, np.int16), 1e3 * values], schema=pa.schema(fields))
    pq.write_table(table, tmp_path / "log.parquet")
    block = next(read_log(tmp_path).blocks())
    assert block.run == 0
    assert block.data["x_ref_m"].dtype == np.float64
    assert np.array_equal(block.data["x_ref_m"], (1e3 * values).astype(float) * 1e-3)


def test_hdf5_with_groups_within_a_group_per_run(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "runs.h5", "w") as file:
        for run in (3, 1):
            file[f"day2/run_{run}/laser1/x_ref_m"] = np.full(4, float(run))
            file[f"day2/run_{run}/hall_a_m"] = np.full(4, run + 0.5)
    log = read_log(tmp_path / "runs.h5", columns={"x_ref_m": "laser1/x_ref_m"})
    assert (log.runs, log.rows) == ((1, 3), 8)
    assert (log.array("hall_a_m") - log.array("x_ref_m")).tolist() == [0.5] * 8


def test_what_attributes_and_texts_of_hdf5_say(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as out:
        out["time"] = [f"2026-03-02 10:15:0{k}.5".encode() for k in range(3)]
        out["x_ref"] = np.array([10, 20, -1], np.int16)
        out["x_ref"].attrs.update(units="micrometers", scale_factor=0.5, add_offset=1.0, _FillValue=-1)
        for name, width in (("hall", 3), ("tilt", 2)):
            out[f"{name}/Data"] = np.ones((3, width))
    log = read_log(tmp_path / "log.h5")
    assert (log.array("t_s").tolist(), log.array("x_ref_m").tolist()[:2]) == ([0, 1, 2], [6e-6, 11e-6])
    assert np.isnan(log.array("x_ref_m")[2])
    assert {"hall/Data_0", "hall/Data_2", "tilt/Data_0"} <= {*log.table.source.names}


def test_netcdf_of_both_kinds(tmp_path: Path) -> None:
    from scipy.io import netcdf_file

    with netcdf_file(tmp_path / "old.nc", "w") as out, h5py.File(tmp_path / "new.nc", "w") as new:
        out.createDimension("time", 3)
        for name, unit, values in (
            ("time", "seconds since 2026-03-02", [0, 1, 2]),
            ("x_ref", "mm", [4, 5, 6]),
        ):
            out.createVariable(name, "i", ("time",))[:] = new[name] = values
            out.variables[name].units = new[name].attrs["units"] = unit
        out.variables["x_ref"].scale_factor = new["x_ref"].attrs["scale_factor"] = 0.5
    for name in ("old.nc", "new.nc"):
        log = read_log(tmp_path / name, columns={"t": "time"})
        assert (log.array("t_s").tolist(), log.array("x_ref_m").tolist()) == ([0, 1, 2], [2e-3, 2.5e-3, 3e-3])
    (tmp_path / "old.nc").write_bytes((tmp_path / "old.nc").read_bytes()[:-30])
    with refusal("must be a complete NetCDF file"):
        read_log(tmp_path / "old.nc")


def test_vector_of_another_length_is_named_when_needed(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"x_ref_m": np.zeros(5), "y_ref_m": np.zeros(5), "hall_a_m": np.zeros(7)})
    with refusal(r"no time base and 7 values where the others have 5"):
        list(read_log(tmp_path / "a.mat").blocks(["hall_a_m"]))


def test_folder_with_meta(tmp_path: Path) -> None:
    write_log(stage_arrays(), tmp_path / "log.csv")
    (tmp_path / "meta.json").write_text(
        '{"family": "stage", "base_model": "model31", "validation_runs": [1, 3], "extra": [1],'
        ' "nominal": {"H1x": 0.2}, "gap_length_scale_m": 0.35,'
        ' "noise_1sigma": {"hall_m": 5e-7, "hall_b_um": 0.25, "x_ref_m": 3e-7, "temperature_degc": 0.02}}'
    )
    log = read_log(tmp_path)
    assert (log.meta.base_model, log.meta.holdout, log.meta.gap_length_scale_m) == ("model31", (1, 3), 0.35)
    assert log.meta.raw["extra"] == [1]
    assert log.noise["hall_a_m"].value == 5e-7
    assert log.noise["hall_b_m"].value == pytest.approx(2.5e-7)
    assert log.noise["x_ref_m"].source == "given"
    assert set(log.noise) == {"hall_a_m", "hall_b_m", "x_ref_m"}
    assert read_log(tmp_path, noise={"hall_m": 1e-6}).noise["hall_a_m"].value == 1e-6


def test_hash_is_that_of_the_file(tmp_path: Path) -> None:
    import hashlib

    write_log(stage_arrays(), tmp_path / "log.csv")
    assert read_log(tmp_path).sha256 == hashlib.sha256((tmp_path / "log.csv").read_bytes()).hexdigest()
    first, second = (Log.from_arrays(stage_arrays(seed=seed)).sha256 for seed in (0, 1))
    assert first == Log.from_arrays(stage_arrays()).sha256 != second


def test_a_matrix_is_columns_and_a_picture_is_none(tmp_path: Path) -> None:
    halls, wide = np.arange(300.0).reshape(100, 3), np.zeros((101, 102))
    np.savez(tmp_path / "a.npz", hall_um=halls, x_ref_m=np.arange(100.0), map=wide, ok=np.ones(100, bool))
    source = read_log(tmp_path / "a.npz").table.source
    assert source.names == ("hall_0", "hall_1", "hall_2", "x_ref_m")
    assert dict(source.left_out) == {
        "map": "it is an array of 101 x 102", "ok": "it holds booleans, not numbers"
    }  # fmt: skip
    np.save(tmp_path / "b.npy", halls)
    log = read_log(tmp_path / "b.npy", columns={"hall_c_um": "column_2"})
    assert np.allclose(log.array("hall_c_m"), halls[:, 2] * 1e-6, rtol=1e-15, atol=0)
    log = read_log(tmp_path / "a.npz", columns={"hall_c": "hall_2"})
    assert np.allclose(log.array("hall_c_m"), halls[:, 2] * 1e-6, rtol=1e-15, atol=0)


def test_a_table_of_a_database_is_a_log(tmp_path: Path) -> None:
    import sqlite3

    with contextlib.closing(sqlite3.connect(tmp_path / "log.sqlite")) as base:
        base.execute("CREATE TABLE gains (gain REAL)")
        base.execute("CREATE TABLE samples (t_s REAL, x_ref_um REAL, note TEXT)")
        base.executemany("INSERT INTO samples VALUES (?, ?, 'ok')", [(0.1 * k, k) for k in range(50)])
        base.commit()
        log = read_log(tmp_path / "log.sqlite")
        assert np.allclose(log.array("x_ref_m"), 1e-6 * np.arange(50), rtol=1e-15, atol=0)
        base.execute("CREATE TABLE notes (text TEXT)")
        base.execute("INSERT INTO notes VALUES ('warm')")
        base.commit()
        log = read_log(tmp_path / "log.sqlite")
        assert log.rows == 50
        assert any("table notes is not read" in note for note in log.notes)
        base.execute("INSERT INTO gains VALUES (1.5)")
        base.commit()
    with pytest.raises(
        InputError, match=r"2 tables with cells \(gains, samples\): say which .* --sheet samples"
    ):
        read_log(tmp_path / "log.sqlite")
    assert read_log(tmp_path / "log.sqlite", sheet="samples").rows == 50


def test_files_are_runs_in_natural_order_and_notes_are_none(tmp_path: Path) -> None:
    for day, first in (("monday", 0.0), ("tuesday", 1.0)):
        write_log({"x_ref_m": first + np.arange(3.0)}, tmp_path / f"{day}.csv")
    (tmp_path / "notes.txt").write_text("fine")
    log = read_log(tmp_path)
    assert log.runs == (0, 1)
    assert "run 0 is monday, run 1 is tuesday" in " ".join(log.notes)
    for k in (10, 2):
        (tmp_path / f"scan_{k}.csv").write_text("x_ref_um\n1\n2\n")
    assert read_log(str(tmp_path / "scan_*.csv")).runs == (2, 10)
    for name in ("a/data.csv", "b/data.csv"):
        (tmp_path / "below" / name).parent.mkdir(parents=True)
        (tmp_path / "below" / name).write_text("x_ref_um\n1\n2\n")
    (tmp_path / "below" / "README.txt").write_text("Two runs.\n")
    assert read_log(tmp_path / "below").runs == (0, 1)
    with pytest.raises(InputError, match="same columns to be runs; scan_2 and monday differ in x_ref"):
        read_log(tmp_path)


def test_two_files_are_joined_by_time_and_nothing_is_extrapolated(tmp_path: Path) -> None:
    fast, slow = np.arange(500) * 0.01, np.arange(-5, 40) * 0.1
    write_log({"t_s": fast, "hall_a_m": np.sin(fast)}, tmp_path / "hall.csv")
    write_log({"t_ms": slow * 1e3, "x_ref_m": slow}, tmp_path / "laser.parquet")
    log = read_log([tmp_path / "hall.csv", tmp_path / "laser.parquet"])
    assert (log.array("t_s")[0], log.rows) == (pytest.approx(0.0, abs=1e-9), 40)
    assert np.allclose(log.array("hall_a_m"), np.interp(log.array("t_s"), fast, np.sin(fast)), atol=1e-12)
    assert any("at the samples of laser" in note and "from 0 to 3.9 s" in note for note in log.notes)
    other = read_log([tmp_path / "hall.csv", tmp_path / "laser.parquet"], clock="hall")
    assert other.rows == 391
    write_log({"t_s": slow + 100, "x_ref_m": slow}, tmp_path / "laser.csv")
    with pytest.raises(InputError, match="must overlap in time"):
        read_log([tmp_path / "hall.csv", tmp_path / "laser.csv"])


def test_joined_counts_and_angles_are_not_read_between_two_turns(tmp_path: Path) -> None:
    """Numbers of a text file are all alike; that they are counts, or an angle, is what somebody states."""
    t, other = np.arange(200) * 0.01, np.arange(60) * 0.033
    turn = 3.3 * t
    table = {"t_s": t, "raw": np.floor(turn % 1 * 4096), "enc": turn % 1 * 360}
    rows = [
        "t_s,raw,enc",
        *(",".join(map(repr, row)) for row in zip(*(v.tolist() for v in table.values()), strict=True)),
    ]
    (tmp_path / "chip.csv").write_text("\n".join([*rows, ""]))
    write_log({"t_s": other, "x_ref_m": other}, tmp_path / "ref.csv")
    columns = {"angle_count": "raw", "angle_ref_deg": "enc"}
    log = read_log([tmp_path / "ref.csv", tmp_path / "chip.csv"], columns=columns, counts_per_turn=4096)
    truth, found = 2 * np.pi * 3.3 * log.array("t_s"), (log.array("angle_rad"), log.array("angle_ref_rad"))
    off = [np.abs(np.angle(np.exp(1j * (values - truth)))).max() for values in found]
    assert off[0] < 2 * np.pi * (3.3 * 0.005 + 1 / 4096)
    assert off[1] < 1e-9


def test_few_columns_of_runs_are_no_runs_side_by_side(tmp_path: Path) -> None:
    table = {"t_s": np.arange(5.0), "x_ref_m": np.arange(5.0), "y_ref_m": np.zeros(5)}
    write_log(table | {"x_run1_m": np.zeros(5), "x_run2_m": np.zeros(5)}, tmp_path / "log.csv")
    assert "x_ref_m" in read_log(tmp_path).columns
    (tmp_path / "wide.csv").write_text("t_s,x_ref_run1_um,x_ref_run2_um\n0,1,4\n1,2,5\n2,3,\n")
    log = read_log(tmp_path / "wide.csv")
    assert log.runs == (1, 2)
    assert log.array("x_ref_m") == pytest.approx([1e-6, 2e-6, 3e-6, 4e-6, 5e-6])
    (tmp_path / "odd.csv").write_text("x_ref_run1_um,x_ref_run2_um,z_run1_um\n0,1,3\n1,2,\n")
    with pytest.raises(InputError, match=r"Run 2 of .* must have a column for z_um"):
        read_log(tmp_path / "odd.csv")


def test_a_run_begins_where_the_clock_starts_again(tmp_path: Path) -> None:
    t = np.r_[np.arange(50), np.arange(40), 0.2 + np.arange(30)] * 0.1 + 7.0
    for size in (100, 7):
        log = read_log({"t_s": t, "x_ref_m": t})
        assert log.runs == (0, 1, 2)
        assert next(len(b.data["t_s"]) for b in log.blocks(size=size) if b.run == 2) == min(size, 30)
    late = np.arange(50) * 0.1
    late[20] = late[10]
    assert read_log({"t_s": late, "x_ref_m": late}).runs == (0,)
    assert read_log({"x_ref_m": t}).runs == (0,)


@pytest.mark.parametrize(
    ("between", "every", "runs"),
    [
        ("\n", 20, 5),
        ("t_s,x_ref_um\n", 20, 5),
        ("\n,\nt_s,x_ref_um\n", 20, 5),
        ("\n", 1, 1),
        ("# hot\n", 20, 1),
    ],
)
def test_empty_lines_and_repeated_names_divide_runs(
    tmp_path: Path, between: str, every: int, runs: int
) -> None:
    """Not where each line has an empty one below it; a clock that goes on tells nothing."""
    rows = [f"{'' if k % every else between}{0.1 * k:.1f},{k}\n" for k in range(100)]
    (tmp_path / "log.csv").write_text("".join(["t_s,x_ref_um\n", *rows]))
    log = read_log(tmp_path / "log.csv")
    assert (log.rows, log.runs) == (100, tuple(range(runs)))


def test_runs_with_names_are_numbered_in_their_order(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("run,x_ref_um\nup,1\nup,2\ndown,3\n")
    for log in (tmp_path / "log.csv", {"run": ["up", "up", "down"], "x_ref_um": [1, 2, 3]}):
        assert read_log(log).array("run").tolist() == [0, 0, 1]
    trials = {"trialName": ["up"] * 30 + ["down"] * 30, "x_ref_um": np.arange(60), "Note": ["", "a"] * 30}
    log = read_log(trials)
    assert (log.runs, log.notes) == ((0, 1), ("Runs are those of column 'trialName'.",))
    step = np.arange(60)
    for name, values, wanted in (
        ("TestID", step // 20, (0, 1, 2)),
        ("test", step // 4, (0,)),
        ("n", step // 20, (0,)),
    ):
        log = read_log({name: values, "x_ref_um": step})
        assert log.runs == wanted, name
        assert any("--column run=n" in note for note in log.notes) == (name == "n")
    (tmp_path / "bad.csv").write_text("run,x_ref_um\n1,1\n1x,2\n2,3\n")
    with pytest.raises(InputError, match="Line 3, column 'run'"):
        read_log(tmp_path / "bad.csv").runs  # noqa: B018


@pytest.mark.parametrize("name", ["../../{}", "/{}", "a/b/c/{}"])
def test_no_name_in_an_archive_leads_outside_its_folder(tmp_path: Path, name: str) -> None:
    within = tmp_path / "deep" / "er"
    within.mkdir(parents=True)
    with zipfile.ZipFile(within / "runs.zip", "w") as archive:
        for k in (1, 2):
            archive.writestr(name.format(f"hallsym_run{k}.csv"), "x_ref_um\n1\n2\n")
    assert read_log(within / "runs.zip").runs == (1, 2)
    outside = (*tmp_path.rglob("*.csv"), *Path("/").glob("hallsym_run*"), *Path.cwd().glob("*hallsym_run*"))
    assert not outside
    with zipfile.ZipFile(within / "one.zip", "w") as archive:
        archive.writestr(name.format("hallsym_run1.csv"), "x\n1\n2\n")
    with pytest.raises(
        InputError, match=rf"{re.escape(str(within))}/one.zip has no column .*one.zip --write"
    ):
        read_log(within / "one.zip")


def test_files_on_one_clock_have_one_time(tmp_path: Path) -> None:
    t = np.arange(30) * 0.1
    write_log({"run": np.zeros(30), "t_s": t, "hall_a_m": t}, tmp_path / "a.csv")
    write_log({"run": np.zeros(30), "t_s": t, "x_ref_m": 2 * t}, tmp_path / "b.csv")
    log = read_log([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert set(log.columns) == {"run", "t_s", "hall_a_m", "x_ref_m"}
    assert np.array_equal(log.array("x_ref_m"), 2 * log.array("t_s"))


@pytest.mark.parametrize("runs", [(1, 2, 5), (3, 1, 2)])
def test_files_whose_clocks_start_again_are_joined_run_by_run(tmp_path: Path, runs: tuple[int, ...]) -> None:
    """Each logger counts from the trigger of each run; nothing is read between two runs."""
    slow, fast = np.arange(20) * 0.1, np.arange(201) * 0.01
    reference = {
        "run": np.repeat(runs, 20), "t_s": np.tile(slow, 3),
        "x_ref_m": np.concatenate([r + slow for r in runs]),
    }  # fmt: skip
    halls = {
        "run": np.repeat(runs, 201), "t_s": np.tile(fast, 3),
        "hall_a_m": np.concatenate([r + np.sin(fast) for r in runs]),
    }  # fmt: skip
    write_log(reference, tmp_path / "ref.csv")
    write_log(halls, tmp_path / "hall.csv")
    files = [tmp_path / "ref.csv", tmp_path / "hall.csv"]
    if runs != tuple(sorted(runs)):
        with pytest.raises(InputError, match=r"Time of ref .* in each run, and run numbers"):
            read_log(files)
        return
    log = read_log(files)
    assert (log.runs, log.rows) == (runs, 60)
    for run in runs:
        part = log.run(run)
        assert np.allclose(part["t_s"], slow, rtol=0, atol=1e-12)
        assert np.allclose(part["hall_a_m"], run + np.sin(slow), rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("head", "step"),
    [
        ("rig 7\nSample rate: 2 kHz\nt_s\tx_ref_um", 5e-4),
        ("Abtastintervall [ms]\t0,25\nt_s\tx_ref_um", 2.5e-4),
        ("Name\tx\nPort\t801\nVersion\t8\nDelta_X\t0.5\nt_s\tx_ref_um", 0.5),
    ],
)
def test_a_stated_interval_gives_the_times_that_an_empty_column_does_not(
    tmp_path: Path, head: str, step: float
) -> None:
    (tmp_path / "log.txt").write_text(f"{head}\n" + "".join(f"\t{k}.5\n" for k in range(30)))
    log = read_log(tmp_path / "log.txt")
    assert log.array("t_s") == pytest.approx(step * np.arange(30))
    assert log.array("x_ref_m")[-1] == pytest.approx(29.5e-6)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["daq/sample_rate"], file["data/x_ref_m"] = 1 / step, np.arange(30.0)
    assert read_log(tmp_path / "log.h5").array("t_s") == pytest.approx(step * np.arange(30))
