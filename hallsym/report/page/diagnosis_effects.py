"""The section of a diagnosis page on the effects: ranked, with what the log cannot tell apart."""

from __future__ import annotations

import math
from typing import Any

from hallsym.diagnosis import Diagnosis, Separation
from hallsym.errors import counted
from hallsym.report.page import bars
from hallsym.report.page.content import Figure, Heading, Item, Items, Section, Table, Words
from hallsym.report.page.diagnosis_words import p_cell, percent, with_interval
from hallsym.report.words import three


def effects_section(d: Diagnosis) -> Section:
    """Return the ranking of the effects, and groups that the log cannot tell apart."""
    if not (d.effects or d.groups or d.ranked):
        none = "None. No effect of the catalogue lowers the gap by what is worth reporting."
        return Section("effects", "Which effects", [Words(none)])
    notes = Items([Item(e.note, e.name) for e in d.effects if e.note])
    return Section("effects", "Which effects", [_ranking(d), _ranked(d), notes, *_groups(d)])


def _ranking(d: Diagnosis) -> Figure | None:
    rows = [(e.name, e.shrinkage, e.interval) for e in d.effects if math.isfinite(e.shrinkage)]
    if not rows:
        return None
    how = "With the 95 % interval of each effect"
    return Figure([bars.shares(rows, "decrease of the gap [%]", 1)], how, look="two")


def _ranked(d: Diagnosis) -> Table:
    """Return the ranking as a table: effects with numbers, then names that carry evidence without them."""
    head = [
        "effect", "link", "form", "shrinks the gap by (95 %)", "share of the excess", "p",
        "not told apart from",
    ]  # fmt: skip
    rows: list[list[Any]] = [
        [
            e.name,
            e.link,
            e.variant,
            with_interval(e.shrinkage, e.interval),
            percent(e.share, 0),
            p_cell(e.p_value),
            _others(d, e.name),
        ]
        for e in d.effects
    ]
    named = {e.name for e in d.effects}
    rows += [[name, "", "", "", "", "", _others(d, name)] for name in d.ranked if name not in named]
    return Table(head, rows, "effects, best first", left=3, wordy=(6,), sortable=True)


def _others(d: Diagnosis, name: str) -> str:
    return ", ".join(dict.fromkeys(other for g in d.groups if name in g for other in g if other != name))


def _groups(d: Diagnosis) -> list[Any]:
    """Return what the log cannot tell apart, and the recording that would."""
    found = {s.group: s for s in d.separate_by}
    lines = [_separation(group, found.get(group)) for group in dict.fromkeys([*d.groups, *found])]
    return [Heading("Confusable effects"), Items(lines)] if lines else []


def _separation(group: tuple[str, ...], s: Separation | None) -> Item:
    """Return what would separate a group, and by how much."""
    if s is None:
        return Item("this log cannot tell them apart.", ", ".join(group))
    now = "" if s.sigma_now is None else f" ({three(s.sigma_now)} sigma)"
    said = f"this log cannot tell them apart{now}. Record {s.recording}"
    if not s.simulated or s.sigma is None or s.run_s is None or not s.runs:
        if s.factor is None or not math.isfinite(s.factor):
            return Item(f"{said}.", s.said)
        return Item(f"{said}: the difference must be {s.factor:.3g} times larger than here.", s.said)
    total = f" ({s.seconds:.3g} s in all)" if s.runs > 1 and s.seconds else ""
    once = f": simulated, one run of {s.run_s:.3g} s tells them apart by {three(s.sigma)} sigma"
    tried = sorted(s.tried.items(), key=lambda item: -item[1])
    rows = [[what, three(v)] for what, v in tried]
    table = Table(["recording", "sigma per run"], rows, "recordings that were simulated") if rows else None
    return Item(f"{said}{once}; 5 sigma take {counted(s.runs, 'run')}{total}.", s.said, table)
