"""Times as text are seconds from the first sample; what may be read in two ways is asked about."""

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow.feather import write_feather

import hallsym
from hallsym import InputError, fit, load_fit, read_log
from hallsym.cli.main import main
from hallsym.log.arrow import Seconds, time_form
from hallsym.log.format_parquet import ParquetSource

STEPS = np.array([0.0, 0.25, 1.5, 2.0, 3.125])
START = datetime(2026, 1, 30, 23, 59, 58, tzinfo=timezone(timedelta(hours=2)))

FORMS = {
    "ISO 8601": lambda at: at.replace(tzinfo=None).isoformat(timespec="milliseconds"),
    "with a zone": lambda at: at.isoformat(timespec="microseconds"),
    "in Greenwich": lambda at: at.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S.%fZ"),
    "slashes": lambda at: at.strftime("%Y/%m/%d %H:%M:%S.%f"),
    "dots": lambda at: at.strftime("%d.%m.%Y %H:%M:%S,%f"),
    "day first": lambda at: at.strftime("%d/%m/%Y %H:%M:%S.%f"),
    "month first": lambda at: at.strftime("%m-%d-%Y %H:%M:%S.%f"),
    "time of day": lambda at: at.strftime("%H:%M:%S.%f"),
    "behind days": lambda at: f"{at.day} days {at:%H:%M:%S.%f}",
    "without hours": lambda at: at.strftime("%M:%S.%f"),
    "short": lambda at: f"{at.hour}:{at:%M:%S},{at.microsecond // 1000:03d}",
}


def written(path: Path, form, steps=STEPS, start=START, name="Zeit", times=20) -> Path:
    """Write an encoder's log whose time is text, each step `times` times a round."""
    seconds = np.concatenate([steps + k * (steps[-1] + 0.5) for k in range(times)])
    turn = np.linspace(0, 350, len(seconds))
    lines = [f"{name};angle_deg;angle_ref_deg"]
    for s, a in zip(seconds, turn, strict=True):
        lines.append(
            f"{form(start + timedelta(seconds=float(s)))};{a:.4f};{a + 0.5 * np.sin(np.radians(a)):.4f}"
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_every_form_is_the_same_time_over_midnight(tmp_path, form):
    """The 30th is no month, so that its order is plain; the next sample is on the 31st."""
    log = read_log(written(tmp_path / "log.csv", form))
    expected = np.concatenate([STEPS + k * (STEPS[-1] + 0.5) for k in range(20)])
    assert log.array("t_s") == pytest.approx(expected, abs=1.1e-3)
    assert any("holds" in note and "in seconds from its first sample on" in note for note in log.notes)


def test_a_number_for_the_time_stays_the_time(tmp_path):
    path = tmp_path / "log.csv"
    rows = "\n".join(f"{0.1 * k:.1f},12:00:{k:02d},{k},{k}" for k in range(30))
    path.write_text(f"t_s,Clock,angle_deg,angle_ref_deg\n{rows}\n")
    assert read_log(path).array("t_s")[1] == pytest.approx(0.1)
    assert read_log(path, columns={"t_s": "Clock"}).array("t_s")[1] == 1.0


def test_a_date_that_may_be_read_in_two_ways_is_refused_where_it_matters(tmp_path):
    path = written(tmp_path / "log.csv", FORMS["day first"], start=START.replace(month=2, day=3))
    with pytest.raises(InputError, match="day may stand first or second: write the year first"):
        read_log(path).array("t_s")
    one_day = written(tmp_path / "day.csv", FORMS["day first"], start=START.replace(month=2, day=3, hour=1))
    assert read_log(one_day).array("t_s")[1] == 0.25


def test_a_line_that_is_no_time_is_named(tmp_path):
    path = written(tmp_path / "log.csv", FORMS["ISO 8601"], times=1000)
    lines = path.read_text().split("\n")
    lines[-3] = "30.01. yesterday;1.0;1.0"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"Column 'Zeit' of .* must hold dates with times in one form"):
        read_log(path).array("t_s")


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=30), st.integers(1, 5))
def test_chunks_of_a_column_give_the_same_seconds(steps, size):
    at = [START + timedelta(milliseconds=int(ms)) for ms in np.cumsum(steps)]
    for name in ("ISO 8601", "dots", "time of day"):
        cells = [FORMS[name](t) for t in at]
        form = time_form(cells)
        whole = Seconds(form, "it")(pa.array(cells))
        turned = Seconds(form, "it")
        parts = [turned(pa.array(cells[k : k + size])) for k in range(0, len(cells), size)]
        assert np.concatenate(parts) == pytest.approx(whole)


# -- what a calibration remembers of how its log was read ------------------------------------------------


def table(path: Path, decimal: str) -> Path:
    """Write knots of an encoder whose three decimals may be thousands."""
    reference = np.arange(3.0, 362.0, 3.0)
    angle = reference + 0.5 * np.sin(2 * np.radians(reference))
    rows = [f"{a:.3f}\t{r:.3f}".replace(".", decimal) for a, r in zip(angle, reference, strict=True)]
    path.write_text("\n".join(["Winkel\tRef", *rows]) + "\n", encoding="utf-8")
    return path


COLUMNS = {"angle_deg": "Winkel", "angle_ref_deg": "Ref"}


def test_a_calibration_answers_what_the_next_file_leaves_open(tmp_path, capsys):
    first, second = table(tmp_path / "a.txt", ","), table(tmp_path / "b.txt", ",")
    with pytest.raises(InputError, match="--decimal"):
        read_log(first, columns=COLUMNS)
    found = fit(read_log(first, columns=COLUMNS, decimal=","), "rotary", solver="direct")
    found.save(tmp_path / "calib.json")
    known = load_fit(tmp_path / "calib.json")
    assert dict(known.read_with) == {"decimal": ","}
    seen = hallsym.evaluate(known, second)
    assert any("is read as the calibration's log was: decimal ','" in note for note in seen.notes)
    assert main(["evaluate", str(tmp_path / "calib.json"), str(second)]) in (0, 3), capsys.readouterr().err


# -- columns that are typed as times ---------------------------------------------------------------------

TYPES = {
    "timestamp ns": pa.timestamp("ns"),
    "timestamp ms, zoned": pa.timestamp("ms", "Europe/Berlin"),
    "duration us": pa.duration("us"),
    "time of day us": pa.time64("us"),
    "time of day ms": pa.time32("ms"),
}


def typed(kind, name="Stamp", count=200) -> pa.Table:
    """An encoder's log with a sample each quarter of a second; its time has an Arrow type, from 23:59:50."""
    ms = 7000 + 250 * np.arange(count)
    if pa.types.is_timestamp(kind):
        ms = ms + 1_769_817_583_000
    elif pa.types.is_time(kind):
        ms = (ms + 86_383_000) % 86_400_000
    ticks = ms * {"ms": 1, "us": 1000, "ns": 1_000_000}[kind.unit]
    column = pa.array(ticks, pa.int32() if pa.types.is_time32(kind) else pa.int64()).cast(kind)
    turn = np.linspace(0, 6, count)
    return pa.table({name: column, "angle_rad": turn + 1e-3 * np.sin(turn), "angle_ref_rad": turn})


@pytest.mark.parametrize("name", ["Stamp", "t_s", "t", "t_ms"])
@pytest.mark.parametrize("kind", TYPES.values(), ids=TYPES)
def test_a_typed_time_is_seconds_in_a_file_and_in_a_table(tmp_path, kind, name):
    table = typed(kind, name)
    pq.write_table(table, tmp_path / "log.parquet")
    for log in (read_log(tmp_path / "log.parquet"), read_log(table)):
        assert log.array("t_s") == pytest.approx(0.25 * np.arange(200), abs=1e-9)
        assert any(f"Column '{name}'" in note and "in seconds from its first" in note for note in log.notes)


def test_chunks_of_a_typed_time_are_as_the_whole(tmp_path):
    pq.write_table(typed(TYPES["time of day us"]), tmp_path / "day.parq")
    source = ParquetSource(tmp_path / "day.parq")
    parts = [chunk["t"] for chunk in source.chunks(["t"], 7)]
    assert np.concatenate(parts) == pytest.approx(0.25 * np.arange(200))


def test_a_missing_moment_is_no_number_and_numpy_has_times_too():
    stamps = np.datetime64("2026-01-30T23:59:58", "us") + (250_000 * np.arange(200)).astype("m8[us]")
    turn = np.linspace(0, 6, 200)
    columns = {"angle_rad": turn, "angle_ref_rad": turn + 1e-4}
    assert read_log({"when": stamps, **columns}).array("t_s") == pytest.approx(0.25 * np.arange(200))
    gone = typed(TYPES["timestamp ns"])["Stamp"].to_pylist()
    column = pa.array([None, *gone[1:100], None, *gone[101:]], pa.timestamp("ns"))
    seconds = Seconds()(column)
    assert np.flatnonzero(np.isnan(seconds)).tolist() == [0, 100]
    assert seconds[1] == 0.0
    assert seconds[-1] == pytest.approx(0.25 * 198)


@pytest.mark.parametrize("suffix", [".feather", ".parquet"])
def test_moments_put_two_files_on_one_clock(tmp_path: Path, suffix: str) -> None:
    """The second file begins half a second later."""
    t = np.arange(0, 3, 0.01)
    for name, begin in (("hall_a_um", 0.0), ("x_ref_um", 0.5)):
        ticks = np.round((begin + t) * 1e9).astype("timedelta64[ns]")
        table = pa.table({"time": np.datetime64("2026-01-01", "ns") + ticks, name: np.sin(begin + t)})
        write = pq.write_table if suffix == ".parquet" else write_feather
        write(table, str(tmp_path / f"{name}{suffix}"))
    log = read_log([tmp_path / f"hall_a_um{suffix}", tmp_path / f"x_ref_um{suffix}"])
    assert log.rows == 250
    assert log.array("hall_a_m") == pytest.approx(log.array("x_ref_m"), abs=1e-15)
    for day in (0, 1):  # a time of day alone is on the day that is nearest
        begin = np.datetime64("2026-01-01T23:59:59.8", "ms") + np.round(1e3 * t).astype("timedelta64[ms]")
        rows = [f"{at.astype(str)[11 * day :]},{1e6 * float(s)!r}" for at, s in zip(begin, t, strict=True)]
        (tmp_path / f"{'xy'[day]}.csv").write_text("\n".join(["time,{}_ref_um".format("xy"[day]), *rows, ""]))
    log = read_log([tmp_path / "x.csv", tmp_path / "y.csv"])
    assert log.array("x_ref_m") == pytest.approx(log.array("y_ref_m"), abs=1e-9)
