"""Save pictures: one style, folder made if missing, written atomically, the same file for the same input."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.errors import InputError
from hallsym.files import atomic_write, reason
from hallsym.report.figures.content import is_bare
from hallsym.report.figures.style import DPI, FONT, GREY, LINE, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = ("png", "pdf", "svg")


def _unsaid(sentence: str) -> None:
    return None


@dataclass(frozen=True)
class Place:
    """Where pictures are written, as which kinds of file (any of png, pdf, svg), and what each of them names.

    `source`: file and model, below each picture. `told(sentence)` hears of a picture that is not drawn
    because it would be a straight line or a dot.
    """

    folder: Path
    suffixes: Sequence[str] = ("png",)
    source: str = ""
    told: Callable[[str], None] = _unsaid


def save_figures(
    draw: Mapping[str, Callable[[], Figure]],
    folder: str | Path | Place,
    suffixes: Sequence[str] = ("png",),
) -> list[Path]:
    """Draw each picture and save it as `folder/name.suffix`; returns the files written.

    A picture that would be a straight line or a single dot is left out. `suffixes`: any of png, pdf, svg,
    where `folder` is no `Place`, which has its own. Raises `InputError` for another one or a folder that
    cannot be written.
    """
    place = folder if isinstance(folder, Place) else Place(Path(folder), suffixes)
    for suffix in place.suffixes:
        if suffix not in SUFFIXES:
            raise InputError(
                f"Input suffixes must hold only {', '.join(SUFFIXES)}; instead received {suffix!r}."
            )
    from matplotlib import style

    try:
        place.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {place.folder} for pictures: {reason(error)}.") from error
    written = []
    with style.context(["default", STYLE]):  # whatever style the caller has set
        for name, make in draw.items():
            figure = make()
            if is_bare(figure):
                place.told(f"The picture {name} would be a straight line or a dot; it is left out.")
                continue
            _name(figure, place.source)
            for suffix in place.suffixes:
                path = place.folder / f"{name}.{suffix}"
                atomic_write(path, partial(_write, figure, suffix))
                written.append(path)
    return written


def _name(figure: Figure, source: str) -> None:
    """Write the source below the figure, in a line of its own."""
    if source:
        width, height = figure.get_size_inches()
        figure.text(1 - 0.06 / width, -0.11 / height, source, ha="right", size=FONT - 1.5, color=GREY)


def _write(figure: Figure, suffix: str, path: Path) -> None:
    from matplotlib.transforms import Bbox

    width, height = figure.get_size_inches()
    below = LINE if any(text.get_position()[1] < 0 for text in figure.texts) else 0.0
    dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(suffix)
    box = Bbox([[0.0, -below], [width, height]]) if below else None
    # the same picture gives the same file
    figure.savefig(path, format=suffix, dpi=DPI, metadata=dated, bbox_inches=box)
