"""What `hallsym fit --reference` prints: what each wave of the table belongs to."""

import numpy as np

from hallsym.errors import counted, listed
from hallsym.estimation.self_calibration import MOTION, NONE, OPEN, SENSOR, Wave
from hallsym.estimation.without_reference import SelfFit, electrical, separated_by
from hallsym.experiment.turns import RATIOS, TurnPlan, table_error, two_speeds
from hallsym.fleets import RingFleet
from hallsym.report.tables import grid
from hallsym.report.text.fleet import fleet_text

SHOWN = 12
"""Waves of the sensor that are listed, the largest; of the others all up to as many."""
READING = {
    SENSOR: "no ripple of the motion shows",
    MOTION: "motion, told apart from the sensor",
    OPEN: "sensor and motion are not separable with this recording",
}


def self_fit_text(result: SelfFit) -> str:
    """Return what is printed: the sentence, errors on the turn held out, waves, and what separates them."""
    found, fit = result.found, result.fit
    turns = ", ".join(f"{t:.1f}" for t in found.turns)
    parts = [
        result.sentence,
        "",
        f"{fit.model.name}, {counted(found.pairs, 'pole pair')}, reference: {found.reference}; turns: "
        f"{turns}; "
        f"{found.seconds:.1f} s",
        "",
    ]
    if found.left:
        rows = [["left on the turn held out", "rms [electrical deg]", "less the motion told apart"]]
        names = {"nominal": "nominal transform", "ellipse": "ellipse alone", "table": "this table"}
        rows += [[names[n], *(f"{electrical_deg(v):.2f}" for v in pair)] for n, pair in found.left.items()]
        parts += [grid(rows), ""]
    shown: list[Wave] = []
    for verdict, many in ((MOTION, SHOWN), (OPEN, SHOWN), (SENSOR, SHOWN)):
        shown += found.verdicts(verdict)[:many]
    rows = [["wave per turn", "per period", "sensor", "motion", "[electrical deg]"]]
    for w in shown:
        none = w not in found.kept or (w.verdict == OPEN and found.reference == NONE)
        sensor = "not in the table" if none else _size(result, w.sensor, w.std)
        motion = "" if w.motion is None else _size(result, w.motion, w.motion_std)
        rows.append([str(w.per_turn), f"{w.per_turn / found.pairs:.3g}", sensor, motion, READING[w.verdict]])
    parts += [grid(rows, left=1)]
    rest = len(found.kept) - len([w for w in shown if w in found.kept])
    parts += [f"and {counted(rest, 'wave')} more"] if rest > 0 else []
    parts += [f"to separate them: {text}" for text in separated_by(found)]
    parts += [f"note: {note}" for note in fit.notes]
    return "\n".join(parts)


def electrical_deg(value: float) -> float:
    """Return an electrical angle [rad] in degrees."""
    return float(value * 57.29577951308232)


def _size(result: SelfFit, value: complex, std: float | None) -> str:
    size = electrical(result.found, value)
    return f"{size:.3f}" if std is None else f"{size:.3f} +- {electrical(result.found, std):.3f}"


def ring_fleet_text(found: RingFleet) -> str:
    """Return what `hallsym fleet --reference` prints: drive and heads, rings to look at, rings best first."""
    jig, fleet = found.jig, found.fleet
    pairs = found.pairs
    heads = [str(h + 1) for h in jig.heads]
    places = ", ".join(f"{electrical_deg(p):.3f}" for p in jig.places)
    parts = [
        found.sentence,
        "",
        f"{counted(len(fleet.rows), 'ring')} in {fleet.seconds:.1f} s; Halls {', '.join(heads)} see one "
        "field, at "
        f"{places} mechanical deg from Hall {heads[0]}",
        "",
    ]
    rows = [["ripple of the drive, per turn", "[electrical deg]"]]
    for n, c, s in zip(jig.orders, jig.ripple, found.ripple_std, strict=True):
        rows.append([str(n), f"{electrical_deg(abs(c) * pairs):.3f} +- {electrical_deg(s * pairs):.3f}"])
    parts += [grid(rows, left=1), ""] if len(rows) > 1 else []
    parts += [fleet_text(fleet), ""]
    left = [(str(r["device"]), float(r["left_rad"])) for r in fleet.rows if r.get("left_rad") is not None]
    if left:
        middle, most = map(electrical_deg, np.percentile([v for _, v in left], [50, 95]))
        parts.append(
            f"left on the turn held out, less the drive's ripple: median {middle:.2f}, 95 % {most:.2f} "
            "electrical deg"
        )
        ends = [left[0], left[len(left) // 2], left[-1]]
        words = ("best", "median", "worst")
        parts += [f"  {w}: {d}, {electrical_deg(v):.2f}" for w, (d, v) in zip(words, ends, strict=True)]
    return "\n".join(parts)


def turns_text(found: TurnPlan) -> str:
    """Return what `hallsym plan --reference` prints: open waves, turns, speeds."""
    places = ", ".join(f"{electrical_deg(p):.4g}" for p in found.places)
    parts = [f"Halls at {places} deg (mechanical) over {counted(found.pairs, 'pole pair')}", ""]
    if found.open:
        named = listed([str(n) for n in found.open])
        parts.append(
            f"These Halls leave {'wave' if len(found.open) == 1 else 'waves'} {named} per turn open: n "
            "p is near a "
            "multiple of 360 deg for all of them. Only the motion tells these: a rotor that coasts at "
            "two speeds, "
            "or one Hall more at another angle. Turning back does not."
        )
    else:
        parts.append(f"These Halls leave none of the waves 1 to {len(found.seen)} per turn open.")
    weak = np.argsort(found.seen)[:6]
    rows = [["weakest waves per turn", "error over that of a difference of two Halls"]]
    rows += [
        [str(n + 1), "open" if n + 1 in found.open else f"{1 / found.seen[n]:.1f}"] for n in sorted(weak)
    ]
    parts += ["", grid(rows, left=1), ""]
    parts.append(
        "torque ripple by two speeds, error over that of one: "
        + ", ".join(f"{two_speeds(1.0, 1.0, r):.2f} at ratio {r:g}" for r in RATIOS)
    )
    if found.density is None:
        parts.append("turns: not known before a recording; give one with --after LOG --accuracy 0.01deg")
        return "\n".join(parts)
    rows = [["turns", "rms of the table [mechanical deg]"]]
    rows += [[str(n), f"{electrical_deg(table_error(found.density, n)):.4f}"] for n in (1, 2, 4, 8, 16, 32)]
    parts += ["", grid(rows, left=1)]
    if found.target is not None:
        parts.append(
            f"{electrical_deg(found.target):.4g} deg needs {counted(found.turns or 0, 'turn')}, and one "
            "to judge it."
        )
    return "\n".join(parts)
