"""Tables of makers' firmware: every byte comes back, and a table is the readings that it was made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym.errors import InputError
from hallsym.log import read_log
from hallsym.log.formats import files_of
from hallsym.log.maker_tables import (
    BY_NAME,
    CSV,
    LAYOUTS,
    TURN,
    Layout,
    MakerTable,
    encoded,
    found_in,
    measured,
    read_table,
    replaced,
    stairs,
    text_of,
)
from hallsym.log.phase import wrapped

ROOT = Path(__file__).resolve().parents[2]
BUNDLED = ROOT / "data" / "tables" / "calibration_lut.h"
NAMES = [one.name for one in LAYOUTS]


def error(angle: np.ndarray) -> np.ndarray:
    return 0.008 * np.cos(angle - 1.1) + 0.004 * np.cos(2 * angle + 0.4) + 0.001 * np.cos(4 * angle)


def filled(layout: Layout, count: int, sense: int = 1, scale: float = 0.004) -> MakerTable:
    """A table of an encoder that is off by `error`: entries computed here from the definition of each."""
    at = np.arange(count) * TURN / count
    if layout.at_reading:
        angle = sense * at - error(at)
        values = layout.reading * at + layout.angle * (angle if layout.absolute else at - error(at))
    else:
        values = sense * at + error(at)
    scale = scale if layout.scaled else 1.0
    values = values * layout.per_turn / (TURN * scale)
    return MakerTable(layout, values, layout.decimals, scale=scale).rounded()


@pytest.mark.parametrize("name", NAMES)
def test_a_table_as_the_firmware_prints_it_reads_back(name: str) -> None:
    table = filled(BY_NAME[name], BY_NAME[name].entries)
    text = text_of(table)
    found = found_in(text)
    assert found is not None
    assert found.table.layout is table.layout
    np.testing.assert_array_equal(found.table.values, table.values)
    assert found.table.scale == table.scale
    assert text_of(found.table) == text == replaced(text, found.table)


CELLS = {
    "simplefoc": st.floats(-0.1, 0.1).map(lambda x: f"{x:.6f}"),
    "mechaduino": st.floats(0, 359.99).map(lambda x: f"{x:.2f}"),
    "mechaduino-knots": st.integers(0, 16383).map(str),
    "klipper": st.floats(0, 65535).map(lambda x: f"{x:.1f}"),
    "moteus": st.integers(-127, 127).map(str),
}
GAPS = st.sampled_from([" ", "", "\n    ", "\r\n\t", " /* 1, 2 */ ", " // 3.5\n"])
HEADS = {
    "simplefoc": "float calibrationLut[{n}] = {{",
    "mechaduino": "const float __attribute__((__aligned__(256))) lookup[] = {{",
    "mechaduino-knots": "static const uint16_t fullStepReadings[{n}] = {{",
}


@st.composite
def files(draw: st.DrawFn) -> tuple[str, str, list[str]]:
    """A file as a person may have it: name of its format, text and the cells that it holds."""
    name = draw(st.sampled_from(NAMES))
    count = BY_NAME[name].multiple * draw(st.integers(3, 40) if name in HEADS else st.integers(1, 9))
    cells = draw(st.lists(CELLS[name], min_size=count, max_size=count))
    before = draw(
        st.sampled_from(["", "// 1.0, 2.0\n#include <SPI.h>\r\n", "\ufeff", "int pins[2] = {3, 4};\n"])
    )
    if name in HEADS:
        body = "".join(f"{draw(GAPS)}{cell}{draw(GAPS)}," for cell in cells[:-1]) + draw(GAPS) + cells[-1]
        return (
            name,
            f"{before}{HEADS[name].format(n=len(cells))}{body}{draw(GAPS)}}};\nfloat a = 1.0f;\n",
            cells,
        )
    if name == "klipper":
        mark = draw(st.sampled_from(["", "#*# "]))
        lines = [",".join(cells[k : k + 8]) for k in range(0, len(cells), 8)]
        body = f",\n{mark}\t".join(lines)
        return (
            name,
            f"[mcu]\n{mark}[angle a1]\n{mark}calibrate =\n{mark}\t{body}\n{mark}[probe]\n{mark}z = 1.5\n",
            cells,
        )
    source = draw(st.integers(0, 2))
    entry = f"motor_position.sources.{source}."
    lines = [f"{entry}compensation_table.{k} {cell}\n" for k, cell in enumerate(cells)]
    beside = f"{entry}compensation_scale 0.00312\n{entry}sign -1\n{entry}offset 12.5\n{entry}cpr 16384\n"
    return name, f"id.id 1\n{''.join(lines)}{beside}servo.pid_dq.kp 0.25\n", cells


@settings(max_examples=120, deadline=None)
@given(files(), st.randoms(use_true_random=False))
def test_every_byte_of_a_file_that_is_not_a_changed_number_stays(file, random) -> None:
    name, text, cells = file
    found = found_in(text)
    assert found is not None
    assert found.table.layout.name == name
    assert [text[slice(*span)] for span in found.cells] == cells
    assert replaced(text, found.table) == text
    other = list(cells)
    random.shuffle(other)
    values = np.array([float(cell) for cell in other])
    changed = replaced(text, MakerTable(found.table.layout, values, found.table.decimals, found.table.scale))
    again = found_in(changed)
    assert again is not None
    np.testing.assert_array_equal(again.table.values, values)
    parts, last = [], 0  # what stands between the numbers
    for first, end in again.cells:
        parts.append(changed[last:first])
        last = end
    ours = [
        text[a:b]
        for a, b in zip([0, *(e for _, e in found.cells)], [s for s, _ in found.cells], strict=False)
    ]
    assert parts == ours


def test_bytes_of_any_coding_come_back(tmp_path: Path) -> None:
    data = BUNDLED.read_bytes().replace(b"\n", b"\r\n") + b"// Gr\xf6\xdfe in Bogenma\xdf\r\n"
    (tmp_path / "t.h").write_bytes(data)
    table, text = read_table(tmp_path / "t.h")
    assert encoded(replaced(text, table)) == data


SENSES = [(name, sense) for name, one in BY_NAME.items() for sense in (1, -1) if one.absolute or sense > 0]
"""A table of corrections has the sense of its readings."""


@pytest.mark.parametrize(("name", "sense"), SENSES)
def test_entries_are_readings_beside_angles(name: str, sense: int) -> None:
    layout = BY_NAME[name]
    table = filled(layout, layout.entries, sense)
    reading, angle = table.rows
    off = error(reading if layout.at_reading else angle)
    truth = sense * (reading - off) if not layout.at_reading else sense * reading - off
    step = table.unit * 10.0**-layout.decimals
    assert np.abs(wrapped(angle - truth, TURN)).max() < 0.6 * step + 1e-9
    assert table.sense == sense
    # Klipper keeps 64 lines, which leave (2 pi n / 64)^2 / 8 of wave n, in whole 65536ths of a turn
    lines = sum(a * (TURN * n / 64) ** 2 / 8 for n, a in ((1, 0.008), (2, 0.004), (4, 0.001)))
    coarse = lines + TURN / 65536 / 2 if layout.lines else 1e-9
    assert np.abs(wrapped(table.decoded(reading) - angle, TURN)).max() < coarse


def test_moteus_reads_sign_offset_and_scale_of_its_source() -> None:
    entries = "".join(f"motor_position.sources.1.compensation_table.{k} {k - 4}\n" for k in range(32))
    text = (
        "motor_position.sources.0.sign 1\nmotor_position.sources.1.sign -1\n"
        f"motor_position.sources.1.offset 4096\n{entries}motor_position.sources.1.compensation_scale 0.0127\n"
    )
    found = found_in(text)
    assert found is not None
    table = found.table
    assert (table.sign, table.scale) == (-1, 0.0127)
    assert table.shift == pytest.approx(TURN / 4)
    assert table.unit == pytest.approx(TURN * 1e-4)
    reading, angle = table.rows
    np.testing.assert_allclose(angle - reading, TURN * 1e-4 * (np.arange(32) - 4), atol=1e-12)
    scaled = replaced(text, MakerTable(table.layout, table.values, 0, 0.02))
    assert "sources.1.compensation_scale 0.02\n" in scaled
    with pytest.raises(InputError, match="compensation_scale"):
        found_in(entries)


# -- what a table was made of ------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(st.integers(20, 400), st.data())
def test_a_staircase_is_told_from_a_smooth_table(entries: int, data) -> None:
    places = data.draw(st.integers(5, entries - 4))
    shift = data.draw(st.integers(0, entries - 1))
    ticks = np.random.default_rng(places).standard_normal(places)
    copied = ticks[(np.arange(entries) * places // entries)]  # as CalibratedSensor fills its table
    begins = stairs(np.roll(copied, shift))
    assert begins is not None
    assert len(begins) == places
    assert stairs(np.random.default_rng(entries).standard_normal(entries)) is None
    uneven = np.repeat(ticks, np.r_[entries, np.ones(places - 1, int)])
    assert stairs(uneven) is None


def calibrated_sensor(pole_pairs: int, entries: int, sense: int, start: float) -> np.ndarray:
    """The table that CalibratedSensor::calibrate makes of a sensor which reads angle + error(angle)."""
    ticks = 5 * pole_pairs

    def off(elec: np.ndarray) -> np.ndarray:  # sense (reading - first reading) - angle of the motor
        angle = start + sense * elec
        return sense * (angle + error(angle) - start - error(start)) - elec

    k = np.arange(ticks) * TURN / ticks
    both = (off(k + TURN / ticks) + off(k)) / 2  # forward: measured after the step; back: before it
    smooth = np.mean([np.roll(both, j) for j in (-2, -1, 0, 1, 2)], axis=0)
    table = np.zeros(entries)
    first = int(entries * ((start + error(start)) % TURN) / TURN)
    for i in range(entries):
        table[(first + i * sense) % entries] = sense * (smooth[i * ticks // entries] - smooth.mean())
    return table


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("start", [0.3, 2.9])
def test_what_calibrated_sensor_measures_belongs_to_the_middle_of_its_plateau(
    sense: int, start: float
) -> None:
    values = calibrated_sensor(7, 100, sense, start)
    table = MakerTable(BY_NAME["simplefoc"], values, 6).rounded()
    reading, angle, _ = measured(table)
    assert len(reading) == 35
    true = reading - error(reading - error(reading))  # angle of the motor
    steps = np.r_[-2.5, np.arange(-1.5, 2), np.arange(-1.5, 2), 2.5] * TURN / 35  # both ends, five steps
    for n, share in ((1, 0.96), (2, 0.86), (4, 0.52)):  # of wave n, as docs/tables.md says
        assert np.cos(n * steps).mean() == pytest.approx(share, abs=0.005)

    def left(place: np.ndarray) -> float:
        seen = np.mean([error(place + step) for step in steps], axis=0)
        return float((reading - angle - seen).std())

    assert left(true) < 2.5e-4 < 0.05 * error(true).std()
    for away in (-1.5, 1.5):  # entries, half a plateau
        assert left(true) < 0.5 * left(true + away * table.places[1])


def test_a_table_of_few_digits_is_no_staircase() -> None:
    table = filled(BY_NAME["moteus"], 256)
    assert (np.diff(table.values) == 0).sum() > 20
    assert stairs(table.values) is None


def test_the_bundled_staircase_is_read_as_its_measured_places() -> None:
    log = read_log(BUNDLED)
    assert len(log.run(0)["angle_rad"]) == 35
    note = " ".join(log.notes)
    assert "35 measured places in 100 entries, a staircase" in note
    assert "the reference is that motor" in note
    assert "zero_electric_angle 2.417306, Direction CW, kept" in note


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("steps", [200, 400])
def test_full_steps_are_found_again_in_a_table_of_all_counts(steps: int, sense: int) -> None:
    at = np.arange(steps) * TURN / steps
    pattern = 0.002 * np.cos(steps / 4 * at + 0.5)  # of the stepper's pole pairs
    counts = np.round(sense * (at + error(at) + pattern) / TURN * 16384) % 16384
    knots = MakerTable(BY_NAME["mechaduino-knots"], counts, 0)
    if steps == 200:
        assert len(measured(knots)[0]) == 200
    count = np.arange(16384) * TURN / 16384
    table = MakerTable(BY_NAME["mechaduino"], np.degrees(knots.decoded(count)), 2).rounded()
    reading, angle, said = measured(table)
    assert said.startswith(f"{steps} full steps")
    k = np.round(angle / TURN * steps).astype(int) % steps
    assert sorted(k) == list(range(steps))
    assert np.abs(wrapped(reading - counts[k] / 16384 * TURN, TURN)).max() / TURN * 16384 < 0.05


def test_a_table_that_no_full_steps_make_is_read_entry_by_entry() -> None:
    count = np.arange(16384) * TURN / 16384
    wavy = MakerTable(BY_NAME["mechaduino"], np.degrees(count + 1e-3 * np.cos(2000 * count)), 2).rounded()
    assert len(measured(wavy)[0]) == 16384


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BUNDLED.read_text().replace("0.004862, ", "", 1), r"must be 100 in a file .* received 99"),
        (BUNDLED.read_text().replace("0.004862", "4.7e300", 1), r"must be 1e\+06 at most"),
        (
            "calibrate =\n\t" + ",".join(map(str, range(0, 6000, 100))) + ",6e3,\n",
            "multiples of 4 .* received 61",
        ),
    ],
)
def test_a_damaged_table_is_refused(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        found_in(text)


def test_code_that_lies_beside_a_log_is_no_run_of_it(tmp_path: Path) -> None:
    for name in ("a.h", "b.h"):
        (tmp_path / name).write_bytes(BUNDLED.read_bytes())
    (tmp_path / "log.txt").write_text("angle_rad,angle_ref_rad\n0,0\n1,1\n")
    assert [file.name for file in files_of(tmp_path)] == ["log.txt"]
    assert len(read_log([tmp_path / "a.h", tmp_path / "b.h"]).runs) == 2


def test_a_file_without_a_table_is_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.h").write_text(
        "int a[2] = {1, 2};\nconst float lookup[] = {\n//Put lookup table here!\n};\n"
    )
    with pytest.raises(InputError, match=r"must hold a table of SimpleFOC .* it holds none"):
        read_log(tmp_path / "a.h")
    table = filled(BY_NAME["simplefoc"], 50)
    with pytest.raises(InputError, match=r"one with 50 entries .* received 100"):
        replaced(BUNDLED.read_text(), table)
    assert CSV.name not in NAMES
