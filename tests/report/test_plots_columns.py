"""Pictures as wide as one and two columns of a journal page: no words on words, the same files every time."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
import reports
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from test_plots_layout import PICTURES, apart
from twins import record, with_noise

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.estimation import fit
from hallsym.report import figures as plots

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


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("name", NAMES)
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


def test_both_widths_have_names_of_their_own_and_the_same_bytes(tmp_path: Path) -> None:
    draw = {"spectrum": drawings()["spectrum full"]}
    place = plots.Place(tmp_path, plots.SUFFIXES, "campaign/log.parquet, stage31", columns=(1, 2))
    written = plots.save_figures(draw, place)
    assert [p.name for p in written] == [
        f"{stem}.{suffix}" for stem in ("spectrum", "spectrum_1column") for suffix in plots.SUFFIXES
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
