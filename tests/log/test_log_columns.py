"""Names carry units, foreign names are mapped with theirs, and nothing is guessed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from log_samples import refusal

from hallsym.errors import InputError
from hallsym.log import Foreign, Log, parse_column_option, read_column_file, read_log, write_log
from hallsym.units import split_unit


@pytest.mark.parametrize(
    ("column", "value", "si", "expected"),
    [
        ("x_ref_um", 2.0, "x_ref_m", 2e-6),
        ("rz_ref_urad", 3.0, "rz_ref_rad", 3e-6),
        ("t_ms", 4.0, "t_s", 4e-3),
        ("angle_ref_deg", 180.0, "angle_ref_rad", np.pi),
        ("rx_arcsec", 3600.0, "rx_rad", np.pi / 180),
        ("speed_rpm", 60.0, "speed_rad_s", 2 * np.pi),
        ("temperature_k", 293.15, "temperature_degc", 20.0),
        ("Temp (F)", 68.0, "Temp_degc", 20.0),
        ("v_sin_mv", 5.0, "v_sin_v", 5e-3),
        ("hall_a_count", 7.0, "hall_a_count", 7.0),
        ("hall_a_mt", 7.0, "hall_a_t", 7e-3),
    ],
)
def test_a_column_whose_name_states_its_unit_becomes_si(
    column: str, value: float, si: str, expected: float
) -> None:
    log = Log.from_arrays({"run": np.zeros(3), column: np.full(3, value)})
    assert log.columns == ("run", si)
    assert log.array(si) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("name", ["hall_a", "hall_t", "v_s", "col_3", "x_ref", "t", "v_sin", "HallA"])
def test_a_probe_letter_is_no_unit(name: str) -> None:
    assert split_unit(name) == (name, None)


def test_mapping_with_unit(tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    path.write_text("Time,HallA,x_ref_m,X_um\n0,1,1,5\n1,2,2,6\n")
    columns = dict(map(parse_column_option, ("hall_a_um=HallA", "t_ms = Time", "x_ref_um=X_um")))
    log = read_log(path, columns=columns)
    assert log.array("hall_a_m").tolist() == [1e-6, 2e-6]
    assert log.array("t_s").tolist() == [0, 1e-3]
    assert log.array("x_ref_m") == pytest.approx([5e-6, 6e-6])  # the mapping wins over the file's own name


def test_column_file_with_sign_scale_and_noise(tmp_path: Path) -> None:
    (tmp_path / "columns.toml").write_text(
        '[columns]\nrun = "Nr"\nhall_a_um = "A"\nhall_b_m = {name = "B", sign = -1, scale = 0.5}\n'
        "[noise]\nhall_um = 0.5\n"
    )
    (tmp_path / "lab.csv").write_text("Nr,A,B\n3,1,2\n3,2,4\n")
    log = read_log(tmp_path / "lab.csv", column_file=tmp_path / "columns.toml")
    assert log.runs == (3,)
    assert log.array("hall_b_m").tolist() == [-1.0, -2.0]
    assert log.noise["hall_b_m"].value == pytest.approx(5e-7)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"hall_a": "HallA"}, "must end with the unit.*hall_a_m"),
        ({"hall_a_rad": "HallA"}, "unit of 'hall_a'.*instead received 'rad'"),
        ({"t_um": "HallA"}, "unit of 't'"),
        ({"hall_a_um": "HalA"}, "no column 'HalA'.*did you mean 'HallA'"),
        ({"hall_a_um": "HallA", "hall_a_mm": "HallB"}, "hall_a_m twice"),
        ({"gain": "HallA"}, "must end with the unit"),
    ],
)
def test_bad_mapping(tmp_path: Path, columns: dict[str, str], says: str) -> None:
    (tmp_path / "lab.csv").write_text("HallA,HallB\n1,2\n")
    with refusal(says):
        read_log(tmp_path / "lab.csv", columns=columns)


def test_no_column_with_a_unit_says_how_to_map(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text("HallA,HallB\n1,2\n")
    with pytest.raises(InputError, match=r"HallA, HallB; map them with --column hall_a_um=ITS_NAME"):
        read_log(tmp_path / "lab.csv")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[columns]\nhall_a_um = 3\n", 'must be a table .* write it as "Name"'),
        ("[columns]\nhall_a_um = {name = 'A', sign = 2}\n", "sign.*sign = -1"),
        ("[columns]\nhall_a_um = {name = 'A', gain = 2}\n", "unknown key 'gain'"),
        ("[columns]\nhall_a_um = {name = 'A', scale = 0}\n", "scale other than zero"),
        ("[column]\n", r"Unknown key 'column' in .*did you mean 'columns'"),
        ("[noise]\nhall_m = -1\n", "positive"),
        ("[columns\n", "not valid TOML"),
    ],
)
def test_bad_column_file(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "c.toml").write_text(text)
    with refusal(says):
        read_column_file(tmp_path / "c.toml")


def test_counts_have_a_scale_and_an_offset(tmp_path: Path) -> None:
    (tmp_path / "columns.toml").write_text(
        '[columns]\nhall_a_um = {name = "A,1", scale = 0.5, offset = -100}\n'
        'temperature_k = {name = "T", offset = 1}\n'
    )
    (tmp_path / "lab.csv").write_text("A,1;T;R\n300;299;64\n302;300;0\n")
    log = read_log(tmp_path / "lab.csv", column_file=tmp_path / "columns.toml")
    assert log.array("hall_a_m") == pytest.approx([50e-6, 51e-6])
    assert log.array("temperature_degc") == pytest.approx([26.85, 27.85])
    text = "hall_a_um=A,1,scale=0.5,offset=-100"
    ours, foreign = parse_column_option(text)
    assert (ours, foreign) == ("hall_a_um", Foreign("A,1", 0.5, -100.0))
    assert f"{ours}={foreign.option}" == "hall_a_um=A,1,scale=0.5,offset=-100.0"
    angle = read_log(
        tmp_path / "lab.csv",
        columns=dict([parse_column_option("angle_count=R,counts_per_turn=256,offset=-64")]),
    )
    assert angle.array("angle_rad") == pytest.approx([0.0, -np.pi / 2])
    with pytest.raises(InputError, match="scale as a number"):
        parse_column_option("hall_a_um=A,scale=x")


def test_noise_that_belongs_to_no_column_is_refused(tmp_path: Path) -> None:
    write_log({"hall_a_m": np.arange(9.0)}, tmp_path / "log.csv")
    with pytest.raises(InputError, match=r"'hal_m'.*belongs to no column"):
        read_log(tmp_path, noise={"hal_m": 1e-6})
    with pytest.raises(InputError, match="positive"):
        read_log(tmp_path, noise={"hall_m": 0.0})


def test_runs_must_be_whole_and_contiguous() -> None:
    with pytest.raises(InputError, match="whole run numbers"):
        Log.from_arrays({"run": np.array([0, 0.5]), "x_ref_m": np.zeros(2)}).runs  # noqa: B018
    log = Log.from_arrays({"run": np.array([0, 1, 0]), "x_ref_m": np.zeros(3)}, name="bench")
    with pytest.raises(InputError, match="Run 0 of bench must be contiguous; it comes back after run 1"):
        list(log.blocks())


def test_unknown_run_and_column_name_what_there_is() -> None:
    log = Log.from_arrays({"run": np.array([4, 5]), "x_ref_m": np.zeros(2)})
    with pytest.raises(InputError, match="no run 9; it has runs 4, 5"):
        log.run(9)
    with pytest.raises(InputError, match=r"no column x_rf_m.*did you mean 'x_ref_m'"):
        log.array("x_rf_m")
    named = read_log({"t_s": np.zeros(2), "x1_col_1_v": np.zeros(2), "Sinus [mV]": np.zeros(2)})
    for ours, near in (("x1_col_0_v", ""), ("v_sin_v", r" \(did you mean 'Sinus'\?\)")):
        with pytest.raises(InputError, match=f"no column {ours}{near}; it has"):
            named.array(ours)
    with pytest.raises(ValueError, match="read-only"):
        log.array("x_ref_m")[0] = 1.0
