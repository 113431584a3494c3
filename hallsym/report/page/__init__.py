"""One self-contained HTML page for a fit or a diagnosis: opens from disk, prints, needs no network.

`html` escapes, `page` is the skeleton, `svg` and `figures` draw, `series` draws what can be zoomed; what is
drawn comes from `hallsym.report.data`. `fit_page` and `diagnosis_page` put the sections together, those of a
diagnosis from `diagnosis_errors`, `diagnosis_effects` and `diagnosis_places`. The same input gives the same
bytes.
"""

from hallsym.report.page.diagnosis_page import diagnosis_page
from hallsym.report.page.fit_page import fit_page

__all__ = ["diagnosis_page", "fit_page"]
