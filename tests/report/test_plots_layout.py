"""Pictures of what data determine, as drawings: nothing beyond the edge, no words on words, whole files."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import reports
from matplotlib import style
from matplotlib.axis import Tick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from hallsym.inference import VERDICTS, Identifiability
from hallsym.report.figures import (
    LOOKS,
    STYLE,
    broken,
    correlation,
    drawable,
    effects,
    profiles,
    text_width,
)
from hallsym.report.words import digits

PICTURES = {
    "correlation": correlation,
    "effects": effects,
    "profiles": profiles,
}


@pytest.fixture(autouse=True)
def _look() -> Iterator[None]:
    with style.context(["default", STYLE]):
        yield


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


@pytest.mark.parametrize(
    ("picture", "which"),
    [
        *(("correlation", which) for which in ("full", "level")),
        *(("effects", which) for which in ("odd", "level")),
        *(("profiles", which) for which in ("full", "odd")),
    ],
)
def test_nothing_is_beyond_the_edge_or_on_other_words(picture: str, which: str) -> None:
    report: Identifiability = getattr(reports, which)()
    figure = PICTURES[picture](report)
    FigureCanvasAgg(figure).draw()
    reports.inside(figure)
    apart(figure)


def test_pictures_that_have_nothing_to_show_are_not_drawn() -> None:
    plan, full = reports.plan(), reports.full()
    assert drawable(plan) == [correlation, effects]
    assert drawable(full) == [correlation, effects, profiles]
    assert drawable(replace(plan, correlation=np.full((21, 21), np.nan))) == [effects]


def test_every_verdict_has_a_look_of_its_own() -> None:
    assert set(LOOKS) == set(VERDICTS)
    assert len({look.marker + str(look.filled) for look in LOOKS.values()}) == len(LOOKS)


def test_broken_lines_fit_and_lose_no_word() -> None:
    text = " ".join(f"parameter_{k}," for k in range(40))
    lines = broken(text, 3.0)
    assert len(lines) > 5
    assert max(map(text_width, lines)) <= 3.0
    assert " ".join(line.strip() for line in lines) == text
    assert broken("unbreakablylongword", 0.1) == ["unbreakablylongword"]


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (0.86677703, 0.0002, "0.86678"),
        (-189.416, 1.8, "\N{MINUS SIGN}189.4"),
        (np.inf, 1.0, "∞"),
        (-np.inf, 0.0, "\N{MINUS SIGN}∞"),
        (np.nan, 1.0, "unknown"),
        (0.85, 0.0, "0.85"),
        (12345.6, 200.0, "12346"),
    ],
)
def test_numbers_have_the_digits_of_their_interval(value: float, half: float, text: str) -> None:
    assert digits(value, half) == text
