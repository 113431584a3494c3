"""One self-contained HTML page for a fit or a diagnosis: opens from disk, prints, needs no network.

`fit_page` and `diagnosis_page` put together what a page holds (`content`, `shared`), the charts among it
(`charts`, `pictures`) from `hallsym.report.data`. HTML, style and script are in `templates`. The same input
gives the same bytes.
"""
