"""Save pictures: one style, folder made if missing, written atomically, the same file for the same input."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hallsym.errors import InputError
from hallsym.files import atomic_write, reason
from hallsym.report.figures.style import DPI, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = ("png", "pdf", "svg")


def save_figures(
    draw: Mapping[str, Callable[[], Figure]], folder: str | Path, suffixes: Sequence[str] = ("png",)
) -> list[Path]:
    """Draw each picture and save it as `folder/name.suffix`; returns the files written.

    `suffixes`: any of png, pdf, svg. Raises `InputError` for another one or a folder that cannot be written.
    """
    for suffix in suffixes:
        if suffix not in SUFFIXES:
            raise InputError(
                f"Input suffixes must hold only {', '.join(SUFFIXES)}; instead received {suffix!r}."
            )
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
            for suffix in suffixes:
                path = folder / f"{name}.{suffix}"
                atomic_write(path, partial(_write, figure, suffix))
                written.append(path)
    return written


def _write(figure: Figure, suffix: str, path: Path) -> None:
    dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(suffix)
    figure.savefig(path, format=suffix, dpi=DPI, metadata=dated)  # the same picture gives the same file
