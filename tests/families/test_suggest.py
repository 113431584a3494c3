"""Which column could be which: by its name, its unit, and by what the data do; never applied by itself."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from twins import bundled

import hallsym
from hallsym.errors import InputError
from hallsym.families.suggest import Suggestion, suggest
from hallsym.log import open_source, read_column_file, read_log


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    """Ten runs of the bundled campaign."""
    return bundled(slice(0, 20, 2))


LAB = {
    "run": ("Pass", 1.0), "t_s": ("Time [ms]", 1e3), "hall_a_m": ("HallA [um]", 1e6),
    "hall_b_m": ("HallB [um]", 1e6), "hall_c_m": ("HallC [um]", 1e6), "z_m": ("Height [mm]", 1e3),
    "rx_rad": ("Roll [mrad]", 1e3), "ry_rad": ("Pitch [mrad]", 1e3), "x_ref_m": ("IFM_X [nm]", 1e9),
    "y_ref_m": ("IFM_Y [nm]", 1e9), "rz_ref_rad": ("IFM_Yaw [urad]", 1e6),
}  # fmt: skip


def guessed(columns: dict[str, np.ndarray], **others: tuple[str, float]) -> Suggestion:
    """Suggest for the columns under a laboratory's names."""
    names = LAB | others
    return suggest(open_source({names[c][0]: v * names[c][1] for c, v in columns.items()})[2])


def found(suggestion: Suggestion) -> dict[str, tuple[str, str, int]]:
    return {g.stem: (g.theirs, g.unit, g.sign) for g in suggestion.guesses}


def test_names_and_units(columns: dict[str, np.ndarray]) -> None:
    made = guessed(columns)
    assert made.model.name == "stage31"
    assert made.rest == ()
    for ours, (name, _) in LAB.items():
        stem = "run" if ours == "run" else ours.rpartition("_")[0]
        text, _, unit = name.partition(" [")
        assert found(made)[stem] == (text, unit.rstrip("]"), 1), ours


def test_numbers_stand_for_letters(columns: dict[str, np.ndarray]) -> None:
    for first in (0, 1):
        names = {f"hall_{c}_m": (f"Hall{k + first} [um]", 1e6) for k, c in enumerate("abc")}
        made = found(guessed(columns, **names))
        assert [made[f"hall_{c}"][0] for c in "abc"] == [f"Hall{k + first}" for k in range(3)]


def test_readings_without_a_name_are_found_by_what_they_move_with(columns: dict[str, np.ndarray]) -> None:
    names = {"hall_a_m": ("U7", 1e6), "hall_b_m": ("U2", -1e6), "hall_c_m": ("U5", 1e3)}
    made = found(guessed(columns, **names))
    assert made["hall_a"] == ("U7", "um", 1)
    assert made["hall_b"] == ("U2", "um", -1)
    assert made["hall_c"] == ("U5", "mm", 1)


def test_numbered_readings_of_any_name_are_the_channels_in_order(columns: dict[str, np.ndarray]) -> None:
    """Also names written with the letter of their axis, and a time of which only the unit tells."""
    names = {f"hall_{c}_m": (f"S{k} [um]", 1e6) for k, c in enumerate("abc")}
    names |= {"x_ref_m": ("Xlaser [um]", 1e6), "y_ref_m": ("laserY [um]", 1e6), "t_s": ("ts [ms]", 1e3)}
    made = found(guessed(columns, **names))
    assert [made[stem][0] for stem in ("hall_a", "hall_b", "hall_c", "x_ref", "y_ref", "t")] == [
        "S0", "S1", "S2", "Xlaser", "laserY", "ts",
    ]  # fmt: skip
    names = {"x_ref_m": ("laser_0 [um]", 1e6), "y_ref_m": ("laser_1 [um]", 1e6), "z_m": ("height [um]", 1e6)}
    names |= {"rx_rad": ("tilt_0 [urad]", 1e6), "ry_rad": ("tilt_1 [urad]", 1e6)}
    names |= {f"hall_{c}_m": (f"hall_{k} [um]", 1e6) for k, c in enumerate("abc")}
    made = found(guessed(columns, **names))
    assert [made[c.rpartition("_")[0]][0] for c in names] == [
        name.partition(" ")[0] for name, _ in names.values()
    ]


@pytest.mark.parametrize(
    ("x", "yaw"), [("Réf X", "Lacet"), ("Xref", "Guiñada Rz"), ("IfmX", "Rzref"), ("干渉計X", "ヨー角Rz")]
)
def test_names_in_other_languages_and_the_last_reference_of_a_unit(
    columns: dict[str, np.ndarray], x: str, yaw: str
) -> None:
    names = {
        "x_ref_m": (f"{x} [um]", 1e6),
        "rz_ref_rad": (f"{yaw} [urad]", 1e6),
        "rx_rad": ("TiltX_mrad", 1e3),
    }
    made = found(guessed(columns, **names))
    assert (made["x_ref"], made["rz_ref"]) == ((x, "um", 1), (yaw, "urad", 1))
    assert made["rx"] == ("TiltX_mrad", "mrad", 1)


def test_what_a_file_says_of_its_counts_is_their_scale_and_samples_may_stand_twice(tmp_path: Path) -> None:
    """A wave of 30 mm in counts of 0.1 mV, the reference in fringes; columns with an index in brackets."""
    x = np.repeat(np.linspace(0, 0.06, 500), 2)
    halls = [np.round(5e3 * np.sin(2 * np.pi * (x / 0.03 - k / 3))) for k in range(3)]
    table = np.column_stack([np.repeat(np.arange(500), 2), *halls, x / 158e-9, np.full(1000, 6.0)])
    head = "ADC;16 bit, 1 LSB = 0.1 mV\nLaser;158 nm/fringe\nTime [ms];H(1);H(2);H(3);X (fringes);Z [mm]\n"
    rows = "\n".join(";".join(f"{v:.0f}" for v in row) for row in table.tolist())
    (tmp_path / "log.csv").write_text(f"{head}{rows}\n")
    made = suggest(open_source(tmp_path / "log.csv").source, "halbach")
    assert {g.ours: (g.theirs, g.scale) for g in made.guesses} == {
        "t_ms": ("Time", None), "col_0_mv": ("H(1)", 0.1), "col_1_mv": ("H(2)", 0.1),
        "col_2_mv": ("H(3)", 0.1), "x_ref_nm": ("X (fringes)", 158.0), "z_ref_mm": ("Z", None),
    }  # fmt: skip
    assert not made.open
    (tmp_path / "log.csv").write_text(f"Monitor;1 LSB = 1 mV\n{head}{rows}\n")  # which is not known
    made = suggest(open_source(tmp_path / "log.csv").source, "halbach")
    assert {g.ours for g in made.guesses} >= {"col_0_v", "x_ref_nm"}


def test_numbered_sums_are_as_many_columns_of_an_array() -> None:
    x, z = np.linspace(0, 0.06, 500), np.full(500, 6e-3)
    waves = {f"H{k:02d} [mV]": 500 * np.sin(2 * np.pi * (x / 0.03 - k / 3)) for k in range(1, 6)}
    made = suggest(open_source({"X_laser_um": 1e6 * x, "gap_um": 1e6 * z, **waves})[2])
    assert made.model.name == "halbach"
    assert [found(made)[f"col_{k}"] for k in range(5)] == [(f"H{k + 1:02d}", "mv", 1) for k in range(5)]


def test_numbers_of_readings_count_from_one_where_ours_count_from_zero() -> None:
    model = hallsym.build("halbach_planar")
    names = [re.sub(r"\d+_v", lambda n: f" {int(n[0][:-2]) + 1} [mV]", c) for c in model.channels]
    made = suggest(open_source({n: np.sin(k + RAMP) for k, n in enumerate(names)})[2], model.name)
    assert [found(made)[c[:-2]][0] for c in model.channels] == [n[:-5] for n in names]


@pytest.mark.parametrize(
    ("name", "zero", "span", "unit", "entry"),
    [
        ("Angle [counts]", 0.0, 4096, "count", 'angle_count = { name = "Angle", counts_per_turn = 4096 }'),
        ("Angle [V]", 0.5, 4.0, "rad", '# angle_rad = { name = "Angle", scale = 1.0, offset = 0.0 }'),
    ],
)
def test_an_angle_in_counts_or_in_volts(name, zero, span, unit, entry) -> None:
    t = np.arange(4000) * 1e-3
    angle = 2 * np.pi * 0.5 * t
    raw = zero + span * (angle / (2 * np.pi) % 1)
    raw = np.floor(raw) if unit == "count" else raw
    made = suggest(open_source({"time [s]": t, name: raw, "Angle ref [deg]": np.degrees(angle)})[2])
    assert made.model.name.startswith("rotary")
    assert found(made)["angle"] == ("Angle", unit, 1)
    assert found(made)["angle_ref"] == ("Angle ref", "deg", 1)
    assert entry in made.to_toml("log")


def test_the_column_file_that_is_written_is_read(columns: dict[str, np.ndarray], tmp_path: Path) -> None:
    path = tmp_path / "columns.toml"
    path.write_text(guessed(columns, hall_b_m=("U2", -1e6)).to_toml("lab.csv"), encoding="utf-8")
    stated = read_column_file(path)
    assert stated.columns["hall_b_um"].sign == -1
    table = {LAB[c][0]: v * LAB[c][1] for c, v in columns.items()} | {"U2": -1e6 * columns["hall_b_m"]}
    log = read_log(table, column_file=path)
    assert np.allclose(log.array("hall_b_m"), columns["hall_b_m"], rtol=1e-12)


def test_what_has_no_unit_is_written_as_a_comment() -> None:
    t = np.arange(100) * 1e-3
    made = suggest(open_source({"time": t, "Temp": 20 + 1e3 * t, "Words": ["a"] * 100})[2], "stage31")
    text = made.to_toml("lab.csv")
    assert '# temperature_UNIT = "Temp"' in text or 'temperature_degc = "Temp"' in text
    assert "hall" not in text.split("[columns]")[1]
    with pytest.raises(InputError, match="must hold numbers; it holds words"):
        suggest(open_source({"Words": ["a"] * 100})[2])


def test_columns_of_ours_stay_what_they_are() -> None:
    """A name of ours is not taken for another one of ours, and needs no line."""
    log = hallsym.bundled_campaign()
    few = {c: log.array(c)[:500] for c in log.columns} | {"hall_7_v": log.array("hall_a_m")[:500]}
    made = suggest(
        open_source({c: v for c, v in few.items() if c != "hall_a_m"} | {"z_ref_m": few["z_m"]})[2]
    )
    assert "hall_a" not in found(made)
    assert found(made)["z"][0] == "z_m"
    assert set(made.rest) == {"hall_7_v", "z_ref_m"}
    text = made.to_toml("log").split("[columns]")[1]
    assert all(line.startswith("#") for line in text.strip().split("\n"))


def units_of(name: str, values: np.ndarray, model: str = "stage31") -> tuple[str, ...]:
    """The units among which somebody has to choose for a column whose file states none."""
    made = suggest(open_source({name: values})[2], model)
    return next(g.units for g in made.guesses if g.theirs == name)


RAMP = np.linspace(0.0, 1.0, 500)


@pytest.mark.parametrize(
    ("name", "values", "model", "units"),
    [
        ("IFM X", 600.3 * RAMP, "stage31", ("mm", "um", "nm")),
        ("IFM X", 1e-3 * RAMP, "stage31", ("m", "mm")),  # no sensor resolves a nanometre of travel
        ("IFM Yaw", 600.3 * RAMP, "stage31", ("urad", "nrad")),
        ("Time", np.arange(500) * 1e-3, "stage31", ("s",)),
        ("Time", np.arange(500.0), "stage31", ("s", "ms")),
        ("Angle ref", 360.0 * (5 * RAMP % 1), "rotary", ("deg",)),
        ("Angle ref", 2 * np.pi * (5 * RAMP % 1), "rotary", ("rad",)),
        ("Angle ref", 40.0 * RAMP, "rotary", ("rad", "deg")),
    ],
)
def test_units_that_a_size_leaves_open(
    name: str, values: np.ndarray, model: str, units: tuple[str, ...]
) -> None:
    assert units_of(name, values, model) == units


def test_whole_numbers_over_eight_bits_may_be_counts() -> None:
    few, many = (np.round(n * RAMP) for n in (255, 256))
    for values, raw in ((few, ""), (many, "counts")):
        (guess,) = suggest(open_source({"HallA": values})[2], "stage31").guesses
        assert guess.raw == raw
        assert guess.open
        assert any("scale" in line for line in guess.lines) == bool(raw)
    (unknown,) = suggest(open_source({"HallA (furlong)": RAMP})[2], "stage31").guesses
    assert unknown.open
    assert "state um per furlong" in unknown.why
    (volts,) = suggest(open_source({"HallA [V]": RAMP})[2], "stage31").guesses
    assert volts.lines == ['# hall_a_um = { name = "HallA", scale = 1.0, offset = 0.0 }']


def test_references_tell_the_unit_of_readings(columns: dict[str, np.ndarray]) -> None:
    made = found(guessed(columns, **{f"hall_{c}_m": (f"Hall{c.upper()}", 1e6) for c in "abc"}))
    assert {made[f"hall_{c}"][1] for c in "abc"} == {"um"}


@pytest.mark.parametrize(
    ("names", "angle", "entry"),
    [
        (("ch1", "ch2", "angle"), lambda turns: 360 * turns, "angle_ref_deg"),
        (("V1", "V2", "theta_ref"), lambda turns: 21600 * turns, "angle_ref_arcmin"),
        (("A", "B", "position_arcsec"), lambda turns: 1296e3 * turns, "angle_ref_arcsec"),
        (("sinus", "cosinus", "encoder"), lambda turns: np.round(2**17 * turns), "angle_ref_count"),
    ],
    ids=["deg", "arcmin", "arcsec", "counts"],
)
def test_readings_tell_the_unit_of_an_angle_and_which_columns_they_are(names, angle, entry) -> None:
    """Eleven turns with a zero of its own: in any other unit no combination of sine and cosine follows."""
    turns = np.linspace(0, 11.3, 4000)
    volts = [np.sin(2 * np.pi * turns + 0.7), np.cos(2 * np.pi * turns + 0.7)]
    file = dict(zip(names, (*volts, angle(turns)), strict=True))
    found = suggest(open_source(file).source, "rotary")
    theirs = {g.ours: g for g in found.guesses}
    assert (theirs["v_sin_v"].theirs, theirs["v_cos_v"].theirs) == names[:2]
    assert theirs[entry].theirs == names[2]
    assert theirs[entry].counts_per_turn in (None, 2**17)
