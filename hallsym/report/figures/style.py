"""How pictures look: colours, fonts, margins in inches, axes; and how they are saved.

Margins are stated, not searched for: a layout engine draws every picture twice more to find them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.errors import InputError
from hallsym.files import atomic_write, reason
from hallsym.report.words import short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

WIDTH = 7.1  # inches: two columns of a journal page
DPI = 300
FONT = 8.0  # points
LEFT = 0.64  # inches: an upright label and six digits
LINE = 0.165  # inches: a line of text
EDGE = 0.1  # inches: beside a caption
ENTRY = 0.18  # inches: a line of a legend
BLACK, GREY, FAINT, SHADE, STRIPE = "#000000", "#777777", "#bbbbbb", "#e6e6e6", "#f4f4f4"
BEFORE, AFTER, GREEN = "#d55e00", "#0072b2", "#009e73"  # Okabe and Ito's palette
SERIES = (AFTER, BEFORE, GREEN, "#cc79a7", BLACK, "#e69f00", "#56b4e9")
DASHED = (0, (4, 2))
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
STYLE = {
    "font.size": FONT,
    "axes.titlesize": FONT,
    "axes.titley": 1.0,
    "axes.labelsize": FONT,
    "xtick.labelsize": FONT,
    "ytick.labelsize": FONT,
    "legend.fontsize": FONT,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "legend.borderaxespad": 0.1,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 0.9,
    "path.simplify": False,
    "hatch.linewidth": 0.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "hallsym",  # names inside an svg are random without one
    "pdf.fonttype": 42,
}


def panels(
    rows: int,
    columns: int,
    height: float,
    *,
    top: float,
    bottom: float,
    left: float = LEFT,
    right: float = 0.08,
    gaps: tuple[float, float] = (0.12, 0.12),
    **options: Any,
) -> tuple[Figure, np.ndarray]:
    """Return a figure of `rows` x `columns` axes, each `height` high; margins and gaps in inches."""
    from matplotlib.figure import Figure

    across, down = gaps
    total = top + bottom + rows * height + (rows - 1) * down
    width = (WIDTH - left - right - (columns - 1) * across) / columns
    place = {
        "left": left / WIDTH,
        "right": 1 - right / WIDTH,
        "top": 1 - top / total,
        "bottom": bottom / total,
        "wspace": across / width,
        "hspace": down / height,
    }
    figure = Figure(figsize=(WIDTH, total))
    axes = figure.subplots(
        rows, columns, squeeze=False, gridspec_kw=place | options.pop("gridspec_kw", {}), **options
    )
    return figure, axes


def label_y(ax: Axes, text: str, margin: float = LEFT) -> None:
    """Label the y axis at the outer edge of a left margin [inches]."""
    ax.set_ylabel(text, va="top")
    ax.yaxis.set_label_coords(-(margin - 0.03) / _inches(ax)[0], 0.5)


def label_x(ax: Axes, text: str, below: float = 0.24) -> None:
    """Label the x axis `below` [inches] its line."""
    ax.set_xlabel(text)
    ax.xaxis.set_label_coords(0.5, -below / _inches(ax)[1])


def _inches(ax: Axes) -> tuple[float, float]:
    box, inch = ax.get_position(), ax.figure.dpi_scale_trans.inverted()
    (width, height) = inch.transform(ax.figure.bbox.size)
    return float(box.width * width), float(box.height * height)


def legend(figure: Figure, handles: Sequence[Any], where: str, **options: Any) -> None:
    """Draw a legend at the upper edge of the figure.

    Entries that have no room in a line make more lines, and the figure grows by them.
    """
    em = FONT / 72
    mark = em * (options.get("handlelength", STYLE["legend.handlelength"]) + 0.8)
    between = em * options.get("columnspacing", 2.0)
    widths = [mark + text_width(handle.get_label()) for handle in handles]
    asked = columns = min(options.get("ncols", 1), len(handles))
    while columns > 1:
        wide = sum(max(part) for part in np.array_split(np.array(widths), columns))
        if wide + (columns - 1) * between <= WIDTH - 0.1:
            break
        columns -= 1
    options["ncols"] = columns
    lines = -(-len(handles) // columns)
    _grow(figure, ENTRY * (lines + (-len(handles) // asked)))
    x, edge = {"left": 0.0, "center": 0.5}[where.split()[1]], 0.03 / figure.get_size_inches()[1]
    options |= {"loc": where, "bbox_to_anchor": (x, 1 - edge)}
    figure.legend(handles=handles, **options)


def _grow(figure: Figure, above: float) -> None:
    """Make a figure higher [inches]; its axes keep their size and their place from the lower edge."""
    width, old = figure.get_size_inches()
    new = old + above
    figure.set_size_inches(width, new)
    for ax in figure.axes:
        box = ax.get_position()
        ax.set_position((box.x0, box.y0 * old / new, box.width, box.height * old / new))
    for text in figure.texts:
        x, y = text.get_position()
        text.set_position((x, y * old / new))
    for drawn in figure.legends:
        box = drawn.get_bbox_to_anchor().transformed(figure.transFigure.inverted())
        drawn.set_bbox_to_anchor((box.x0, box.y0), transform=figure.transFigure)


def key(label: str, **look: Any) -> Line2D:
    """Return an entry of a legend for a line or a marker."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **look)


def text_width(text: str) -> float:
    """Width of text [inches]."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=FONT)
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0]) / 72


def broken(text: str, width: float | None = None, indent: str = "    ") -> list[str]:
    """Break text into lines of at most `width` inches; what follows the first is indented."""
    width = WIDTH - 2 * EDGE if width is None else width
    lines: list[str] = []
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}" if lines else word
        if not lines or text_width(longer) > width:
            lines.append(indent + word if lines else word)
        else:
            lines[-1] = longer
    return lines


def log_axis(ax: Axes, which: str, values: np.ndarray) -> None:
    """Logarithmic x or y axis around the positive values, with plain numbers at 1, 2, 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    values = values[np.isfinite(values) & (values > 0)]
    if not len(values):
        return
    low, top = float(values.min()), float(values.max())
    decades = float(np.log10(top / low))
    margin = 1.5 * 10 ** (0.04 * decades)
    ax.set(**{f"{which}scale": "log", f"{which}lim": (low / margin, top * margin)})
    axis = getattr(ax, f"{which}axis")
    subs = (1, 2, 5) if decades < 1.4 else (1, 3) if decades < 2.6 else (1,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda v, _: short(v)))
    axis.set_minor_formatter(NullFormatter())


# -- files: one style, a folder made if missing, written atomically, the same file for the same input --------


def save_figures(
    draw: Mapping[str, Callable[[], Figure]], folder: str | Path, format: str = "png", source: str = ""
) -> list[Path]:
    """Draw each picture and save it as `folder/name.format` (png, pdf or svg); returns the files written.

    `source`: the line below each picture, file and model. Raises `InputError` for a folder that cannot be
    written.
    """
    from matplotlib import style

    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {folder} for pictures: {reason(error)}.") from error
    written = []
    with style.context(["default", STYLE]):  # whatever style the caller has set
        for name, make in draw.items():
            figure = make()
            if source:
                width, height = figure.get_size_inches()
                figure.text(1 - 0.06 / width, -0.11 / height, source, ha="right", size=FONT - 1.5, color=GREY)
            path = folder / f"{name}.{format}"
            atomic_write(path, partial(_write, figure, format, bool(source)))
            written.append(path)
    return written


def _write(figure: Figure, format: str, below: bool, path: Path) -> None:
    from matplotlib.transforms import Bbox

    width, height = figure.get_size_inches()
    dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(format)
    box = Bbox([[0.0, -LINE], [width, height]]) if below else None
    # the same picture gives the same file
    figure.savefig(path, format=format, dpi=DPI, metadata=dated, bbox_inches=box)
