"""The section of a diagnosis page on the effects: ranked, with what the log cannot tell apart."""

from __future__ import annotations

import math

from hallsym.diagnosis import Diagnosis, Separation
from hallsym.errors import counted
from hallsym.report.page import figures
from hallsym.report.page.diagnosis_words import p_cell, percent, with_interval
from hallsym.report.page.html import Markup, items, join, table, tag
from hallsym.report.words import three


def effects_section(d: Diagnosis) -> Markup:
    """Return the ranking of the effects, and groups that the log cannot tell apart."""
    if not (d.effects or d.groups or d.ranked):
        return tag("p", "None. No effect of the catalogue lowers the gap by what is worth reporting.")
    notes = [join([tag("strong", e.name), ": ", e.note]) for e in d.effects if e.note]
    return join([_ranking(d), _ranked(d), *([items(notes)] if notes else []), _groups(d)])


def _ranking(d: Diagnosis) -> Markup:
    rows = [(e.name, e.shrinkage, e.interval) for e in d.effects if math.isfinite(e.shrinkage)]
    if not rows:
        return Markup("")
    return tag(
        "figure", figures.intervals(rows, "decrease of the gap by the effect [%], with its 95 % interval")
    )


def _ranked(d: Diagnosis) -> Markup:
    """Return the ranking as a table: effects with numbers, then names that carry evidence without them."""
    head = ["effect", "link", "form", "shrinks the gap by", "share of the excess", "p", "not told apart from"]
    rows: list[list[object]] = [
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
    return table(head, rows, left=3, wordy=(6,), caption="effects, best first")


def _others(d: Diagnosis, name: str) -> str:
    return ", ".join(dict.fromkeys(other for g in d.groups if name in g for other in g if other != name))


def _groups(d: Diagnosis) -> Markup:
    """Return what the log cannot tell apart, and the recording that would."""
    found = {s.group: s for s in d.separate_by}
    lines = [
        join([tag("strong", _said(group, found.get(group))), *_separation(found.get(group))])
        for group in dict.fromkeys([*d.groups, *found])
    ]
    return join([tag("h3", "Confusable effects"), items(lines)]) if lines else Markup("")


def _said(group: tuple[str, ...], s: Separation | None) -> str:
    return s.said if s else ", ".join(group)


def _separation(s: Separation | None) -> list[object]:
    """Return what would separate a group, and by how much."""
    if s is None:
        return [": this log cannot tell them apart."]
    now = "" if s.sigma_now is None else f" ({three(s.sigma_now)} sigma)"
    said = f": this log cannot tell them apart{now}. Record {s.recording}"
    if not s.simulated or s.sigma is None or s.run_s is None or not s.runs:
        if s.factor is None or not math.isfinite(s.factor):
            return [f"{said}."]
        return [f"{said}: the difference must be {s.factor:.3g} times larger than here."]
    total = f" ({s.seconds:.3g} s in all)" if s.runs > 1 and s.seconds else ""
    each = f": simulated, one run of {s.run_s:.3g} s tells them apart by {three(s.sigma)} sigma"
    tried = sorted(s.tried.items(), key=lambda item: -item[1])
    return [
        f"{said}{each}; 5 sigma take {counted(s.runs, 'run')}{total}.",
        table(["recording that was simulated", "sigma per run"], [[what, three(v)] for what, v in tried]),
    ]
