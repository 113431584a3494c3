"""What has to be said of an encoder's log before it is fitted: turns, direction, zero."""

from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.families.rotary.seen import BINS, UNITS, Seen, seen_of
from hallsym.model import Inspection, Model

GAP_NOTE, GAP_REFUSE = 30.0, 120.0
"""Widest part of a turn [deg] without a sample: what is worth a note, and what no harmonics survive."""
FOLLOWS = 0.5
"""An encoder follows its reference if the mean of exp(i (angle - reference)) is longer than this."""
TOGETHER = 0.75
"""The same within runs of a full turn: 43 deg, far beyond any offset, gain or clipping."""
CLEARLY, LEAST_ZERO = 3.0, 1.0
"""What zeros of runs must differ by for a note: times the scatter of the angle within a run, and deg."""
SURE, TURNS, LEAST_DRIFT, MOST_DRIFT = 0.8, 1.9, 1.0, 30.0
"""A reference of another scale: share of the variation within runs that drifts along it, turns that show
it, and how far it must drift over them for a note [deg], and to be refused."""
ORDERED = 0.3
"""Length of the mean of exp(2 i |step|) below which rows follow no motion."""
DEAD = 0.2
"""Share of its variation below which a voltage does not go round."""
MOST_LEFT = 0.5
"""Scatter about that drift [rad], at most."""


def inspect(model: Model, log: Any, *, fitted: bool = True) -> Inspection:
    """Refuse a log that no encoder model can be fitted to; return its direction and what it cannot tell.

    `fitted` False: the log is only judged, for which a part of a turn is enough.

    Raises `InputError` when the reference covers too little of a turn, makes another number of turns, or does
    not belong to the readings.
    """
    seen, (column,) = seen_of(model, log), model.references
    if model.zeros:  # each run has a zero of its own
        for k in (1.0, -1.0):
            seen.follows[k] = sum(abs(own[k]) for own in seen.runs.values())
    _refuse(seen, log.name, model, fitted)
    guessed = fitted and "t_s" not in log.columns and column not in log.noise
    if guessed and abs(seen.even) < ORDERED * (seen.samples - len(seen.runs)):
        raise InputError(
            f"Rows of {log.name} are in no order ({column} moves by anything from one to the next), so the "
            f"noise cannot be estimated: sort them by {column}, or state the noise with --noise."
        )
    forward = abs(seen.follows[1.0]) >= abs(seen.follows[-1.0])
    notes = _notes(seen, column)
    slope = _scale(seen, LEAST_DRIFT)
    if slope and "reference_scale_error" not in model.effects:
        notes.append(
            f"The encoder makes {1 + slope:.5g} turns while {column} makes one: --effect "
            "reference_scale_error fits that, or scale the reference in a column file."
        )
    if not slope:
        notes += _homed(seen, column, 1.0 if forward else -1.0, bool(model.zeros))
    if not forward:
        channel = model.channels[0]
        swapped = ", or the two voltages are swapped" if len(model.channels) == 2 else ""
        notes.append(
            f"The encoder turns against {column} (its other side faces the reference{swapped}); {channel} is "
            "taken with its sign reversed."
        )
    wiring = None if forward else tuple((c, -1 if k == 0 else 1) for k, c in enumerate(model.channels))
    return Inspection(tuple(notes), wiring)


def _refuse(seen: Seen, name: str, model: Model, fitted: bool) -> None:
    gap, other, (column,) = _gap(seen.reference), _gap(seen.angle), model.references
    length = {k: abs(v) / max(seen.samples, 1) for k, v in seen.follows.items()}
    if fitted and gap > GAP_REFUSE and other > GAP_REFUSE:
        raise InputError(
            f"Column {column} of {name} covers only {360 - gap:.0f} deg of a turn; offset, gain and phase of "
            "an encoder show once and twice per turn, so record at least one full turn, or check its unit."
        )
    best = max(length, key=lambda k: (round(length[k], 3), -abs(k)))
    straight = max(length[1.0], length[-1.0])
    if straight < FOLLOWS and length[best] > FOLLOWS:
        many = f"{abs(best):g} turns" if abs(best) > 1 else f"1/{1 / abs(best):.0f} of a turn"
        raise _other_scale(name, column, many, abs(best))
    if gap < GAP_REFUSE:
        _check_wraps(seen, name, model)
    alone = seen.together
    astray = max(straight, alone) < (TOGETHER if gap < GAP_REFUSE else FOLLOWS)
    if astray and (why := _unit(seen, model) or _dead(seen, model)):
        raise InputError(f"{why[0]} of {name} {why[1]}")
    slope = _scale(seen, MOST_DRIFT)
    if slope and min(straight, alone) < TOGETHER:
        raise _other_scale(name, column, f"{1 + slope:.4g} turns", 1 + slope)
    if straight < FOLLOWS < alone and len(seen.runs) > 1:
        raise InputError(
            f"The encoder in {name} follows {column} in each run, but each from another zero: the reference "
            "was homed anew between runs. Fit with --effect zero_deviation, which gives each run its own."
        )
    if astray:
        raise InputError(
            f"The encoder in {name} does not follow {column} (their difference is spread over the turn); it "
            "does not belong to these readings: check file, clock, columns and units."
        )
    if fitted:
        _check_swing(seen, name, model)


def _check_wraps(seen: Seen, name: str, model: Model) -> None:
    """Refuse an angle that jumps back by anything but whole turns."""
    columns = model.references if len(model.channels) == 2 else (*model.channels, *model.references)
    for jumps, c in zip(seen.jumps[-len(columns) :], columns, strict=True):
        if jumps.odd:
            raise InputError(
                f"Column {c} of {name} wraps after {jumps.odd:.3f} turns, which is no whole number: check "
                "its unit, or its counts per turn (counts_per_turn of that column in a column file)."
            )


def _check_swing(seen: Seen, name: str, model: Model) -> None:
    """Refuse voltages of an amplitude that the model cannot have."""
    known = {p.name: p for p in model.parameters}
    for channel, (_, half), own in zip(model.channels, seen.scales, ("Ay", "Ax"), strict=False):
        amplitude = known.get(own) or known.get("A")
        if amplitude and not amplitude.lower <= half <= amplitude.upper:
            raise InputError(
                f"Column {channel} of {name} swings by +-{half:.3g} V, beyond the bounds of its amplitude "
                f"{amplitude.name} ({amplitude.lower:g} to {amplitude.upper:g} V): check its unit, or give "
                "lower, upper and nominal of amplitudes and offsets of that size in a machine file."
            )


def _other_scale(name: str, column: str, many: str, factor: float) -> InputError:
    return InputError(
        f"In {name} the encoder makes {many} while {column} makes one; both must be angles of one shaft: "
        f"scale the reference by {factor:.6g} in a column file, or check its unit."
    )


def _unit(seen: Seen, model: Model) -> tuple[str, str] | None:
    """Which column looks like another unit than its name says, and what to do."""
    (column,), spans = model.references, seen.spans
    for (mine, theirs, _), total in sorted(seen.units.items(), key=lambda entry: -abs(entry[1])):
        if abs(total) < TOGETHER * seen.tried:
            return None
        if min(mine * spans[0], theirs * spans[1]) < np.radians(360.0 - GAP_REFUSE):
            continue  # all angles are near each other then
        pairs = ((model.channels[0], mine), (column, theirs))
        other = [(c, UNITS[factor]) for c, factor in pairs if UNITS[factor]]
        if other:
            looks = " and ".join(f"{c} were in {unit}" for c, unit in other)
            return (
                f"Column {other[0][0]}",
                f"seems to be in another unit: the encoder would follow its reference if {looks}; say so by "
                "the ending of the name, _deg or _rad, in the file or with --column.",
            )
    return None


def _dead(seen: Seen, model: Model) -> tuple[str, str] | None:
    """Which voltage does not go round while the other does, and what to do."""
    if len(model.channels) < 2:
        return None
    shares = seen.plates.shares()
    dead, well = (int(k) for k in np.argsort(shares))
    if not (shares[dead] < DEAD and shares[well] > FOLLOWS):
        return None
    return (
        f"Column {model.channels[dead]}",
        f"does not go round with {model.references[0]} (one wave per turn makes "
        f"{100 * max(shares[dead], 0.0):.0f} % of its variation) while {model.channels[well]} does: check "
        "that plate and its wiring.",
    )


def _scale(seen: Seen, least: float) -> float:
    """Turns more that the encoder makes per turn of the reference; 0 where none are seen or they do no harm.

    `least`: drift [deg] over the longest run that counts.
    """
    sign = 1.0 if abs(seen.follows[1.0]) >= abs(seen.follows[-1.0]) else -1.0
    line = seen.lines[sign].found()
    clear = line.share > SURE and line.longest > TURNS * 2 * np.pi and line.left < MOST_LEFT
    drift = abs(line.slope) * line.longest
    return sign * line.slope if clear and drift > np.radians(least) and sign * line.slope > -0.9 else 0.0


def _notes(seen: Seen, column: str) -> list[str]:
    notes, gap = [], _gap(seen.reference)
    if gap > GAP_NOTE:
        notes.append(
            f"No sample lies in {gap:.0f} deg of the turn: what is said of that part is extrapolated."
        )
    if min(seen.up, seen.down) < 0.05 * (seen.up + seen.down):
        notes.append(
            f"{column} turns in one direction only: latency and hysteresis look like another zero and are "
            "not observable (latency is, as far as the speed changes); record both directions to tell them."
        )
    return notes


def _homed(seen: Seen, column: str, sign: float, own: bool) -> list[str]:
    """What to say of zeros of runs that clearly differ, unless each has its `own`."""
    if own or len(seen.runs) < 2:
        return []
    first = next(iter(seen.runs))
    zeros = {run: np.angle(k[sign] / seen.runs[first][sign]) for run, k in seen.runs.items()}
    length = [abs(k[sign]) / max(seen.counts[run], 1) for run, k in seen.runs.items()]
    spread = float(np.sqrt(max(-2 * np.log(max(np.median(length), 1e-9)), 0.0)))
    far = max(zeros, key=lambda run: abs(zeros[run]))
    if abs(zeros[far]) < max(CLEARLY * spread, np.radians(LEAST_ZERO)):
        return []
    most = np.degrees(abs(zeros[far]))
    return [
        f"The zero of {column} differs between runs, by {most:.3g} deg in run {far} beside run {first}. If "
        "it was homed anew, --effect zero_deviation gives each run its own; latency makes differences too."
    ]


def _gap(bins: np.ndarray) -> float:
    """Widest run of empty sectors around the turn [deg]."""
    if bins.all():
        return 0.0
    if not bins.any():
        return 360.0
    at = np.flatnonzero(bins)
    between = np.diff(np.r_[at, at[0] + BINS]) - 1
    return float(between.max()) * 360.0 / BINS
