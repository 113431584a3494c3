"""Sentences below the axes of a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hallsym.report.figures.style import EDGE, LINE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def height(lines: Sequence[str]) -> float:
    """Inches that a caption takes."""
    return LINE * len(lines) + 0.06 if lines else 0.0


def caption(figure: Figure, lines: Sequence[str]) -> None:
    """Write lines at the lower edge of the figure."""
    width, tall = figure.get_size_inches()
    for k, text in enumerate(reversed(lines)):
        figure.text(EDGE / width, (0.06 + LINE * k) / tall, text)
