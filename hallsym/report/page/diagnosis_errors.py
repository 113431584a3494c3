"""The section of a diagnosis page on the errors: before and after, per output, sensor and harmonic."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from hallsym.diagnosis import Diagnosis
from hallsym.report.page import shared
from hallsym.report.page.content import Heading, Section, Table, Words
from hallsym.report.page.diagnosis_words import changed, percent
from hallsym.report.page.shared import Gap
from hallsym.report.text.diagnosis import shrinks_text
from hallsym.report.words import NOT_DECODED, amount, scale, three
from hallsym.report.words import name as named_column
from hallsym.units import readable


def errors_section(d: Diagnosis) -> Section:
    """Return errors on the holdout runs beside the noise floor, as picture and tables."""
    rows = gaps(d)
    if changed(d):
        drawn = {when: (when, gap) for when, gap in rows.items()}
    else:
        drawn = {"holdout": ("after", rows["holdout"])}
    floor = d.noise_floor
    note = "On runs that took part in neither the fit nor the choice of effects. Dashed line: noise floor."
    content: list[Any] = [
        Words(f"{shrinks_text(d) if changed(d) else ''} {_metric(d)}".strip()),
        Words(note, note=True),
        shared.against_floor(drawn, floor.outputs),
        shared.gap_table(rows, floor.outputs, floor.source),
        *_sizes(d),
    ]
    for coordinate in dict.fromkeys(w.coordinate for w in d.waves):
        content += _waves(d, coordinate)
    title = f"{'Before and after' if changed(d) else 'Errors'}, against the noise floor"
    return Section("errors", title, content)


def gaps(d: Diagnosis) -> dict[str, Gap]:
    """Return the errors before and after, or on the holdout runs, without outputs that have no number."""
    every = {"before": asdict(d.gap_before), "after": asdict(d.gap_after)}
    parts = [part for gap in every.values() for part in gap.values()]
    known = [c for c in parts[0] if all(math.isfinite(part.get(c, math.nan)) for part in parts)]
    found: dict[str, Gap] = {
        when: {what: {c: part[c] for c in known} for what, part in gap.items()} for when, gap in every.items()
    }
    return found if changed(d) else {"holdout": found["before"]}


def _metric(d: Diagnosis) -> str:
    """Return the gap as one number over all outputs, which shrinkage is measured by."""
    outputs = tuple(d.gap_before.rmse)
    column = next((c for c in outputs if c.endswith("_m")), outputs[0])
    sizes = asdict(d.metric)
    if not changed(d):
        sizes = {"on the holdout runs": d.metric.before, "floor": d.metric.floor}
    return f"One number over all outputs: {', '.join(f'{amount(column, v)} {k}' for k, v in sizes.items())}."


def _waves(d: Diagnosis, coordinate: str) -> list[Any]:
    """Return the harmonics of the error over a periodic coordinate."""
    factor, unit, name = readable(coordinate or next(iter(d.noise_floor.outputs)))
    per = f"period of {name}" if coordinate else "turn"
    rows: list[list[object]] = []
    for w in (w for w in d.waves if w.coordinate == coordinate):
        sizes = ["" if a is None else three(factor * a) for a in (w.designed, w.model, w.after)]
        found = [e.name for e in d.effects if e.name in w.causes]
        rows.append([w.per_turn, *sizes, ", ".join(found), ", ".join(w.causes)])
    head = [
        f"waves per {per}", f"nominal [{unit}]", f"model [{unit}]", f"with the effects [{unit}]",
        "effects found", "causes",
    ]  # fmt: skip
    lost = any(w.designed is None for w in d.waves if w.coordinate == coordinate)
    caption = (
        f"amplitude of the error over all runs: of the nominal sensor with only its zeros fitted"
        f"{f' (none: {NOT_DECODED})' if lost else ''}, of the model, and with the effects found"
    )
    return [Heading(f"By waves per {per}"), Table(head, rows, caption, wordy=(4, 5))]


def _sizes(d: Diagnosis) -> list[Any]:
    """Return how large the gap is per output and sensor, on fitted and on holdout runs."""
    rows: list[list[object]] = []
    for column, sides in d.size.rows.items():
        factor, unit = scale(column, max(side.rms for side in sides.values()))
        row: list[object] = [named_column(column), unit]
        for when in ("fitted", "held_out"):
            side = sides.get(when)
            row += [three(factor * v) for v in (side.rms, side.noise, side.above)] if side else [""] * 3
            row.append(percent(side.share, 0) if side and side.share is not None else "")
        rows.append(row)
    if not rows:
        return []
    head = ["of the model", "unit"]
    for when in ("fitted", "holdout"):
        head += [f"{what}, {when}" for what in ("rms", "noise", "above", "share")]
    caption = (
        f"residual error on fitted and holdout runs: rms, noise floor ({d.noise_floor.source}), the excess "
        "above it, and its share of the excess of all outputs, or of all sensors, where the whole excess is "
        "more than chance"
    )
    return [Heading("Per output and per sensor"), Table(head, rows, caption, left=2)]
