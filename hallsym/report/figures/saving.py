"""Save pictures: one style, folder made if missing, written atomically, the same file for the same input."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.errors import InputError
from hallsym.files import atomic_write, reason
from hallsym.report.figures.style import DPI, FONT, GREY, LINE, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Place:
    """Where pictures are written, as png, pdf or svg, and the line below each of them: file and model."""

    folder: Path
    format: str = "png"
    source: str = ""


def save_figures(draw: Mapping[str, Callable[[], Figure]], folder: str | Path | Place) -> list[Path]:
    """Draw each picture and save it as `folder/name.png`, or as the `Place` says; returns the files written.

    Raises `InputError` for a folder that cannot be written.
    """
    place = folder if isinstance(folder, Place) else Place(Path(folder))
    from matplotlib import style

    try:
        place.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {place.folder} for pictures: {reason(error)}.") from error
    written = []
    with style.context(["default", STYLE]):  # whatever style the caller has set
        for name, make in draw.items():
            figure = make()
            if place.source:
                width, height = figure.get_size_inches()
                at = (1 - 0.06 / width, -0.11 / height)
                figure.text(*at, place.source, ha="right", size=FONT - 1.5, color=GREY)
            path = place.folder / f"{name}.{place.format}"
            atomic_write(path, partial(_write, figure, place))
            written.append(path)
    return written


def _write(figure: Figure, place: Place, path: Path) -> None:
    from matplotlib.transforms import Bbox

    width, height = figure.get_size_inches()
    dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(place.format)
    box = Bbox([[0.0, -LINE], [width, height]]) if place.source else None
    # the same picture gives the same file
    figure.savefig(path, format=place.format, dpi=DPI, metadata=dated, bbox_inches=box)
