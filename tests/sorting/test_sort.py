"""`sort_sensors`: gains and their uncertainty by simulation, drift, bins, refusals; the thesis's repeats."""

import csv
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from hallsym.errors import InputError
from hallsym.families.published import table as published
from hallsym.sorting import (
    bins_of,
    change_probability,
    fit_changes,
    read_readings,
    smooth,
    sort_sensors,
    wrong_probability,
)
from tests.sorting.benches import FIELD, bench, long_form, truth, written

REAL = Path(__file__).parents[3] / "shared" / "real" / "minibumblebee-8x3hall"
if not REAL.exists():
    REAL = Path(__file__).parents[4] / "shared" / "real" / "minibumblebee-8x3hall"


# -- the thesis --------------------------------------------------------------------------------------------


def test_the_thesis_repeats_are_a_drift_and_a_scatter():
    told = published("sorting_repeat")
    counts = dict(zip((round(c / 0.005) for c in told["change"]), map(int, told["sensors"]), strict=True))
    assert counts == {-2: 1, -1: 144, 0: 588, 1: 66}
    drift, std = fit_changes(counts, 0.005)
    # 799 sensors tell the drift to .009 % and the scatter to .006 %: the likelihood's own best is as near
    assert drift == pytest.approx(-0.049e-2, abs=0.003e-2)
    assert std == pytest.approx(0.157e-2, abs=0.006e-2)
    expected = {k: 799 * change_probability(k, 0.005, -0.049e-2, 0.157e-2) for k in range(-2, 3)}
    assert sum(expected.values()) == pytest.approx(799, abs=0.01)
    for k, n in counts.items():
        assert abs(n - expected[k]) < 2 * max(np.sqrt(expected[k]), 1)


def test_changes_of_bin_are_what_is_drawn():
    rng = np.random.default_rng(3)
    first = rng.uniform(-0.5, 0.5, 400_000)
    moved = np.floor(first + 0.3 + rng.normal(0, 0.4, len(first)) + 0.5)
    for k in range(-2, 4):
        p = change_probability(k, 1.0, 0.3, 0.4)
        assert abs((moved == k).mean() - p) < 4 * np.sqrt(p / len(first)) + 1e-5


# -- drift -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("walk", [0.0, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_the_smoothed_reference_is_at_least_as_good_as_its_readings_and_as_nothing(walk, noise):
    rng = np.random.default_rng(1)
    drift = 1 + np.cumsum(rng.normal(0, walk, 1500))
    read = drift + rng.normal(0, noise, 1500)
    found = smooth(read, 25.0 * np.arange(1500))
    errors = {"smooth": found.value - drift, "ratio": read - drift, "none": np.median(read) - drift}
    rms = {way: np.std(e) for way, e in errors.items()}
    # a noise far below the walk's own step is not told from none
    assert rms["smooth"] <= 1.05 * min(rms["ratio"], rms["none"]) + (
        0.04 * walk if walk > 10 * noise else 1e-4 * noise
    )
    if walk:
        assert np.std(errors["smooth"] / found.std) < 1.2
    if 0 < walk <= noise:
        assert np.std(errors["smooth"] / found.std) > 0.8


def test_a_reference_that_jumps_is_followed_and_a_single_one_refused():
    read = 1 + np.random.default_rng(2).normal(0, 1e-4, 400)
    read[200:] += 5e-3
    read[100] += 2e-2
    found = smooth(read, np.arange(400.0))
    assert np.flatnonzero(found.bad).tolist() == [100]
    assert found.value[:195].mean() == pytest.approx(1.0, abs=3e-4)
    assert found.value[205:].mean() == pytest.approx(1.005, abs=3e-4)


def test_noise_that_sensor_and_reference_share_is_taken_out_by_each_reading():
    table, *_ = bench(common=3e-3)
    found = sort_sensors(table)
    assert found.drift.method == "ratio"
    assert found.drift.scatter["ratio"] < 0.6 * found.drift.scatter["smooth"]
    assert sort_sensors(bench()[0]).drift.method == "smooth"


def test_the_change_with_temperature_is_told():
    table, *_ = bench(walk=0.0, reference=1e-4)
    warm = 22 + np.linspace(0, 3, len(table["t_s"]))
    for column in ("reading_1_v", "reference_1_v"):
        table[column] = table[column] * (1 - 1.1e-3 * (warm - 22))
    value, std = sort_sensors(table | {"temperature_degc": warm}).drift.per_kelvin
    assert abs(value + 1.1e-3) < 5 * std + 5e-6


# -- what is stated is what happens ------------------------------------------------------------------------


def coverage(seeds):
    inside, total, wrong, expected, spread = 0, 0, 0, 0.0, 0.0
    for seed in seeds:
        table, gains, _ = bench(seed=seed, n=500, repeats=200)
        found = sort_sensors(table)
        true = truth(found, gains)
        inside += int(np.sum(np.abs(found.gain - true) < 1.96 * found.std))
        total += len(true)
        wrong += int(np.sum(bins_of(true / found.nominal, found.width) != found.bin))
        number, std = found.expected_wrong
        expected, spread = expected + number, np.hypot(spread, std)
        assert [r for r in found.refused if r.whole] == [] or len(found.refused) <= 2
    return inside / total, total, wrong, expected, spread


def test_gains_and_wrong_bins_are_as_stated():
    share, total, wrong, expected, spread = coverage(range(6))
    assert abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / total) + 0.01
    assert abs(wrong - expected) < 3 * spread


def test_offsets_are_as_stated():
    table, _, offsets = bench(repeats=300)
    table["reading_0_v"] = table["reading_0_v"] + np.random.default_rng(8).normal(0, 2e-4, 900)
    found = sort_sensors(table)
    away = (found.offset - np.array([offsets[name] for name in found.sensors])) / found.offset_std
    assert np.std(away) == pytest.approx(1.0, abs=0.1)


def test_readings_about_their_lines_tell_the_uncertainty_where_nothing_was_measured_twice():
    rng = np.random.default_rng(6)
    gain, offset = 2 * (1 + rng.normal(0, 0.02, 200)), rng.normal(0, 5e-3, 200)
    field = np.tile([0.0, 0.2, 0.4, 0.6], (200, 1))
    table = {
        "sensor": np.repeat(np.arange(200), 4),
        "field_t": field.ravel(),
        "reading_v": (offset[:, None] + gain[:, None] * field + rng.normal(0, 5e-4, (200, 4))).ravel(),
    }
    found = sort_sensors(table, drift="none")
    assert np.std((found.gain - gain) / found.std) == pytest.approx(1.0, abs=0.15)
    assert np.std((found.offset - offset) / found.offset_std) == pytest.approx(1.0, abs=0.15)
    assert any("about their lines" in note for note in found.notes)


@pytest.mark.slow
def test_gains_and_wrong_bins_are_as_stated_over_many_benches():
    share, _, wrong, expected, spread = coverage(range(200))
    assert abs(share - 0.95) < 0.005
    assert abs(wrong - expected) < 3 * spread
    assert abs(wrong / expected - 1) < 0.02


def test_a_sorted_bin_measured_again_is_judged_as_one():
    """Of sensors that lie within a bin few leave it, though their uncertainty is a third of its width."""
    rng = np.random.default_rng(5)
    true = rng.normal(1.0, 8e-4, 4000)
    read = true + rng.normal(0, 1.6e-3, 4000)
    p = wrong_probability(read, np.full(4000, 1.6e-3), np.inf, 5e-3)
    wrong = bins_of(true, 5e-3) != bins_of(read, 5e-3)
    assert abs(wrong.sum() - p.sum()) < 4 * np.sqrt((p * (1 - p)).sum()) + 0.03 * p.sum()
    flat = norm.sf((2.5e-3 - np.abs(read - 1)) / 1.6e-3)
    assert flat.sum() > 0.3 * p.sum()


def test_good_benches_lose_no_sensor():
    lost = sum(
        len(sort_sensors(bench(seed=s, n=n, repeats=20)[0]).refused) for s in range(20) for n in (40, 300)
    )
    assert lost <= 6  # 40 records with five checks of 1 in 100 each: 2 expected


def test_two_reels_are_one_lot():
    rng = np.random.default_rng(4)
    gains = np.r_[2.0 * (1 + rng.normal(0, 0.01, 570)), 2.24 * (1 + rng.normal(0, 0.01, 30))]
    assert sort_sensors(bench(gains=gains)[0]).refused == ()


# -- refusals ----------------------------------------------------------------------------------------------


def test_a_sensor_that_was_not_seated_is_refused_by_name():
    table, *_ = bench()
    table["reference_1_v"][17] *= 1.02
    table["reading_1_v"][30] = table["reading_0_v"][30] + 1e-3
    table["reading_1_v"][50] = -table["reading_1_v"][50]
    table["reading_0_v"][70] = table["reading_1_v"][70] = 0.4
    table["reading_1_v"][90] = np.nan
    table["reading_0_v"][110] += 0.1
    again = 600 + np.flatnonzero(np.isin(table["sensor"][600:], table["sensor"][:600]))[0]
    table["reading_1_v"][again] *= 1.012
    found = sort_sensors(table)
    why = {r.sensor: r.reason for r in found.refused}
    for row, words in (
        (17, "reference sensor"), (30, "hardly differ"), (50, "turned over"), (70, "hardly differ"),
        (90, "one field only"), (110, "offset"), (again, "2 measurements differ"),
    ):  # fmt: skip
        name = table["sensor"][row]
        assert words in why.pop(name), name
        assert name not in found.sensors or any(not r.whole for r in found.refused if r.sensor == name)
    assert len(why) <= 1


def test_rows_that_contradict_each_other_refuse_the_sensor():
    table = long_form(bench(repeats=0)[0])
    for column, values in table.items():
        table[column] = np.insert(values, 42, values[41])
    table["reading_mv"][42] *= 1.05
    (refusal,) = sort_sensors(table, repeatability=1e-3).refused
    assert refusal.sensor == table["sensor"][41]
    assert "in one field differ" in refusal.reason


def test_one_in_ten_not_seated_leaves_the_others_as_they_are():
    table, gains, _ = bench(n=800, repeats=200)
    rng = np.random.default_rng(11)
    bad = rng.choice(1000, 100, replace=False)
    slip = 1 - rng.uniform(0.01, 0.2, 100)
    table["reading_1_v"][bad] *= slip
    table["reference_1_v"][bad] *= slip
    found = sort_sensors(table)
    refused = {r.sensor for r in found.refused}
    assert set(table["sensor"][bad].tolist()) <= refused
    assert len(refused) <= 102
    away = (found.gain - truth(found, gains)) / found.std
    assert np.abs(away).max() < 5
    assert np.std(away) == pytest.approx(1.0, abs=0.15)


def test_of_three_measurements_the_odd_one_is_left_out():
    table, gains, _ = bench()
    rows = [0, 0, 0]
    for column, values in table.items():
        table[column] = np.r_[values, values[rows]]
    table["t_s"] = 25.0 * np.arange(len(table["t_s"]))
    table["reading_1_v"][-1] *= 1.02
    found = sort_sensors(table)
    name = table["sensor"][0]
    assert [(r.sensor, r.whole) for r in found.refused] == [(name, False)]
    at = found.sensors.index(name)
    assert found.measurements[at] >= 3
    assert found.gain[at] == pytest.approx(gains[name], rel=5e-3)


# -- tables ------------------------------------------------------------------------------------------------


def test_every_form_of_the_table_gives_the_same(tmp_path):
    table, *_ = bench(n=120, repeats=40)
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


def test_parquet_and_numbers_as_names(tmp_path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    table, *_ = bench(n=60, repeats=30)
    parquet.write_table(arrow.table(table), tmp_path / "a.parquet")
    text = sort_sensors(tmp_path / "a.parquet")
    numbers = table | {"sensor": np.array([int(s[3:]) for s in table["sensor"]])}
    parquet.write_table(arrow.table(numbers), tmp_path / "b.parquet")
    other = sort_sensors(tmp_path / "b.parquet")
    assert [f"R1-{int(s):05d}" for s in other.sensors] == list(text.sensors)
    assert other.sensors[7] == "7"
    np.testing.assert_array_equal(other.gain, text.gain)


def test_readings_that_repeat_in_a_field_are_averaged_and_a_field_that_comes_back_is_a_new_measurement():
    field = [0, 0, 0.4, 0.4, 0.4, 0, 0.4]
    reading = [0.1, 0.3, 1.0, 1.1, 1.2, 0.2, 1.1]
    names = ["a"] * 7 + ["b"] * 7
    table = {"sensor": np.array(names), "field_t": np.array(field * 2), "reading_v": np.array(reading * 2)}
    found = sort_sensors(table, drift="none", width=0.2)
    assert found.measurements.tolist() == [2, 2]
    assert found.gain == pytest.approx([0.9 / 0.4] * 2)
    assert found.offset == pytest.approx([0.2] * 2)
    labelled = sort_sensors(
        table | {"repeat": np.array(["x"] * 14)}, drift="none", repeatability=0.1, width=0.2
    )
    assert labelled.measurements.tolist() == [1, 1]


def test_a_reel_of_12700_sensors_takes_seconds(tmp_path):
    table, *_ = bench(n=12_700, repeats=799)
    path = written(tmp_path / "reel.csv", table)
    started = time.process_time()
    found = sort_sensors(path)
    assert time.process_time() - started < 5
    assert len(found.sensors) > 12_690


# -- bad input ---------------------------------------------------------------------------------------------


def without(table, *columns):
    return {c: v for c, v in table.items() if c not in columns}


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (lambda t: without(t, "sensor"), {}, "column 'sensor'"),
        (lambda t: t | {"field_1_t": t["field_0_t"]}, {}, "must differ"),
        (lambda t: without(t, "reference_0_v", "reference_1_v"), {}, "no reference sensor"),
        (lambda t: without(t, "reference_0_v"), {}, "for each reading"),
        (lambda t: t | {"reference_1_v": t["reference_0_v"]}, {}, "do not change"),
        (lambda t: t | {"reading_1_v": -t["reading_1_v"]}, {}, "other sign"),
        (lambda t: t | {"reading_1_v": np.full(750, np.nan)}, {}, "two readings"),
        (lambda t: t | {"t_s": np.r_[np.nan, t["t_s"][1:]]}, {}, "Column t_s"),
        (lambda t: without(t, "reading_1_v"), {}, "must differ"),
        (lambda t: t, {"width": 5e-4}, "no wider than"),
        (lambda t: t, {"width": 0.0}, "width of a bin"),
        (lambda t: t, {"nominal": -1.0}, "nominal gain"),
        (lambda t: t, {"nominal": 100.0}, "nominal gain"),
        (lambda t: t, {"repeatability": 0.0}, "repeatability"),
        (lambda t: t, {"drift": "smoth"}, "did you mean 'smooth'"),
        (lambda t: t, {"fields": (0.0, 0.4, 0.5)}, "2 readings a row"),
        (lambda t: without(t, "reading_0_v", "reading_1_v"), {}, "no column reading_v"),
        (lambda t: {c: v[:0] for c, v in t.items()}, {}, "no rows"),
        (lambda t: t | {"sensor": np.array([""] * 750)}, {}, "names no sensor"),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(change, options, words):
    with pytest.raises(InputError) as error:
        sort_sensors(change(bench()[0]), **options)
    text = str(error.value)
    assert words in text
    assert len(text) <= 300
    assert "\n" not in text


def test_few_sensors_and_equal_times_are_sorted():
    table, *_ = bench(n=10, repeats=0)
    found = sort_sensors(table)
    assert np.median(found.std / found.gain) == pytest.approx(1e-3, rel=0.5)
    assert any("stands for it" in note for note in found.notes)
    together = sort_sensors(bench()[0] | {"t_s": np.repeat(np.arange(75.0), 10)})
    assert np.std(together.gain / sort_sensors(bench()[0]).gain) < 3e-4
    assert len(sort_sensors(bench()[0] | {"t_s": np.zeros(750)}).sensors) == 600


def test_no_reference_can_be_accepted():
    table = without(bench(walk=0.0)[0], "reference_0_v", "reference_1_v")
    found = sort_sensors(table, drift="none")
    assert any("no drift was taken out" in note for note in found.notes)
    assert np.isfinite(found.std).all()


# -- real sensors ------------------------------------------------------------------------------------------


def eight_sensors(gain, offset, read, drift):
    """A table of sensors in zero field and in one of 45 mT many times; the last column is the reference."""
    rows = [
        (f"{k}", 0.0, -offset[k], 0.0) for k in range(8)
    ] + [(f"{k}", 45.0, read[p, k], drift[p] * 45) for p in range(len(read)) for k in range(8)]  # fmt: skip
    names, field, reading, reference = zip(*rows, strict=True)
    return {
        "sensor": np.array(names), "repeat": np.zeros(len(rows), int), "field_mt": np.array(field),
        "reading_mt": np.array(reading), "reference_mt": np.array(reference),
    }  # fmt: skip


def agreement(found, gain, offset):
    """Scatter of gains beside the owners' (theirs multiply the reading), and largest offset difference."""
    beside = found.gain * gain
    return float(np.std(beside / beside.mean(), ddof=1)), float(np.abs(found.offset + offset * 1e-3).max())


def test_simulated_sensors_as_the_real_ones_agree_with_their_calibration():
    rng = np.random.default_rng(0)
    gain, offset = 1 + rng.normal(0, 8e-3, 8), rng.normal(-0.1, 0.1, 8)
    drift = 1 + np.linspace(0, 5e-3, 18)
    read = 45 * drift[:, None] / gain - offset + rng.normal(0, 0.03, (18, 8))
    table = eight_sensors(gain, offset, read, drift)
    scatter, apart = agreement(
        sort_sensors(table, drift="none", width=0.02, repeatability=3e-3), gain, offset
    )
    assert scatter < 1e-3
    assert apart < 5e-5


@pytest.mark.skipif(not REAL.exists(), reason="../shared/real/minibumblebee-8x3hall is not here")
def test_real_sensors_agree_with_their_owners_calibration():
    """The y axes stand in 45 mT; corrected by their owners, (reading + offset) gain, they differ by .33 %."""
    with (REAL / "lab_calibration.csv").open() as file:
        lab = [row for row in csv.DictReader(file) if row["axis"] == "y"]
    gain, offset = (np.array([float(row[c]) for row in lab]) for c in ("gain", "zero_offset_mt"))
    with (REAL / "measurement.csv").open() as file:
        read = np.array([float(row["by_mt"]) for row in csv.DictReader(file)]).reshape(18, 8)
    corrected = (read + offset) * gain
    own = np.std(corrected.mean(axis=0) / corrected.mean(), ddof=1)
    table = eight_sensors(gain, offset, read, corrected.mean(axis=1) / corrected.mean())
    found = sort_sensors(table, drift="none", width=0.02, repeatability=own)
    scatter, apart = agreement(found, gain, offset)
    assert found.refused == ()
    assert scatter < 1.05 * own
    assert own < 4e-3
    assert apart < 1e-4
