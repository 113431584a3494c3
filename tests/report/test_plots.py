"""Pictures: what is drawn is what was measured and fitted, in files that are whole; words are readable."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import reports
from twins import SIGMAS, record, with_noise

from hallsym.errors import InputError
from hallsym.estimation import Fit, evaluate, fit
from hallsym.estimation.prediction import decoded
from hallsym.families import build
from hallsym.families.recording import Correction
from hallsym.log import Log
from hallsym.report.data.gather import COLUMNS, Trace, held_out, settings
from hallsym.report.drawing import DPI, WIDTH, draw, save, svg
from hallsym.report.results import fit as plots
from hallsym.simulation import Campaign, NoiseModel, Run, simulate, sine


def _legends(figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


# -- figures of a campaign -------------------------------------------------------------------------------


def test_errors_by_setting_shows_every_series(log: Log, fitted: Fit) -> None:
    picture = plots.fit_figure(log, fitted)
    figure = draw(picture)
    reports.inside(figure)
    labels = ["nominal", "fitted", "fitted, holdout runs", "noise floor"]
    assert _legends(figure) == labels
    assert [ax.get_ylabel() for ax in figure.axes] == ["rmse x [µm]", "rmse y [µm]", "rmse Rz [µrad]"]
    assert all(ax.get_yscale() == "log" for ax in figure.axes)
    title = "vertical setting (Z in µm; Rx, Ry in µrad)"
    assert [ax.get_xlabel() for ax in figure.axes] == ["", "", title]  # in a file once
    assert all(svg(panel, 360.0).count(title) == 1 for panel in picture.panels)
    level = fitted.errors.designed.over((0, 1, 2))
    assert level is not None
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata()[0], 1e6 * level["rmse"]["x_m"], rtol=1e-9)


# -- other logs ------------------------------------------------------------------------------------------


def one_run(samples: int, model: str = "stage15") -> dict[str, np.ndarray]:
    motion = {"x_m": sine(3e-4, 1.0), "y_m": sine(5e-4, 0.7), "rz_rad": sine(3e-4, 0.3)}
    run = Run(samples * 2e-3, {"z_m": 100e-6}, motion, () if model == "stage15" else (1e-6,) * 3)
    return simulate(build(model), {}, Campaign(2e-3, (run,)), NoiseModel(SIGMAS), seed=5)


def test_one_run_without_holdout() -> None:
    log = with_noise(one_run(6000))
    result = fit(log, "stage15", solver="direct", loss="none")
    assert settings(result, log) == ([("0", [0])], "run")
    assert len(plots.fit_figure(log, result).panels) == 3


# -- files -----------------------------------------------------------------------------------------------


def saved(log: Log, fitted: Fit, folder: Path) -> list[Path]:
    return save({"errors_by_setting": plots.fit_figure(log, fitted)}, folder)


def test_pictures_are_whole_files_in_their_own_style(log: Log, fitted: Fit, tmp_path: Path) -> None:
    import matplotlib

    pyplot = "matplotlib.pyplot" in sys.modules
    with matplotlib.rc_context({"font.size": 17.0, "axes.facecolor": "red"}):
        written = saved(log, fitted, tmp_path / "new" / "folder")
        assert matplotlib.rcParams["font.size"] == 17.0
        assert matplotlib.rcParams["axes.facecolor"] == "red"
    assert ("matplotlib.pyplot" in sys.modules) == pyplot
    assert [path.stem for path in written] == ["errors_by_setting"]
    for path in written:
        content = path.read_bytes()
        assert content.startswith(b"\x89PNG\r\n")
        assert content.endswith(b"IEND\xaeB`\x82")
        width = int.from_bytes(content[16:20], "big")
        assert width == round(WIDTH * DPI)
        assert 10_000 < len(content) < 1_000_000
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == sorted(p.name for p in written)


@pytest.mark.slow
def test_a_file_names_its_source_and_is_the_same_every_time(log: Log, fitted: Fit, tmp_path: Path) -> None:
    draw = {"errors": plots.fit_figure(log, fitted)}
    source = "campaign/log.parquet, stage31"
    first, again, bare = (save(draw, tmp_path, said)[0].read_bytes() for said in (source, source, ""))
    assert first == again != bare


def test_a_fit_starts_without_what_it_does_not_need() -> None:
    """And matplotlib is loaded only to draw."""
    heavy = ["scipy.stats", "scipy.optimize", "scipy.interpolate", "jinja2", "pyarrow"]
    heavy += [f"hallsym.{part}" for part in ("diagnosis", "codegen", "fleets", "uncertainty", "inference")]
    script = "import sys; from hallsym.cli.parser import parser_of; parser_of(['fit']); "
    script += f"print(*set({heavy}) & set(sys.modules)); "
    script += "import hallsym.report.views, hallsym.cli.fit, hallsym.cli.diagnose; "
    script += "print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "\nFalse\n"


def test_a_folder_that_cannot_be_is_one_sentence(log: Log, fitted: Fit, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match=r"^Cannot make the folder .*file.*\.$"):
        saved(log, fitted, tmp_path / "file" / "pictures")
    assert (tmp_path / "file").read_text() == "mine"


def test_corrections_of_the_fit_are_applied(log: Log, fitted: Fit) -> None:
    a, b, *_ = fitted.model.channels
    data = {name: log.array(name) for name in log.columns}
    swapped = with_noise(data | {a: data[b], b: -data[a]})
    wired = fitted.changed(corrections=(Correction("sign", (b,)), Correction("exchange", (a, b))))
    right, drawn = (draw(plots.fit_figure(*made)).axes[0] for made in ((log, fitted), (swapped, wired)))
    for line, same in zip(drawn.lines, right.lines, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), same.get_ydata())


# -- traces ----------------------------------------------------------------------------------------------


def test_trace_keeps_every_extreme_of_a_long_log() -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal((2, 50_000))
    values[0, 31_234], values[1, 7] = 50.0, np.nan
    trace, first = Trace(2), 0
    for size in (1, 700, 8192, 8192, 20_000, 12_915):
        trace.add(values[:, first : first + size])
        first += size
    assert first == trace.count == 50_000
    assert COLUMNS <= trace.low.shape[1] <= 2 * COLUMNS
    at = np.arange(50_000) // trace.width
    for k in range(2):
        for column in (0, 1, 976, trace.low.shape[1] - 1):
            part = values[k, at == column]
            assert trace.low[k, column] == np.nanmin(part)
            assert trace.high[k, column] == np.nanmax(part)
    assert trace.high[0, 31_234 // trace.width] == 50.0


# -- the errors of a log ----------------------------------------------------------------------------------


def test_what_is_decoded_has_the_error_tables_of_the_fit_and_of_an_evaluation(log: Log, fitted: Fit) -> None:
    """Zero deviations are those of the log that is evaluated, not of the one that was fitted."""
    assert fitted.errors is not None
    found = evaluate(fitted, with_noise(record(seed=2)))
    assert (held_out(fitted), held_out(found.applied)) == (reports.HOLDOUT, ())
    own, made = fitted.errors, decoded(log, fitted).tables()
    other = decoded(found.decoded, found.applied).tables()["fitted"]
    pairs = ((made["nominal"], own.designed), (made["fitted"], own.fitted), (other, found.table))
    for mine, theirs in pairs:
        assert mine.runs == theirs.runs
        np.testing.assert_allclose(mine.squares, theirs.squares, rtol=1e-6)
        np.testing.assert_allclose(mine.peak, theirs.peak, rtol=1e-6)


def test_settings_are_labelled_by_what_the_stage_does(log: Log, fitted: Fit) -> None:
    groups, title = settings(fitted, log)
    labels = [label.replace("\N{MINUS SIGN}", "-") for label, _ in groups]
    assert len(groups) == 19
    assert labels[0] == "level"
    assert {"Z -250", "Z +250", "Rx +500", "Ry -500"} <= set(labels)
    assert sorted(run for _, runs in groups for run in runs) == list(log.runs)
    assert title == "vertical setting (Z in µm; Rx, Ry in µrad)"
