"""The sections of a diagnosis page on where the gap lies and on what no effect explains."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hallsym.diagnosis import Diagnosis, Share, Statement
from hallsym.report.page import curves, figures
from hallsym.report.page.diagnosis_words import p_cell, percent, typeset
from hallsym.report.page.html import Markup, join, table, tag
from hallsym.report.words import name as named_column

MOST = 12
"""Statements on where the gap lies that are drawn; all of them are in the table."""


def where_section(d: Diagnosis) -> Markup:
    """Return the statements on where the gap lies, then the share of each place alone."""
    said = _statements(d.where, "share of the excess above the noise floor [%]")
    if not said and d.size.rows:
        said = tag("p", "The excess above the noise goes with nothing that the log holds.")
    return join([said, _alone(d.shares)])


def _alone(shares: Sequence[Share]) -> Markup:
    """Return the share of the excess that goes with each place alone, significant or not, folded away."""
    rows = [
        [
            s.kind,
            named_column(s.name) if s.kind in ("output", "sensor") else s.name,
            "" if s.share is None else percent(s.share, 0),
            p_cell(s.p_value),
            s.text,
        ]
        for s in shares
    ]
    if not rows:
        return Markup("")
    head = ["kind", "place", "share of the excess", "p", ""]
    note = "Each place alone, so shares overlap; p above 0.01 is no evidence."
    summary = tag("summary", "every place alone: coordinates, links, outputs, sensors, frequencies, runs")
    return tag("details", summary, table(head, rows, left=2, wordy=(4,), caption=note))


def rest_section(d: Diagnosis) -> Markup:
    """Return the unexplained rest: how much it is, what it goes with, and its shape."""
    rest = d.unexplained
    if not rest and not d.remaining:
        return Markup("")
    said = []
    if rest:
        share = percent(rest.share, 0)
        said.append(tag("p", f"{share} of the excess above the noise floor has no known cause."))
    if d.remaining and d.remaining != d.where:
        said.append(_statements(d.remaining, "share of the unexplained excess [%]"))
    elif d.remaining:
        said.append(tag("p", "It goes with what the gap goes with, see above."))
    elif rest:
        said.append(tag("p", f"{typeset(rest.text).capitalize()}."))
    if rest and rest.curve:
        said.append(curves.curve(rest.curve))
    return join(said)


def _statements(statements: Sequence[Statement], title: str) -> Markup:
    if not statements:
        return Markup("")
    drawn = [s for s in statements if math.isfinite(s.share)]
    rows = [
        [
            typeset(s.text),
            "" if s.held_out is None else percent(max(s.held_out, 0.0), 0),
            p_cell(s.p_value),
        ]
        for s in statements
    ]
    picture = None
    if drawn:
        picture = tag("figure", figures.shares([(_place(s), s.share) for s in drawn[:MOST]], title))
    return join([picture, table(["statement (fitted runs)", "on holdout runs", "p"], rows)])


def _place(s: Statement) -> str:
    """Return the label of a bar; the range of a coordinate is left to the statement under it."""
    if s.by in ("output", "sensor"):
        return f"{s.by} {named_column(s.at)}"
    return f"{s.by}: {s.at}" if s.at and s.by in ("link", "run", "frequency") else s.by
