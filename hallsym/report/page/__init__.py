"""One self-contained HTML page for a fit or a diagnosis: opens from disk, prints, needs no network.

`fit_page` and `diagnosis_page` put together what a page holds (`content`, `shared`), the charts among it
(`charts`, `pictures`) from `hallsym.report.data`. HTML, style and script are in `templates`. The same input
gives the same bytes.
"""

from hallsym.report.page.charts import Scale, decades, label, ticks
from hallsym.report.page.content import Table, render
from hallsym.report.page.diagnosis_page import diagnosis_page
from hallsym.report.page.fit_page import fit_page
from hallsym.report.page.pictures import ACROSS, UP, runs, sketch

__all__ = [
    "ACROSS",
    "UP",
    "Scale",
    "Table",
    "decades",
    "diagnosis_page",
    "fit_page",
    "label",
    "render",
    "runs",
    "sketch",
    "ticks",
]
