"""One self-contained HTML page of a result: opens from disk, prints, needs no network.

The pages of a fit, a diagnosis and a fleet put together what they hold (`content`, `shared`), with figures
from `hallsym.report.figures`. HTML, style and script are in `templates`. The same input gives the same bytes.
"""
