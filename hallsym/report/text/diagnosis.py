"""The diagnosis as a person reads it in a terminal, in lines of prose that fit it."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite, isnan
from textwrap import fill

from hallsym.diagnosis import QUIET, Diagnosis, Estimate, FoundEffect, Significance, Statement, noise_text
from hallsym.errors import counted
from hallsym.output import percent, prose_width
from hallsym.report.tables import concise, error_rows, grid
from hallsym.report.words import NOT_DECODED, name, three
from hallsym.units import parameter_unit, readable, scaled

MOST = 10
"""Statements on where a gap lies that are printed at most."""
FEW_UNITS = 8
"""Units of a test by signs below which the least p-value they can give is said: 2 / 2^8 is 0.008."""
LEAST_P = 1e-6
"""P-values below this are only said to be below it: no test is better than its assumptions."""
UNITS = {"m": (1e6, "um"), "rad": (1e6, "urad"), "s": (1e3, "ms"), "m/s": (1e6, "um/s"), "1": (1.0, ""),
         "m s2/m": (1e6, "um per m/s2")}  # fmt: skip
"""How parameters are shown: SI unit -> factor and unit for reading."""


def diagnosis_text(d: Diagnosis, reading: Sequence[str] = ()) -> str:
    """Return what `hallsym diagnose` prints: verdict, errors, effects, where, what could not be tested.

    `reading`: the words of the command line that say how the log is read, for the next step.
    """
    parts = [_wrapped(d.sentence), "", _wrapped(_basis(d), "  "), "", _errors(d)]
    sizes = size_rows(d)
    parts += [*(["", grid(sizes)] if sizes else []), *_waves(d)]
    if d.noise is not None:
        noise = noise_text(d.noise, d.noise_floor.source == "stated")
        parts += ["", _wrapped(f"{noise_name(d)}: {noise}", "  ")]
    if d.effects:
        parts += ["", effect_text(d.effects), "", *(_parameters(e, units_of(d)) for e in d.effects)]
        parts += [_wrapped(f"  {e.note}", "    ") for e in d.effects if e.note]
        parts.append(_wrapped(shrinks_text(d)))
    if d.next_step:
        words = ["hallsym", "fit", d.log.path or "LOG", *d.next_step, *reading]
        parts.append(f"next: {shlex.join(words)}")
    for s in d.separate_by:
        now = f"This log cannot tell apart: {', '.join(s.group)} ({s.sigma_now:.2g} sigma)."
        parts += ["", _wrapped(f"{now} Record {s.recording}.", "  ")]
    above = "where the excess over the noise lies" if d.verdict in QUIET else "where the gap lies"
    parts += _statements(above, d.where, d.held_out)
    if d.remaining != d.where:
        parts += _statements("where the unexplained rest lies", d.remaining, d.held_out)
    if d.smaller_findings:
        smaller = ", ".join(f"{f.name} {percent(f.shrinkage, 1)}" for f in d.smaller_findings)
        said = f"smaller findings (significant, but below the threshold): {smaller}"
        parts += ["", _wrapped(said, "  ")]
    parts += _untested(d.not_testable)
    parts += ["", *(_wrapped(f"note: {note}", "  ") for note in d.notes)] if d.notes else []
    return "\n".join(parts)


def noise_name(d: Diagnosis) -> str:
    """Return what the noise that is left is called: where something has no cause it may be no noise."""
    return "noise, or what follows nothing logged" if d.verdict == "unexplained" else "noise"


def p_text(p: float | None) -> str:
    """Return a p-value for reading: never 0, never more digits than it is worth."""
    if p is None or isnan(p):
        return ""
    return f"< {LEAST_P:.0e}".replace("e-0", "e-") if p < LEAST_P else f"{p:.1g}"


def _wrapped(text: str, indent: str = "") -> str:
    return fill(text, prose_width(), subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _basis(d: Diagnosis) -> str:
    any_effect = ""
    if d.significance:  # with the least possible p-value where units are few
        p = significance_text(d.significance, piece_of(d))
        any_effect = f"any effect of the catalogue: p {p}; "
    return (
        f"verdict: {d.verdict}. Model {d.model}; errors are on "
        f"{counted(len(d.validation_runs), d.held_out)}, which took part in neither the fit nor the "
        f"choice of effects; a decrease of {100 * d.threshold:g} % is worth reporting; the noise floor is "
        f"{d.noise_floor.source}; {any_effect}computed in {d.seconds:.1f} s."
    )


def piece_of(d: Diagnosis) -> str:
    """Return what a recording was taken to pieces of: "run", "time slice", "knot group"."""
    return d.held_out.removeprefix("held-out ").removeprefix("holdout ")


def significance_text(s: Significance, piece: str = "run") -> str:
    """Return a p-value with what it rests on: `= 0.3 (46 runs)`, with the least possible one of few units.

    `piece`: what a run of the log is called.
    """
    unit = s.unit if (s.unit, piece) == ("stretch", "run") else piece
    least = f", {p_text(s.least)} at least" if s.units < FEW_UNITS else ""
    return f"= {p_text(s.p_value)} ({counted(s.units, unit)}{least})"


def _errors(d: Diagnosis) -> str:
    gaps = {"before": d.gap_before, "after": d.gap_after} if d.effects else {"holdout": d.gap_before}
    rows = {when: asdict(gap) for when, gap in gaps.items()}
    return error_rows(tuple(d.noise_floor.outputs), rows, d.noise_floor.outputs, d.noise_floor.source)


def size_rows(d: Diagnosis) -> list[list[str]]:
    """Return head and rows of the residual error by output and sensor; nothing where none is known."""
    head = [
        "residual error", "rms, fitted", "rms, holdout", "noise", "above, fitted",
        "above, holdout", "share, fitted", "share, holdout",
    ]  # fmt: skip
    rows = []
    for column, sides in d.size.rows.items():
        factor, unit = scaled(column, max(side.rms for side in sides.values()))
        both = [sides.get(side) for side in ("fitted", "held_out")]
        noise = next((three(factor * s.noise) for s in both if s), "")
        rms = [three(factor * s.rms) if s else "" for s in both]
        above = [three(factor * s.above) if s else "" for s in both]
        share = ["" if s is None or s.share is None else percent(s.share) for s in both]
        rows.append([f"{name(column)} [{unit}]", *rms, noise, *above, *share])
    return [head, *rows] if rows else []


def wave_rows(d: Diagnosis, coordinate: str) -> list[list[str]]:
    """Return head and rows of the harmonics of the error over a periodic coordinate, and their causes."""
    factor, unit, per = _period(d, coordinate)
    head = [f"waves per {per} [{unit}]", "nominal", "model", "with the effects", "effects found", "causes"]
    rows = []
    for w in (w for w in d.waves if w.coordinate == coordinate):
        found = [e.name for e in d.effects if e.name in w.causes]
        sizes = ["" if a is None else three(factor * a) for a in (w.designed, w.model, w.after)]
        rows.append([str(w.per_turn), *sizes, ", ".join(found), ", ".join(w.causes)])
    return [head, *rows]


def _period(d: Diagnosis, coordinate: str) -> tuple[float, str, str]:
    """Return factor and unit of the error over a periodic coordinate, and what its period is called."""
    factor, unit, name = readable(coordinate or next(iter(d.noise_floor.outputs)))
    return factor, unit, f"period of {name}" if coordinate else "turn"


def _waves(d: Diagnosis) -> list[str]:
    """Return the harmonics of the error over each periodic coordinate, and which the model absorbs."""
    lines = []
    for coordinate in dict.fromkeys(w.coordinate for w in d.waves):
        mine = [w for w in d.waves if w.coordinate == coordinate]
        lines += ["", grid([row[:-1] for row in wave_rows(d, coordinate)])]
        if any(w.designed is None for w in mine):
            lines.append(_wrapped(f"No nominal waves: {NOT_DECODED}."))
        most = max(mine, key=lambda w: w.designed or 0.0)
        if most.designed and most.absorbed and most.causes:
            factor, unit, per = _period(d, coordinate)
            size = f"{factor * most.designed:.2g} {unit}"
            said = f"The largest harmonic is {most.per_turn} per {per} ({size}). The model's own parameters "
            lines.append(_wrapped(f"{said}absorb it, whichever causes it: {' or '.join(most.causes)}."))
    return lines


def effect_text(effects: tuple[FoundEffect, ...]) -> str:
    """Return the table of effects, best first."""
    rows = [["effect", "link", "gap shrinks by (95 %)", "share of excess", "p"]]
    for e in effects:
        rows.append(
            [e.name, e.link, shrinkage_text(e.shrinkage, e.interval), percent(e.share), p_text(e.p_value)]
        )
    return grid(rows, left=2)


def shrinkage_text(value: float, interval: tuple[float, float] | None) -> str:
    """Return a decrease with its interval in per cent: `61.0 % (57.0 to 64.0)`; of each what exists."""
    known = interval is not None and all(map(isfinite, (value, *interval)))
    return percent(value, 1) + (f" ({_ends(interval)})" if interval and known else "")


def units_of(d: Diagnosis) -> Mapping[str, tuple[float, str]]:
    """Return how numbers are shown: angles in degrees where the first output is an angle, else in urad."""
    factor, unit, _ = readable(next(iter(d.noise_floor.outputs), "x_m"))
    return UNITS | ({"rad": (factor, unit)} if unit == "deg" else {})


def _parameters(effect: FoundEffect, units: Mapping[str, tuple[float, str]]) -> str:
    values = ", ".join(f"{n} {_estimate(p, units)}" for n, p in effect.parameters.items())
    form = f" ({effect.variant})" if effect.variant else ""
    text = f"{effect.name}{form}: {values + ' (1 sigma); ' if values else ''}{effect.cost}"
    return _wrapped(text, "  ")


def _estimate(p: Estimate, units: Mapping[str, tuple[float, str]]) -> str:
    factor, unit = parameter_unit(p.unit) if p.unit in ("m", "rad") else units.get(p.unit, (1.0, p.unit))
    std = None if p.std is None else p.std * factor
    return f"{concise(p.value * factor, std)} {unit}".strip()


def shrinks_text(d: Diagnosis) -> str:
    """Return how far the error falls, on the holdout runs and over all runs, so that the two are told apart.

    The sizes before and after are of the holdout runs. The shrinkage and its interval are of all runs that
    judge, each by a fit that left its group out (`hallsym.diagnosis.validation`).
    """
    s, piece, judges = d.shrinkage, piece_of(d), len(d.validation_runs)
    held = d.held_out if judges == 1 else counted(judges, d.held_out)
    fall = f"falls by {percent(1 - d.metric.after / d.metric.before, 1)}" if d.metric.before > 0 else "is 0"
    more = counted(s.parameters_added, "parameter")
    alone = (
        f"On the {held} alone the error {fall}: {percent(s.share_closed)} of its excess above the noise "
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


def _statements(title: str, statements: tuple[Statement, ...], held_out: str) -> list[str]:
    lines = ["", f"{title}:"] if statements else []
    for s in statements[:MOST]:
        held = "" if s.held_out is None else f"; {held_out}s {100 * max(s.held_out, 0.0):.0f} %"
        p = p_text(s.p_value)
        p = p if s.p_value < LEAST_P else f"= {p}"
        lines.append(_wrapped(f"  {s.text} (p {p}{held})", "    "))
    return lines


def _untested(reasons: Mapping[str, str]) -> list[str]:
    """Return what could not be tested, names with the same reason together."""
    together: dict[str, list[str]] = {}
    for effect, reason in reasons.items():
        together.setdefault(reason, []).append(effect)
    lines = [_wrapped(f"not testable: {', '.join(n)}: {reason}", "  ") for reason, n in together.items()]
    return ["", *lines] if lines else []
