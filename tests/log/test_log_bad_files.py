"""Files that cannot be read: each is refused in one sentence that names the file and what to do."""

from __future__ import annotations

import builtins
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_files import hidden
from log_samples import refusal, refused, save, stage_arrays

from hallsym.errors import InputError
from hallsym.log import read_log, write_log


def test_missing_file(tmp_path: Path) -> None:
    write_log(stage_arrays(), tmp_path / "log_7.csv")
    refused(tmp_path / "log7.csv", r"does not exist \(did you mean 'log_7.csv'\?\)")
    refused(tmp_path / "nowhere" / "log.csv", "neither does its folder")


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".h5", ".mat"])
def test_empty_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    path.touch()
    refused(path, r"is empty \(0 bytes\)")


@pytest.mark.parametrize(
    ("suffix", "kind"), [(".parquet", "Parquet"), (".h5", "HDF5"), (".mat", "MATLAB"), (".pq", "Parquet")]
)
@pytest.mark.parametrize("keep", [0.1, 0.5, 0.98])
def test_truncated_file(tmp_path: Path, suffix: str, kind: str, keep: float) -> None:
    path = tmp_path / f"log{suffix}"
    save(stage_arrays(), path)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    refused(path, f"must be a complete {kind} file")


def test_unknown_suffix_and_format(tmp_path: Path) -> None:
    path = tmp_path / "log.xyz"
    path.write_bytes(b"\0\1")
    (tmp_path / "log.parqet").write_bytes(b"\0\1")
    refused(path, r"cannot be read by its ending '.xyz'.*--format.*'hallsym info --help' lists")
    refused(tmp_path / "log.parqet", r"ending '.parqet' \(did you mean '.parquet'\?\)")
    with pytest.raises(InputError, match=r"Format must be one of.*did you mean 'csv'"):
        read_log(path, format="cvs")
    path.write_text("x_ref_m\n1\n")
    assert read_log(path).rows == 1
    assert read_log(path, format="csv").rows == 1
    path.rename(tmp_path / "log.xls")
    assert read_log(tmp_path / "log.xls").rows == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0,1\n0,2\n", "no column whose name ends with a unit; it has unnamed_0"),
        ("t_s,t_s\n0,2\n", "'t_s' stands there twice"),
        ("# only\n\n", "must hold a header line"),
        ("t_s,x_ref_m\n", "has no samples"),
        ("t_s,x_ref_m\n0,1\n0.1\n", "Line 3 of .* must have 2 cells as the header has; it has 1"),
        ("t_s,x_ref_m\n0,1\n0.1,2,3\n", "Line 3 of .* must have 2 cells as the header has; it has 3"),
        ("t_s,x_ref_m\n0,1\n0.1,bad\n", "Line 3, column 'x_ref_m' of .* must be a number; it is 'bad'"),
        ("t_s;x_ref_mm\n0;1,5\n1;2,5\n2;2.5\n", "Line 4, .*decimal comma, not a point; it is '2.5'"),
        ("t_s\tx_ref_mm\n0\t1.5\n1\t2,5\n", "Line 3, .*decimal point, not a comma; .*state --decimal ,"),
        ("t_s;x_ref_mm\n0;1,234\n1;2,345\n", "'1,234' of .* two ways: say --decimal , if .*--decimal . if"),
        ("t_s;x_ref_um\ns;mm\n0;1\n1;2\n", "Column 'x_ref_um' .*its name says um, the file mm"),
        ("t_s,x_ref [um]\ns,mm\n0,1\n1,2\n", "column 'x_ref' .*the names say um, the line below mm"),
        ("t_s,x_ref_mm\n0,1\n1,2\n2,3\n3\nEnd of log\n", "Line 5 of .* must have 2 cells"),
        ("t_s,x_ref_mm\n" + "".join(f"{k},0,{k},5\n" for k in range(30)), "commas may be decimal signs too"),
        ("t;x_ref_um\n0;1\n" + "".join(f"{k};{k % 900},5\n" for k in range(40000)) + "1;1.234,5\n",
         "Line 40003.*if a point separates thousands, state --decimal ,"),
    ],
)  # fmt: skip
def test_bad_csv(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    refused(path, says)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"delimiter": ","}, r"separated by commas; line 1 looks separated by semicolons: leave --delim"),
        ({"delimiter": "ab"}, "Delimiter must be one character"),
        ({"decimal": "x"}, "Decimal sign must be"),
        ({"sheet": "Log"}, "Option sheet must be left out for .*: a csv file has none"),
    ],
)
def test_what_is_stated_of_a_csv_file_and_cannot_be(
    tmp_path: Path, options: dict[str, str], says: str
) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t_s;x_ref_m\n0;1\n")
    with refusal(says):
        read_log(path, **options)


@pytest.mark.slow
def test_a_torn_line_far_inside_a_large_file_is_named(tmp_path: Path) -> None:
    lines = ["t_s;x_ref_um", "s;um", *(f"{k};{k},5" for k in range(200_000))]
    lines[150_000] = "149998"
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*lines, ""]))
    refused(path, "Line 150001 of .* must have 2 cells as the header has; it has 1")


@pytest.mark.parametrize("keep", [0.1, 0.5, 0.98])
def test_a_torn_compressed_file(tmp_path: Path, keep: float) -> None:
    write_log(stage_arrays(), tmp_path / "log.csv")
    path = tmp_path / "torn.csv.gz"
    data = gzip.compress((tmp_path / "log.csv").read_bytes())
    path.write_bytes(data[: int(len(data) * keep)])
    refused(path, "must be a complete CSV file; it is cut short or damaged")


def test_text_column_in_parquet(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"x_ref_m": ["1", "2"]}), tmp_path / "log.parquet")
    refused(tmp_path / "log.parquet", "Column 'x_ref_m' of .* must hold numbers; it holds string")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1]", "must hold a JSON object"),
        ("{", "meta.json cannot be read as JSON"),
        ('{"validation_runs": 3}', "'validation_runs' of .* must be a list"),
        ('{"validation_runs": ["a"]}', "'validation_runs.0' of .* must be a whole number"),
        ('{"noise_1sigma": {"hall_m": -1}}', "'noise_1sigma.hall_m' of .* must be a number > 0.*received -1"),
        ('{"gap_threshold_rel": "5 %"}', "must be a number"),
    ],
)
def test_bad_meta(tmp_path: Path, text: str, says: str) -> None:
    write_log({"x_ref_m": np.arange(9.0)}, tmp_path / "log.csv")
    (tmp_path / "meta.json").write_text(text)
    with refusal(says):
        read_log(tmp_path)


@pytest.mark.parametrize(
    ("suffix", "library", "extra"),
    [
        (".h5", "h5py", "hdf5"),
        pytest.param(".tdms", "nptdms", "tdms", marks=pytest.mark.slow),
        pytest.param(".mf4", "asammdf", "mdf", marks=pytest.mark.slow),
        pytest.param(".mcap", "mcap", "mcap", marks=pytest.mark.slow),
        pytest.param(".mcap", "mcap_ros2", "mcap", marks=pytest.mark.slow),
    ],
)
def test_missing_extra_says_what_to_install(tmp_path: Path, suffix: str, library: str, extra: str) -> None:
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"something\0")
    with hidden([library], tmp_path), refusal(rf"'hallsym\[{extra}\]'\."):
        read_log(path)


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    path.write_text("x_ref_m\n1\n")

    def denied(*args: Any, **options: Any) -> Any:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(builtins, "open", denied)
    refused(path, "Cannot read .*permission is denied")
