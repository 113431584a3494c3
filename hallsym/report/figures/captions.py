"""Sentences below the axes of a picture, broken into lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hallsym.report.figures.style import LINE, WIDTH, text_width

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EDGE = 0.1  # inches


def broken(text: str, width: float = WIDTH - 2 * EDGE, indent: str = "    ") -> list[str]:
    """Break text into lines of at most `width` inches; what follows the first is indented."""
    lines: list[str] = []
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}" if lines else word
        if not lines or text_width(longer) > width:
            lines.append(indent + word if lines else word)
        else:
            lines[-1] = longer
    return lines


def height(lines: Sequence[str]) -> float:
    """Inches that a caption takes."""
    return LINE * len(lines) + 0.06 if lines else 0.0


def caption(figure: Figure, lines: Sequence[str]) -> None:
    """Write lines at the lower edge of the figure."""
    width, tall = figure.get_size_inches()
    for k, text in enumerate(reversed(lines)):
        figure.text(EDGE / width, (0.06 + LINE * k) / tall, text)
