"""The sections of a diagnosis page on where the gap lies and on what no effect explains."""

from __future__ import annotations

from collections.abc import Sequence

from hallsym.report.page import curves, figures
from hallsym.report.page.diagnosis_record import (
    Record,
    p_cell,
    percent,
    typeset,
)
from hallsym.report.page.html import Markup, join, table, tag
from hallsym.report.words import name as named_column

MOST = 12
"""Statements on where the gap lies that are drawn; all of them are in the table."""


def where_section(record: Record) -> Markup:
    """Return the statements on where the gap lies, then each place by itself."""
    said = _statements(record.get("where") or [], "share of the excess above the noise floor [%]")
    if not said and record.get("size"):
        said = tag("p", "Nowhere in particular: what is above the noise goes with nothing beyond chance.")
    return join([said, _alone(record.get("shares") or [])])


def _alone(shares: Sequence[Record]) -> Markup:
    """Return what each place takes of the excess by itself, sure or not, folded away."""
    rows = [
        [
            s["kind"],
            named_column(s["name"]) if s["kind"] in ("output", "sensor") else s["name"],
            "" if s.get("share") is None else percent(s["share"], 0),
            p_cell(s.get("p_value")),
            s.get("text") or "",
        ]
        for s in shares
    ]
    if not rows:
        return Markup("")
    head = ["kind", "place", "share of the excess", "p", ""]
    note = "Each with nothing before it, so that shares overlap; p above 0.01 is no evidence."
    summary = tag("summary", "every place by itself: coordinates, links, outputs, sensors, frequencies, runs")
    return tag("details", summary, table(head, rows, left=2, wordy=(4,), caption=note))


def rest_section(record: Record) -> Markup:
    """Return what is left: how much, what it goes with, and its shape."""
    rest, statements = record.get("unexplained") or {}, record.get("remaining") or []
    if not rest and not statements:
        return Markup("")
    said = []
    if rest.get("share") is not None:
        said.append(
            tag("p", f"{percent(rest['share'], 0)} of the gap above the noise floor has no known cause.")
        )
    if statements and statements != record.get("where"):
        said.append(_statements(statements, "share of what no effect explains [%]"))
    elif statements:
        said.append(tag("p", "It lies where the gap lies, see above."))
    elif rest.get("text"):
        said.append(tag("p", f"{typeset(str(rest['text'])).capitalize()}."))
    if rest.get("curve"):
        said.append(curves.curve(rest["curve"]))
    return join(said)


def _statements(statements: Sequence[Record], title: str) -> Markup:
    if not statements:
        return Markup("")
    drawn = [s for s in statements if s.get("share") is not None][:MOST]
    bars = [(_place(s), float(s["share"])) for s in drawn]
    rows = [
        [
            typeset(str(s.get("text") or _place(s))),
            "" if s.get("held_out") is None else percent(max(s["held_out"], 0.0), 0),
            p_cell(s.get("p_value")),
        ]
        for s in statements
    ]
    picture = tag("figure", figures.shares(bars, title)) if bars else None
    return join([picture, table(["statement (fitted runs)", "on held-out runs", "p"], rows)])


def _place(statement: Record) -> str:
    """Return what a bar is called; of a coordinate the range is left to the statement under it."""
    by, at = str(statement.get("by") or ""), str(statement.get("at") or "")
    if by in ("output", "sensor"):
        return f"{by} {named_column(at)}"
    return f"{by}: {at}" if at and by in ("link", "run", "frequency") else by
