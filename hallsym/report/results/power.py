"""The detection power of a diagnosis as a person reads it in a terminal."""

from collections.abc import Sequence

from hallsym.diagnosis import gap_text, gap_unit
from hallsym.errors import counted, few
from hallsym.power import CurvePoint, DetectionPower, Findable, Trial
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.words import number
from hallsym.units import parameter_unit

SHORT = {"found": "yes", "group": "group", "listed": "second", "other": "wrong", "refused": "refused"}


def power_content(s: DetectionPower) -> Content:
    """Return the report of a detection power: a line for each effect, and undetectable effects."""
    quiet, unit, rate = len(s.quiet_trials), gap_unit(s.outputs), s.false_alarm_rate
    bounds = f" (95 % interval of the rate: {100 * rate.low:.0f} to {100 * rate.high:.0f} %)"
    tested = [e for e in s.effects if e.trials]
    seen = sum(e.status == "found" for e in tested)
    parts: list[Block | str] = [
        f"detection power of a diagnosis with {s.model}: {s.rows} samples"
        + (f" of {s.log['rows']}, in stretches at the full rate" if s.rows < s.log["rows"] else "")
        + f", noise floor {gap_text(s.floor_m, unit)}, threshold {100 * s.threshold:g} %, seed {s.seed}; "
        f"{s.seconds:.0f} s" + ("" if s.complete else "; INTERRUPTED, what was done:"),
        f"noise: {s.noise}",
        f"false alarms: {s.false_alarms} of {quiet} logs without an effect{bounds if rate.trials else ''}",
    ]
    if tested:
        parts += [_table(s, tested), *_legend(s)]
    parts += [f"not testable: {e.name}: {e.reason}" for e in s.effects if e.status == "not testable"]
    undone = [e.name for e in s.effects if e.status == "not run"]
    parts += ["not run: " + few(undone)] if undone else []
    quietly = f"{s.false_alarms} of {quiet} logs without an effect give a false alarm"
    return Content(
        f"Detection power of a diagnosis with {s.model}",
        f"A diagnosis of this log would find {seen} of {counted(len(tested), 'effect')}; {quietly}.",
        [Section("power", "Effects", [*parts, *(f"note: {note}" for note in s.notes)])],
        columns={key: [getattr(e, key) for e in s.effects] for key in ("name", "status", "ratio", "gap_m")},
    )


def _table(s: DetectionPower, tested: Sequence[Findable]) -> Table:
    head = ["effect", *(f"{r:g} x" for r in s.ratios), "found from", "that is", "taken for"]
    rows = []
    for e in tested:
        cells = [_cell([t for t in e.trials if t.ratio == r], e.curve) for r in s.ratios]
        if e.trials[0].ratio is None:
            cells = [_cell(e.trials, e.curve), *[""] * (len(cells) - 1)]
        found = "found" if e.ratio is None else gap_text(e.gap_m or 0.0, gap_unit(s.outputs))
        found = found if e.status == "found" and e.gap_m is not None else "not found"
        rows.append([e.name, *cells, found, size_text(e), ", ".join(e.confused_with)])
    return Table(head, rows, "effects by size", left=len(head))


def _cell(trials: Sequence[Trial], curve: Sequence[CurvePoint]) -> str:
    if not trials:
        return "-"
    said = [SHORT.get(t.outcome, t.outcome) for t in trials]
    if len(said) == 1:
        return said[0]
    point = next(p for p in curve if p.ratio == trials[0].ratio)
    return f"{100 * point.found:.0f} % ({100 * point.low:.0f}-{100 * point.high:.0f})"


def size_text(e: Findable) -> str:
    """Return the largest parameter of each unit at the size above which the effect is found."""
    largest: dict[str, tuple[str, float]] = {}
    for name, (value, unit) in e.size.items():
        if unit not in largest or abs(value) > abs(largest[unit][1]):
            largest[unit] = (name, value)
    said = []
    for unit, (name, value) in largest.items():
        factor, shown = parameter_unit(unit, bare=True)
        said.append(f"{name} {number(factor * value)} {shown}".rstrip())
    return ", ".join(said)


def _legend(s: DetectionPower) -> list[str]:
    columns = f"columns {', '.join(f'{r:g} x' for r in s.ratios)}: gap over noise floor; "
    lines = [
        f"{columns}yes: named first; group: in one group with the effect named first; second: named "
        "beside another;",
        "wrong: only another effect was named; unexplained: a gap without a name; no gap: not detected; -: "
        "cannot be made that large here, or was not tried",
        "found from: the smallest gap over the floor, of those tried, at and above which it is found, and "
        "its largest parameters",
    ]
    if s.repeats > 1:
        lines[:2] = [
            f"{columns}in how many of {s.repeats} trials the effect is named first, or",
            "in one group with the first, with its 95 % interval; -: cannot be made that large here",
        ]
    bounded = [e for e in s.effects if e.trials and e.reason]
    return [*lines, *(f"{e.name}: {e.reason}" for e in bounded)]
