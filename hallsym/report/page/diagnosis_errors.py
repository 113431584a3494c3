"""The section of a diagnosis page on the errors: before and after, per output, sensor and wave per turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hallsym.report.page import figures, parts
from hallsym.report.page.diagnosis_record import (
    Record,
    changed,
    interval_text,
    percent,
    source_of,
)
from hallsym.report.page.html import Markup, join, table, tag
from hallsym.report.words import name as named_column
from hallsym.report.words import scale, three
from hallsym.units import readable


def errors_title(record: Record) -> str:
    """Return its title."""
    return f"{'Before and after' if changed(record) else 'Errors'}, against the noise floor"


def errors_section(record: Record, floor: Mapping[str, float]) -> Markup:
    """Return errors on held-out runs beside the noise floor, as picture and tables."""
    shown = gaps_of(record)
    if not shown:
        return _sizes(record)
    drawn = {k: ("before" if k == "before" else "after", gap) for k, gap in shown.items()}
    if not changed(record):
        shown = {"held out": shown["before"]} if "before" in shown else shown
        drawn = {k: ("after", gap) for k, gap in shown.items()}
    note = "On runs that took part in neither the fit nor the choice of effects. Dashed line: noise floor."
    shrinks = _shrinks(record.get("shrinkage") or {}) if changed(record) else None
    return join(
        [
            tag("p", shrinks, _metric(record)),
            tag("p", note, class_="note"),
            tag("figure", figures.against_floor(drawn, floor)),
            parts.gap_table(shown, floor, source_of(record)),
            _sizes(record),
            _waves(record),
        ]
    )


def _waves(record: Record) -> Markup:
    """Return the error of each periodic coordinate by waves per period."""
    waves = record.get("waves") or []
    coordinates = dict.fromkeys(w.get("coordinate", "") for w in waves)
    return join([_waves_of(record, c, waves) for c in coordinates])


def _waves_of(record: Record, coordinate: str, waves: Sequence[Record]) -> Markup:
    factor, unit, name = readable(coordinate or next(iter(record["noise_floor"])))
    per = f"period of {name}" if coordinate else "turn"
    named = [e["name"] for e in record.get("effects") or []]
    rows: list[list[object]] = []
    for w in waves:
        if w.get("coordinate", "") != coordinate:
            continue
        sizes = ["" if w.get(k) is None else three(factor * w[k]) for k in ("designed", "model", "after")]
        found = [n for n in named if n in w["causes"]]
        rows.append([w["per_turn"], *sizes, ", ".join(found), ", ".join(w["causes"])])
    head = [f"waves per {per}", f"as designed [{unit}]", "model", "with the effects", "named here", "made by"]
    caption = (
        "amplitude of the error over all runs: as designed (only the zero fitted), with the model's own "
        "parameters, with the effects found"
    )
    return join([tag("h3", f"By waves per {per}"), table(head, rows, left=1, wordy=(4, 5), caption=caption)])


def _sizes(record: Record) -> Markup:
    """Return how large the gap is per output and sensor, fitted and held-out runs apart."""
    size = record.get("size") or {}
    rows: list[list[object]] = []
    for kind in ("outputs", "sensors"):
        for column, sides in (size.get(kind) or {}).items():
            if kind == "sensors" and column in (size.get("outputs") or {}):
                continue  # a decoded angle is both
            row: list[object] = [named_column(column)]
            largest = max(side["rms"] for side in sides.values())
            factor, unit = scale(column, largest)
            row.append(unit)
            for when in ("fitted", "held_out"):
                side = sides.get(when)
                cells = [three(factor * side[k]) for k in ("rms", "noise", "above")] if side else [""] * 3
                share = "" if not side or side.get("share") is None else percent(side["share"], 0)
                row += [*cells, share]
            rows.append(row)
    head = ["of the model", "unit"]
    for when in ("fitted", "held out"):
        head += [f"rms, {when}", "noise", "above", "share"]
    caption = (
        "what the model leaves on fitted and on held-out runs: rms, noise floor "
        f"({source_of(record) or 'as given'}), what is above it, and its share of the excess of all outputs, "
        "or of all sensors, where the excess as a whole is more than chance"
    )
    return (
        join([tag("h3", "Per output and per sensor"), table(head, rows, left=2, caption=caption)])
        if rows
        else Markup("")
    )


def _metric(record: Record) -> str | None:
    """Return the one number over all outputs (SI) that shrinkage is measured by."""
    metric = dict(record.get("metric") or {})
    if not changed(record):
        metric = {"on held-out runs" if k == "before" else k: v for k, v in metric.items() if k != "after"}
    outputs = tuple((record.get("gap_before") or {}).get("rmse") or ("x_m",))
    column = next((c for c in outputs if c.endswith("_m")), outputs[0])
    said = [f"{parts.amount(column, v)} {when}" for when, v in metric.items() if isinstance(v, int | float)]
    return f" One number over all outputs: {', '.join(said)}." if said else None


def gaps_of(record: Record) -> dict[str, Any]:
    """Return the gaps that there are, with the outputs for which each of them has a number."""
    gaps = {k: record[f"gap_{k}"] for k in ("before", "after") if record.get(f"gap_{k}")}
    if not gaps:
        return {}
    outputs = [
        c
        for c in next(iter(gaps.values()))["rmse"]
        if all(isinstance(g[what].get(c), int | float) for g in gaps.values() for what in ("rmse", "peak"))
    ]
    if not outputs:
        return {}
    return {k: {what: {c: g[what][c] for c in outputs} for what in ("rmse", "peak")} for k, g in gaps.items()}


def _shrinks(shrinkage: Record) -> str | None:
    value = shrinkage.get("value")
    if value is None:
        return None
    text = f"The gap shrinks by {percent(value)}{interval_text(shrinkage.get('interval'))}"
    if shrinkage.get("share_closed") is not None:
        text += f"; {percent(shrinkage['share_closed'], 0)} of what is above the noise floor is closed"
    if shrinkage.get("parameters_added"):
        text += f", with {shrinkage['parameters_added']} parameters more"
    return text + "."
