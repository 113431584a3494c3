"""How a picture is drawn, with matplotlib: as a figure, as a file, and as SVG inside a page.

matplotlib is imported only here, and this module only to draw. In a page colours are CSS variables and words
are text, so dark mode, print and the reader's font hold for figures too. Constrained layout finds the
margins: no label is cut off or lies on another.
"""

from __future__ import annotations

import io
import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from matplotlib.transforms import Affine2D, Bbox

from hallsym.errors import InputError
from hallsym.files import atomic_write, reason
from hallsym.output import printable
from hallsym.report import picture as p
from hallsym.report.words import minus, number

WIDTH, DPI, FONT = 7.1, 300, 8.0
"""Inches of two columns of a journal page; resolution of files; points of their letters."""
PAGE_FONT = 11.0
"""Px of letters in a page."""
LETTER = 6.4
"""Px of a letter in a page, with room to spare."""
UPRIGHT = 4
"""Names with more characters stand upright below an axis."""
STYLE = {
    "font.size": FONT,
    **dict.fromkeys(("axes.titlesize", "axes.labelsize", "xtick.labelsize", "ytick.labelsize"), "medium"),
    **dict.fromkeys(("legend.fontsize", "figure.labelsize"), "medium"),
    **dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width"), 0.6),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon", "path.simplify"), False),
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titley": 1.0,
    "axes.axisbelow": True,
    "grid.color": p.GRID,
    "grid.linewidth": 0.5,
    "text.parse_math": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "hallsym",  # names inside an svg are random without one
}


def _style(**more: Any) -> Any:
    """Return the style of these pictures as a context, whatever style the caller has set."""
    return style.context(["default", STYLE | more])


class Drawn(Figure):
    """A figure that a notebook shows by itself."""

    def _repr_svg_(self) -> str:
        text = io.StringIO()
        with _style():
            self.savefig(text, format="svg", metadata={"Date": None})
        return text.getvalue()


# -- a figure --------------------------------------------------------------------------------------------


def draw(picture: p.Picture) -> Figure:
    """Return a picture as a figure of `WIDTH`, with one legend for all panels.

    Raises `InputError` where there is nothing to draw.
    """
    if not picture.panels:
        raise InputError("There is nothing to draw: none of the errors has a number.")
    with _style():
        across = min(picture.across, len(picture.panels))
        panels = _once(picture.panels, across)
        lines = [panels[k : k + across] for k in range(0, len(panels), across)]
        plain = [max(panel.height for panel in line) for line in lines]
        high = sum(plain) + sum(max(_around(panel, FONT) for panel in line) for line in lines)
        figure = Drawn(figsize=(WIDTH, high / 72), layout="constrained")
        wide = [panel.share for panel in lines[0]]
        axes = figure.subplots(len(lines), across, squeeze=False, height_ratios=plain, width_ratios=wide)
        keys: dict[str, Any] = {}
        for ax, panel in zip(axes.flat, panels, strict=False):
            _panel(ax, panel, FONT)
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                keys.setdefault(label, handle)
        for ax in axes.flat[len(panels) :]:
            ax.set_axis_off()
        below = textwrap.wrap(printable(picture.words), 115)
        columns = max(1, int(WIDTH * 72 / FONT / (0.5 * max(map(len, keys), default=0) + 5)))
        figure.set_figheight((high + 1.6 * FONT * (len(below) - (-len(keys) // columns)) + 8) / 72)
        if keys:
            columns = min(columns, len(keys))
            figure.legend(keys.values(), keys.keys(), loc="outside upper left", ncols=columns)
        if below:
            figure.supxlabel("\n".join(below), x=0.01, ha="left")
    return figure


def _once(panels: Sequence[p.Panel], across: int) -> list[p.Panel]:
    """Return panels in rows, each axis once: below, or on the left, of panels that have the same."""
    below = [*(panel.x for panel in panels[across:]), *[None] * across]
    left = [None if k % across == 0 else panels[k - 1].y for k in range(len(panels))]
    return [
        replace(panel, x=panel.x.beside(x), y=panel.y.beside(y))
        for panel, x, y in zip(panels, below, left, strict=True)
    ]


def _around(panel: p.Panel, font: float) -> float:
    """Return the px that title, numbers or names, and title of the axis take above and below a panel."""
    names = max(map(len, panel.x.names or ()), default=0)
    below = (0.65 * names if names > UPRIGHT else 1.2) + 1.5 * bool(panel.x.title)
    above = 1.6 * (1 + panel.title.count("\n")) if panel.title else 0.0
    return font * (above + below) + 12


# -- a panel ---------------------------------------------------------------------------------------------


def _panel(ax: Axes, panel: p.Panel, font: float) -> None:
    ax.set_title(printable(panel.title, keep="\n"))
    for layer in (*panel.layers, *panel.inside):
        layer(ax)
    for k, words in enumerate(panel.beside):
        ax.text(1.02, k, printable(words), transform=ax.get_yaxis_transform(), va="center_baseline")
    for which, axis in (("x", panel.x), ("y", panel.y)):
        ax.set(**{f"{which}label": printable(axis.title)})
        if axis.log:
            ax.set(**{f"{which}scale": "log"})
        (ax.set_xlim if which == "x" else ax.set_ylim)(axis.low, axis.high)
        if axis.names is None:
            _numbers(ax, which, axis)
            getattr(ax, f"{which}axis").grid(panel.grid)
        else:
            _names(ax, which, [printable(name) for name in axis.names], font)


def _names(ax: Axes, which: Any, names: Sequence[str], font: float) -> None:
    """Put names on an axis; of those that have no room every second, fifth, tenth, .. stays."""
    figure: Any = ax.get_figure()
    ax.tick_params(which, length=0)
    if which == "y":
        high = ax.get_position().height * figure.get_figheight() * 72
        ax.set_yticks(range(len(names)), names, fontsize=min(font, 0.9 * high / max(len(names), 1)))
        return
    longest = max(map(len, names), default=0)
    upright = longest > UPRIGHT
    room = ax.get_position().width * figure.get_figwidth() * 72 / font
    most = max(1.0, room / (1.3 if upright else 0.65 * longest + 0.9))
    step = next(s * 10**e for e in range(12) for s in (1, 2, 5) if len(names) <= most * s * 10**e)
    ax.set_xticks(range(0, len(names), step), names[::step])
    if upright:
        ax.tick_params(which, rotation=90)
        for label in ax.get_xticklabels():
            label.set(rotation_mode="anchor", ha="right", va="center")


def _numbers(ax: Axes, which: str, axis: p.Axis) -> None:
    own, (low, high) = getattr(ax, f"{which}axis"), getattr(ax, f"get_{which}lim")()
    own.set_major_formatter(FuncFormatter(lambda value, _: minus(number(value, 6))))
    own.set_major_locator(MaxNLocator(axis.most, steps=[1, 2, 5, 10]))
    if axis.log:
        own.set_minor_locator(NullLocator())
        decades = abs(np.log10(high / low))
        if decades > 0.7:  # which hold two of 1, 2, 5
            subs = (1, 2, 5) if decades < 1.4 else (1, 3) if decades < 2.6 else (1,)
            own.set_major_locator(LogLocator(subs=subs, numticks=axis.most + 2))


# -- files: a folder made if missing, written atomically, the same file for the same picture ---------------


def save(pictures: Mapping[str, p.Picture], folder: str | Path, source: str = "") -> list[Path]:
    """Draw each picture and save it as `folder/name.png`; returns the files written.

    `source`: the line below each picture, file and model. Raises `InputError` for a folder that cannot be
    written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {folder} for pictures: {reason(error)}.") from error
    written = []
    for name, picture in pictures.items():
        figure, path = draw(picture), folder / f"{name}.png"
        with _style():
            if source:
                width, height = figure.get_size_inches()
                where = (1 - 0.06 / width, -0.11 / height)
                figure.text(
                    *where, printable(source), ha="right", size=FONT - 1.5, color=p.SOFT
                ).set_in_layout(False)
            atomic_write(path, partial(_write, figure, bool(source)))
        written.append(path)
    return written


def _write(figure: Figure, below: bool, path: Path) -> None:
    width, height = figure.get_size_inches()
    box = Bbox([[0.0, -0.165], [width, height]]) if below else None
    figure.savefig(path, format="png", dpi=DPI, bbox_inches=box)


# -- SVG inside a page -----------------------------------------------------------------------------------


def svg(panel: p.Panel, width: float, *, fixed: bool = False) -> Markup:
    """Return a panel as SVG, `width` px wide: short, without names or links, its colours CSS variables.

    `fixed`: the colours themselves, where no style sheet of a page holds.
    """
    top, right, bottom, left = _margins(panel)
    height = top + panel.height + bottom
    with _style(**{"font.size": PAGE_FONT}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # the browser's font has it
        figure = Figure(figsize=(width / 72, height / 72), dpi=72)
        place = (left / width, bottom / height, 1 - (left + right) / width, panel.height / height)
        ax = figure.add_axes(place)
        for patch in (figure.patch, ax.patch):
            patch.set_visible(False)
        _panel(ax, replace(panel, inside=()), PAGE_FONT)
        longest = max((len(label.get_text()) for label in ax.get_yticklabels()), default=0)
        more = LETTER * longest - 42 if panel.y.names is None else 0.0  # beyond the usual numbers
        if more > 0:
            ax.set_position(((left + more) / width, place[1], place[2] - more / width, place[3]))
        drawn = _Svg(width, height, {} if fixed else variables())
        figure.draw(drawn)
    says = panel.says or " over ".join(filter(None, (panel.title or panel.y.title, panel.x.title)))
    box, says = f"0 0 {_px(width)} {_px(height)}", escape(printable(says))
    return Markup(f'<svg viewBox="{box}" role="img" aria-label="{says}">{"".join(drawn.parts)}</svg>')


def key(panels: Sequence[p.Panel], *, fixed: bool = False) -> Markup:
    """Return the legend of panels as SVG; nothing where no layer has a name. `fixed` as of `svg`."""
    with _style(**{"font.size": PAGE_FONT}):
        ax = Figure().add_subplot()
        for layer in (layer for panel in panels for layer in panel.layers):
            layer(ax)
        found = {words: mark for mark, words in zip(*ax.get_legend_handles_labels(), strict=True)}
        if not found:
            return Markup("")
        width = 360.0
        across = max(1, int(width / (LETTER * max(map(len, found)) + 45)))
        height = 1.7 * PAGE_FONT * -(-len(found) // across) + 4
        figure = Figure(figsize=(width / 72, height / 72), dpi=72)
        figure.patch.set_visible(False)
        figure.legend([*found.values()], [*found], loc="center left", ncols=across, borderpad=0.0)
        drawn = _Svg(width, height, {} if fixed else variables())
        figure.draw(drawn)
    box = f"0 0 {_px(width)} {_px(height)}"
    return Markup(f'<svg class="key" viewBox="{box}" aria-hidden="true">{"".join(drawn.parts)}</svg>')


def _margins(panel: p.Panel) -> tuple[float, float, float, float]:
    """Return the px above, right of, below and left of a panel, equal for panels below each other."""
    names = max(map(len, panel.y.names or ()), default=0)
    left = (LETTER * names + 10 if panel.y.names else 50.0) + 2.2 * PAGE_FONT * bool(panel.y.title)
    top = 1.8 * PAGE_FONT * (1 + panel.title.count("\n")) * bool(panel.title) + 4
    rim = 24 if panel.x.names is None else 14  # half of the last number
    return top, LETTER * max(map(len, panel.beside), default=0) + rim, _around(panel, PAGE_FONT) - top, left


@cache
def variables() -> dict[str, str]:
    """Return the CSS variable of each colour, from the style sheet of the pages."""
    sheet = files("hallsym.report").joinpath("templates", "page.css").read_text(encoding="utf-8")
    return {colour: f"var({name})" for name, colour in reversed(re.findall(r"(--\w+): (#\w{6})\b", sheet))}


class _Svg(RendererBase):
    """A device that writes SVG; a group whose name is lines of text gives each of its paths a title."""

    def __init__(self, width: float, height: float, names: Mapping[str, str]) -> None:
        super().__init__()
        self.size, self.parts, self.names = (width, height), list[str](), names
        self.said: Iterator[str] = iter(())
        self.down = Affine2D().scale(1, -1).translate(0, height)

    def get_canvas_width_height(self) -> tuple[float, float]:
        return self.size

    def open_group(self, s: str, gid: str | None = None) -> None:
        self.said = iter((gid or "").split("\n"))

    def draw_path(self, gc: GraphicsContextBase, path: Any, transform: Any, rgbFace: Any = None) -> None:
        steps = ""
        for numbers, code in path.iter_segments(transform + self.down, simplify=False):
            steps += LETTERS[code] + " ".join(map(_px, () if code == path.CLOSEPOLY else numbers))
        self._put(gc, steps, rgbFace, next(self.said, ""))

    def draw_markers(
        self, gc: GraphicsContextBase, marker_path: Any, marker_trans: Any, path: Any, trans: Any,
        rgbFace: Any = None,
    ) -> None:  # fmt: skip
        """Draw equal marks as one short path: a fleet has thousands."""
        corners = marker_path.transformed(marker_trans + Affine2D().scale(1, -1)).vertices
        shape = "".join(f"l{_px(dx)} {_px(dy)}" for dx, dy in np.diff(corners, axis=0))
        if marker_path.codes is not None and marker_path.CURVE4 in marker_path.codes:  # a disc
            r = corners.max()
            corners, arc = np.array([[-r, 0.0]]), f"a{_px(r)} {_px(r)} 0 1 0 "
            shape = f"{arc}{_px(2 * r)} 0{arc}{_px(-2 * r)} 0z"
        elif marker_path.codes is not None and np.count_nonzero(marker_path.codes == marker_path.MOVETO) > 1:
            super().draw_markers(gc, marker_path, marker_trans, path, trans, rgbFace)
            return
        at = (trans + self.down).transform(path.vertices) + corners[0]
        self._put(gc, "".join(f"M{_px(x)} {_px(y)}{shape}" for x, y in at if np.isfinite(x + y)), rgbFace)

    def _put(self, gc: GraphicsContextBase, steps: str, face: Any, title: str = "") -> None:
        look = self._colour("fill", face)
        if gc.get_linewidth() > 0 and gc.get_rgb()[3] > 0:
            look += self._colour("stroke", gc.get_rgb()) + f' stroke-width="{_px(gc.get_linewidth())}"'
            dashes: Any = gc.get_dashes()[1]
            look += f' stroke-dasharray="{" ".join(map(_px, dashes))}"' if dashes else ""
        title = f"<title>{escape(title)}</title>" if title else ""
        if steps and look != ' fill="none"':
            self.parts.append(f'<path d="{steps}"{look}>{title}</path>')

    def draw_text(
        self, gc: GraphicsContextBase, x: float, y: float, s: str, prop: Any, angle: float,
        ismath: Any = False, mtext: Any = None,
    ) -> None:  # fmt: skip
        place = ""
        if mtext is not None and (angle == 0 or mtext.get_rotation_mode() == "anchor"):
            # the browser's letters are not as wide as those measured: begin, centre or end where asked
            at = mtext.get_transform().transform(mtext.get_unitless_position())
            off = np.array([x - at[0], self.size[1] - y - at[1]])
            turn = np.radians(angle)
            across = np.array([-np.sin(turn), np.cos(turn)])
            x, y = at + (off @ across) * across
            y = self.size[1] - y
            place = {"center": ' text-anchor="middle"', "right": ' text-anchor="end"'}.get(mtext.get_ha(), "")
        rotation = f' transform="rotate({-angle:g} {_px(x)} {_px(y)})"' if angle else ""
        fill = self._colour("fill", gc.get_rgb()) + ' font-weight="600"' * (prop.get_weight() == "bold")
        self.parts.append(f'<text x="{_px(x)}" y="{_px(y)}"{place}{rotation}{fill}>{escape(s)}</text>')

    def _colour(self, what: str, colour: Any) -> str:
        if colour is None:
            return f' {what}="none"'
        shown = to_hex(colour[:3])
        faint = f' {what}-opacity="{colour[3]:.2f}"' if len(colour) > 3 and colour[3] < 1 else ""
        return f' {what}="{self.names.get(shown, shown)}"{faint}'


LETTERS = {1: "M", 2: "L", 3: "Q", 4: "C", 79: "Z"}
"""The command of SVG for each code of a matplotlib path."""


def _px(value: float) -> str:
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
