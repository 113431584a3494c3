"""The report of `identify` as tables for a terminal."""

from collections.abc import Mapping, Sequence

import numpy as np

from hallsym.inference import (
    Change,
    CombinationReport,
    Identifiability,
    NullDirection,
    NullSpace,
    Offsets,
    ParameterReport,
)
from hallsym.model import Model
from hallsym.report.tables import cells, concise, grid, heads, in_units
from hallsym.units import parameter_unit


def report_text(report: Identifiability) -> str:
    """Return what `hallsym sensitivity` prints."""
    cost = report.evidence.cost
    runs, recorded = len(cost.summary.runs), report.evidence.recorded
    what = "will determine" if cost.planned else "determine" if runs > 1 else "determines"
    amiss = report.evidence.amiss
    parts = [
        *([amiss, ""] if amiss else []),
        f"{report.model.name}: what {f'{runs} runs of ' if runs > 1 else ''}{recorded} {what}",
        "",
        parameters_text(report.parameters, {p.name: p.meaning for p in report.model.parameters}),
    ]
    if report.combinations:
        rows = [["identifiable combinations", "value (1 sigma)", "unit", "95 % interval"]]
        for c in report.combinations:
            interval = _interval(c, parameter_unit(c.unit)[0])
            rows.append([c.expression, *in_units(c.value, c.std, c.unit), interval])
        parts += ["", grid(rows)]
    parts += ["", *null_text(report.structural, report.practical)]
    parts += ["", further_text(report)] if report.further else []
    parts += ["", effects_text(report)]
    parts += ["", outputs_text(report), "", *offsets_text(report.offsets)]
    told = report.evidence.uncertainty
    parts += [f"uncertainty: {told.method} ({told.reason})"]
    parts += [f"not computed: {sentence}" for sentence in report.partial]
    parts += [f"note: {note}" for note in report.evidence.notes if note != amiss]
    return "\n".join(parts)


def parameters_text(parameters: Sequence[ParameterReport], meanings: Mapping[str, str] | None = None) -> str:
    """Return value, interval, strongest correlation and verdict of every parameter.

    `meanings`: what each parameter is, by name; it is said where the verdict needs no reason.
    """
    rows = [
        ["parameter", "value (1 sigma)", "unit", "95 % interval", "of bounds", "correlated with", "verdict"]
    ]
    for entry in parameters:
        factor, unit = parameter_unit(entry.unit)
        value = f"({entry.value * factor:.4g})"
        if entry.std is not None:
            value = concise(entry.value * factor, entry.std * factor)
        share = "" if entry.share is None else f"{100 * entry.share:.2g} %"
        other = "".join(f"{name} {r:+.2f}" for name, r in entry.correlated_with[:1] if entry.std is not None)
        because, meaning = entry.verdict.because, (meanings or {}).get(entry.name)
        verdict = entry.verdict.word + (f": {because}" if because else f"; {meaning}" if meaning else "")
        rows.append([entry.name, value, unit, _interval(entry, factor), share, other, verdict])
    return grid(rows, words=True)


def _interval(entry: ParameterReport | CombinationReport, factor: float) -> str:
    if entry.interval is None or entry.std is None:
        return ""
    digits = max(1, 2 - int(np.floor(np.log10(max(entry.std * factor, 1e-300)))))
    ends = (f"{v * factor:.{min(digits, 9)}f}" for v in (entry.interval.low, entry.interval.high))
    mark = {"normal": "", "student": " t", "profile": " p"}[entry.interval.how]
    return " .. ".join(ends) + mark


def null_text(structural: NullSpace, practical: NullSpace) -> list[str]:
    """Return the sentences on null directions."""
    some = "not identifiable from any recording:" if structural.null else "all are identifiable"
    less = "not identifiable from this recording:" if practical.null else "nothing more is lost"
    return [
        f"structural rank {structural.rank} of {structural.of}: {some}",
        *map(_direction, structural.null),
        f"practical rank {practical.rank} of {practical.of}: {less}",
        *map(_direction, practical.null),
    ]


def _direction(direction: NullDirection) -> str:
    named = ", ".join(direction.parameters)
    if not direction.determined:
        return f"  {named}: no combination is identifiable"
    if direction.is_wide:
        known = len(direction.determined)
        return f"  {named} may change together; {known} combinations of them are identifiable (table above)"
    return f"  {named}: only {' and '.join(direction.determined)}"


def further_text(report: Identifiability) -> str:
    """Return what each further recording would determine beside this one."""
    rows = [["with another recording", "practical rank", "then determined (1 sigma)"]]
    for f in report.further:
        units = {n: parameter_unit(report[n].unit, bare=True) for n in f.determined}
        sized = [f"{n} ({f'{s * units[n][0]:.2g} {units[n][1]}'.rstrip()})" for n, s in f.determined.items()]
        more = f" and {len(sized) - LISTED} more" if len(sized) > LISTED else ""
        rows.append([f.recording, f"{f.rank} of {f.of}", ", ".join(sized[:LISTED]) + more or "nothing more"])
    return grid(rows, words=True)


LISTED = 8
"""Gains of a further recording that are listed; all are in the JSON record."""


def effects_text(report: Identifiability) -> str:
    """Return what 1 sigma and 1 % of each parameter do to the decoded pose."""
    pose, period = report.model.pose, report.model.period
    rows = [["largest effect", *heads(pose, period, "1 sigma"), *heads(pose, period, "1 %")]]
    entries = [entry for entry in report.parameters if entry.verdict.word != "fixed"]
    sigma = _numbers([entry.sigma for entry in entries], report.model)
    percent = _numbers([entry.percent for entry in entries], report.model)
    rows += [[e.name, *s, *p] for e, s, p in zip(entries, sigma, percent, strict=True)]
    return grid(rows)


NIL = 1e-9
"""Part of the largest change of a coordinate below which a change is a rounding error: 0."""


def _numbers(changes: Sequence[Change | None], model: Model) -> list[list[str]]:
    """Return each change of each coordinate, in its unit; empty where a parameter has none."""
    largest = {c: max((abs(x.worst[c]) for x in changes if x), default=0.0) for c in model.pose}

    def sizes(change: Change) -> list[float]:
        found = change.worst
        return [found[c] if abs(found[c]) > NIL * largest[c] else 0.0 for c in model.pose]

    none = [""] * len(model.pose)
    return [cells(sizes(change), model.pose, model.period) if change else none for change in changes]


def outputs_text(report: Identifiability) -> str:
    """Return what the uncertainty of all parameters together does to the decoded pose."""
    pose, period = report.model.pose, report.model.period
    rows = [["decoded pose (1 sigma)", *heads(pose, period)]]
    labels = {
        "parameters_rms": "all parameters, rms",
        "parameters_worst": "all parameters, worst",
        "noise_floor": "noise of one reading",
    }
    for key, label in labels.items():
        rows.append([label, *cells([getattr(report.outputs[c], key) for c in pose], pose, period)])
    return grid(rows)


def offsets_text(offsets: Offsets) -> list[str]:
    """Return the zero deviations: their sizes over all runs."""
    if not offsets.names:
        return []
    sizes = offsets.sizes()
    factor, unit = (1e6, "um") if offsets.units[0] == "m" else (float(np.degrees(1.0)), "deg")
    said = [
        f"{n} {factor * z['rms']:.3g} {unit} rms, {factor * z['worst']:.3g} {unit} at most"
        for n, z in sizes.items()
    ]
    std = factor * max(z["std"] for z in sizes.values())
    each = f"each +-{std:.2g} {unit} (1 sigma)"
    return [f"{offsets.values.size} zero deviations, eliminated: {'; '.join(said)}; {each}"]
