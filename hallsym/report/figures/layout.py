"""How wide a picture is, and what follows from it: panels side by side or stacked, lines of a legend.

The drawing functions ask the layout that is in force, they never decide by the width themselves. What would
be higher than a page is drawn in several files, each with its share of what the picture repeats (runs,
coordinates, rows). A picture that has no room at a width raises `NoRoomError`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 7.1  # inches: two columns of a journal page
WIDTHS = {1: 3.5, 2: WIDTH}
"""Inches of a picture by the columns of a journal page that it takes: 89 and 180 mm."""
PAGE = 9.7
"""Inches of text on an A4 page with margins of 25 mm: a stacked picture is no higher."""
LOW = 0.85
"""Least height of a stacked panel [inches]: a label of its y axis."""
LABEL = 0.4
"""Inches below a stacked panel for the numbers and the label of its x axis."""
LATER = 0.8
"""Inches kept for lines by which labels and legends make a picture grow."""
HEAD = 0.42
"""Most inches above a stacked panel: a title of two lines."""
NUMBER = 0.43
"""Inches of an x axis that a number of six digits takes."""
TIGHT = 0.5
"""Least width of axes in which anything can be read [inches]."""


T = TypeVar("T")


class NoRoomError(Exception):
    """A picture cannot be drawn at the width in force."""


@dataclass(frozen=True)
class Layout:
    """Width of a picture, by the columns of a journal page that it takes (1 or 2); which file of how many."""

    columns: int = 2
    part: int = 0
    parts: int = 1
    repeats: list[int] = field(default_factory=list, compare=False)
    """How many items a picture that was drawn repeats, where it does."""

    @property
    def width(self) -> float:
        """Width [inches]."""
        return WIDTHS[self.columns]

    @property
    def stacked(self) -> bool:
        """Whether panels that belong side by side stand below each other."""
        return self.width < WIDTH

    @property
    def last(self) -> bool:
        """Whether this is the last file of the picture, which holds what stands once below it."""
        return self.part == self.parts - 1

    def share(self, items: Sequence[T]) -> list[T]:
        """Return what this file draws of the items that a picture repeats, one or more of them a file."""
        self.repeats.append(len(items))
        size, more = divmod(len(items), self.parts)
        start = self.part * size + min(self.part, more)
        return list(items[start : start + size + (self.part < more)])

    def across(self, most: int) -> int:
        """Return how many of `most` equal panels in a row of the full width stand in a row."""
        return max(1, round(most * self.width / WIDTH))

    def letters(self, most: int, beside: float) -> int:
        """Return the letters of a line that has `most` at full width, `beside` [inches] something else."""
        return max(12, int(most * (self.width - beside) / (WIDTH - beside)))

    def ticks(self, room: float) -> int | None:
        """Return how many numbers an x axis of `room` inches has at most; None: as many as it likes."""
        return max(3, int(room / NUMBER)) if self.stacked else None

    def need(self, room: float, least: float) -> None:
        """Raise `NoRoomError` if there is less room than needed; the full width takes what it gets."""
        if self.stacked and room < least:
            raise NoRoomError


FULL = Layout()
_current: ContextVar[Layout] = ContextVar("layout", default=FULL)


def layout() -> Layout:
    """Return the layout in force: two columns unless `laid_out` says otherwise."""
    return _current.get()


@contextmanager
def laid_out(columns: int, part: int = 0, parts: int = 1) -> Iterator[Layout]:
    """Draw pictures for so many columns of a page (1 or 2), as file `part` of `parts`."""
    token = _current.set(Layout(columns, part, parts))
    try:
        yield layout()
    finally:
        _current.reset(token)


def leftmost(axes: np.ndarray) -> np.ndarray:
    """Return the axes of a grid (rows, columns) or of a row that have nothing to their left."""
    if layout().stacked:
        return axes
    return axes[..., :1]


def stack(
    figure: Figure, axes: np.ndarray, height: float, *, top: float, bottom: float, left: float, right: float,
    gap: float, least: float, head: float = HEAD,
) -> None:  # fmt: skip
    """Place the columns of a grid of axes below each other, as one picture of at most a page; inches.

    `height` of each of the axes, which become lower, down to `least`, where the page asks for it; `gap`
    between those of a column, `head` for the title above the first of each.
    """
    rows, columns = axes.shape
    apart = LABEL + min(top, head)
    fixed = top + bottom + (columns - 1) * apart + columns * (rows - 1) * gap
    height = min(height, max(least, (PAGE - LATER - fixed) / axes.size))
    total, wide = fixed + axes.size * height, layout().width - left - right
    layout().need(PAGE, total - 1e-9)
    layout().need(wide, TIGHT)
    figure.set_size_inches(layout().width, total)
    floor = total - top
    for column in axes.T:
        for ax in column:
            floor -= height
            place = (left, floor, wide, height)
            ax.set_position(tuple(np.divide(place, (layout().width, total) * 2)))
            ax.tick_params("y", labelleft=True)
            floor -= gap
        floor += gap - apart


def grow(figure: Figure, *, above: float = 0.0, below: float = 0.0) -> None:
    """Make a figure higher [inches]; all that is on it keeps its size and its place from the other edge."""
    width, old = figure.get_size_inches()
    new = old + above + below
    layout().need(PAGE, new - 1e-9)
    figure.set_size_inches(width, new)
    for ax in figure.axes:
        box = ax.get_position()
        ax.set_position((box.x0, (box.y0 * old + below) / new, box.width, box.height * old / new))
    for text in figure.texts:
        x, y = text.get_position()
        text.set_position((x, (y * old + below) / new))
    for drawn in figure.legends:
        box = drawn.get_bbox_to_anchor().transformed(figure.transFigure.inverted())
        drawn.set_bbox_to_anchor((box.x0, box.y0), transform=figure.transFigure)


def folded(widths: Sequence[float], columns: int, between: float, room: float) -> int:
    """Return how many columns of a legend have room [inches]; `widths` of its entries, `columns` at most."""
    columns = max(1, min(columns, len(widths)))
    while columns > 1:
        wide = sum(max(part) for part in np.array_split(np.array(widths), columns))
        if wide + (columns - 1) * between <= room:
            break
        columns -= 1
    return columns


def clashes(figure: Figure) -> list[tuple[str, ...]]:
    """Return the texts of a figure that lie on each other, two by two, and each that leaves the canvas."""
    words, boxes = extents(figure)
    width, height = figure.bbox.size
    outside = (boxes[:, :2] < -1).any(axis=1) | (boxes[:, 2:] > (width + 1, height + 1)).any(axis=1)
    apart = boxes + np.array([0.5, 0.5, -0.5, -0.5])
    across = (apart[:, None, 0] < apart[None, :, 2]) & (apart[None, :, 0] < apart[:, None, 2])
    up = (apart[:, None, 1] < apart[None, :, 3]) & (apart[None, :, 1] < apart[:, None, 3])
    pairs = np.argwhere(np.triu(across & up, 1)).tolist()
    return [(words[k],) for k in np.flatnonzero(outside)] + [(words[a], words[b]) for a, b in pairs]


def extents(figure: Figure) -> tuple[list[str], np.ndarray]:
    """Return all texts that are seen and their boxes (texts, 4): left, bottom, right, top [pixels]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    hidden = {id(t) for ax in figure.axes for t in _unseen(ax)}
    texts: list[Any] = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text().strip()]
    texts = [t for t in texts if id(t) not in hidden]
    boxes = np.array([t.get_window_extent(renderer).extents for t in texts]).reshape(-1, 4)
    return [t.get_text() for t in texts], boxes


def _unseen(ax: Axes) -> set[Any]:
    """Return the texts of axes that are not drawn: of what is switched off, and of ticks beyond the ends."""
    from matplotlib.text import Text

    if not ax.get_visible():
        return set(ax.findobj(Text))
    out: set[Any] = set()
    for axis in (ax.xaxis, ax.yaxis):
        every = {t for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()) for t in tick.findobj(Text)}
        off = not axis.get_visible() or not ax.axison
        drawn: list[Any] = [] if off else axis._update_ticks()  # type: ignore[union-attr]
        seen = {t for tick in drawn for t in tick.findobj(Text)}
        out |= (every - seen) | (set(axis.findobj(Text)) if off else set())
    return out
