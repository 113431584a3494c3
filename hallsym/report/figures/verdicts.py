"""How a verdict looks: colour, hatch and marker, so that it can be told without the colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hallsym.inference import VERDICTS
from hallsym.report.figures.style import AFTER, BEFORE, BLACK, FAINT

if TYPE_CHECKING:
    from hallsym.inference import Identifiability, ParameterReport


@dataclass(frozen=True)
class Look:
    """Colour of bars and markers, hatch of bars, marker and whether it is filled."""

    color: str
    hatch: str
    marker: str
    filled: bool = True

    def bar(self) -> dict[str, Any]:
        """Return options of a bar."""
        return {"facecolor": self.color, "hatch": self.hatch, "edgecolor": BLACK, "linewidth": 0.4}

    def point(self) -> dict[str, Any]:
        """Return options of a marker."""
        face = self.color if self.filled else "white"
        return {"ls": "none", "marker": self.marker, "ms": 4.2, "color": self.color, "mfc": face}


LOOKS = {
    "determined": Look(AFTER, "", "o"),
    "weak": Look("#e69f00", "////", "D"),
    "at bound": Look(BEFORE, "....", "s"),
    "not determined": Look("#cc79a7", "xxxx", "o", filled=False),
    "no effect": Look(FAINT, "", "X"),
    "fixed": Look(FAINT, "", "|"),
}


def shown(report: Identifiability) -> list[ParameterReport]:
    """Return the parameters that are not fixed."""
    return [entry for entry in report.parameters if entry.verdict.word != "fixed"]


def present(entries: Sequence[ParameterReport]) -> list[str]:
    """Return the verdicts that occur, best first."""
    found = {entry.verdict.word for entry in entries}
    return [word for word in VERDICTS if word in found]


def by_verdict(entries: Sequence[ParameterReport]) -> list[str]:
    """Return `not determined: H1x, H1y` for every verdict that occurs."""
    return [
        f"{word}: {', '.join(entry.name for entry in entries if entry.verdict.word == word)}"
        for word in present(entries)
    ]
