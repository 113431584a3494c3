"""Pictures: what is drawn is what was measured and fitted, axes say their units."""

import numpy as np
import pytest
from twins import SIGMAS, record, with_noise

from hallsym.estimation import Fit, coverage_factor, fit
from hallsym.families import build
from hallsym.log import Log
from hallsym.report import data
from hallsym.report import figures as plots
from hallsym.simulation import Campaign, NoiseModel, Run, simulate, sine

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


def _legends(figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


# -- figures of a campaign -------------------------------------------------------------------------------


def test_plotted_peak_is_the_peak_of_the_table(fitted: Fit, survey: data.Survey) -> None:
    assert survey.errors[0].width > 1, "the log shall be long enough to be decimated"
    figure = plots.errors_before_after(fitted, survey)
    tables = (survey.nominal, survey.fitted)
    assert len(figure.axes) == 6
    for k, ax in enumerate(figure.axes):
        trace = max(ax.lines, key=lambda line: len(line.get_xdata()))
        drawn = 1e-6 * np.nanmax(np.abs(trace.get_ydata()))
        np.testing.assert_allclose(drawn, tables[k % 2].peak[:, k // 2].max(), rtol=1e-9)
        assert ax.get_ylabel() == f"error in {('x [µm]', 'y [µm]', 'Rz [µrad]')[k // 2]}"
        low, high = ax.get_ylim()
        assert low < -1e6 * tables[k % 2].peak[:, k // 2].max() < 0 < high
    assert "held out" in figure.axes[1].get_title("left")
    assert "held out" not in figure.axes[0].get_title("left")
    rmse = fitted.error_rows["holdout"]["rmse"]["x_m"]
    assert f"held out {1e6 * rmse:.3g}"[:12] in figure.axes[1].get_title("left")


def test_measured_lays_the_decoded_pose_over_the_reference(
    log: Log, fitted: Fit, survey: data.Survey
) -> None:
    figure = plots.measured(log, fitted, survey)
    assert len(figure.axes) == 12
    assert [ax.get_ylabel() for ax in figure.axes[::3]] == ["x [µm]", "y [µm]", "Rz [µrad]", "reading [µm]"]
    assert "held out" in figure.axes[2].get_title("left")
    reference, designed, decoded = (line.get_ydata() for line in figure.axes[3].lines)  # y of run 0
    np.testing.assert_allclose(reference, 1e6 * log.run(0)["y_ref_m"], rtol=1e-12)
    assert np.abs(decoded - reference).max() <= 1e6 * survey.fitted.peak[:, 1].max() * (1 + 1e-9)
    assert np.abs(designed - reference).max() > 50
    assert {"Hall A", "Hall B", "Hall C", "reference"} <= set(_legends(figure))


def test_errors_by_setting_shows_every_series(fitted: Fit, survey: data.Survey) -> None:
    figure = plots.errors_by_setting(fitted, survey)
    labels = ["nominal", "fitted", "fitted, held-out runs", "noise floor"]
    assert _legends(figure) == labels
    assert [ax.get_ylabel() for ax in figure.axes] == ["rmse x [µm]", "rmse y [µm]", "rmse Rz [µrad]"]
    assert all(ax.get_yscale() == "log" for ax in figure.axes)
    level = survey.nominal.over((0, 1, 2))
    assert level is not None
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata()[0], 1e6 * level["rmse"]["x_m"], rtol=1e-9)


def test_parameters_say_what_is_not_identifiable(fitted: Fit) -> None:
    figure = plots.parameters(fitted)
    words = [text.get_text() for place in (*figure.axes, figure) for text in place.texts]
    told = words.count("not identifiable") + words.count("not identifiable, fixed")
    assert told == np.sum(~fitted.determined) - len(fitted.at_bound)
    assert sum("±" in word for word in words) == fitted.determined.sum() + len(fitted.combinations) + 1
    width = fitted.model.bounds[1] - fitted.model.bounds[0]
    half = 100 * np.nanmax(coverage_factor(fitted.degrees_of_freedom) * fitted.std / width)
    drawn = max(float(line.get_xdata().max()) for line in figure.axes[1].lines)
    assert drawn == pytest.approx(half)


# -- other logs ------------------------------------------------------------------------------------------


def one_run(samples: int, model: str = "stage15") -> dict[str, np.ndarray]:
    motion = {"x_m": sine(3e-4, 1.0), "y_m": sine(5e-4, 0.7), "rz_rad": sine(3e-4, 0.3)}
    run = Run(samples * 2e-3, {"z_m": 100e-6}, motion, () if model == "stage15" else (1e-6,) * 3)
    return simulate(build(model), {}, Campaign(2e-3, (run,)), NoiseModel(SIGMAS), seed=5)


@pytest.mark.parametrize("timed", [True, False])
def test_one_run_without_holdout(timed: bool) -> None:
    columns = one_run(6000)
    if not timed:
        del columns["t_s"]
    log = with_noise(columns)
    result = fit(log, "stage15", solver="direct", loss="none")
    survey = data.look_over(log, result)
    assert data.settings(result, survey) == ([("0", [0])], "run")
    figure = plots.errors_before_after(result, survey)
    assert figure.axes[-1].get_xlabel() == ("time [s]" if timed else "sample")
    assert len(_legends(figure)) == 1
    assert len(plots.measured(log, result, survey).axes) == 4
    assert len(plots.errors_by_setting(result, survey).axes) == 3


def test_a_run_too_long_to_see_is_shown_from_its_start(fitted: Fit) -> None:
    log = with_noise(one_run(100_000, "stage31"))
    figure = plots.measured(log, fitted, data.look_over(log, fitted))
    title = figure.axes[0].get_title("left")
    assert title.startswith("run 0, Z +100 µm, first ")
    assert title.endswith(" s")
    seconds = float(title.split()[-2])
    assert 3 < seconds < 20
    np.testing.assert_allclose(np.nanmax(figure.axes[0].lines[0].get_xdata()), seconds, rtol=0.01)


def test_nothing_is_drawn_beyond_the_edge(log: Log, fitted: Fit, survey: data.Survey) -> None:
    """Margins are stated in inches: everything must fit into them."""
    from matplotlib import style

    with style.context(["default", plots.STYLE]):
        figures = (
            plots.measured(log, fitted, survey),
            plots.errors_before_after(fitted, survey),
            plots.errors_by_setting(fitted, survey),
            plots.parameters(fitted),
        )
        for figure in figures:
            drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
            assert min(drawn.x0, drawn.y0) >= 0
            assert drawn.x1 <= width
            assert drawn.y1 <= height
