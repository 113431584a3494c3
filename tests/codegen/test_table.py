"""A calibration as a maker's table: what the firmware then computes, from its own source, is the angle."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rings import Ring, recorded, ring
from twins import with_arrays

import hallsym
from hallsym.cli.main import main
from hallsym.codegen.table import POINTS, Exported, export_table
from hallsym.errors import InputError
from hallsym.estimation import Fit
from hallsym.estimation.without_reference import fit_without_reference
from hallsym.log import Log, Meta
from hallsym.log.maker_tables import BY_NAME, LAYOUTS, TURN, MakerTable, found_in, read_table, text_of
from hallsym.log.phase import wrapped

ROOT = Path(__file__).resolve().parents[2]
BUNDLED = ROOT / "data" / "tables" / "calibration_lut.h"
ANGLE = np.arange(POINTS) * TURN / POINTS
PATTERN = 0.0015
"""Amplitude of the 50 waves of a stepper [rad]."""


def truth(angle: np.ndarray) -> np.ndarray:
    """What a chip reads: the ellipse's one and two waves."""
    return np.arctan2(0.006 + 0.995 * np.sin(angle + 0.01), 0.011 + np.cos(angle))


@cache
def chip(sense: int = 1, pattern: float = 0.0) -> Fit:
    """Calibration of a chip beside a reference, which is off by 50 waves a turn."""
    angle = np.arange(400) * TURN / 400
    noise = 1e-5 * np.random.default_rng(5).standard_normal((2, 400))
    columns = {
        "angle_rad": np.mod(sense * truth(angle) + noise[0] + 0.7, TURN),
        "angle_ref_rad": angle + pattern * np.cos(50 * angle) + noise[1],
    }
    effects = ["reference_pole_pairs"] if pattern else []
    log = hallsym.read_log(columns, noise={"angle_rad": 1e-5})
    return hallsym.fit(log, "rotary", effects=effects)


@cache
def voltages() -> Fit:
    angle = np.arange(400) * TURN / 400
    noise = 1e-5 * np.random.default_rng(6).standard_normal((2, 400))
    columns = {
        "v_sin_v": 0.006 + 0.995 * np.sin(angle + 0.01) + noise[0],
        "v_cos_v": 0.011 + np.cos(angle) + noise[1],
        "angle_ref_rad": angle,
    }
    return hallsym.fit(columns, "rotary")


def left(angle: np.ndarray) -> float:
    """Largest error of angles of either sense beside `ANGLE`, but for a constant."""
    best = []
    for sense in (1, -1):
        off = sense * angle - ANGLE
        off = wrapped(off - np.angle(np.exp(1j * off).mean()), TURN)
        best.append(float(np.abs(off - off.mean()).max()))
    return min(best)


# -- firmware, from the sources that the module names ----------------------------------------------------


def firmware(name: str, values: np.ndarray, raw: np.ndarray, scale: float) -> np.ndarray:
    """What the firmware makes of readings [rad], written here from its source."""
    turn, n = np.mod(raw, TURN) / TURN, len(values)
    cell = np.floor(turn * n).astype(int)
    part = turn * n - cell
    between = (1 - part) * values[cell % n] + part * values[(cell + 1) % n]
    if name == "simplefoc":
        return raw - between
    if name == "moteus":
        return raw + between * scale / 127 * TURN
    if name == "mechaduino":
        return np.radians(values[np.round(turn * 16384).astype(int) % 16384])
    if name == "mechaduino-knots":  # printAngles: straight lines between full steps
        steps = np.append(values, values[0])
        ticks = np.diff(steps)
        ticks[ticks < -15000] += 16384
        ticks[ticks > 15000] -= 16384
        k = np.arange(n)
        at = np.concatenate([values[i] + np.arange(0, abs(ticks[i])) * np.sign(ticks[i]) for i in k])
        step = np.concatenate([i + np.arange(0, abs(ticks[i])) / abs(ticks[i]) for i in k])
        return TURN / n * step[np.argsort(np.mod(at, 16384))[np.floor(turn * 16384).astype(int) % 16384]]
    angles = list(values)  # Klipper: load_calibration and apply_calibration
    flipped = angles[-2] > angles[-1]
    angles = angles[::-1] if flipped else angles
    first = angles.index(min(angles))
    angles = angles[first:] + angles[:first]
    equations, answers = np.zeros((n, 64)), np.zeros(n)
    for step, value in enumerate(angles):
        bucket = int(value) // 1024
        share = (value - bucket * 1024) / 1024
        equations[step, bucket], equations[step, (bucket + 1) % 64] = 1 - share, share
        answers[step] = step * 65536 / n - (share * 65536 if bucket == 63 else 0)
    solved = [int(s + 0.5) for s in np.linalg.lstsq(equations, answers, rcond=None)[0]]
    table = np.array([*solved, solved[0] + 65536])
    whole = np.round(turn * 65536).astype(int) % 65536
    low, high = table[whole >> 10], table[(whole >> 10) + 1]
    return (low + (((whole & 1023) * (high - low) + 512) >> 10)) * (TURN / 65536)


WITHIN = {
    "simplefoc": 2e-5, "mechaduino": 3e-4, "mechaduino-knots": 6e-4, "klipper": 3e-4, "moteus": 1e-4,
}  # fmt: skip
"""Most that is left [rad]: lines between 200 places and 1e-5 of the fit; two digits of a degree; whole counts
of 14 bits; 64 lines and 16 bits; 1/127 of .014 rad."""


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("name", [one.name for one in LAYOUTS])
def test_the_firmware_computes_the_angle(name: str, sense: int) -> None:
    made = export_table(chip(sense), name)
    table = found_in(made.text).table
    raw = sense * truth(ANGLE) + 0.7
    assert left(raw) > 0.01
    computed = firmware(name, table.values, raw, table.scale)
    assert left(computed) < WITHIN[name]
    assert made.before.peak == pytest.approx(left(raw), rel=0.01)
    assert made.after.peak < WITHIN[name]
    assert made.after.rms < made.before.rms / 30
    assert made.summary().startswith(f"The new table of {made.entries} entries lowers the error")


def test_a_table_of_two_voltages_corrects_their_arctangent() -> None:
    made = export_table(voltages(), "simplefoc", entries=128)
    table = found_in(made.text).table
    raw = np.arctan2(0.006 + 0.995 * np.sin(ANGLE + 0.01), 0.011 + np.cos(ANGLE))
    assert len(table.values) == 128
    assert left(firmware("simplefoc", table.values, raw, 1.0)) < 3e-5
    assert abs(table.values.mean()) < 1e-6
    assert any("arctangent of both voltages" in note for note in made.notes)


def test_csv_is_a_log_of_the_encoder(tmp_path: Path) -> None:
    made = export_table(chip(), "csv", entries=360)
    (tmp_path / "t.csv").write_text(made.text)
    columns = hallsym.read_log(tmp_path / "t.csv").run(0)
    assert np.abs(wrapped(columns["angle_rad"] - truth(columns["angle_ref_rad"]) - 0.7, TURN)).max() < 2e-5


@cache
def halls(pairs: int, *effects: str) -> tuple[Ring, Fit]:
    """A ring under Halls at 0, 101 and 262 electrical deg, and its calibration without a reference."""
    own = ring(7, pairs=pairs, places=np.radians([0.0, 101.0, 262.0]))
    x = 2048 + 900 * recorded(own, 7, turns=5.1)[1]
    names = [f"hall{k}_count" for k in (1, 2, 3)]
    meta = Meta(raw={"encoder": {"pole_pairs": pairs}}, columns=tuple(names))
    log = Log.from_arrays(dict(zip(names, x.T, strict=True)), meta=meta)
    return own, fit_without_reference(log, "rings3", "constant-speed", effects=effects).fit


@pytest.mark.parametrize(("pairs", "effects"), [(1, ()), (4, ("turn_waves:count=4,step=4",))])
def test_a_table_of_three_halls_corrects_their_nominal_angle(pairs: int, effects: tuple[str, ...]) -> None:
    own, fit = halls(pairs, *effects)
    made = export_table(fit, "simplefoc", allow_undetermined=True)
    a, b, c = (own.readings(ANGLE) - own.readings(ANGLE).mean(axis=0)).T
    raw = np.unwrap(np.arctan2(np.sqrt(0.75) * (c - b), a - (b + c) / 2)) / pairs
    computed = firmware("simplefoc", found_in(made.text).table.values, raw, 1.0)
    assert made.before.rms == pytest.approx(np.std(raw - ANGLE), rel=0.1)
    assert made.after.rms < made.before.rms / 100
    assert np.std(computed - ANGLE) < np.std(raw - ANGLE) / (20 if pairs == 1 else 2)
    assert any("hall2_count at 120 deg about" in note for note in made.notes)


@pytest.mark.parametrize(("pairs", "effects"), [(1, ()), (4, ("turn_waves:count=4,step=4",))])
def test_the_noise_of_halls_without_a_reference_holds_what_their_ellipse_leaves(pairs, effects) -> None:
    """C compares readings with the plane of their ellipse: harmonics of the field are no fault."""
    own, fit = halls(pairs, *effects)
    x = 2048 + 900 * own.readings(ANGLE)
    plane = np.column_stack(
        [np.ones(len(x)), *np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[0][:, :2].T]
    )
    rest = x - plane @ np.linalg.lstsq(plane, x, rcond=None)[0]
    sigma = np.array([fit.noise.sigmas[c].value for c in fit.model.channels])
    normal = rest[np.abs(rest).sum(axis=1).argmax()]
    assert np.std(rest @ normal) < np.linalg.norm(sigma * normal) < 10 * np.std(rest @ normal)


def test_a_table_that_a_firmware_of_halls_cannot_carry_is_refused() -> None:
    _, fit = halls(4)
    with pytest.raises(InputError, match="differs from one period to the next"):
        export_table(fit, "simplefoc", allow_undetermined=True)
    with pytest.raises(InputError, match="corrects the angle of a chip"):
        export_table(fit, "klipper", allow_undetermined=True)
    assert export_table(fit, "csv", allow_undetermined=True).after.rms < 1e-3


# -- a file of the maker's -------------------------------------------------------------------------------


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("name", ["mechaduino", "klipper", "simplefoc"])
def test_zero_and_sense_of_the_old_table_stay(name: str, sense: int, tmp_path: Path) -> None:
    layout = BY_NAME[name]
    at = np.arange(layout.entries) * TURN / layout.entries
    if layout.absolute:  # of an ideal sensor, turned against its drive by 1.3 rad
        values = np.mod(sense * (at - 1.3), TURN) * layout.per_turn / TURN
    else:
        values = np.full(layout.entries, 0.002)
    old = MakerTable(layout, values, layout.decimals).rounded()
    (tmp_path / "old").write_text(text_of(old))
    made = export_table(chip(), name, like=tmp_path / "old")
    new = found_in(made.text).table
    assert made.old is not None
    assert made.old.rms > 30 * made.after.rms
    assert new.sense == old.sense
    reading = np.linspace(0, TURN, 500)
    shift = wrapped(new.decoded(reading) - old.decoded(reading), TURN)
    assert abs(shift.mean()) < 2e-4
    assert np.abs(shift).max() < 0.02


def test_the_maker_s_file_keeps_all_else() -> None:
    made = export_table(chip(), "simplefoc", like=BUNDLED)
    table, text = read_table(BUNDLED)
    cells = {text[slice(*span)] for span in found_in(text).cells}
    assert "float zero_electric_angle = 2.417306;\nDirection sensor_direction = Direction::CW;\n" in made.text
    same = [line for line in text.splitlines() if not any(cell in line for cell in cells)]
    assert [line for line in made.text.splitlines() if line in same] == same
    assert len(table.values) == made.entries == 100


# -- the reference's own error ---------------------------------------------------------------------------


def waves(made: Exported, n: int, about: int = 0) -> float:
    """Amplitude of the waves n +- about of a table of 400 corrections [rad].

    A wave of the angle has neighbours as a function of the reading, which is not in step with it.
    """
    found = 2 * np.abs(np.fft.rfft(found_in(made.text).table.values)) / 400
    return float(np.sqrt((found[n - about : n + about + 1] ** 2).sum()))


@pytest.mark.slow
def test_waves_of_the_stepper_are_left_out_of_the_table() -> None:
    fit = chip(1, PATTERN)
    plain = export_table(fit, "simplefoc", entries=400)
    kept = export_table(fit, "simplefoc", entries=400, keep_reference=True)
    stated = export_table(fit, "simplefoc", entries=400, keep_reference=True, motor_steps=200)
    assert waves(kept, 50, 10) == pytest.approx(PATTERN, rel=0.02)
    assert waves(plain, 50, 10) < 1e-5
    assert waves(stated, 50, 10) < 3e-5
    assert waves(plain, 1) == pytest.approx(waves(kept, 1), rel=1e-2)
    assert any("reference_pole_pairs) is left out" in note for note in plain.notes)
    assert any("is in the table" in note for note in kept.notes)
    raw = np.unwrap(truth(ANGLE)) + 0.7
    assert left(firmware("simplefoc", found_in(plain.text).table.values, raw, 1.0)) < 5e-5


def test_full_steps_of_the_motor_are_the_entries_of_a_table_by_steps() -> None:
    assert export_table(chip(), "klipper", motor_steps=400).entries == 400
    first = found_in(export_table(chip(), "klipper").text).table.values
    assert int(np.argmin(first)) < 4  # begins with the pole pair of the lowest reading
    assert int(np.argmax(found_in(export_table(chip(-1), "klipper").text).table.values)) < 4


# -- the command -----------------------------------------------------------------------------------------


def test_a_table_goes_through_fit_and_back(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["fit", str(BUNDLED), "--model", "rotary", "--effect", "harmonics", "-o", "calib.json"]) == 0
    assert "35 measured places in 100 entries" in capsys.readouterr().out
    words = ["export", "calib.json", "--table", "simplefoc", "--like", str(BUNDLED), "-o", "new.h"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert said.startswith("The new table of 100 entries lowers the error over the turn from ")
    assert f"with the table in {BUNDLED}" in said
    assert main([*words, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["after"]["rms"] < record["old"]["rms"] < record["before"]["rms"]
    assert record["old"]["rms"] > 20 * record["after"]["rms"]  # a staircase, beside lines
    assert "zero_electric_angle = 2.417306;" in read_table("new.h")[1]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--table", "mechaduno"], "did you mean 'mechaduino'"),
        (["--table", "moteus", "--like", str(BUNDLED)], "must be a table of moteus compensation"),
        (["--table", "simplefoc", "--like", str(BUNDLED), "--entries", "50"], "that of --like, 100"),
        (["--table", "simplefoc", "--entries", "2"], "--entries must be 3 to"),
        (["--table", "simplefoc", "--motor-steps", "201"], "in fours"),
        (["--table", "simplefoc", "--like", "none.h"], "does not exist"),
    ],
)
def test_what_cannot_be_exported_is_said(words: list[str], says: str, tmp_path: Path, capsys) -> None:
    chip().save(tmp_path / "c.json")
    assert main(["export", str(tmp_path / "c.json"), *words, "-o", str(tmp_path / "o.h")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "o.h").exists()


def test_other_machines_and_calibrations_that_no_table_holds_are_refused() -> None:
    stage = hallsym.load_fit(ROOT / "tests" / "golden" / "calib.json")
    with pytest.raises(InputError, match="A table corrects the angle of a chip, of two voltages or of Halls"):
        export_table(stage, "simplefoc")
    fit = chip()
    far = with_arrays(fit, values=fit.values * np.where(np.array(fit.model.names) == "Vx", 0, 1) + 1.5 * (
        np.array(fit.model.names) == "Vx"))  # fmt: skip
    with pytest.raises(InputError):
        export_table(far, "simplefoc")
    open_ = fit.changed(undetermined_by_log=("Vx",))
    with pytest.raises(InputError, match="does not determine Vx"):
        export_table(open_, "simplefoc")
    assert export_table(open_, "simplefoc", allow_undetermined=True).undetermined == ("Vx",)
