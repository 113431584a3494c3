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
from hallsym.report.figures.layout import WIDTHS, NoRoomError, clashes, laid_out, layout
from hallsym.report.figures.style import DPI, FONT, GREY, LINE, STYLE, broken

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = ("png", "pdf", "svg")


def _unsaid(sentence: str) -> None:
    return None


@dataclass(frozen=True)
class Place:
    """Where pictures are written, as which kinds of file (any of png, pdf, svg), and what each of them names.

    `source`: file and model, below each picture. `columns`: of a journal page that a picture takes, 1 or 2;
    of both, the narrow ones are `NAME_1column`. A picture that is higher than a page in one column is several
    files, `NAME_1`, `NAME_2`, ... `told(sentence)` hears of a picture that is not drawn because it would be a
    straight line or a dot, and of one that has no room in one column and is drawn for two.
    """

    folder: Path
    suffixes: Sequence[str] = ("png",)
    source: str = ""
    told: Callable[[str], None] = _unsaid
    columns: Sequence[int] = (2,)


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
    if not set(place.columns) <= set(WIDTHS) or not place.columns:
        known = " and ".join(map(str, WIDTHS))
        raise InputError(f"Input columns must hold only {known}; instead received {list(place.columns)!r}.")
    from matplotlib import style

    try:
        place.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {place.folder} for pictures: {reason(error)}.") from error
    written = []
    with style.context(["default", STYLE]):  # whatever style the caller has set
        for name, make in draw.items():
            figures = _drawn(make, name, place)
            if all(is_bare(figure) for parts in figures.values() for figure in parts):
                place.told(f"The picture {name} would be a straight line or a dot; it is left out.")
                continue
            for columns, parts in figures.items():
                stem = f"{name}_1column" if columns == 1 and len(place.columns) > 1 else name
                for k, figure in enumerate(parts):
                    own = f"{stem}_{k + 1}" if len(parts) > 1 else stem
                    for suffix in place.suffixes:
                        path = place.folder / f"{own}.{suffix}"
                        atomic_write(path, partial(_write, figure, suffix))
                        written.append(path)
    return written


def _drawn(make: Callable[[], Figure], name: str, place: Place) -> dict[int, list[Figure]]:
    """Draw a picture at the widths asked for, for two columns where it has no room in one."""
    found: dict[int, list[Figure]] = {}
    for columns in sorted(set(place.columns), reverse=True):
        try:
            found[columns] = _in_parts(make, columns, place.source)
        except NoRoomError:
            place.told(f"The picture {name} has no room in one column; it is drawn for two.")
            found[2] = found.get(2) or _in_parts(make, 2, place.source)
    return found


def _in_parts(make: Callable[[], Figure], columns: int, source: str) -> list[Figure]:
    """Draw a picture in as few files as have room; `NoRoomError` where there are no more parts to make."""
    parts = 1
    found: list[Figure] = []
    while len(found) < parts:
        with laid_out(columns, len(found), parts) as used:
            try:
                figure = make()
                if used.stacked and clashes(figure):
                    raise NoRoomError
                _name(figure, source)
                found.append(figure)
            except NoRoomError:
                if parts >= max(used.repeats, default=1):
                    raise
                found, parts = [], parts + 1
    return found


def _name(figure: Figure, source: str) -> None:
    """Write the source below the figure, in a line of its own."""
    if source:
        width, height = figure.get_size_inches()
        lines = [source]
        if layout().stacked:
            lines = broken(source, (width - 0.12) * FONT / (FONT - 1.5), "")
        for k, line in enumerate(lines):
            y = -(0.11 + k * LINE) / height
            figure.text(1 - 0.06 / width, y, line, ha="right", size=FONT - 1.5, color=GREY)


def _write(figure: Figure, suffix: str, path: Path) -> None:
    from matplotlib.transforms import Bbox

    width, height = figure.get_size_inches()
    below = LINE * sum(text.get_position()[1] < 0 for text in figure.texts)
    dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(suffix)
    box = Bbox([[0.0, -below], [width, height]]) if below else None
    # the same picture gives the same file
    figure.savefig(path, format=suffix, dpi=DPI, metadata=dated, bbox_inches=box)
