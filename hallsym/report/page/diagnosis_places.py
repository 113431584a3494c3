"""The sections of a diagnosis page on where the gap lies and on what no effect explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hallsym.diagnosis import Diagnosis, Share, Statement
from hallsym.report.page import bars, curves
from hallsym.report.page.content import Figure, Fold, Section, Table, Words
from hallsym.report.page.diagnosis_words import p_cell, percent, typeset
from hallsym.report.words import name as named_column

MOST = 12
"""Statements on where the gap lies that are drawn; all of them are in the table."""


def where_section(d: Diagnosis) -> Section:
    """Return the statements on where the gap lies, then the share of each place alone."""
    said = _statements(d.where, "share of the excess above the noise floor [%]")
    if not said and d.size.rows:
        said = [Words("The excess above the noise goes with nothing that the log holds.")]
    return Section("where", "Where the gap lies", [*said, _alone(d.shares)])


def _alone(shares: Sequence[Share]) -> Fold:
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
    head = ["kind", "place", "share of the excess", "p", "remark"]
    note = "Each place alone, so shares overlap; p above 0.01 is no evidence."
    summary = "every place alone: coordinates, links, outputs, sensors, frequencies, runs"
    return Fold(summary, Table(head, rows, note, left=2, wordy=(4,)))


def rest_section(d: Diagnosis) -> Section:
    """Return the unexplained rest: how much it is, what it goes with, and its shape."""
    rest = d.unexplained
    said: list[Any] = []
    if rest:
        share = percent(rest.share, 0)
        said.append(Words(f"{share} of the excess above the noise floor has no known cause."))
    if d.remaining and d.remaining != d.where:
        said += _statements(d.remaining, "share of the unexplained excess [%]")
    elif d.remaining:
        said.append(Words("It goes with what the gap goes with, see above."))
    elif rest:
        said.append(Words(f"{typeset(rest.text).capitalize()}."))
    if rest and rest.curve:
        how, charts = curves.curves(rest.curve)
        said.append(Figure(charts, how, look="shape"))
    return Section("rest", "What no effect explains", said)


def _statements(statements: Sequence[Statement], title: str) -> list[Any]:
    drawn = [s for s in statements if math.isfinite(s.share)]
    rows = [
        [
            typeset(s.text),
            "" if s.held_out is None else percent(max(s.held_out, 0.0), 0),
            p_cell(s.p_value),
        ]
        for s in statements
    ]
    chart = (
        [bars.shares([(_place(s), s.share, None) for s in drawn[:MOST]], title, look="before")]
        if drawn
        else []
    )
    head = ["statement (fitted runs)", "on holdout runs", "p"]
    found = [Figure(chart, look="two"), Table(head, rows, "statements on the places")]
    return found if statements else []


def _place(s: Statement) -> str:
    """Return the label of a bar; the range of a coordinate is left to the statement under it."""
    if s.by in ("output", "sensor"):
        return f"{s.by} {named_column(s.at)}"
    return f"{s.by}: {s.at}" if s.at and s.by in ("link", "run", "frequency") else s.by
