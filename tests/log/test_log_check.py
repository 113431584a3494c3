"""What goes wrong in labs is found, placed and dropped on request; healthy logs pass silently."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from log_samples import one_sentence, stage_arrays

from hallsym.errors import InputError
from hallsym.log import Log, check_log, clean_log, read_log, spans, write_log

Arrays = dict[str, np.ndarray]
Change = Callable[[Arrays], object]


def broken(change: Change) -> Log:
    arrays = stage_arrays()
    change(arrays)
    return Log.from_arrays(arrays, name="bench.csv")


def put(column: str, rows: object, value: object) -> Change:
    def change(arrays: Arrays) -> None:
        arrays[column][rows] = value  # type: ignore[index]

    return change


def remove(rows: object) -> Change:
    def change(arrays: Arrays) -> None:
        for name in arrays:
            arrays[name] = np.delete(arrays[name], rows)  # type: ignore[arg-type]

    return change


def scale(column: str, factor: float) -> Change:
    return lambda arrays: arrays.update({column: arrays[column] * factor})


def clip(column: str, level: float) -> Change:
    return lambda arrays: arrays.update({column: np.clip(arrays[column], -level, level)})


REFUSED: list[tuple[Change, str, int | None]] = [
    (put("hall_a_m", [450, 900], np.nan), r"hall_a_m .* 2 of 1600 .* row 451 \(run 1\)", 1598),
    (put("t_s", 10, 0.001), r"t_s .* runs backwards 1 times, first in row 11 \(run 0\)", 1599),
    (remove(np.arange(400, 795)), r"at least 8 samples; run 1 has 5", 1200),
    (put("hall_b_m", slice(800, 1200), 1e-4), r"hall_b_m .* never changes in run 2 although", 1200),
    (
        clip("hall_a_m", 3e-4),
        r"hall_a_m .* is saturated: \d+ samples \(\d\d.\d%\) lie on its rails at -0.0003 and 0.0003 m",
        None,
    ),
    (
        remove(np.arange(200, 300)),
        r"t_s .* misses 100 ticks .* first after 0.398 s in row 201 \(run 0\)",
        1500,
    ),
    (put("hall_b_m", slice(None), 0.0), "hall_b_m .* never changes; it is 0 in all 1600", 0),
    (scale("t_s", 1e6), r"t_s .* its usual step is 2000 s: it looks like ms", 0),
]


@pytest.mark.parametrize(("change", "says", "left"), REFUSED, ids=[entry[1][:25] for entry in REFUSED])
def test_refused_then_dropped(change: Change, says: str, left: int | None) -> None:
    """`left` is the number of samples that remain with drop_bad; 0 means that dropping cannot help."""
    log = broken(change)
    required = tuple(log.columns)
    with pytest.raises(InputError, match=says) as caught:
        check_log(log, required)
    message = str(caught.value)
    assert one_sentence(message), message
    assert "bench.csv" in message
    assert ("--drop-bad" in message) == (left != 0)
    if left == 0:
        with pytest.raises(InputError, match=says):
            check_log(log, required, drop_bad=True)
        return
    kept = clean_log(log, required)
    assert left in (None, kept.rows)
    assert any(re.search(says, note) for note in kept.notes), kept.notes
    assert all(map(one_sentence, kept.notes))
    assert list(kept.notes) == check_log(log, required, drop_bad=True)
    assert not any("left out" in note for note in clean_log(kept, required).notes[len(kept.notes) :])


NOTED: list[tuple[Change, str]] = [
    (scale("x_ref_m", 1e9), r"x_ref_m covers 1e\+06 m in 0.798 s.*check the units of x_ref_m and t_s"),
    (remove([100, 101, 700]), r"t_s .* misses 3 ticks \(0.19%\), first after 0.198 s in row 101 \(run 0\)"),
    (clip("hall_a_m", 5.7e-4), "hall_a_m .* is saturated"),
    (
        lambda a: a["x_ref_m"].__setitem__(slice(500, 530), a["x_ref_m"][500]),
        r"x_ref_m .* up to 30 .* row 501, run 1",
    ),
    (
        lambda a: a.update(x_ref_m=np.repeat(a["x_ref_m"][::10], 10)),
        "x_ref_m .* repeats each value about 10 times",
    ),
    (
        lambda a: a.update(temperature_degc=np.full(1600, np.nan)),
        "temperature_degc .* no finite value and is not used",
    ),
]


def quantise(column: str, step: float) -> Change:
    return lambda arrays: arrays.update({column: step * np.round(arrays[column] / step)})


def staircase(arrays: Arrays) -> None:
    """Dwell at three heights, coarse ADC, so that many readings sit exactly at the greatest value."""
    level = np.tile(np.repeat([0.0, 4e-4, 0.0, -4e-4], 100), 4)
    move = np.convolve(level, np.ones(20) / 20, "same")
    for name in ("hall_a_m", "hall_b_m", "y_ref_m"):
        arrays[name] = move + (arrays[name] * 0 if "hall" in name else 3e-7 * np.sin(np.arange(1600.0) ** 2))
    quantise("hall_a_m", 1e-5)(arrays)
    quantise("hall_b_m", 1e-5)(arrays)


def single_axis_without_noise(arrays: Arrays) -> None:
    for name in ("hall_a_m", "hall_b_m", "y_ref_m", "rz_ref_rad"):
        arrays[name] = np.where(arrays["run"] < 3, arrays[name], 0.0)


SILENT: list[Change] = [
    lambda arrays: None,
    quantise("hall_a_m", 2e-5),
    quantise("hall_a_m", 1e-4),
    quantise("x_ref_m", 1e-5),
    staircase,
    single_axis_without_noise,
    lambda arrays: arrays.update(hall_a_m=5e-4 * np.abs((arrays["t_s"] % 0.2) / 0.1 - 1) ** 1.0),
    lambda arrays: arrays.update(z_m=1e-4 * arrays["run"]),
    lambda arrays: arrays.update(temperature_degc=20 + 0.1 * np.round(arrays["run"] / 2)),
    lambda arrays: arrays.update(t_s=arrays["t_s"] % 10.0),
    lambda arrays: arrays.update(t_s=arrays["t_s"] + 5e-4 * np.random.default_rng(1).uniform(-1, 1, 1600)),
]


@pytest.mark.parametrize("change", SILENT)
def test_healthy_logs_pass_silently(change: Change) -> None:
    assert check_log(broken(change)) == []


def test_only_required_columns_are_judged() -> None:
    log = broken(put("z_m", 3, np.nan))
    assert check_log(log, ("hall_a_m", "x_ref_m")) == []
    with pytest.raises(InputError, match=r"has no column hall_c_m.*--column hall_c_m=ITS_NAME"):
        check_log(log, ("hall_c_m",))


def test_nothing_left() -> None:
    """Runs that are all too short are told so at once: leaving them out is no way."""
    short, gone = np.arange(5.0), np.where(np.arange(8) == 3, np.nan, np.arange(8.0))
    with pytest.raises(InputError, match=r"at least 8 samples; it has 5: record more samples\.$"):
        clean_log(Log.from_arrays({"x_ref_m": short}))
    with pytest.raises(InputError, match=r"at least 8 samples; it has 5: record more samples\.$"):
        check_log(Log.from_arrays({"x_ref_m": short}), ("x_ref_m",))
    with pytest.raises(InputError, match=r"it has 7: record more samples \(.* 1 of 8 .*; left out\)\.$"):
        clean_log(Log.from_arrays({"x_ref_m": gone}))


def test_faults_of_several_kinds_are_dropped_together() -> None:
    def change(arrays: Arrays) -> None:
        put("hall_a_m", slice(395, 790), np.nan)(arrays)  # leaves 5 + 10 samples around
        put("t_s", 1000, 0.0)(arrays)

    kept = clean_log(broken(change))
    assert (kept.rows, kept.runs) == (395 + 10 + 400 + 400 - 1, (0, 1, 2, 3))
    assert np.isfinite(kept.array("hall_a_m")).all()


def test_drop_bad_while_reading(tmp_path: Path) -> None:
    arrays = stage_arrays()
    arrays["hall_a_m"][7] = np.nan
    write_log(arrays, tmp_path / "log.csv")
    log = read_log(tmp_path, drop_bad=True)
    assert (log.rows, sum(len(block.data["t_s"]) for block in log.blocks())) == (1599, 1599)
    assert "left out" in log.notes[0]


def test_spans_agree_with_numpy() -> None:
    arrays = stage_arrays(runs=3, samples=1000)
    arrays["x_ref_m"] += 1.0  # an offset a thousand times the motion must not cost digits
    found = spans(Log.from_arrays(arrays))
    for name in ("x_ref_m", "hall_a_m", "z_m"):
        for run in (0, 1, 2):
            values = arrays[name][arrays["run"] == run]
            span = found.runs[run][name]
            assert (span.min, span.max) == (values.min(), values.max())
            assert span.mean == pytest.approx(values.mean(), rel=1e-12, abs=1e-15)
            assert span.std == pytest.approx(values.std(), rel=1e-9)
        assert found.overall[name].std == pytest.approx(arrays[name].std(), rel=1e-9)
    assert found.samples == {0: 1000, 1: 1000, 2: 1000}


def test_a_noise_free_axis_that_rests_in_two_runs_of_three_repeats_nothing():
    t = np.arange(300) * 2e-3
    run = np.repeat([0, 1, 2], 100)
    x = np.where(run == 1, 3e-4 * np.sin(2 * np.pi * 5 * t), 0.0)
    rng = np.random.default_rng(0)
    log = Log.from_arrays(
        {"run": run, "t_s": t, "x_ref_m": x, "hall_a_m": x + 1e-7 * rng.standard_normal(300)}
    )
    assert check_log(log) == []


@pytest.mark.parametrize("step", [1e-3, 2.5e-3, 5e-3])
@pytest.mark.parametrize("phase", [0.0, 5e-3])
@pytest.mark.parametrize("digits", [16, 6])
def test_a_wave_that_comes_back_to_the_same_phase_is_on_no_rail(
    step: float, phase: float, digits: int
) -> None:
    """A machine steps x over periods of 15 mm: tops have one value, other phases one but for rounding."""
    x = np.arange(round(0.24 / step) + 1) * step
    v = np.round(0.6 * np.cos(2 * np.pi / 0.015 * (x - phase)), digits)
    log = Log.from_arrays({"run": np.zeros(len(x), int), "x_ref_m": x, "col_0_v": v})
    assert not any("saturated" in note for note in check_log(log))
