"""The section of a diagnosis page on the effects: ranked, with what the log cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence

from hallsym.errors import counted
from hallsym.report.page import figures
from hallsym.report.page.diagnosis_record import (
    Record,
    interval_text,
    p_cell,
    pair,
    percent,
)
from hallsym.report.page.html import Markup, items, join, table, tag
from hallsym.report.words import three


def effects_section(record: Record) -> Markup:
    """Return the ranking of the effects, and groups that the log cannot tell apart."""
    effects, groups = record.get("effects") or [], record.get("groups") or []
    if not (effects or groups or record.get("ranked")):
        return tag("p", "None: no effect of the catalogue lowers the gap by what is worth reporting.")
    return join([_ranking(record, effects), _ranked(record, effects, groups), _groups(record, groups)])


def _ranking(record: Record, effects: Sequence[Record]) -> Markup:
    drawn = [e for e in effects if e.get("shrinkage") is not None]
    if not drawn:
        return Markup("")
    rows = [(str(e["name"]), float(e["shrinkage"]), pair(e.get("interval"))) for e in drawn]
    title = "the gap without it shrinks by [%], with its 95 % interval"
    return tag("figure", figures.intervals(rows, title))


def _ranked(record: Record, effects: Sequence[Record], groups: Sequence[Sequence[str]]) -> Markup:
    """Return the ranking as a table: effects with numbers, then names that carry evidence without them."""
    head = ["effect", "link", "form", "shrinks the gap by", "share of the gap", "p", "not told apart from"]
    rows: list[list[object]] = []
    for e in effects:
        shrinks = (
            "" if e.get("shrinkage") is None else percent(e["shrinkage"]) + interval_text(e.get("interval"))
        )
        share = "" if e.get("share") is None else percent(e["share"], 0)
        row = [
            e["name"],
            e.get("link") or "",
            e.get("variant") or "",
            shrinks,
            share,
            p_cell(e.get("p_value")),
        ]
        rows.append([*row, _others(e["name"], groups)])
    named = {e["name"] for e in effects}
    for name in record.get("ranked") or []:
        if name not in named:
            rows.append([name, "", "", "", "", "", _others(name, groups)])
    return table(head, rows, left=3, wordy=(6,), caption="effects, best first")


def _others(name: str, groups: Sequence[Sequence[str]]) -> str:
    return ", ".join(dict.fromkeys(other for g in groups if name in g for other in g if other != name))


def _groups(record: Record, groups: Sequence[Sequence[str]]) -> Markup:
    """Return what the log cannot tell apart, and the recording that would."""
    found = {tuple(s.get("group") or ()): s for s in record.get("separate_by") or []}
    lines = []
    for group in dict.fromkeys([*map(tuple, groups), *found]):
        s = found.get(group, {})
        lines.append(join([tag("strong", ", ".join(group)), *_separation(s)]))
    return join([tag("h3", "Groups"), items(lines)]) if lines else Markup("")


def _separation(s: Record) -> list[object]:
    """Return what would separate a group, and by how much."""
    now = "" if s.get("sigma_now") is None else f" ({three(s['sigma_now'])} sigma)"
    out: list[object] = [f": this log cannot tell them apart{now}."]
    if not s.get("recording"):
        return out
    out.append(f" Record {s['recording']}")
    if s.get("simulated") and s.get("sigma") is not None and s.get("runs"):
        each = f": simulated, one run of {s['run_s']:.3g} s tells them apart by {three(s['sigma'])} sigma"
        total = f" ({s['seconds']:.3g} s in all)" if s["runs"] > 1 and s.get("seconds") else ""
        out.append(f"{each}; 5 sigma take {counted(s['runs'], 'run')}{total}.")
        tried = sorted((s.get("tried") or {}).items(), key=lambda x: -(x[1] or 0.0))
        rows = [[what, three(sigma)] for what, sigma in tried if sigma is not None]
        out.append(table(["recording that was simulated", "sigma per run"], rows))
    elif s.get("factor"):
        out.append(f": the difference must show {s['factor']:.3g} times more than here.")
    else:
        out.append(".")
    return out
