"""One self-contained HTML page for a fit or a diagnosis: opens from disk, prints, needs no network.

`html` escapes, `page` is the skeleton, `svg` and `figures` draw, `series` draws what can be zoomed, `gather`
reads the log in blocks; `fit_page` and `diagnosis_page` put the sections together, those of a diagnosis from
`diagnosis_errors`, `diagnosis_effects` and `diagnosis_places`. The same input gives the same bytes.
"""

from hallsym.report.page.cells import Cells
from hallsym.report.page.diagnosis_page import diagnosis_page
from hallsym.report.page.fit_page import fit_page
from hallsym.report.page.gather import Gathered, Version, gather
from hallsym.report.page.series import RunSeries, run_series

__all__ = ["Cells", "Gathered", "RunSeries", "Version", "diagnosis_page", "fit_page", "gather", "run_series"]
