"""The same log in every text that laboratories write is the same log, without an option."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from mangled import rows, variants, write_workbook
from twins import bundled

import hallsym
from hallsym.errors import InputError
from hallsym.estimation import Fit, fit
from hallsym.log import Log, open_source, read_log


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    """Some runs of the bundled campaign, at other heights and tilts."""
    return bundled(slice(0, 12, 2))


@pytest.fixture(scope="module")
def files(columns: dict[str, np.ndarray]) -> dict[str, tuple[str, bytes]]:
    """Name of a file and its bytes, by what is mangled."""
    return variants(columns)


@pytest.fixture(scope="module")
def usual(columns: dict[str, np.ndarray]) -> Fit:
    """The fit of the same arrays."""
    return fit(Log.from_arrays(columns), "stage31", solver="direct")


def same(found: Fit, wanted: Fit) -> bool:
    return bool(np.allclose(found.values, wanted.values, rtol=1e-7, atol=1e-12))


FITTED = ("semicolons", "decimal comma", "two lines of header")
"""Logs of the same columns have the same fit; these show it."""


def _names() -> list[str]:
    return list(variants({"run": np.arange(3), "t_s": np.arange(3) * 0.1, "x_ref_m": np.arange(3) * 1e-6}))


@pytest.mark.parametrize("name", _names())
def test_mangled_text_is_the_same_log(
    tmp_path: Path,
    columns: dict[str, np.ndarray],
    files: dict[str, tuple[str, bytes]],
    usual: Fit,
    name: str,
) -> None:
    file, data = files[name]
    path = tmp_path / file
    path.write_bytes(data)
    log = read_log(path)
    assert set(log.columns) == set(columns)
    assert log.rows == len(columns["run"])
    for column, values in columns.items():
        assert np.allclose(log.array(column), values, rtol=1e-14, atol=1e-21), column
    assert len(log.notes) <= 1
    if name in FITTED:
        assert same(fit(log, "stage31", solver="direct"), usual)


@pytest.mark.parametrize("above", [True, False])
def test_a_workbook_is_the_same_log(
    tmp_path: Path, columns: dict[str, np.ndarray], usual: Fit, above: bool
) -> None:
    write_workbook(tmp_path / "log.xlsx", columns, above=above)
    log = read_log(tmp_path / "log.xlsx")
    assert np.allclose(log.array("x_ref_m"), columns["x_ref_m"], rtol=1e-14, atol=1e-21)
    assert "sheet 'Log'" in log.notes[0]
    assert same(fit(log, "stage31", solver="direct"), usual)


def test_sheets_of_the_same_columns_are_runs_and_of_others_it_asks_which(tmp_path: Path) -> None:
    import xlsxwriter

    for file, second in (("log.xlsx", "y_ref_m"), ("runs.xlsx", "x_ref_m")):
        with xlsxwriter.Workbook(str(tmp_path / file)) as book:
            book.add_worksheet("Monday").write_column(0, 0, ["x_ref_m", 1, 2])
            book.add_worksheet("Tuesday").write_column(0, 0, [second, 3, 4])
            book.add_worksheet("Remarks").write_column(0, 0, ["cold", "warm"])
    log = read_log(tmp_path / "runs.xlsx")
    assert log.run(1)["x_ref_m"].tolist() == [3.0, 4.0]
    assert any("Remarks is not read" in note for note in log.notes)
    with pytest.raises(InputError, match=r"2 sheets with cells .*--sheet Monday"):
        read_log(tmp_path / "log.xlsx")
    assert read_log(tmp_path / "log.xlsx", sheet="Tuesday").rows == 2
    with pytest.raises(InputError, match=r"no sheet 'Munday'.*did you mean 'Monday'"):
        read_log(tmp_path / "log.xlsx", sheet="Munday")


def test_what_was_recognised_is_said_in_one_line(tmp_path: Path, files: dict[str, tuple[str, bytes]]) -> None:
    for name, words in {
        "utf-16": ("UTF-16", "semicolons", "decimal comma", "names in line 1 with units in line 2"),
        "lines above the names": ("names in line 4", "2 lines above them not used"),
        "words below": ("words among the numbers left out ('End of measurement: 60 s')",),
        "thousands": ("decimal comma and '.' between thousands",),
    }.items():
        file, data = files[name]
        (tmp_path / file).write_bytes(data)
        (note,) = read_log(tmp_path / file).notes
        assert all(word in note for word in words), note
        assert "\n" not in note


def test_a_mapping_says_the_unit_or_takes_that_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Time [ms];HallA [µm];IFM\n0;1,5;2\n1;2,5;3\n")
    log = read_log(path, columns={"t": "Time", "hall_a": "HallA", "x_ref_nm": "IFM"})
    assert log.array("hall_a_m").tolist() == [1.5 * 1e-6, 2.5 * 1e-6]
    assert log.array("t_s").tolist() == [0.0, 1e-3]
    by_whole_name = read_log(path, columns={"hall_a_um": "HallA [µm]"})
    assert by_whole_name.array("hall_a_m").tolist() == [1.5 * 1e-6, 2.5 * 1e-6]
    other = read_log(path, columns={"hall_a_mm": "HallA"})
    assert other.array("hall_a_m")[0] == pytest.approx(1.5e-3)
    assert "Column 'HallA' is read in mm as stated; its header says um." in other.notes
    with pytest.raises(InputError, match="must end with the unit"):
        read_log(path, columns={"x_ref": "IFM"})


def test_a_calibration_remembers_the_names_of_its_log(
    tmp_path: Path, columns: dict[str, np.ndarray], usual: Fit
) -> None:
    """The next log of the machine needs no option, in another format neither; ours need none anyway."""
    named = {"hall_a_m": "HallA", "x_ref_m": "IFM"}
    table = {
        named.get(c, c): v * (1e6 if c == "hall_a_m" else -1.0 if c == "x_ref_m" else 1.0)
        for c, v in columns.items()
    }
    (tmp_path / "columns.toml").write_text(
        '[columns]\nhall_a_um = "HallA"\nx_ref_m = { name = "IFM", sign = -1 }\n'
    )
    path = tmp_path / "lab.csv"
    path.write_text(
        rows(
            list(table),
            [list(map(repr, row)) for row in zip(*(v.tolist() for v in table.values()), strict=True)],
        )
    )
    first = fit(read_log(path, column_file=tmp_path / "columns.toml"), "stage31", solver="direct")
    assert same(first, usual)
    first.save(tmp_path / "calib.json")
    known = hallsym.load_fit(tmp_path / "calib.json")
    assert dict(known.columns) == dict(first.columns)
    found = hallsym.evaluate(known, path)
    assert "Columns are named as in the calibration: hall_a_um is 'HallA', x_ref_m is 'IFM'." in found.notes
    direct = hallsym.evaluate(known, columns)
    assert not any("named as in" in note for note in direct.notes)
    assert found.table.over()["rmse"]["x_m"] == pytest.approx(direct.table.over()["rmse"]["x_m"], rel=1e-9)
    assert "columns" not in usual.to_dict()


def test_a_remembered_name_in_another_unit_is_asked_about(tmp_path: Path) -> None:
    from hallsym.log import Foreign

    path = tmp_path / "next.csv"
    path.write_text("t_s;HallA [mm]\n0;1,5\n1;2,5\n")
    with pytest.raises(InputError, match=r"is in mm by its header; .* it was in um: .*hall_a_mm=HallA"):
        read_log(path, remembered={"hall_a_um": Foreign("HallA")})
    log = read_log(path, remembered={"hall_a_um": Foreign("HallA")}, columns={"hall_a_mm": "HallA"})
    assert log.array("hall_a_m")[0] == pytest.approx(1.5e-3)
    assert (
        read_log(path, remembered={"hall_a": Foreign("HallA")}).array("hall_a_m")[0]
        == log.array("hall_a_m")[0]
    )


@pytest.mark.parametrize("name", ["log.xlsx", "log.h5", "log.mat", "log.csv.gz"])
def test_what_is_only_read_is_not_written(tmp_path: Path, columns: dict[str, np.ndarray], name: str) -> None:
    with pytest.raises(InputError, match=r"not written as .*end .* with \.parquet"):
        hallsym.write_log(columns, tmp_path / name)


def test_head_of_a_file(tmp_path: Path) -> None:

    path = tmp_path / "lab.csv"
    path.write_text("Time;HallA;Note\ns;um;\n0;1,50;ok\n1;2,50;ok\n")
    source = open_source(path)[2]
    assert source.head(1, 2) == [["0", "1,50"]]
    assert dict(source.units) == {"Time": "s", "HallA": "um"}
    assert source.recognised.startswith("UTF-8, columns separated by semicolons, decimal comma")


COUNTED = [f"{k};{k},5" for k in range(30)]


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (["LabVIEW Measurement", "Separator;;", "***End_of_Header***;", ";", "t [s];x_ref [um]"], COUNTED),
        (["t;x_ref;run", "s;um;1"], [f"{line};0" for line in COUNTED]),
        (["Datum;t_s;x_ref µm"], [f"22.11.2026;{line}" for line in COUNTED]),
        (["Time;t [s];x_ref (um)"], [f"2026-11-22 12:00:{k:02d},5;{k};{k},5" for k in range(30)]),
        (["t_s;ok;x_ref/um"], [f"{k};TRUE;{k},5" for k in range(30)]),
        (["t (s)   x_ref (um)"], [f"  {k}    {k}.5" for k in range(30)]),
        (['"t.s." "x_ref.um."'], [f'"{k}" {k} {k}.5' for k in range(30)]),
        (["t_s;x_ref [um];v_mv"], [f"{k};{k},5;{k if k else '∞'}" for k in range(30)]),
        (["#g;false;true;true", "#d;;_r;", ";table;t_s;x_ref_um"], [f";0;{line}" for line in COUNTED]),
        (["t_s;x_ref_um"], [*COUNTED[:-1], "29;29,5", "", "Messung beendet", ""]),
        (["t_s,x_ref_um"], [f'{k},"{k},5"' for k in range(30)]),
        (['"t_s" ; "x_ref_um"'], [f'"{k}" ; "{k},5"' for k in range(30)]),
        (["t_s;x_ref_mm"], [f"{k};0,{k:03d}5" for k in range(30)]),
        (["# fs: 1 Hz", "# Columns: z x_ref", "# Units: inch um"], [f"{k} {k}.5" for k in range(30)]),
    ],
)
def test_what_programs_write(tmp_path: Path, head: list[str], body: list[str]) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*head, *body, ""]), encoding="utf-8")
    log = read_log(path)
    assert log.array("t_s").tolist() == list(map(float, range(30)))
    assert log.array("x_ref_m")[-1] == pytest.approx(29.5e-6)


def test_a_title_and_a_torn_line_above_numbers_are_no_names(tmp_path: Path) -> None:
    (tmp_path / "putty.log").write_text("== log of 2026.03.02 10:15 ==\n,3.5\n" + "7,1,2.5\n" * 9)
    source = open_source(tmp_path / "putty.log").source
    assert source.names == ("unnamed_0", "unnamed_1", "unnamed_2")
    assert source.read(["unnamed_2"])["unnamed_2"].tolist() == [2.5] * 9


def test_columns_of_one_name_are_numbered_and_answer_to_their_own(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t_s,Hall [um],Hall [um].1,Temp [K]\n0,1,2,300\n1,3,4,301\n")
    log = read_log(path, columns={"hall_a": "Hall [um]", "hall_b": "Hall [um].1"})
    assert log.array("hall_b_m") == pytest.approx([2e-6, 4e-6])
    path.write_text("t_s,Hall [um],Hall [um]\n0,1,2\n1,3,4\n")
    assert read_log(path, columns={"hall_b": "Hall 2"}).array("hall_b_m") == pytest.approx([2e-6, 4e-6])


def test_letters_of_western_europe_are_not_chinese(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes("t_s;Größe [mm];créée\n0;1;2\n1;2;3\n".encode("latin-1"))
    assert open_source(tmp_path / "log.csv").source.names == ("t_s", "Größe", "créée")


@pytest.mark.parametrize(
    "text",
    [
        '{"t_ms": [0, 1], "x_ref_um": [1.5, 2]}',
        '[{"t_ms": 0, "x_ref_um": 1.5}, {"t_ms": 1, "x_ref_um": 2}]',
        '{"rig": {"rate": 1000}, "log": {"t_ms": [0, 1], "ref": {"x_ref_um": [1.5, 2]}}}',
        '{"rig": "A", "log": [{"t_ms": 0, "x_ref_um": 1.5}, {"t_ms": 1, "x_ref_um": 2}]}',
        '{"t_ms": {"0": 0, "1": 1}, "x_ref_um": {"0": 1.5, "1": 2}}',
        '{"columns": ["t_ms", "x_ref_um"], "index": [0, 1], "data": [[0, 1.5], [1, 2]]}',
        '{"t_ms": 0, "ref": {"um": {"x": 1.5}}, "x_ref_um": 1.5}\n{"t_ms": 1, "x_ref_um": 2}\n',
    ],
)
def test_json_of_lists_and_lists_of_json(tmp_path: Path, text: str) -> None:
    (tmp_path / "log.jsonl.gz").write_bytes(gzip.compress(text.encode()))
    log = read_log(tmp_path / "log.jsonl.gz")
    assert log.array("t_s").tolist() == [0.0, 1e-3]
    assert log.array("x_ref_m") == pytest.approx([1.5e-6, 2e-6])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (",t_ms,x_ref_um\nRange:,10,10\n" + "".join(f",{k},{k}.5\n" for k in range(9)), "left out ('Range:"),
        ("t_ms,0,1,2,3\nx_ref_um,0.5,1.5,2.5,3.5\n", "transposed"),
        ("Hz,200\nt_ms;ms;0;1;2;3\nx_ref_um;um;0,5;1,5;2,5;3,5\n", "transposed"),
    ],
)  # fmt: skip
def test_what_is_no_sample_and_what_lies_on_its_side_is_said(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "log.csv").write_text(text)
    log = read_log(tmp_path / "log.csv")
    assert log.array("x_ref_m")[:4] == pytest.approx([0.5e-6, 1.5e-6, 2.5e-6, 3.5e-6])
    assert any(said in note for note in log.notes)


def test_a_list_in_each_sample_of_json_is_columns(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text('{"t_s": 0, "hall_um": [1, 2.5]}\n{"t_s": 1, "hall_um": [3, 4]}\n')
    source = read_log(tmp_path / "log.jsonl").table.source
    assert source.names == ("t_s", "hall_0_um", "hall_1_um")
    assert source.read(["hall_1_um"])["hall_1_um"].tolist() == [2.5, 4.0]


def test_repetitions_are_runs_where_each_has_a_time(tmp_path: Path) -> None:
    head = "Time #1 [ms];x_ref #1 [um];Time #2 [ms];x_ref #2 [um]"
    (tmp_path / "log.csv").write_text(f"{head}\n0;1;0;3\n1;2;1;4\n")
    log = read_log(tmp_path / "log.csv", columns={"t": "Time", "x_ref": "x_ref"})
    assert log.runs == (1, 2)
    (tmp_path / "log.csv").write_text("t_s;Hall #1 [um];Hall #2 [um]\n0;1;3\n1;2;4\n")
    assert read_log(tmp_path / "log.csv").table.source.names == ("t_s", "Hall #1", "Hall #2")


def test_a_bad_byte_far_into_a_compressed_file_harms_its_own_cell(tmp_path: Path) -> None:
    text = "t_s,x_ref_m,note\n" + "".join(f"{k},{k}e-9,as before\n" for k in range(20_000))
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(text.encode() + b"20000,1e-3,\xff\n"))
    log = read_log(tmp_path / "log.csv.gz")
    assert (log.rows, log.array("x_ref_m")[-1]) == (20_001, 1e-3)


def test_lines_after_a_table_are_left_out_wherever_the_text_is_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "log.csv").write_text("t_s,x_ref_m\n0,1\n# pause\n1,2\n\n\nEnd: 2 s\n,\n\n")
    for piece in (1, 5, 17, 4096):
        monkeypatch.setattr("hallsym.log.text.sniff.PIECE", piece)
        log = read_log(tmp_path / "log.csv")
        assert (log.rows, log.array("x_ref_m").tolist()) == (2, [1.0, 2.0]), piece


def test_names_in_another_order_are_no_header_that_comes_again(tmp_path: Path) -> None:
    rows = "".join(f"{k},{k}e-6,{k}e-6\n" for k in range(9))
    head = "rig,3,3\nt_s,12:30,12:30\nt_s,x_ref_m,y_ref_m\n"
    (tmp_path / "log.csv").write_text(
        head + rows + head.replace("12:30", "12:40").replace("x_ref_m,y_ref_m", "y_ref_m,x_ref_m") + rows
    )
    with pytest.raises(InputError, match=r"Line 14 .* names the columns anew"):
        read_log(tmp_path / "log.csv").array("x_ref_m")
