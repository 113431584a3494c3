"""The sketch of a machine, with the links lit that are at fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hallsym.model import Part
from hallsym.model.sketch import HEIGHT, WIDTH
from hallsym.report.page.marks import Chart, Mark, path, text

CAUSE, POSSIBLE = "lit", "maybe"
"""How the link of an effect that was found is drawn, and that of one that the log cannot tell from it."""
SIGNS = {CAUSE: "● ", POSSIBLE: "○ "}
"""What stands before the name of such a part, so that it is not told by colour alone."""


def sketch(parts: Sequence[Part], lit: Mapping[str, str]) -> Chart | None:
    """Draw the parts of a machine; `lit`: link -> `CAUSE` or `POSSIBLE`. None where there is no sketch."""
    if not parts:
        return None
    marks: list[Mark] = [path(part.outline, f"part {lit.get(part.link, '')}".rstrip()) for part in parts]
    for part in parts:
        look, (x, y) = lit.get(part.link), part.at
        words = SIGNS.get(look or "", "") + part.name
        marks.append(text(x, y, words, "middle" if part.centred else None, look))
    shown = [p.name for p in parts if p.link in lit]
    says = f"sketch of the machine: {', '.join(p.name for p in parts)}"
    return Chart(WIDTH, HEIGHT, says + (f"; lit: {', '.join(shown)}" if shown else ""), marks)
