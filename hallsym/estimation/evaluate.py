"""A calibration on another log: errors of the decoded pose, lack of fit, offsets that moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit, load_fit
from hallsym.estimation.claims import mistakes_of
from hallsym.estimation.decoding import ErrorTable, error_tables, logged_columns, zero_shifts
from hallsym.estimation.goodness_of_fit import (
    GoodnessOfFit,
    goodness_of,
    noise_floor,
    noise_followed,
    with_noise,
)
from hallsym.estimation.likelihood import Point, cost_near, deviations_of, offsets_of
from hallsym.estimation.task import noise_of
from hallsym.families.recording import corrected
from hallsym.log import Fault, Log, Noise, as_log, usable
from hallsym.log.phase import LISTED, at_rest, continuous, rehomed
from hallsym.model import Inspection, Model
from hallsym.records import named
from hallsym.shown import Shown
from hallsym.units import readable

Shifts = Mapping[str, Mapping[int, float]]


@dataclass(frozen=True, eq=False)
class Judged:
    """Fixed parameters on another log: errors, offsets beside the calibration's, how well they fit it.

    `point`: of its cost. `log`: what was decoded, with the reference offsets that were asked for.
    """

    table: ErrorTable
    shifts: Shifts
    goodness: GoodnessOfFit
    point: Point
    log: Log


def judged(
    log: Log, model: Model, p: np.ndarray, noise: Mapping[str, float], *, own_zero: bool = False
) -> Judged:
    """Evaluate fixed parameters on another log; each run's offsets are estimated from that run.

    `own_zero`: so is the zero of a periodic reference.
    """
    cost = cost_near(log, model, p, noise)
    shifts = zero_shifts(log, model, p, offsets_of(cost, p), cost.reading_variance, noise)
    if own_zero and shifts:
        log = rehomed(log, shifts, model)
        cost = cost_near(log, model, p, noise)
    (table,) = error_tables(log, model, [(p, offsets_of(cost, p))], cost.reading_variance, sigma=noise)
    point = cost.at(p)
    return Judged(table, shifts, goodness_of(point, 0), point, log)


MOSTLY = 0.5
"""Share of the squared error above which a shifted zero is reported first."""
REMEDY = "--own-zero estimates it"


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Shown):
    """Result of `evaluate`: errors of the decoded pose against the reference of a log, by run.

    `table.over(runs)` gives rmse and peak by pose coordinate, SI. `goodness`: the residual in multiples of
    the noise. `noise_floor`: the error by noise alone, by pose coordinate. `notes` on the log. `calibration`,
    `log`: the inputs. `offsets`: zero deviations by run. `decoded`: the log as it was decoded, channels as
    the model names them.
    """

    model: Model
    table: ErrorTable
    goodness: GoodnessOfFit
    noise_floor: Mapping[str, float]
    noise: Noise
    notes: tuple[str, ...]
    calibration: Fit
    log: Log
    offsets: Mapping[int, np.ndarray]
    decoded: Log

    @property
    def applied(self) -> Fit:
        """The calibration as it decodes `decoded`: with the offsets and the noise of this log."""
        names = [zero.name for zero in self.model.offsets]
        return self.calibration.changed(
            zero_deviations={run: named(names, found) for run, found in self.offsets.items()},
            noise=self.noise, noise_floor=self.noise_floor, errors=None, corrections=(), keep=None,
            log=structs.replace(self.calibration.log, holdout=()),
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym evaluate --json` prints."""
        return {
            "goodness_of_fit": self.goodness.to_dict(),
            "model": self.model.name,
            "errors": self.table.over(),
            "noise_floor": dict(self.noise_floor),
            "by_run": {str(run): self.table.over([run]) for run in self.table.runs},
            "noise": {c: {"value": s.value, "source": s.source} for c, s in self.noise.sigmas.items()},
            "notes": list(self.notes),
        }


def evaluate(
    calibration: Fit | str | Path,
    log: Any,
    *,
    corrections: str | Sequence[str] = (),
    own_zero: bool = False,
    drop_bad: bool = False,
) -> Evaluation:
    """Decode a log with a calibration and compare it with the log's reference.

    `calibration`: a fit, or the path of a saved one. `log`: as `fit` takes it. The zero deviations of each
    run are estimated from that run. `corrections`: mistakes of the recording to undo, as for `fit`.
    `own_zero`: the zero of a periodic reference is estimated from each run too. `drop_bad`: leave out bad
    samples.

    Raises `InputError` for a log that is not of the machine that was calibrated, and for one whose units,
    signs or runs are wrong, as a fit of it does.
    """
    known = calibration if isinstance(calibration, Fit) else load_fit(calibration)
    model = known.model
    given = at_rest(corrected(as_log(log, known.columns, known.read_with), corrections), model)
    given, notes = usable(given, logged_columns(model), drop_bad=drop_bad)
    given = corrected(given, [one for one in known.corrections if not one.runs])
    mounted = model.inspect(model, given, fitted=False) if model.inspect else Inspection()
    notes += [note for note in mounted.notes if isinstance(note, Fault)]
    if mounted.inverted:
        raise InputError(
            f"In {given.name} {' and '.join(model.references)} runs the other way round than when the "
            "calibration was made: turn the sign of the reference in a column file, or put the wires of "
            f"{' and '.join(model.channels)} right."
        )
    seen = continuous(given, model)
    noise = noise_of(seen, model)
    found = judged(seen, model, known.values, noise.std, own_zero=own_zero)
    if (followed := noise_followed(found.log, found.point, noise)) is not None:
        noise, found = followed, judged(seen, model, known.values, followed.std, own_zero=own_zero)
    notes += _shift_notes(model, found.table, found.shifts, taken_out=own_zero)
    goodness = with_noise(found.goodness, found.log, found.point, noise)
    if goodness.sentence:
        notes += [Fault(one.text, one.name, one.columns, one.runs, one.correction)
                  for one in mistakes_of(given, model)]  # fmt: skip
    return Evaluation(
        model, found.table, goodness, noise_floor(found.point), noise, tuple(notes), known, given,
        deviations_of(found.point), found.log,
    )  # fmt: skip


def _shift_notes(model: Model, table: ErrorTable, shifts: Shifts, *, taken_out: bool) -> list[str]:
    """Say which references have another zero than when the calibration was made, and how to take it out."""
    notes, count = [], dict(zip(table.runs, table.count.tolist(), strict=True))
    for column, own in shifts.items():
        made = sum(count[run] * shift**2 for run, shift in own.items())
        if not taken_out and made <= MOSTLY * table.squares[:, model.references.index(column)].sum():
            continue
        factor, unit, _ = readable(column)
        said = [f"run {run}: {factor * shift:+.4f}" for run, shift in own.items()]
        said = said if len(own) > 1 else [f"{factor * shift:+.4f}" for shift in own.values()]
        more = f", and {len(own) - LISTED} more" if len(own) > LISTED else ""
        remedy = "The errors are without it." if taken_out else f"Most of the error is that; {REMEDY}."
        if not taken_out and len(own) > 1:
            remedy = f"{remedy[:-1]} from each run, a fit with --effect zero_deviation gives each its own."
        notes.append(
            f"{column} counts from another zero than when the calibration was made; in {unit}, beside that: "
            f"{', '.join(said[:LISTED])}{more}. {remedy}"
        )
    return notes
