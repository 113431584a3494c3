"""Report of the periodic error of a sensor: its size, its causes and its remedies."""

from __future__ import annotations

from math import hypot

from hallsym.log.phase import decoding
from hallsym.model import Family
from hallsym.report.content import Block, Table
from hallsym.report.data.periodic import PeriodicError, Size
from hallsym.report.words import NOT_DECODED, number
from hallsym.units import readable


def periodic(found: PeriodicError, family: Family) -> list[Block | str]:
    """Return the error over the period, by remedy, and the part that is not the machine's."""
    factor, unit, name = readable(found.coordinate, {found.coordinate})
    noun = family.noun or "machine"
    over = "turn" if unit == "deg" else f"period of {name}"
    if not decoding(found.rest, found.rest_calibrated):
        rest = found.rest_calibrated
        return [
            f"error of the {noun}: not split by cause, {NOT_DECODED}; "
            f"with this calibration rms {number(factor * hypot(found.calibrated.rms, rest))} {unit}, "
            f"of which {number(factor * rest)} {unit} do not repeat (noise)"
        ]
    head = [f"error of the {noun}, by remedy"]
    head += [f"{what} [{unit}]" for what in ("rms", "lower by", "repeating, peak")]
    rows = []
    remedies = [("nothing done", found.machine, found.rest)]
    if found.mounted != found.machine:
        waves = "waves" if len(found.mount_orders) > 1 else "wave"
        mounted = f"mounted anew, at best without {waves} {_per(found.mount_orders, over)}"
        remedies.append((mounted, found.mounted, found.rest))
    remedies += [
        ("with this calibration", found.calibrated, found.rest_calibrated),
        (f"with a correction table over the {over}", Size(0, 0), found.rest),
    ]
    before = hypot(found.machine.rms, found.rest)
    for label, size, rest in remedies:
        left = hypot(size.rms, rest)
        lower = "" if size is found.machine else number(factor * (before - left), 2)
        rows.append([label, number(factor * left), lower, number(factor * size.peak)])
    return [Table(head, rows, "what each remedy would leave"), *_sentences(found, noun, factor, unit, over)]


def _per(orders: tuple[int, ...], over: str) -> str:
    return f"{' and '.join(map(str, orders))} per {over}"


def _amplitudes(found: PeriodicError, factor: float, unit: str, orders: tuple[int, ...]) -> str:
    shown = [h for h in found.harmonics if h.shown and h.per_period in orders]
    said = (f"{h.per_period}: {number(factor * h.amplitude, 2)}" for h in shown)
    widest = max((h.half_width for h in shown), default=0.0)
    return f"{', '.join(said)} {unit} (95 %: +-{number(factor * widest, 1)})" if shown else ""


def _sentences(found: PeriodicError, noun: str, factor: float, unit: str, over: str) -> list[str]:
    orders = tuple(h.per_period for h in found.harmonics if h.per_period not in found.pattern_orders)
    said = _amplitudes(found, factor, unit, orders)
    lines = [f"amplitude of each wave per {over} of the {noun}: {said or 'none that the log shows'}"]
    pattern = _amplitudes(found, factor, unit, found.pattern_orders)
    if pattern:
        lines.append(
            f"pattern of the reference, no error of the {noun}: {pattern}; left out above, and a correction "
            "table made from this reference would copy it"
        )
    elif found.pattern_orders:
        per = _per(found.pattern_orders, over)
        lines.append(f"pattern of the reference ({per}): none that the log shows")
    lines += [
        f"wave {n} per {over} may also come from {', '.join(names)}, which mounting does not remove"
        for n, names in found.elsewhere.items()
        if names and any(h.per_period == n and h.shown for h in found.harmonics)
    ]
    if found.slope:
        lines.append(f"the scale of the reference differs by {100 * found.slope:+.2g} %; left out above")
    rest, after = (f"{number(factor * size, 2)} {unit}" for size in (found.rest, found.rest_calibrated))
    if rest == after:
        return [*lines, f"part of every rms that does not repeat: {rest} (noise)"]
    return [
        *lines,
        f"part of every rms that does not repeat: {rest} with nominal parameters, {after} (noise) with this "
        "calibration",
    ]
