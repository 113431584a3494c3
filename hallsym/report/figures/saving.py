"""Save pictures: one style, folder made if missing, written atomically, the same file for the same input."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.errors import InputError
from hallsym.files import atomic_write, reason
from hallsym.report.figures.style import DPI, FONT, GREY, LINE, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
