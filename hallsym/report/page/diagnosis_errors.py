"""The section of a diagnosis page on the errors: before and after, per output, sensor and harmonic."""

from __future__ import annotations

import math
from dataclasses import asdict

from hallsym.diagnosis import Diagnosis
from hallsym.report.page import figures, parts
from hallsym.report.page.diagnosis_words import changed, percent, with_interval
from hallsym.report.page.html import Markup, join, table, tag
from hallsym.report.words import name as named_column
from hallsym.report.words import scale, three
from hallsym.units import readable


def errors_title(d: Diagnosis) -> str:
    """Return its title."""
    return f"{'Before and after' if changed(d) else 'Errors'}, against the noise floor"


def errors_section(d: Diagnosis) -> Markup:
    """Return errors on the holdout runs beside the noise floor, as picture and tables."""
    gaps = _finite({"before": asdict(d.gap_before), "after": asdict(d.gap_after)})
    drawn = {when: (when, gap) for when, gap in gaps.items()}
    if not changed(d):
        gaps = {"holdout": gaps["before"]}
        drawn = {"holdout": ("after", gaps["holdout"])}
    floor = d.noise_floor
    note = "On runs that took part in neither the fit nor the choice of effects. Dashed line: noise floor."
    return join(
        [
            tag("p", _shrinks(d) if changed(d) else None, _metric(d)),
            tag("p", note, class_="note"),
            tag("figure", figures.against_floor(drawn, floor.outputs)),
            parts.gap_table(gaps, floor.outputs, floor.source),
            _sizes(d),
            _waves(d),
        ]
    )


def _finite(gaps: dict[str, dict[str, dict[str, float]]]) -> dict[str, dict[str, dict[str, float]]]:
    """Return gaps without the outputs of which a number does not exist."""
    parts = [part for gap in gaps.values() for part in gap.values()]
    known = [c for c in parts[0] if all(math.isfinite(part.get(c, math.nan)) for part in parts)]
    return {
        when: {what: {c: part[c] for c in known} for what, part in gap.items()} for when, gap in gaps.items()
    }


def _shrinks(d: Diagnosis) -> str:
    s = d.shrinkage
    return (
        f"The gap shrinks by {with_interval(s.value, s.interval)}; {percent(s.share_closed, 0)} of the "
        f"excess above the noise floor is closed, with {s.parameters_added} parameters more."
    )


def _metric(d: Diagnosis) -> str:
    """Return the gap as one number over all outputs, which shrinkage is measured by."""
    outputs = tuple(d.gap_before.rmse)
    column = next((c for c in outputs if c.endswith("_m")), outputs[0])
    sizes = asdict(d.metric)
    if not changed(d):
        sizes = {"on the holdout runs": d.metric.before, "floor": d.metric.floor}
    said = ", ".join(f"{parts.amount(column, v)} {when}" for when, v in sizes.items())
    return f" One number over all outputs: {said}."


def _waves(d: Diagnosis) -> Markup:
    """Return the harmonics of the error over each periodic coordinate."""
    return join([_waves_of(d, coordinate) for coordinate in dict.fromkeys(w.coordinate for w in d.waves)])


def _waves_of(d: Diagnosis, coordinate: str) -> Markup:
    factor, unit, name = readable(coordinate or next(iter(d.noise_floor.outputs)))
    per = f"period of {name}" if coordinate else "turn"
    rows: list[list[object]] = []
    for w in (w for w in d.waves if w.coordinate == coordinate):
        sizes = ["" if a is None else three(factor * a) for a in (w.designed, w.model, w.after)]
        found = [e.name for e in d.effects if e.name in w.causes]
        rows.append([w.per_turn, *sizes, ", ".join(found), ", ".join(w.causes)])
    head = [f"waves per {per}", f"nominal [{unit}]", "model", "with the effects", "effects found", "causes"]
    caption = (
        "amplitude of the error over all runs: of the nominal sensor with only its zeros fitted, of the "
        "model, and with the effects found"
    )
    return join([tag("h3", f"By waves per {per}"), table(head, rows, left=1, wordy=(4, 5), caption=caption)])


def _sizes(d: Diagnosis) -> Markup:
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
        return Markup("")
    head = ["of the model", "unit"]
    for when in ("fitted", "holdout"):
        head += [f"rms, {when}", "noise", "above", "share"]
    caption = (
        f"residual error on fitted and holdout runs: rms, noise floor ({d.noise_floor.source}), the excess "
        "above it, and its share of the excess of all outputs, or of all sensors, where the whole excess is "
        "more than chance"
    )
    return join([tag("h3", "Per output and per sensor"), table(head, rows, left=2, caption=caption)])
