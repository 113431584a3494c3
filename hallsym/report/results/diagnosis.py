"""Report of a diagnosis: verdict, errors, effects, where the gap lies, effects that were not testable."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from itertools import product
from math import isfinite, isnan
from typing import Any

import numpy as np

from hallsym.diagnosis import (
    QUIET,
    Band,
    CurveShape,
    Diagnosis,
    Significance,
    Statement,
    noise_text,
    place_unit,
)
from hallsym.errors import counted
from hallsym.estimation import Fit
from hallsym.families import FAMILIES, added_effects, effects, plain
from hallsym.output import percent
from hallsym.report import picture as p
from hallsym.report.content import Block, Content, Folded, Heading, Items, Note, Section, Table
from hallsym.report.data.gather import RunSeries
from hallsym.report.panels import Sizes
from hallsym.report.picture import BEFORE
from hallsym.report.results import shared
from hallsym.report.tables import attributes, in_units
from hallsym.report.words import NOT_DECODED, name, number, scale
from hallsym.units import readable, scaled, typeset

FEW_UNITS = 8
"""Units of a test by signs below which the least possible p-value is stated: 2 / 2^8 is 0.008."""
LEAST_P = 1e-6
"""P-values below this are printed as below it: no test is better than its assumptions."""
STATES = {"no gap": "good", "explained": "good"}
"""Verdicts that close the diagnosis; every other one is open."""


def diagnosis_content(
    d: Diagnosis,
    *,
    maps: shared.Versions | None = None,
    groups: Sequence[p.Picture] = (),
    series: Sequence[RunSeries] = (),
    fit: Fit | None = None,
    command: str = "",
    reading: Sequence[str] = (),
) -> Content:
    """Return the report of a diagnosis.

    `maps`, `groups`, `series`: of the errors before and after, from `gather`, for a page. `fit`: the
    calibration that was diagnosed, for its parameter table. `command`: what was typed, `reading`: the words
    of it that say how the log is read, for the next command.
    """
    word = f"{d.verdict.capitalize()}."
    why, following = _next(d, fit, reading)
    return Content(
        f"Diagnosis of {d.model}: {shared.called(d.log.path)}",
        d.sentence,
        [
            Section("asked", "Input", [_input(d)]),
            _errors_section(d),
            _effects_section(d),
            _where_section(d),
            _rest_section(d),
            shared.maps_section(maps or {}, d.noise_floor.outputs, groups, seen=True),
            shared.runs_section(series),
            Section("parameters", "Parameters", shared.parameters_of(fit) if fit else []),
            Section("notes", "Other checks", [Items(_notes(d))]),
            shared.origin_section(d.log, d.versions, command),
        ],
        [
            "",
            _basis(d),
            _errors(d),
            *([shrinks_text(d)] if changed(d) and d.effects else []),
            *(shared.expanded_at_rest(fit) if fit and d.verdict in QUIET else []),
            *shared.first_view(series, maps or {}, d.noise_floor.outputs),
        ],
        state=STATES.get(d.verdict, "open"),
        word=word,
        why=why,
        command=following,
        columns=_columns(d),
        pictures={"gap": lambda log: gap(d)},
        seconds=d.seconds,
    )


def _columns(d: Diagnosis) -> dict[str, list[Any]]:
    """Return the effects found as columns."""
    found = attributes(d.effects, "link", "shrinkage", "interval", "share", "p_value")
    names, texts = [e.name for e in d.effects], [e.text for e in d.effects]
    return {"effect": names, **found, "fit_with": texts}


def _next(d: Diagnosis, fit: Fit | None, reading: Sequence[str]) -> tuple[str, str]:
    """Return what comes next, and the command for it."""
    if d.next_step:
        words = ["hallsym", "fit", d.log.path or "LOG", *d.next_step, *reading]
        return "Next, fit the model with the effects found:", shlex.join(words)
    if d.verdict == "no gap" and fit:
        added = [word for effect in added_effects(fit.model) for word in ("--effect", effect)]
        words = ["hallsym", "fit", d.log.path or "LOG", "--model", plain(fit.model).name, *added, *reading]
        return "Next, keep the calibration of this model:", shlex.join([*words, "-o", "calib.json"])
    return "", ""


def p_text(p: float | None) -> str:
    """Return a p-value for reading: never 0, never more digits than it is worth."""
    if p is None or isnan(p):
        return ""
    return f"< {LEAST_P:.0e}".replace("e-0", "e-") if p < LEAST_P else number(p, 1)


def _basis(d: Diagnosis) -> str:
    judges = counted(len(d.validation_runs), d.held_out)
    one = "the error is one number over all outputs, " if len(d.gap_before.rmse) > 1 else "errors are "
    said = "which took part in neither the fit nor the choice of effects"
    return f"Model {d.model}; {one}on {judges}, {said}."


def _input(d: Diagnosis) -> Items:
    """Return the basis of the verdict."""
    noise = "noise, or an unlogged cause" if d.verdict == "unexplained" else "noise"
    pairs: list[tuple[str, Any]] = [
        ("log", d.log.path or "a log in memory"),
        ("samples", f"{d.log.rows} in {d.log.runs} {d.held_out.rpartition(' ')[2]}s" if d.log.rows else None),
        (f"{d.held_out}s", shared.numbers(d.validation_runs)),
        ("noise floor", d.noise_floor.source),
        (noise, noise_text(d.noise, d.noise_floor.source == "stated") if d.noise else None),
        ("worth reporting", f"a decrease of {100 * d.threshold:g} % or more"),
        # with the least possible p-value where units are few
        (
            "test over all effects",
            f"p {significance_text(d.significance, piece_of(d))}" if d.significance else None,
        ),
    ]
    return Items(pairs)


def piece_of(d: Diagnosis) -> str:
    """Return the unit of a split recording: "run", "time slice", "knot group"."""
    return d.held_out.removeprefix("holdout ")


def significance_text(s: Significance, piece: str = "run") -> str:
    """Return a p-value with what it rests on: `= 0.3 (46 runs)`, with the least possible one of few units.

    `piece`: what a run of the log is called.
    """
    unit = s.unit if (s.unit, piece) == ("stretch", "run") else piece
    least = f", {p_text(s.least)} at least" if s.units < FEW_UNITS else ""
    return f"= {p_text(s.p_value)} ({counted(s.units, unit)}{least})"


# -- errors: before and after, per output, sensor and harmonic -------------------------------------------


def _errors(d: Diagnosis) -> Table:
    """Return rmse and peak on the holdout runs, with the floor and the one number that shrinkage is of."""
    gaps = {"before": d.gap_before, "after": d.gap_after} if d.effects else {"holdout": d.gap_before}
    rows, floor = {when: gap.sizes for when, gap in gaps.items()}, d.noise_floor
    known = {when: gap.interval for when, gap in gaps.items()}
    return shared.error_table([*floor.outputs], rows, floor.outputs, floor.source, intervals=known)


def _errors_section(d: Diagnosis) -> Section:
    """Return the error on fitted and holdout runs, and by harmonic."""
    content = _sizes(d)
    for coordinate in dict.fromkeys(w.coordinate for w in d.waves):
        content += _waves(d, coordinate)
    return Section("errors", "Errors by output, sensor and wave", content)


def _sizes(d: Diagnosis) -> list[Block | str]:
    """Return the residual error by output and sensor; nothing where none is known."""
    head = [
        "residual error", "rms, fitted", "rms, holdout", "noise", "above, fitted",
        "above, holdout", "share, fitted", "share, holdout",
    ]  # fmt: skip
    rows = {}
    for column, sides in d.size.rows.items():
        factor, unit = scaled(column, max(side.rms for side in sides.values()))
        both = [sides.get(side) for side in ("fitted", "held_out")]
        noise = next((number(factor * s.noise) for s in both if s), "")
        rms = [number(factor * s.rms) if s else "" for s in both]
        above = [number(factor * s.above) if s else "" for s in both]
        share = ["" if s is None or s.share is None else percent(s.share) for s in both]
        rows[column] = [f"{name(column)} [{unit}]", *rms, noise, *above, *share]
    caption = (
        f"residual error on fitted and holdout runs: rms, noise floor ({d.noise_floor.source}), the excess "
        "above it, and its share of the excess of all outputs, or of all sensors, where the whole excess is "
        "more than chance"
    )
    sensors = [column for column in rows if column not in d.noise_floor.outputs]
    sensors.sort(key=lambda c: -max(side.above / (side.rms or 1.0) for side in d.size.rows[c].values()))
    folded = sensors[shared.NAMED :] if len(sensors) > shared.NAMED + 1 else []
    blocks: list[Block | str] = [Table(head, [rows[c] for c in rows if c not in folded], caption)]
    if folded:
        more = f"and {len(folded)} sensors whose error is nearer to the noise"
        blocks.append(Folded(more, [Table(head, [rows[c] for c in folded], "the other sensors")]))
    return blocks if rows else []


def _waves(d: Diagnosis, coordinate: str) -> list[Block | str]:
    """Return the harmonics of the error over a periodic coordinate, and which the model absorbs."""
    factor, unit, called = readable(coordinate or next(iter(d.noise_floor.outputs)))
    per = f"period of {called}" if coordinate else "turn"
    head = [f"waves per {per} [{unit}]", "nominal", "model", "with the effects", "effects found", "causes"]
    mine = [w for w in d.waves if w.coordinate == coordinate]
    rows = []
    for w in mine:
        found = [e.name for e in d.effects if e.name in w.causes]
        sizes = ["" if a is None else number(factor * a) for a in (w.designed, w.model, w.after)]
        rows.append([str(w.per_turn), *sizes, ", ".join(found), ", ".join(w.causes)])
    caption = "amplitude of the error over all runs; nominal: with only the offsets fitted"
    blocks: list[Block | str] = [Table(head, rows, caption, wordy=(4, 5))]
    if any(w.designed is None for w in mine):
        blocks.append(f"No nominal waves: {NOT_DECODED}.")
    most = max(mine, key=lambda w: w.designed or 0.0)
    if most.designed and most.absorbed and most.causes:
        size = f"{number(factor * most.designed, 2)} {unit}"
        said = f"The largest harmonic is {most.per_turn} per {per} ({size}). "
        causes = " or ".join(most.causes)
        blocks.append(f"{said}The model's own parameters absorb it, whichever causes it: {causes}.")
    return blocks


def shrinkage_text(value: float, interval: tuple[float, float] | None) -> str:
    """Return a decrease with its interval in per cent: `61.0 % (57.0 to 64.0)`; of each what exists."""
    known = interval is not None and all(map(isfinite, (value, *interval)))
    return percent(value, 1) + (f" ({_ends(interval)})" if interval and known else "")


def shrinks_text(d: Diagnosis) -> str:
    """Return the decrease of the error, on the holdout runs and, separately, over all runs.

    The sizes before and after are of the holdout runs. The shrinkage and its interval are of all runs that
    judge, each by a fit that left its group out (`hallsym.diagnosis.validation`).
    """
    s, piece, judges = d.shrinkage, piece_of(d), len(d.validation_runs)
    judge = d.held_out if judges == 1 else counted(judges, d.held_out)
    fall = f"falls by {percent(1 - d.metric.after / d.metric.before, 1)}" if d.metric.before > 0 else "is 0"
    more = counted(s.parameters_added, "parameter")
    alone = (
        f"On the {judge} alone the error {fall}: {percent(s.share_closed)} of its excess above the noise "
        f"floor is closed, with {more} more."
    )
    if s.judges <= judges:
        known = "" if s.interval is None else f" (95 % of recordings like it: {_ends(s.interval)} %)"
        return f"The gap shrinks by {percent(s.value, 1)}{known}. {alone}" if known else alone
    known = (
        f"no 95 % interval: it needs at least {s.fewest} {piece}s"
        if s.interval is None
        else f"95 % of recordings like it: {_ends(s.interval)} %"
    )
    return (
        f"Over {counted(s.judges, piece)}, each judged by a fit that left it out (nested cross-validation), "
        f"the gap shrinks by {percent(s.value, 1)} ({known}). {alone}"
    )


def _ends(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{100 * low:.1f} to {100 * high:.1f}"


# -- effects: ranked, with the confusable ones ------------------------------------------------------------


def _effects_section(d: Diagnosis) -> Section:
    """Return the ranking of the effects, and groups of confusable ones."""
    if not (d.effects or d.groups or d.ranked):
        none = "None. No effect of the catalogue lowers the gap by what is worth reporting."
        return Section("effects", "Which effects", [Note(none)])
    return Section("effects", "Which effects", [_ranked(d), _meanings(d), *_found(d), *_groups(d)])


def _ranked(d: Diagnosis) -> Table:
    head = [
        "effect", "link", "form", "gap shrinks by (95 %)", "share of the excess", "p", "confusable with",
    ]  # fmt: skip
    known = {e.name: [e.link, e.variant, shrinkage_text(e.shrinkage, e.interval), percent(e.share),
                      p_text(e.p_value)] for e in d.effects}  # fmt: skip
    rows: list[list[Any]] = []
    for effect in dict.fromkeys([*known, *d.ranked]):
        others = dict.fromkeys(other for g in d.groups if effect in g for other in g if other != effect)
        rows.append([effect, *known.get(effect, [""] * 5), ", ".join(others)])
    return Table(head, rows, "effects, best first", left=3, wordy=(6,), sortable=True)


def _meanings(d: Diagnosis) -> Items:
    """Return what each effect is, what it adds to the model, and what there is to do about it."""
    catalogue = effects(*(family for family in FAMILIES if family.maker(d.model)))
    found = {e.name: e for e in d.effects}
    lines = []
    for name_ in dict.fromkeys([*found, *d.ranked]):
        parts = [catalogue[name_].meaning if name_ in catalogue else ""]
        if name_ in found:
            parts += [found[name_].cost and f"Adds {found[name_].cost}.", found[name_].note]
        lines.append((name_, " ".join(filter(None, parts))))
    return Items(lines)


def _found(d: Diagnosis) -> list[Block]:
    """Return the parameters of the effects."""
    found = [(e.name, what, p) for e in d.effects for what, p in e.parameters.items()]
    rows = [[name, what, *in_units(p.value, p.std, p.unit, bare=True)] for name, what, p in found]
    head = ["effect", "parameter", "value (1 sigma)", "unit"]
    return [Table(head, rows, "parameters of the effects", left=2, wordy=(3,), sortable=changed(d))]


def _groups(d: Diagnosis) -> list[Block | str]:
    lines = dict.fromkeys(d.groups, "they are confusable on this log.")
    for s in d.separate_by:
        now = f"they are confusable on this log ({number(s.sigma_now)} sigma)"
        lines[s.group] = f"{now}. Record {s.recording}."
    items = Items([(", ".join(group), line) for group, line in lines.items()])
    return [Heading("Confusable effects"), items] if lines else []


# -- where the gap lies, and what no effect explains -----------------------------------------------------


def _where_section(d: Diagnosis) -> Section:
    """Return the statements on where the gap lies."""
    above = "where the excess over the noise lies" if d.verdict in QUIET else "where the gap lies"
    said = _statements(d.where, above)
    if not d.where and d.size.rows:
        said = ["The excess above the noise depends on no logged quantity."]
    return Section("where", "Where the gap lies", said)


def _rest_section(d: Diagnosis) -> Section:
    """Return the unexplained rest: its share, its place and its shape."""
    rest = d.unexplained
    said: list[Block | str] = []
    if rest:
        said.append(f"{percent(rest.share)} of the excess above the noise floor has no known cause.")
    if d.remaining and d.remaining != d.where:
        said += _statements(d.remaining, "where the unexplained rest lies")
    elif d.remaining:
        said.append(Note("Its places are those of the gap, above."))
    elif rest:
        said.append("It significantly goes with no sensor, coordinate or frequency.")
    if rest and rest.curve:
        how, panels = curves(rest.curve)
        said.append(p.Picture(panels, words=how))
    return Section("rest", "What no effect explains", said)


def _statements(statements: Sequence[Statement], head: str) -> list[Block | str]:
    rows = [
        [s.text, "" if s.held_out is None else percent(max(s.held_out, 0.0)), p_text(s.p_value)]
        for s in statements
    ]
    return [Table([head, "on holdout runs", "p"], rows, "statements on the places, from the fitted runs")]


# -- what else was looked at --------------------------------------------------------------


def _notes(d: Diagnosis) -> list[tuple[str, str]]:
    """Return smaller findings, effects that could not be tested (together where the reason is one), notes."""
    said = "significant, lowers the gap by {}, less than the threshold"
    smaller = [(f.name, said.format(percent(f.shrinkage, 1))) for f in d.smaller_findings]
    together: dict[str, list[str]] = {}
    for effect, reason in d.not_testable.items():
        together.setdefault(reason, []).append(effect)
    untested = [(", ".join(names), f"not testable, {reason}") for reason, names in together.items()]
    return [*smaller, *untested, *(("note", note) for note in d.notes)]


# -- pictures -------------------------------------------------------------------------------------------


def changed(d: Diagnosis) -> bool:
    """Return whether there is an after that differs from before."""
    return bool(d.effects or d.ranked)


def gap(d: Diagnosis) -> p.Picture:
    """Return rmse and peak of each output on the holdout runs, without and with the effects found.

    Bars carry their names and numbers; an output without a number is left out.
    """
    before, after = d.gap_before.sizes, d.gap_after.sizes
    found: dict[str, Sizes] = {"before": before, "after": after} if changed(d) else {"holdout": before}
    looks = {"before": BEFORE, "after": p.AFTER, "holdout": p.HOLDOUT}
    panels = []
    for what, output in product(("rmse", "peak"), before["rmse"]):
        sizes = {label: one[what].get(output, math.nan) for label, one in found.items()}
        if not all(map(isfinite, sizes.values())):
            continue
        floor = d.noise_floor.outputs.get(output, 0.0) if what == "rmse" else 0.0
        factor, unit = scale(output, max(*sizes.values(), floor))
        rows = [p.Row(label, factor * v, number(factor * v), look=looks[label]) for label, v in sizes.items()]
        x = p.Axis(low=0.0, high=1.1 * factor * max(*sizes.values(), floor) or 1.0)
        panels.append(p.rows(f"{what} {name(output)} [{unit}]", x, rows, floor=factor * floor))
    return p.Picture(panels, words=f"Dashed: noise floor ({d.noise_floor.source}).")


# -- the shape of the unexplained rest -------------------------------------------------------------------


def curves(shape: CurveShape) -> tuple[str, list[p.Panel]]:
    """Return caption and panels of `unexplained.curve`: value and 95 % band by sensor."""
    gain = shape.kind == "gain"
    reach = _most_of([*shape.readings.values()])
    factor, unit = (100.0, "%") if gain else scale(next(iter(shape.readings)), reach)
    high = 1.05 * factor * reach or 1.0
    draw = _line if shape.line else _dots
    panels = []
    for channel, r in shape.readings.items():
        band = np.clip(factor * np.array([r.value, r.low, r.high]), -high, high)
        panels.append(draw(shape, name(channel), band, unit, high))
    what = "relative change of the gain" if gain else "error of the reading"
    how = f"{what} against {shape.coordinate}: line with its 95 % band, from runs left out in turn"
    if not shape.line:
        how = f"{what} per standard deviation of {shape.coordinate}, with 95 % intervals"
    return how, panels


def _line(shape: CurveShape, sensor: str, band: np.ndarray, unit: str, high: float) -> p.Panel:
    """Return the panel of a sensor; `band` (3, places): values, and the ends of their intervals."""
    value, low, top = band
    own = shape.unit in ("m", "rad", "v")
    across, shown = scale(shape.column, max(map(abs, shape.grid))) if own else place_unit(shape.unit)
    shown = "" if shape.unit == "1" else typeset(shown)
    grid = across * np.array(shape.grid)
    known = top > low  # no band: no samples there
    most = int(np.argmax(np.abs(value)))
    says = f"{sensor}: largest {number(value[most])} {unit} at {number(grid[most])} {shown}"
    title = shape.coordinate.replace("the reading itself", "reading") + (f" [{shown}]" if shown else "")
    drawn = p.line(grid, np.where(known, value, math.nan), p.MEDIANS[1])
    layers = [p.area(grid[known], low[known], top[known], p.BANDS[1]), drawn]
    x, y = p.Axis(title, grid[0], grid[-1]), p.Axis(low=-high, high=high)
    return p.Panel(x, y, layers, f"{sensor} [{unit}]", says, height=100.0)


def _dots(shape: CurveShape, sensor: str, band: np.ndarray, unit: str, high: float) -> p.Panel:
    """Return the same where places are no line."""
    labels = shape.labels or [str(k + 1) for k in range(len(shape.grid))]
    entries = [p.Row(w, v, number(v), (a, b)) for w, v, a, b in zip(labels, *band, strict=True)]
    return p.rows(f"{sensor} [{unit}]", p.Axis(low=-high, high=high, most=3), entries)


def _most_of(readings: list[Band]) -> float:
    """Return the largest value with some room, and what most of the bands need: a lone wide end is cut."""
    values = [abs(v) for r in readings for v in r.value]
    ends = sorted(abs(v) for r in readings for v in (*r.low, *r.high))
    return max(1.25 * max(values, default=0.0), ends[int(0.9 * (len(ends) - 1))] if ends else 0.0)
