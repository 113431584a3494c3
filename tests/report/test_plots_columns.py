"""Pictures as wide as one and two columns of a journal page: no words on words, the same files every time."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import reports
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from test_plots_layout import PICTURES, apart
from twins import SIGMAS, TRUTH, record, with_noise

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.estimation import fit
from hallsym.families import build
from hallsym.inference import identify
from hallsym.report import figures as plots
from hallsym.simulation import paper_campaign

FIT = {
    "measured": lambda log, found, survey: plots.measured(log, found, survey),
    "errors_before_after": lambda log, found, survey: plots.errors_before_after(found, survey),
    "errors_by_setting": lambda log, found, survey: plots.errors_by_setting(found, survey, {}),
    "parameters": lambda log, found, survey: plots.parameters(found),
}
WHICH = ("full", "level", "odd")
PAGE = 247 / 25.4
"""Inches: an A4 page with margins of 25 mm."""


@cache
def drawings() -> dict[str, Callable[[], Figure]]:
    log = with_noise(record(seed=1))
    found = fit(log, "stage31", solver="direct", loss="none", holdout=(2, 7, 12))
    survey = plots.look_over(log, found, None)  # type: ignore[attr-defined]
    every = {name: (lambda draw=draw: draw(log, found, survey)) for name, draw in FIT.items()}
    for which in ("full", "level", "odd"):
        report = getattr(reports, which)()
        for name, draw in PICTURES.items():
            if draw in plots.drawable(report):
                every[f"{name} {which}"] = lambda draw=draw, report=report: draw(report)
    return every


NAMES = [*FIT, *(f"{p} {w}" for p in PICTURES for w in WHICH if (p, w) != ("profiles", "level"))]


ODD = ("intervals odd", "profiles odd")
"""Pictures that show every verdict and every end that an interval can have."""


def listed() -> list:
    """One column of one report and of what is odd in every run; all others with the slow tests."""
    always = {(name, 1) for name in NAMES if name.endswith(" full") or name in (*FIT, *ODD)}
    always |= {(name, 2) for name in FIT}
    return [
        pytest.param(name, columns, marks=() if (name, columns) in always else pytest.mark.slow)
        for name in NAMES
        for columns in (1, 2)
    ]


@pytest.mark.parametrize(("name", "columns"), listed())
def test_words_stand_apart_and_on_the_canvas(name: str, columns: int, tmp_path: Path) -> None:
    said: list[str] = []
    drawn: list[Figure] = []

    def draw() -> Figure:
        drawn.append(drawings()[name]())
        return drawn[-1]

    place = plots.Place(tmp_path, ("svg",), told=said.append, columns=(columns,))
    files = plots.save_figures({"picture": draw}, place)
    assert said == []
    assert columns == 1 or len(files) == 1
    for figure in drawn[-len(files) :]:
        with style.context(["default", plots.STYLE]):
            FigureCanvasAgg(figure).draw()
            reports.inside(figure, plots.WIDTHS[columns])
            apart(figure)
        assert figure.get_size_inches()[1] <= PAGE or columns == 2
        assert min(t.get_fontsize() for t in figure.findobj(Text) if t.get_text()) >= 7.0


def test_a_picture_higher_than_a_page_is_several_files_that_share_what_it_repeats(tmp_path: Path) -> None:
    report = reports.full()
    drawn: list[Figure] = []

    def draw() -> Figure:
        drawn.append(plots.profiles(report))
        return drawn[-1]

    place = plots.Place(tmp_path, ("svg",), columns=(1, 2))
    files = plots.save_figures({"profiles": draw}, place)
    several = [f"profiles_1column_{k + 1}.svg" for k in range(len(files) - 1)]
    assert [p.name for p in files] == ["profiles.svg", *several]
    assert len(several) > 1
    shown = [len(figure.axes) for figure in drawn[-len(several) :]]
    assert sum(shown) == len(report.intervals.profiles)
    assert max(shown) - min(shown) <= 1


@pytest.mark.parametrize("columns", [1, 2])
def test_a_legend_of_several_lines_lies_below_the_axis_label(columns: int) -> None:
    with style.context(["default", plots.STYLE]), plots.laid_out(columns):
        figure = Figure(figsize=(plots.WIDTHS[columns], 2.0))
        ax = figure.add_axes((0.2, 0.62 / 2, 0.7, 0.5))
        lines = [ax.plot([0, 1], [0, k], label=f"col {k}")[0] for k in range(9)]
        label = ax.set_xlabel("time in the run [s]")
        ax.xaxis.set_label_coords(0.5, -0.24)  # 0.24 inches below an axis 1 inch high
        plots.legend(figure, lines, "lower center", ncols=6)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        top = figure.legends[0].get_window_extent(canvas.get_renderer()).y1
        assert top <= label.get_window_extent(canvas.get_renderer()).y0


def test_a_number_of_six_digits_has_the_room_that_ticks_leave_it() -> None:
    assert plots.text_width("123456") <= plots.NUMBER


def test_the_narrowest_axes_hold_a_number_and_the_lowest_the_label_of_their_y_axis() -> None:
    assert plots.text_width("123456") <= plots.TIGHT < 1.3 * plots.text_width("123456")
    label = plots.text_width("error in x [um]")
    assert label <= plots.LOW < 1.2 * label


def beside(title: str, label: str) -> tuple[float, float]:
    """Inches that a title takes above axes, and numbers and a label below them."""
    with style.context(["default", plots.STYLE]):
        figure = Figure(figsize=(3.5, 3.0))
        ax = figure.add_axes((0.2, 0.4, 0.7, 0.3))
        ax.set(title=title, xlabel=label)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        inner, outer = ax.get_window_extent(canvas.get_renderer()), ax.get_tightbbox(canvas.get_renderer())
        assert outer is not None
        return (outer.y1 - inner.y1) / figure.dpi, (inner.y0 - outer.y0) / figure.dpi


def test_stacked_panels_leave_room_for_a_title_of_two_lines_and_a_label_of_one() -> None:
    above, below = beside("one line\nand another", "time in the run [s]")
    higher, lower = beside("one line\nanother\nand a third", "time in\nthe run [s]")
    assert above <= plots.HEAD < higher
    assert below <= plots.LABEL < lower


def stacked(lines: int) -> float:
    """Height of a picture of panels that are lowered to a page, with a legend of so many lines [inches]."""
    with style.context(["default", plots.STYLE]), plots.laid_out(1):
        figure, axes = plots.panels(3, 2, 5.0, top=0.3, bottom=0.5)
        assert figure.get_size_inches()[1] < plots.PAGE
        names = [f"{'a name as long as the column is wide'} {k}" for k in range(lines)]
        plots.legend(figure, [axes[0, 0].plot([0, 1], label=name)[0] for name in names], "lower center")
        return float(figure.get_size_inches()[1])


def test_panels_leave_a_page_the_lines_of_a_legend() -> None:
    assert stacked(5) <= plots.PAGE
    with pytest.raises(plots.NoRoomError):
        stacked(7)


def test_many_correlations_in_one_column_are_several_files_each_with_all_rows(tmp_path: Path) -> None:
    model = build("stage31", added=("cross_axis_sensitivity", "odd_nonlinearity", "height_quadratic"))
    report = identify(model, paper_campaign(0.05), values=TRUTH, noise=SIGMAS)
    known = int(np.isfinite(np.diag(report.correlation)).sum())
    said: list[str] = []
    drawn: list[Figure] = []

    def draw() -> Figure:
        drawn.append(plots.correlation(report))
        return drawn[-1]

    files = plots.save_figures({"c": draw}, plots.Place(tmp_path, ("svg",), told=said.append, columns=(1,)))
    assert said == []
    assert known > 30
    assert len(files) > 1
    axes = [figure.axes[0] for figure in drawn[-len(files) :]]
    names = [[label.get_text() for label in ax.get_xticklabels()] for ax in axes]
    rows = [[label.get_text() for label in ax.get_yticklabels()] for ax in axes]
    assert [name for part in names for name in part] == rows[0]
    assert all(row == rows[0] for row in rows)
    assert len(rows[0]) == known
    for figure in drawn[-len(files) :]:
        with style.context(["default", plots.STYLE]):
            FigureCanvasAgg(figure).draw()
            reports.inside(figure, plots.WIDTHS[1])
            apart(figure)
        assert figure.get_size_inches()[1] <= PAGE
        assert min(t.get_fontsize() for t in figure.findobj(Text) if t.get_text()) >= 7.0


def test_both_widths_have_names_of_their_own_and_the_same_bytes(tmp_path: Path) -> None:
    draw = {"spectrum": drawings()["spectrum full"]}
    suffixes = ("pdf", "svg")
    place = plots.Place(tmp_path, suffixes, "campaign/log.parquet, stage31", columns=(1, 2))
    written = plots.save_figures(draw, place)
    assert [p.name for p in written] == [
        f"{stem}.{suffix}" for stem in ("spectrum", "spectrum_1column") for suffix in suffixes
    ]
    first = [p.read_bytes() for p in written]
    assert [p.read_bytes() for p in plots.save_figures(draw, place)] == first
    alone = plots.Place(tmp_path / "one", ("svg",), "campaign/log.parquet, stage31", columns=(1,))
    (narrow,) = plots.save_figures(draw, alone)
    assert narrow.name == "spectrum.svg"
    assert narrow.read_bytes() == (tmp_path / "spectrum_1column.svg").read_bytes()


def test_a_picture_whose_words_touch_is_drawn_for_two_columns(tmp_path: Path) -> None:
    def draw() -> Figure:
        figure = Figure(figsize=(3.5, 2.0))
        figure.subplots().plot([0, 1, 2], [0, 1, 0])
        figure.text(0.5, 0.5, "one text")
        figure.text(0.52, 0.5, "another text")
        return figure

    said: list[str] = []
    plots.save_figures({"words": draw}, plots.Place(tmp_path, told=said.append, columns=(1,)))
    assert said == ["The picture words has no room in one column; it is drawn for two."]


def test_other_numbers_of_columns_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=r"only 1 and 2; instead received \[3\]"):
        plots.save_figures({}, plots.Place(tmp_path, columns=(3,)))
    with pytest.raises(SystemExit):
        main(["sensitivity", "--model", "stage31", "--plan", "--plot-columns", "3"])
    assert "a picture takes 1 or 2 columns; instead received '3'" in capsys.readouterr().err
