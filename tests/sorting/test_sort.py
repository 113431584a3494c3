"""`sort_sensors`: gains and their uncertainty by simulation, bins, tables; the thesis's repeats."""

import csv

import numpy as np
import pytest
from beside import REAL, needs
from scipy.optimize import minimize

from hallsym.errors import InputError
from hallsym.families.published import table as published
from hallsym.sorting import change_probability, read_readings, sort_sensors
from hallsym.sorting.bins import bins_of
from tests.sorting.benches import FIELD, bench, long_form, truth, written

BOARD = REAL / "minibumblebee-8x3hall"


# -- the thesis --------------------------------------------------------------------------------------------


def test_the_thesis_repeats_are_a_drift_and_a_scatter():
    told = published("sorting_repeat")
    counts = dict(zip((round(c / 0.005) for c in told["change"]), map(int, told["sensors"]), strict=True))
    assert counts == {-2: 1, -1: 144, 0: 588, 1: 66}

    def cost(x):
        return -sum(n * np.log(change_probability(k, 0.5, x[0], np.exp(x[1]))) for k, n in counts.items())

    drift, log_std = minimize(cost, [-0.05, np.log(0.15)], method="Nelder-Mead").x
    # 799 sensors tell the drift to .009 % and the scatter to .006 %: the likelihood's own best is as near
    assert drift == pytest.approx(-0.049, abs=0.003)
    assert np.exp(log_std) == pytest.approx(0.157, abs=0.006)
    expected = {k: 799 * change_probability(k, 0.005, -0.049e-2, 0.157e-2) for k in range(-2, 3)}
    assert sum(expected.values()) == pytest.approx(799, abs=0.01)
    for k, n in counts.items():
        assert abs(n - expected[k]) < 2 * max(np.sqrt(expected[k]), 1)


# -- what is stated is what happens ------------------------------------------------------------------------


@pytest.mark.parametrize("benches", [6, pytest.param(200, marks=pytest.mark.slow)])
def test_gains_and_wrong_bins_are_as_stated(benches):
    inside, total, wrong, expected, spread = 0, 0, 0, 0.0, 0.0
    for seed in range(benches):
        table, gains = bench(seed=seed, n=500, repeats=200)
        found = sort_sensors(table)
        true = truth(found, gains)
        inside += int(np.sum(np.abs(found.gain - true) < 1.96 * found.std))
        total += len(true)
        wrong += int(np.sum(bins_of(true / found.nominal, found.width) != found.bin))
        number, std = found.expected_wrong
        expected, spread = expected + number, np.hypot(spread, std)
    # the uncertainty of a bench is itself estimated: by some .5 %
    assert abs(inside / total - 0.95) < 4 * np.sqrt(0.95 * 0.05 / total) + (0.01 if benches < 100 else 0.002)
    assert abs(wrong - expected) < 3 * spread
    assert benches < 100 or abs(wrong / expected - 1) < 0.02


def test_the_reference_sensor_takes_the_drift_out():
    table, gains = bench(walk=2e-4)
    found = sort_sensors(table)
    blind = sort_sensors(without(table, "reference_0_v", "reference_1_v"))
    away, left = (np.std(s.gain / truth(s, gains) - 1) for s in (found, blind))
    assert away < 1.5e-3 < left
    assert found.drift is not None
    assert blind.drift is None
    assert any("no drift was taken out" in note for note in blind.notes)


def test_a_slip_does_not_spoil_the_repeatability():
    table, _ = bench()
    usual = sort_sensors(table).repeatability
    table["reading_1_v"] = table["reading_1_v"] * np.r_[np.ones(749), 0.9]
    found = sort_sensors(table)
    assert found.repeatability == pytest.approx(usual, rel=0.03)
    assert any(table["sensor"][-1] in note for note in found.notes)


def test_a_sensor_read_in_one_field_is_not_sorted():
    table, _ = bench(repeats=20)
    table["reading_1_v"][np.flatnonzero(table["sensor"] == "R1-00090")] = np.nan
    found = sort_sensors(table)
    assert found.unsorted == ("R1-00090",)
    assert len(found.sensors) == 599


# -- tables ------------------------------------------------------------------------------------------------


def test_every_form_of_the_table_gives_the_same(tmp_path):
    table, _ = bench(n=120, repeats=40)
    found = sort_sensors(table)
    columns = {"sensor": "ID", "reading_mv": "Hall", "field_mt": "B", "reference_mv": "Ref", "t_s": "time"}
    long = long_form(table)
    renamed = {columns.get(c, c): v for c, v in long.items()}
    renamed["sensor"] = renamed.pop("ID")
    others = [
        sort_sensors(long),
        sort_sensors(written(tmp_path / "long.csv", long)),
        sort_sensors(written(tmp_path / "wide.csv", table)),
        sort_sensors(read_readings(
            written(tmp_path / "own.csv", renamed),
            columns={k: v for k, v in columns.items() if k != "sensor"})),
    ]  # fmt: skip
    bare = {c: v for c, v in table.items() if not c.startswith("field")}
    others.append(sort_sensors(bare, fields=(0.0, FIELD)))
    for other in others:
        assert other.sensors == found.sensors
        np.testing.assert_allclose(other.gain, found.gain, rtol=1e-5)
        np.testing.assert_allclose(other.offset, found.offset, rtol=1e-4, atol=1e-7)


def test_readings_that_repeat_in_a_field_are_averaged_and_a_field_that_comes_back_is_a_new_measurement():
    field = [0, 0, 0.4, 0.4, 0.4, 0, 0.4]
    reading = [0.1, 0.3, 1.0, 1.1, 1.2, 0.2, 1.1]
    names = ["a"] * 7 + ["b"] * 7
    table = {"sensor": np.array(names), "field_t": np.array(field * 2), "reading_v": np.array(reading * 2)}
    found = sort_sensors(table, width=0.2)
    assert found.measurements.tolist() == [2, 2]
    assert found.gain == pytest.approx([0.9 / 0.4] * 2)
    assert found.offset == pytest.approx([0.2] * 2)


# -- bad input ---------------------------------------------------------------------------------------------


def without(table, *columns):
    return {c: v for c, v in table.items() if c not in columns}


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (lambda t: without(t, "sensor"), {}, "column 'sensor'"),
        (lambda t: t | {"field_1_t": t["field_0_t"]}, {}, "must differ"),
        (lambda t: without(t, "reference_0_v"), {}, "for each reading"),
        (lambda t: t | {"reference_1_v": t["reference_0_v"]}, {}, "must follow the field"),
        (lambda t: {c: v[:600] for c, v in t.items()}, {}, "--repeatability"),
        (lambda t: t | {"reading_1_v": -t["reading_1_v"]}, {}, "other sign"),
        (lambda t: t | {"t_s": np.r_[np.nan, t["t_s"][1:]]}, {}, "Column t_s"),
        (lambda t: t, {"width": 0.0}, "width of a bin"),
        (lambda t: t, {"nominal": -1.0}, "nominal gain"),
        (lambda t: t, {"fields": (0.0, 0.4, 0.5)}, "2 readings a row"),
        (lambda t: {c: v[:0] for c, v in t.items()}, {}, "no rows"),
        (lambda t: t | {"sensor": np.array([""] * 750)}, {}, "names no sensor"),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(change, options, words):
    with pytest.raises(InputError) as error:
        sort_sensors(change(bench()[0]), **options)
    text = str(error.value)
    assert words in text


# -- real sensors ------------------------------------------------------------------------------------------


def eight_sensors(gain, offset, read, drift):
    """A table of sensors in zero field and in one of 45 mT many times; the last column is the reference."""
    rows = [
        (f"{k}", 0.0, -offset[k], 0.0) for k in range(8)
    ] + [(f"{k}", 45.0, read[p, k], drift[p] * 45) for p in range(len(read)) for k in range(8)]  # fmt: skip
    names, field, reading, reference = zip(*rows, strict=True)
    return {
        "sensor": np.array(names), "field_mt": np.array(field),
        "reading_mt": np.array(reading), "reference_mt": np.array(reference),
    }  # fmt: skip


def agreement(found, gain, offset):
    """Scatter of gains beside the owners' (theirs multiply the reading), and largest offset difference."""
    beside = found.gain * gain
    return float(np.std(beside / beside.mean(), ddof=1)), float(np.abs(found.offset + offset * 1e-3).max())


@needs(BOARD)
def test_real_sensors_agree_with_their_owners_calibration():
    """The y axes stand in 45 mT; corrected by their owners, (reading + offset) gain, they differ by .33 %."""
    with (BOARD / "lab_calibration.csv").open() as file:
        lab = [row for row in csv.DictReader(file) if row["axis"] == "y"]
    gain, offset = (np.array([float(row[c]) for row in lab]) for c in ("gain", "zero_offset_mt"))
    with (BOARD / "measurement.csv").open() as file:
        read = np.array([float(row["by_mt"]) for row in csv.DictReader(file)]).reshape(18, 8)
    corrected = (read + offset) * gain
    own = np.std(corrected.mean(axis=0) / corrected.mean(), ddof=1)
    table = eight_sensors(gain, offset, read, corrected.mean(axis=1) / corrected.mean())
    found = sort_sensors(table, width=0.02, repeatability=own)
    scatter, apart = agreement(found, gain, offset)
    assert scatter < 1.05 * own
    assert own < 4e-3
    assert apart < 1e-4
