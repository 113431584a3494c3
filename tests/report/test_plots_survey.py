"""What pictures are made of: every extreme survives decimation, errors are the fit's, words are readable."""

import numpy as np
import pytest
from twins import record, with_noise

from hallsym.estimation import Fit, fit
from hallsym.log import Block, Log
from hallsym.report import data
from hallsym.report import figures as plots
from hallsym.report.words import name, plus_minus, scale

HOLDOUT = (2, 7, 12)


@pytest.fixture(scope="module")
def log() -> Log:
    return with_noise(record(seed=1))


@pytest.fixture(scope="module")
def fitted(log: Log) -> Fit:
    return fit(log, "stage31", solver="direct", loss="none", holdout=HOLDOUT)


@pytest.fixture(scope="module")
def survey(log: Log, fitted: Fit) -> data.Survey:
    return data.look_over(log, fitted)


# -- traces ----------------------------------------------------------------------------------------------


def test_trace_keeps_every_extreme_of_a_long_log() -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal((2, 50_000))
    values[0, 31_234], values[1, 7] = 50.0, np.nan
    trace, first = data.Trace(2), 0
    for size in (1, 700, 8192, 8192, 20_000, 12_915):
        trace.add(values[:, first : first + size])
        first += size
    assert first == trace.count == 50_000
    assert data.COLUMNS <= trace.low.shape[1] <= 2 * data.COLUMNS
    at = np.arange(50_000) // trace.width
    for k in range(2):
        for column in (0, 1, 976, trace.low.shape[1] - 1):
            part = values[k, at == column]
            assert trace.low[k, column] == np.nanmin(part)
            assert trace.high[k, column] == np.nanmax(part)
    assert trace.high[0, 31_234 // trace.width] == 50.0


def test_short_trace_is_drawn_sample_by_sample_and_broken_between_runs() -> None:
    trace = data.Trace(1)
    trace.add(np.arange(10.0)[None])
    x, y = trace.line(0, trace.samples, [4])
    np.testing.assert_array_equal(x, [0, 1, 2, 3, 4, 4, 5, 6, 7, 8, 9])
    np.testing.assert_array_equal(y, [0, 1, 2, 3, np.nan, 4, 5, 6, 7, 8, 9])


# -- the survey of a log ---------------------------------------------------------------------------------


def test_survey_has_the_error_tables_of_the_fit(fitted: Fit, survey: data.Survey) -> None:
    assert fitted.errors is not None
    for mine, theirs in ((survey.nominal, fitted.errors.designed), (survey.fitted, fitted.errors.fitted)):
        assert mine.runs == theirs.runs
        np.testing.assert_allclose(mine.squares, theirs.squares, rtol=1e-9)
        np.testing.assert_allclose(mine.peak, theirs.peak, rtol=1e-9)


def test_survey_leaves_out_what_keep_rejects(log: Log, fitted: Fit) -> None:
    def keep(block: Block) -> np.ndarray:
        return (np.abs(block.data["y_ref_m"]) < 400e-6).astype(float)

    survey = data.look_over(log, fitted, keep)
    rejected = int(np.sum(np.abs(log.array("y_ref_m")) >= 400e-6))
    assert survey.n_rejected == rejected > 0
    assert survey.fitted.count.sum() == log.rows - rejected
    words = [text.get_text() for text in plots.errors_before_after(fitted, survey).legends[0].get_texts()]
    assert f"rejected sample ({rejected})" in words


def test_representative_runs_move_each_axis(survey: data.Survey) -> None:
    assert data.representative(survey) == [0, 1, 2]  # Table A1: Y, X, Rz at each setting


def test_settings_are_labelled_by_what_the_stage_does(fitted: Fit, survey: data.Survey) -> None:
    groups, title = data.settings(fitted, survey)
    labels = [label.replace("\N{MINUS SIGN}", "-") for label, _ in groups]
    assert len(groups) == 19
    assert labels[0] == "level"
    assert {"Z -250", "Z +250", "Rx +500", "Ry -500"} <= set(labels)
    assert sorted(run for _, runs in groups for run in runs) == list(survey.runs)
    assert title == "vertical setting (Z in µm; Rx, Ry in µrad)"


# -- words -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "largest", "factor", "unit"),
    [
        ("x_ref_m", 300e-6, 1e6, "µm"),
        ("x_m", 15e-9, 1e9, "nm"),
        ("x_m", 0.0195, 1e6, "µm"),
        ("x_m", 0.05, 1e3, "mm"),
        ("x_m", 2.0, 1.0, "m"),
        ("angle_ref_rad", 6.28, 180 / np.pi, "deg"),
        ("angle_rad", 1e-3, 180e3 / np.pi, "mdeg"),
        ("rz_rad", 0.1, 1e3, "mrad"),
        ("v_sin_v", 1e-3, 1e3, "mV"),
        ("v_sin_v", 2.5, 1.0, "V"),
        ("temperature_degc", 60.0, 1.0, "°C"),
        ("x_m", float("nan"), 1e6, "µm"),
    ],
)
def test_units_suit_the_size(column: str, largest: float, factor: float, unit: str) -> None:
    found, shown = scale(column, largest)
    assert (found, shown) == (pytest.approx(factor), unit)


def test_names_are_what_people_say() -> None:
    assert [name(c) for c in ("rz_rad", "hall_a_m", "v_sin_v")] == ["Rz", "Hall A", "v sin"]


@pytest.mark.parametrize(
    ("value", "half", "unit", "text"),
    [
        (0.194562, 0.00035, "m", "194.56 ± 0.35 mm"),
        (-188.187, 1.84, "1/m", "\N{MINUS SIGN}188.2 ± 1.8 1/m"),
        (0.86707, 0.00018, "1", "0.86707 ± 0.00018"),
        (123.0, 0.0, "1/m", "123 1/m"),
    ],
)
def test_an_interval_has_two_digits(value: float, half: float, unit: str, text: str) -> None:
    assert plus_minus(value, half, unit) == text
