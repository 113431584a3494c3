"""Pictures of what data determine: what is drawn is what the report says, nothing lies on other words."""

from dataclasses import replace

import numpy as np
import pytest
import reports
from matplotlib.axis import Tick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from hallsym.errors import InputError
from hallsym.report.drawing import draw
from hallsym.report.results.identifiability import correlation

# -- correlation -----------------------------------------------------------------------------------------


def test_correlation_writes_each_pair_once_and_names_what_is_left_out() -> None:
    full = reports.full()
    figure = draw(correlation(full))
    ax = figure.axes[0]
    names = [label.get_text() for label in ax.get_yticklabels()]
    left_out = {n for n in full.model.names if not np.isfinite(full[n].std or np.nan)}
    assert left_out == {"H1x", "H1y", "H2x", "H2y", "H3x", "H3y"}
    assert set(names) == set(full.model.names) - left_out
    n = len(names)
    assert len(ax.texts) == n * (n - 1) // 2
    for text in ax.texts:
        column, row = (round(v) for v in text.get_position())
        index = [full.model.names.index(names[k]) for k in (row, column)]
        shown = float(text.get_text().replace("\N{MINUS SIGN}", "-"))
        assert shown == pytest.approx(full.correlation[index[0], index[1]], abs=0.0051)
    assert sum(len(collection.get_paths()) for collection in ax.collections) == n * (n - 1) // 2
    assert "not determined: H1x, H1y, H2x, H2y, H3x, H3y." in figure.get_supxlabel()


def test_fullness_of_a_cell_is_the_correlation_and_negative_ones_have_a_dash() -> None:
    full = reports.full()
    k = [full.model.names.index(name) for name in ("eta_A", "eta_B")]
    two = np.full_like(full.correlation, np.nan)
    two[np.ix_(k, k)] = [[1.0, -0.25], [-0.25, 1.0]]
    ax = draw(correlation(replace(full, correlation=two))).axes[0]
    (negative,) = ax.collections
    assert negative.get_label() == "anticorrelated"
    assert negative.get_facecolor()[:, 3] == pytest.approx([0.25])
    (dash,) = ax.lines
    assert dash.get_xdata()[:2] == pytest.approx([0.8, 1.2])
    assert dash.get_ydata()[:2] == pytest.approx([0.0, 0.0])


# -- as drawings -----------------------------------------------------------------------------------------


def apart(figure: Figure) -> None:
    """No two texts lie on each other."""
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    axes = [axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)]
    seen = [axis for axis in axes if axis.get_visible()]
    drawn = {id(label) for axis in seen for tick in axis._update_ticks() for label in labels(tick)}
    beyond = {
        id(label)
        for axis in axes
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
        for label in labels(tick)
    } - drawn
    texts = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text().strip()]
    texts = [t for t in texts if id(t) not in beyond]
    assert len(texts) > 10
    boxes = np.array([t.get_window_extent(renderer).extents for t in texts])
    shrunk = boxes + np.array([0.5, 0.5, -0.5, -0.5])
    across = (shrunk[:, None, 0] < shrunk[None, :, 2]) & (shrunk[None, :, 0] < shrunk[:, None, 2])
    up = (shrunk[:, None, 1] < shrunk[None, :, 3]) & (shrunk[None, :, 1] < shrunk[:, None, 3])
    same = [(texts[i].get_text(), texts[j].get_text()) for i, j in np.argwhere(np.triu(across & up, 1))]
    assert same == []


def labels(tick: Tick) -> tuple[Text, Text]:
    return tick.label1, tick.label2


@pytest.mark.parametrize("report", ["full", "level"])
def test_nothing_is_beyond_the_edge_or_on_other_words(report: str) -> None:
    figure = draw(correlation(getattr(reports, report)()))
    FigureCanvasAgg(figure).draw()
    reports.inside(figure)
    apart(figure)


def test_pictures_that_have_nothing_to_show_are_not_drawn() -> None:
    with pytest.raises(InputError, match="no correlation to draw"):
        correlation(replace(reports.plan(), correlation=np.full((21, 21), np.nan)))
