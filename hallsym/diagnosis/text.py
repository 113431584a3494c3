"""The diagnosis as a person reads it in a terminal."""

from collections.abc import Mapping
from typing import Any

from hallsym.diagnosis.record import Diagnosis, FoundEffect, Statement
from hallsym.tables import concise, error_rows, grid


def diagnosis_text(d: Diagnosis) -> str:
    """Return what `hallsym diagnose` prints: verdict, errors, effects, where, what could not be tested."""
    source = d.noise_floor["source"]
    floor = {c: v for c, v in d.noise_floor.items() if c != "source"}
    rows = {"before": d.gap_before, "after": d.gap_after} if d.effects else {"held out": d.gap_before}
    judged = f"judged on {len(d.validation_runs)} runs that were neither fitted nor chosen on"
    parts = [
        d.sentence,
        "",
        f"verdict: {d.verdict} ({d.model}, threshold {100 * d.threshold:g} %, {judged}; "
        f"noise floor from {source} noise; {d.seconds:.1f} s)",
        "",
        error_rows(tuple(floor), rows, floor),
    ]
    if d.effects:
        parts += ["", effect_text(d.effects), "", *(_parameters(e) for e in d.effects if e.parameters)]
        low, high = d.shrinkage["interval"]
        parts.append(
            f"the gap shrinks by {100 * d.shrinkage['value']:.1f} % "
            f"(95 %: {100 * low:.1f} to {100 * high:.1f}); "
            f"{100 * d.shrinkage['share_closed']:.0f} % of what is above the floor is closed with "
            f"{d.shrinkage['parameters_added']} parameters"
        )
    for group, sep in zip(d.groups, d.separate_by, strict=False):
        parts += ["", f"this log cannot tell apart: {', '.join(group)}", f"  record: {sep.recording}"]
        parts.append(f"  the difference must show {sep.factor:.3g} x more than here")
    parts += _statements("where the gap lies", d.where)
    parts += _statements("where the rest lies", d.remaining)
    if d.smaller_findings:
        parts += ["", "smaller findings (significant, below the threshold): " + _smaller(d.smaller_findings)]
    if d.not_testable:
        parts += ["", *(f"not testable: {name}: {reason}" for name, reason in d.not_testable.items())]
    return "\n".join([*parts, *(f"note: {note}" for note in d.notes)])


def effect_text(effects: tuple[FoundEffect, ...]) -> str:
    """Return the table of effects, best first."""
    rows = [["effect", "link", "form", "gap without it shrinks by", "of the excess", "p"]]
    for e in effects:
        low, high = e.interval
        shrinks = f"{100 * e.shrinkage:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
        rows.append([e.name, e.link, e.variant, shrinks, f"{100 * e.share:.0f} %", f"{e.p_value:.1g}"])
    return grid(rows, left=3)


def _parameters(effect: FoundEffect) -> str:
    values = (f"{n} {concise(p.value, p.std)} {p.unit}" for n, p in effect.parameters.items())
    return f"{effect.name}: {', '.join(values)}"


def _statements(title: str, statements: tuple[Statement, ...]) -> list[str]:
    if not statements:
        return []
    return ["", f"{title}:", *(f"  {s.text} (p {s.p_value:.1g})" for s in statements[:10])]


def _smaller(findings: tuple[Mapping[str, Any], ...]) -> str:
    return ", ".join(f"{f['name']} {100 * f['shrinkage']:.1f} %" for f in findings)
