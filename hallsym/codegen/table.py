"""A calibration of an angle as a table of a maker's firmware, and the error over a turn with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.generation import check, notes_of
from hallsym.codegen.lowering.phase_curve import check_static
from hallsym.errors import InputError, require
from hallsym.estimation.calibration import Fit
from hallsym.estimation.without_reference import of_ring
from hallsym.files import atomic_write
from hallsym.log.maker_tables import (
    BY_NAME,
    CSV,
    TURN,
    Layout,
    MakerTable,
    encoded,
    read_table,
    replaced,
    text_of,
)
from hallsym.log.phase import wrapped
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.shown import Shown

POINTS = 1 << 14
"""Angles of a turn at which readings are computed; lines between leave 2e-8 of a wave of one per turn."""
ANGLE = np.arange(POINTS) * (TURN / POINTS)
POLE_PAIR = 4
"""Full steps of a stepper in one of its electrical periods."""
MOST_ENTRIES = 1 << 16
SAME = 1e-6
"""Share of the error over the turn up to which its periods are the same."""


@dataclass(frozen=True)
class Error:
    """Error of an angle over a turn without its mean [rad]."""

    rms: float
    peak: float


@dataclass(frozen=True, eq=False, repr=False)
class Exported(Shown):
    """A table and its text; errors over the turn, by the calibration, without it, with it, with the old one.

    `calibrated`: rms that the calibration leaves on its own log [rad], None where it does not say.
    `undetermined`: parameters that the table depends on and that log does not determine. `like`: the file of
    the old table.
    """

    name: str
    text: str
    entries: int
    before: Error
    after: Error
    old: Error | None
    calibrated: float | None
    notes: tuple[str, ...]
    undetermined: tuple[str, ...]
    like: str = ""

    def write(self, path: str | Path) -> None:
        """Write the file, through a temporary one."""
        atomic_write(path, encoded(self.text))

    def to_dict(self) -> dict[str, Any]:
        """Return the record of `--json`, in SI."""
        return {k: v for k, v in asdict(self).items() if k not in ("text", "like")}


def export_table(
    fit: Fit,
    name: str,
    *,
    entries: int | None = None,
    like: str | Path | None = None,
    keep_reference: bool = False,
    motor_steps: int | None = None,
    allow_undetermined: bool = False,
) -> Exported:
    """Return a calibration as a table in the format `name`, a key of `hallsym.log.maker_tables.BY_NAME`.

    `like`: a file that holds a table of the maker's, whose text, zero and sense are kept; it states the
    entries. What the calibration knows of its reference's own error is left out, unless
    `keep_reference`; so are the waves of a stepper with `motor_steps` full steps, one for each pole pair and
    its multiples. Of two voltages the table corrects the arctangent. Raises `InputError` for a calibration
    that cannot be trusted on a controller, or that no table corrects.
    """
    require(name in BY_NAME, "--table", f"one of {', '.join(BY_NAME)}", name, list(BY_NAME))
    layout, model = BY_NAME[name], fit.model
    if model.family.decoder != "angle":
        raise InputError(
            f"A table corrects the angle of a chip, of two voltages or of Halls over a ring; {model.name} of "
            f"the family {model.family} reads {', '.join(model.channels[:3])}: use 'hallsym codegen'."
        )
    if of_ring(model) and not layout.halls:
        others = " or ".join(f"--table {one.name}" for one in BY_NAME.values() if one.halls)
        raise InputError(
            f"A table of {layout.about} corrects the angle of a chip; its firmware computes none from Halls "
            f"over a ring: give {others}, or use 'hallsym codegen'."
        )
    own = replace(model, steps=tuple(s for s in model.steps if s[0] != "reference"), before=model)
    check_static(own, "the angle")
    used = model if keep_reference else own
    needed = [n for n, symbol in zip(model.names, ca.vertsplit(used.symbols.parameters), strict=True)
              if ca.depends_on(used.symbols.reading, symbol)]  # fmt: skip
    fit = fit.changed(undetermined_by_log=tuple(n for n in fit.undetermined_by_log if n in needed))
    check(fit, allow_undetermined)
    raw, centres = _raw(fit, used, motor_steps, layout)
    usual = layout.entries if layout.at_reading else motor_steps or layout.entries
    old, text = read_table(like) if like else (None, "")
    if old is not None:
        require(old.layout is layout, "--like", f"a table of {layout.about}", old.layout.about)
        usual = len(old.values)
        require(entries in (None, usual), "--entries", f"that of --like, {usual}, or left out", entries)
    count = usual if entries is None else entries
    require(3 <= count <= MOST_ENTRIES, "--entries", f"3 to {MOST_ENTRIES}", count)
    table = _made(raw, layout, count, old)
    rows = [fit.error_rows.get(row) for row in ("holdout", "fitted")]
    return Exported(
        name=name,
        text=text_of(table) if old is None else replaced(text, table),
        entries=count,
        before=_error(raw),
        after=_error(table.decoded(table.seen(raw))),
        old=_error(old.decoded(old.seen(raw))) if old else None,
        calibrated=next((row["rmse"][c] for row in rows if row for c in model.pose), None),
        notes=tuple(_notes(fit, layout, old is not None, keep_reference, centres)),
        like=str(like or ""),
        undetermined=fit.undetermined_by_log,
    )


def _raw(fit: Fit, model: Model, motor_steps: int | None, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return the angle that a firmware computes at `ANGLE` before any table, (POINTS,) [rad] without jumps.

    That of a chip as logged, the arctangent of two voltages as logged, or the angle of Halls over a ring at
    nominal places with equal gains about their means over the turn; and these means, (channels,).
    """
    found = model.readings(fit.values, [ANGLE])
    assignment = fit.assignment or tuple((c, 1) for c in model.channels)
    logged = {source: sign * found[k] for k, (source, sign) in enumerate(assignment)}
    given, centres = np.array([logged[c] for c in model.channels]), found.mean(axis=1)
    if of_ring(model):
        v, nominal = ca.SX.sym("v", len(given)), {p.name: ca.SX(p.nominal) for p in model.parameters}
        assert model.begin is not None
        pose = on_arrays(ca.Function("pose", [v], [ca.densify(model.begin(v, nominal))]))
        centres = given.mean(axis=1)
        period = model.period[model.pose[0]]
        raw = np.unwrap(np.ravel(pose([*(given - centres[:, None])])[0]), period=period)
        pairs, waves = round(TURN / period), np.abs(np.fft.rfft(raw - _sense(raw) * ANGLE))
        others = np.delete(waves, np.arange(0, len(waves), pairs))
        if layout is not CSV and np.sqrt((others**2).sum()) > SAME * np.sqrt((waves[1:] ** 2).sum()):
            raise InputError(  # its firmware does not know in which period it is
                f"This table differs from one period to the next, and a firmware of {layout.about} counts "
                f"the {pairs} periods from where it is switched on: fit with --effect "
                f"turn_waves:count=4,step={pairs}, or give --table csv."
            )
    else:
        raw = np.unwrap(given[0] if len(given) == 1 else np.arctan2(*given))
    sense = _sense(raw)
    if motor_steps is not None:
        good = motor_steps % POLE_PAIR == 0 and 0 < motor_steps <= POINTS
        require(good, "--motor-steps", "full steps in a turn, such as 200, in fours", motor_steps)
        waves = np.fft.rfft(raw - sense * ANGLE)
        waves[motor_steps // POLE_PAIR :: motor_steps // POLE_PAIR] = 0
        raw = sense * ANGLE + np.fft.irfft(waves, POINTS)
    if not (np.diff(sense * np.append(raw, raw[0] + sense * TURN)) > 0).all():
        raise InputError(
            f"No angle belongs to each reading of this calibration of {model.name}: no table undoes it."
        )
    return raw, centres


def _sense(values: np.ndarray) -> int:
    return 1 if np.asarray(wrapped(np.diff(values), TURN)).sum() > 0 else -1


def _centred(off: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the mean of angles that may jump by turns, and what they differ from it by [rad]."""
    middle = float(np.angle(np.exp(1j * off).mean()))
    rest = np.asarray(wrapped(off - middle, TURN))
    return middle + float(rest.mean()), rest - rest.mean()


def _error(angle: np.ndarray) -> Error:
    """Return how far angles (POINTS,) of either sense lie from `ANGLE`."""
    _, off = _centred(angle - _sense(angle) * ANGLE)
    return Error(float(np.sqrt(np.mean(off**2))), float(np.abs(off).max()))


def _made(raw: np.ndarray, layout: Layout, count: int, old: MakerTable | None) -> MakerTable:
    """Return the table of readings at `ANGLE`, with zero and sense of an old one."""
    given = old or MakerTable(layout, np.zeros(count), layout.decimals)
    raw = given.seen(raw)
    seen = _sense(raw)  # of readings as the table has them

    def angle_at(reading: np.ndarray) -> np.ndarray:
        return seen * reading + np.interp(reading, raw, ANGLE - seen * raw, period=TURN)

    sense, shift = 1, 0.0
    if old is not None or not layout.absolute:  # an empty table of corrections has a zero and a sense too
        reading, angle = given.rows
        sense = given.sense * seen
        shift, _ = _centred(angle - sense * angle_at(reading))
    at = given.places
    if layout.at_reading:
        reading, angle = at, sense * angle_at(at) + shift
    else:
        angle, place = at, sense * (at - shift)
        reading = seen * place + np.interp(place, ANGLE, raw - seen * ANGLE, period=TURN)
    needed = layout.reading * reading + layout.angle * angle
    needed = np.mod(needed, TURN) if layout.absolute else np.asarray(wrapped(needed, TURN))
    scale = float(np.float32(np.abs(needed).max() / TURN)) or 1.0 if layout.scaled else given.scale
    made = replace(given, scale=scale, decimals=max(given.decimals, layout.decimals))
    made = replace(made, values=needed / made.unit).rounded()
    if layout.by_pole_pair and old is None:
        first = int(np.argmin(made.values) if made.sense > 0 else np.argmax(made.values)) & ~(POLE_PAIR - 1)
        made = replace(made, values=np.roll(made.values, -first))
    return made


def _notes(fit: Fit, layout: Layout, like: bool, kept: bool, centres: np.ndarray) -> Iterator[str]:
    """Yield what the user of a table should know."""
    yield from notes_of(fit.changed(corrections=()))
    effects = (e.name for e in fit.model.family.effects if e.link == "reference")
    if known := [name for name in effects if name in fit.model.effects]:
        what = "is in the table" if kept else "is left out of the table (--keep-reference puts it in)"
        yield f"What the calibration knows of its reference's own error ({', '.join(known)}) {what}."
    if of_ring(fit.model):
        heads, turn = fit.model.layout, 360 / TURN * fit.model.layout[0].pole_pairs
        said = [
            f"{h.channel} at {turn * (h.place_rad - heads[0].place_rad):.5g} deg about {centre:.6g}"
            for h, centre in zip(heads, centres, strict=True)
        ]
        yield (
            "The table corrects the angle of Halls with equal gains at their nominal places in a period, "
            f"less their centres: {', '.join(said)}; let the firmware compute it so."
        )
    elif len(fit.model.channels) > 1:
        yield "The table corrects the arctangent of both voltages as they are logged, uncalibrated."
    if layout.absolute and not like:
        yield (
            "Zero and sense of the table are those of the log's reference. Where the firmware commutates a "
            "motor by them and that reference was not the motor itself, give its old table with --like."
        )
    elif not like:
        yield "The mean of the table is zero: electrical zero and direction of the motor stay as they are."
