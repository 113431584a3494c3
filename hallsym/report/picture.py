"""A figure: panels with two axes each, and layers over them.

Every figure of a page, of a file and of a session is a `Picture`; `hallsym.report.drawing` draws it. A layer
draws itself over the axes of matplotlib, which is imported only then.

Colours differ in lightness and every series has its own dash or marker, so that a greyscale print can be
read. Those of a fit follow Figures 9 to 12 of Chen et al., Sensors 2016, 16, 872, doi:10.3390/s16060872.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hallsym.output import printable
from hallsym.report.words import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Axis:
    """An axis: its title with the unit, and numbers (about `most`) or `names` at 0, 1, 2, ...

    Limits that are None are those of the layers. An axis with `names` () shows nothing.
    """

    title: str = ""
    low: float | None = None
    high: float | None = None
    log: bool = False
    names: Sequence[str] | None = None
    most: int = 4

    def beside(self, other: Axis | None) -> Axis:
        """Return the axis, without title and numbers where another one is the same within stated limits."""
        known = self.low is not None and self.high is not None
        return replace(self, title="", names=()) if known and self == other else self


Layer = Callable[["Axes"], Any]


@dataclass(frozen=True)
class Panel:
    """Layers over two axes, `height` high [1/72 inch]; `says` is read out in their place.

    `beside`: words to the right, row by row. In a figure a panel is `share` times as wide as others, and has
    `inside`, for whose letters a page has no room.
    """

    x: Axis
    y: Axis
    layers: Sequence[Layer]
    title: str = ""
    says: str = ""
    height: float = 90.0
    grid: bool = True
    beside: Sequence[str] = ()
    inside: Sequence[Layer] = ()
    share: float = 1.0


@dataclass(frozen=True)
class Picture:
    """Panels, up to `across` in a row, with words on all of them.

    In a file an axis that is the same in several panels is written once, below them or on their left.
    """

    kind: ClassVar[str] = "figure"
    panels: Sequence[Panel]
    across: int = 3
    words: str = ""

    @property
    def look(self) -> str | None:
        """The class of the figure in a page: two panels alone are as wide as three."""
        return "two" if min(self.across, len(self.panels)) < 3 else None

    @property
    def width(self) -> float:
        """The px of a panel in a page."""
        return 360.0 if self.look else 240.0


# -- looks -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Look:
    """Colour of lines and edges, colour of areas, and the marks that distinguish them without colour.

    `width` of lines and `size` of markers in points; `dash` and `marker` as in matplotlib.
    """

    color: str
    face: str = "none"
    dash: Any = "-"
    width: float = 0.9
    marker: str = ""
    size: float = 4.5


INK, SOFT, FAINT, GRID, PAPER = "#000000", "#555555", "#bbbbbb", "#e2e2e2", "#ffffff"
BLUE, ORANGE, GREEN, PINK, YELLOW, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
"""Okabe and Ito's palette."""
PALE_BLUE, PALE_ORANGE = "#9fc6e0", "#f0b070"

BEFORE = Look(ORANGE, PALE_ORANGE, marker="s")
AFTER = Look(BLUE, BLUE, marker="o")
HOLDOUT = Look(BLUE, PAPER, marker="D")
FLOOR = Look(INK, dash=(0, (4, 2)))
GREY, OTHER = Look(SOFT), Look(FAINT, FAINT)
BANDS = (Look(ORANGE, "#fbe6d0", width=0.5), Look(BLUE, PALE_BLUE, width=0.0))
MEDIANS = (Look("#d07a1f"), Look("#003c5e", width=1.2))
"""Bands, and lines over them, of two versions of a model, the first of which is pale; of one, the last."""

# -- layers ----------------------------------------------------------------------------------------------


def line(x: Any, y: Any, look: Look, label: str = "") -> Layer:
    """Return a line through points, interrupted at nan."""
    return lambda ax: ax.plot(x, y, color=look.color, ls=look.dash, lw=look.width, label=printable(label))


def points(x: Any, y: Any, look: Look, label: str = "") -> Layer:
    """Return markers."""
    mark: Any = {"marker": look.marker, "ms": look.size, "mfc": look.face, "mec": look.color, "mew": 0.9}
    return lambda ax: (
        np.size(x) and ax.plot(x, y, ls="none", clip_on=False, zorder=3, label=printable(label), **mark)
    )


def level(at: float, look: Look = FLOOR, label: str = "", *, up: bool = False) -> Layer:
    """Return a line across the whole panel, or `up`."""
    stroke = {"color": look.color, "ls": look.dash, "lw": look.width, "label": printable(label)}
    return lambda ax: (ax.axvline if up else ax.axhline)(at, **stroke)


def area(x: Any, low: Any, high: Any, look: Look) -> Layer:
    """Return the area between two lines."""
    return lambda ax: ax.fill_between(x, low, high, facecolor=look.face, linewidth=0)


def text(words: Sequence[str], x: Any, y: Any, place: str = "left", color: str = INK) -> Layer:
    """Return words at points: they begin there (`left`), are centred (`center`) or end there (`right`)."""

    def draw(ax: Axes) -> None:
        for word, a, b in zip(words, x, y, strict=True):
            ax.text(a, b, printable(word), ha=place, va="center_baseline", color=color)

    return draw


def boxes(
    left: Any, right: Any, low: Any, high: Any, look: Look, label: str = "", *,
    said: Sequence[str] = (), strength: Any = 1.0,
) -> Layer:  # fmt: skip
    """Return rectangles; one that is not finite is left out.

    `said` of each shows when it is pointed at in a page. `strength` (0 to 1) of each makes its colour fuller.
    """

    def draw(ax: Axes) -> None:
        from matplotlib.collections import PolyCollection
        from matplotlib.colors import to_rgba_array

        a, b, c, d, full = np.broadcast_arrays(*map(np.atleast_1d, (left, right, low, high, strength)))
        good = np.isfinite(a + b + c + d)
        corners = np.array([[a, c], [b, c], [b, d], [a, d]])[..., good].transpose(2, 0, 1)
        drawn = PolyCollection(
            list(corners), facecolors=to_rgba_array([look.face] * len(corners), full[good]),
            edgecolors=look.color if look.width else "none", linewidths=min(look.width, 0.6),
            zorder=2, label=printable(label), rasterized=len(corners) > DENSE,
        )  # fmt: skip
        if len(said):
            drawn.set_gid(
                "\n".join(printable(words) for words, known in zip(said, good, strict=True) if known)
            )
        ax.add_collection(drawn)
        ax.autoscale_view()

    return draw


DENSE = 1000
"""More boxes than this are pixels in a file, so that it stays small."""

# -- panels of one row per value, and maps ----------------------------------------------------------------


LONGEST = 44
"""Characters of a name in a row; longer ones are cut."""
FULL = 0.1
"""Cells of a map below minus this part of the fullest have a dash."""


@dataclass(frozen=True)
class Row:
    """A value with its name, as it is `shown`; with a `span` it is a dot with its interval, else a bar."""

    name: str
    value: float
    shown: str
    span: tuple[float, float] | None = None
    look: Look = AFTER


def rows(title: str, x: Axis, found: Sequence[Row], *, floor: float = 0.0) -> Panel:
    """Return one row per value, with a bar from 0; a nan has no bar.

    The noise floor, where there is one, is dashed.
    """
    names = [r.name if len(r.name) <= LONGEST else f"{r.name[: LONGEST - 1]}…" for r in found]
    half, layers = 0.32, [level(0.0, Look(SOFT, width=0.6), up=True)]
    for k, r in enumerate(found):
        if r.span is None:
            layers.append(boxes(0.0, r.value, k - half, k + half, r.look))
        else:
            layers += [line(r.span, (k, k), MEDIANS[1]), points(r.value, k, r.look)]
    says = f"{title}: {'; '.join(f'{r.name} {r.shown}' for r in found)}"
    if floor > 0:
        layers.append(level(floor, up=True))
        says += f"; noise floor {number(floor)}"
    y = Axis(low=len(found) - 0.4, high=-0.6, names=names)
    return Panel(x, y, layers, title, says, 15.0 * len(found) + 12, beside=[r.shown for r in found])


def tiles(
    x: Any,
    y: Any,
    values: np.ndarray,
    full: float,
    said: Sequence[str] = (),
    labels: Sequence[str] = ("", ""),
) -> list[Layer]:
    """Return the cells of a map between edges `x` and `y`: `values[j, i]` lies at column i, row j.

    The fuller the colour the larger; negative cells have another colour and a dash; nan is left out.
    `labels` of positive and negative cells stand in the legend.
    """
    layers: list[Layer] = []
    (left, low), (right, high) = np.meshgrid(x[:-1], y[:-1]), np.meshgrid(x[1:], y[1:])
    edge = 0.4 if values.size <= DENSE else 0.0
    for cells, colour, label in ((values >= 0, "#00609a", labels[0]), (values < 0, "#c04f00", labels[1])):
        if cells.any():
            own = np.flatnonzero(cells)
            own = own[np.argsort(-np.abs(values.flat[own]), kind="stable")]  # the legend has the first colour
            words = [said[k] for k in own.tolist()] if said else ()
            strength = np.minimum(np.abs(values.flat[own]) / full, 1.0)
            a, b, c, d = (end.flat[own] for end in (left, right, low, high))
            layers.append(
                boxes(a, b, c, d, Look(GRID, colour, width=edge), label, said=words, strength=strength)
            )
    dashed = values < -FULL * full
    wide, middle = (right - left)[dashed], 0.5 * (low + high)[dashed]
    ends = [left[dashed] + 0.3 * wide, right[dashed] - 0.3 * wide, np.full(len(wide), np.nan)]
    return [*layers, line(np.ravel(ends, "F"), np.repeat(middle, 3), GREY)] if dashed.any() else layers
