"""One self-contained HTML page for a fit or a diagnosis: opens from disk, prints, needs no network.

`html` escapes, `page` is the skeleton, `svg` and `figures` draw, `series` draws what can be zoomed; what is
drawn comes from `hallsym.report.data`. `fit_page` and `diagnosis_page` put the sections together, those of a
diagnosis from `diagnosis_errors`, `diagnosis_effects` and `diagnosis_places`. The same input gives the same
bytes.
"""

from hallsym.report.page.diagnosis_page import diagnosis_page
from hallsym.report.page.fit_page import fit_page
from hallsym.report.page.html import VOID, Markup, escape, table, tag
from hallsym.report.page.series import ACROSS, UP, figure
from hallsym.report.page.svg import Scale, decades, label, ticks

__all__ = [
    "ACROSS",
    "UP",
    "VOID",
    "Markup",
    "Scale",
    "decades",
    "diagnosis_page",
    "escape",
    "figure",
    "fit_page",
    "label",
    "table",
    "tag",
    "ticks",
]
