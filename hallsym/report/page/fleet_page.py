"""One page of a fleet, without a network: tables, and a histogram and a course of every parameter."""

import io
from collections.abc import Sequence
from html import escape

from hallsym.errors import counted
from hallsym.fleets import Fleet
from hallsym.fleets.row import VERDICTS
from hallsym.report.figures.fleet import CAPTION, distributions
from hallsym.report.text.fleet import SPREAD, spread_rows

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: .6rem 0 1.4rem; }
td, th { padding: .2rem .7rem; text-align: right; vertical-align: top; }
td:not(.words) { white-space: nowrap; }
th { border-bottom: 1px solid #999; font-weight: 600; }
td:first-child, th:first-child, td.words, th.words { text-align: left; }
figure { margin: .5rem 0 1.5rem; }
figure svg { max-width: 100%; height: auto; }
"""
MOST_LISTED = 500
"""Devices in the list of those that differ; all stand in the table that is saved."""


def page_of(fleet: Fleet) -> str:
    """Return the page of a fleet."""
    model = fleet.model.name if fleet.model else "no model"
    title = f"Fleet of {counted(len(fleet.rows), 'device')}: {model}"
    parts = [f"<h1>{escape(title)}</h1>", "<h2>Verdicts</h2>"]
    rows = [[v, str(len(devices)), VERDICTS[v]] for v, devices in fleet.verdicts.items()]
    parts.append(_table(["verdict", "devices", "meaning"], rows, words=(2,)))
    if fleet.spreads:
        parts += ["<h2>Spread of the parameters</h2>", _table(SPREAD, spread_rows(fleet))]
    if fleet.outlying:
        rows = [[device, why] for device, why in list(fleet.outlying.items())[:MOST_LISTED]]
        parts += ["<h2>Devices to look at</h2>", _table(["device", "why"], rows, words=(1,))]
    if any(row.get("diagnosis") for row in fleet.rows):
        rows = [
            [key, str(len(d)), ", ".join(d[:12]) + (", ..." if len(d) > 12 else "")]
            for key, d in fleet.groups.items()
        ]
        parts += [
            "<h2>Devices of the same diagnosis</h2>",
            _table(["diagnosis", "devices", "which"], rows, words=(2,)),
        ]
    if fleet.spreads:
        parts += ["<h2>Distributions</h2>", f"<p>{CAPTION}</p>"]
        stream = io.StringIO()
        distributions(fleet).savefig(stream, format="svg", metadata={"Date": None})
        svg = stream.getvalue()
        parts.append(f"<figure>{svg[svg.index('<svg') :]}</figure>")
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[int] = ()) -> str:
    def cells(tag: str, row: Sequence[str]) -> str:
        kinds = (' class="words"' if k in words else "" for k in range(len(row)))
        return "".join(f"<{tag}{kind}>{escape(cell)}</{tag}>" for kind, cell in zip(kinds, row, strict=True))

    lines = "\n".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table>\n<tr>{cells('th', head)}</tr>\n{lines}\n</table>"
