"""What goes wrong in labs is found, placed and dropped on request; healthy logs pass silently."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from log_samples import STAGE, one_sentence, stage_arrays
from mistakes import Arrays, Make, by, hold, keep, of_run, pasted, put

from hallsym.errors import InputError
from hallsym.families.recording import corrected, read_correction
from hallsym.log import Fault, Log, check_log, clean_log, read_log, usable, write_log


def broken(change: Make) -> Log:
    arrays = stage_arrays()
    return Log.from_arrays(change(arrays) or arrays, name="bench.csv")


def without(rows: Iterable[int]) -> Make:
    return keep(lambda arrays: np.delete(np.arange(1600), list(rows)))


COLUMNS = tuple(column for column in STAGE if column not in ("run", "t_s"))
REFUSED: list[tuple[Make, str, int]] = [
    (put("hall_a_m", [450, 900], np.nan), r"hall_a_m .* 2 of 1600 .* row 451 \(run 1\)", 1598),
    (put("t_s", 10, 0.001), r"t_s .* runs backwards 1 times, first in row 11 \(run 0\)", 1599),
]


@pytest.mark.parametrize(("change", "says", "left"), REFUSED, ids=["NaN", "time"])
def test_what_cannot_be_read_is_refused_then_dropped(change: Make, says: str, left: int) -> None:
    log = broken(change)
    required = tuple(log.columns)
    with pytest.raises(InputError, match=says) as caught:
        check_log(log, required)
    message = str(caught.value)
    assert one_sentence(message), message
    assert "bench.csv" in message
    assert "--drop-bad" in message
    kept = clean_log(log, required)
    assert kept.rows == left
    assert any(re.search(says, note) for note in kept.notes), kept.notes
    assert all(map(one_sentence, kept.notes))
    assert list(kept.notes) == usable(log, required, drop_bad=True)[1]
    assert not any("left out" in note for note in clean_log(kept, required).notes[len(kept.notes) :])


CLAIMED: list[tuple[Make, str, str, str | None, int]] = [
    (
        put("hall_b_m", slice(800, 1200), 1e-4),
        r"hall_b_m .* up to 400 samples .* row 801, run 2",
        "stuck",
        "stuck hall_b_m 0 400 in 2",
        1200,
    ),
    (
        put("hall_b_m", slice(None), 0.0),
        "hall_b_m .* never changes; it is 0 in all 1600",
        "stuck",
        None,
        1600,
    ),
    (by(1e6, "t_s"), r"t_s .* has a usual step of 2000 s; if that is 2000 ms", "clock_unit", None, 1600),
    (
        by(1e9, "x_ref_m"),
        r"x_ref_m covers 1e\+06 m in 0.798 s.*check the units of x_ref_m and t_s",
        "clock_unit",
        None,
        1600,
    ),
    (
        hold(("x_ref_m",), of_run(1, 100, 130)),
        r"x_ref_m .* up to 30 .* row 501, run 1",
        "stuck",
        "stuck x_ref_m 100 130 in 1",
        1570,
    ),
    (pasted(COLUMNS, 0, 2), r"the same samples in runs 0 and 2", "copied_run", "copied_run in 2", 1200),
]


@pytest.mark.parametrize(("change", "says", "name", "correction", "left"), CLAIMED)
def test_what_is_odd_is_a_claim_and_accepted_it_keeps_its_samples(
    change: Make, says: str, name: str, correction: str | None, left: int
) -> None:
    """`left`: samples without those that the claim calls bad; its correction leaves as many."""
    log = broken(change)
    good, notes = usable(log)
    (claim,) = (note for note in notes if isinstance(note, Fault))
    assert re.search(says, claim), notes
    assert one_sentence(claim)
    assert (claim.name, claim.correction, good.rows) == (name, correction, left)
    kept, told = usable(log, accept=[name])
    assert kept.rows == 1600
    assert any(re.search(says.partition(".*check")[0], note) for note in told)
    assert not any(isinstance(note, Fault) for note in told)
    dropped = clean_log(log)
    assert dropped.rows == left
    if left < 1600:
        assert not any(isinstance(note, Fault) for note in dropped.notes)
    if correction:
        assert corrected(log, [read_correction(correction)]).rows == left


REMARKS: list[tuple[Make, str]] = [
    (without([100, 101, 700]), r"t_s .* misses 3 ticks \(0.19%\), first after 0.198 s in row 101 \(run 0\)"),
    (
        without(range(200, 300)),
        r"t_s .* misses 100 ticks .* first after 0.398 s in row 201 \(run 0\), a step of 0.202 s",
    ),
    (without(range(400, 795)), r"Run 1 of .* has 5 samples where the usual run has 400"),
    (
        lambda a: a.update(temperature_degc=np.full(1600, np.nan)),
        "temperature_degc .* no finite value and is not used",
    ),
]


@pytest.mark.parametrize(("change", "says"), REMARKS)
def test_what_harms_nothing_is_a_remark(change: Make, says: str) -> None:
    (note,) = check_log(broken(change))
    assert re.search(says, note)
    assert not isinstance(note, Fault)
    assert usable(broken(change))[0].rows == broken(change).rows


def quantise(column: str, step: float) -> Make:
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
        arrays[name] = np.where(arrays["run"] < 2, arrays[name], 0.0)


SILENT: list[Make] = [
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
def test_healthy_logs_pass_silently(change: Make) -> None:
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
