"""`hallsym evaluate`: errors of a saved calibration on another log."""

import shlex
import sys
from argparse import Namespace
from dataclasses import replace
from typing import Any

from hallsym.cli import NOT_DESCRIBED, OK
from hallsym.cli.common import (
    command,
    log_options,
    noted,
    open_log,
    own_effects,
    own_option,
    reading_words,
    say,
)
from hallsym.errors import InputError
from hallsym.estimation import noise_of
from hallsym.estimation.calibration import Fit, load_fit
from hallsym.estimation.channel_assignment import as_read, rewired
from hallsym.estimation.decoding import ErrorTable, logged_columns
from hallsym.estimation.gauss_newton import Shifts, judged
from hallsym.estimation.recorded import recording_notes
from hallsym.log import Fault, Log, usable
from hallsym.log.phase import LISTED
from hallsym.model import Model
from hallsym.report.tables import error_rows
from hallsym.units import readable

MOSTLY = 0.5
"""Share of the squared error from which on another zero is what to say first of it."""
REMEDY = "--own-zero estimates it"


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "evaluate", run,
        "Decode a log with a saved calibration and tabulate the errors against its reference. The zero\n"
        "deviations of each run are estimated from that run: a reset is a reset. Where the calibration does\n"
        "not describe the log, the report begins with that, and the exit code is 3, as for faults of the\n"
        "recording, which are judged as 'hallsym fit' does.",
    )  # fmt: skip
    parser.add_argument("calibration", metavar="CALIB", help="a calibration saved by 'hallsym fit -o'")
    parser.add_argument("log", metavar="LOG", help="log to judge on")
    own_option(parser)
    parser.add_argument("--by-run", action="store_true", help="one line per run")
    parser.add_argument(
        "--own-zero",
        action="store_true",
        help="estimate the zero of a reference that turns from each run too: it was homed or coupled anew",
    )
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    known = load_fit(options.calibration, own_effects(options))
    log = open_log(options)
    columns = logged_columns(known.model)
    log, notes = usable(
        log, columns, drop_bad=options.drop_bad, rails="saturation" not in known.model.effects
    )
    _belongs(log, known)
    log = as_read(log, known.model, known.wiring)
    noise = noise_of(log, known.model)
    notes += recording_notes(log, known.model, known.values, noise.std)
    found = judged(log, known.model, known.values, noise.std, own_zero=options.own_zero)
    table = found.table
    notes += _shift_notes(known.model, table, found.shifts, taken_out=options.own_zero)
    goodness = found.goodness.judged(
        noise, (*known.model.channels, *known.model.references), log.meta.gap_threshold_rel
    )
    words = ["hallsym", "diagnose", options.log, "--model", options.calibration, *reading_words(options)]
    goodness = replace(goodness, next_command=shlex.join(words), what="The calibration")
    amiss = goodness.sentence
    rows: dict[str, Any] = {"all runs": table.over()}
    if options.by_run:
        rows |= {f"run {run}": table.over([run]) for run in table.runs}
    record = {
        "goodness_of_fit": goodness.to_dict(),
        "calibration": str(options.calibration),
        "model": known.model.name,
        "log": str(options.log),
        "errors": rows["all runs"],
        "by_run": {str(run): table.over([run]) for run in table.runs},
        "noise": {c: {"value": s.value, "source": s.source} for c, s in noise.sigmas.items()},
        "notes": notes,
    }
    say(
        options,
        record,
        lambda: "\n".join(
            [
                *([amiss, ""] if amiss else []),
                error_rows(known.model.pose, rows, None, turning=known.model.period),
                *noted(notes),
            ]
        ),
    )
    faults = [note for note in notes if isinstance(note, Fault)]
    for said in (*faults, *([amiss] if amiss and options.json else [])):
        print(f"hallsym: {said}", file=sys.stderr)
    return NOT_DESCRIBED if amiss or faults else OK


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


def _belongs(log: Log, known: Fit) -> None:
    """Refuse a log that a family knows not to be of the machine that was calibrated."""
    model = known.model
    if model.inspect is None:
        return
    found = model.inspect(model, rewired(log, model.channels, known.wiring), fitted=False)
    if found.wiring is not None:
        raise InputError(
            f"In {log.name} {' and '.join(model.references)} runs the other way round than when the "
            "calibration was made: turn the sign of the reference in a column file, or put the wires of "
            f"{' and '.join(model.channels)} right."
        )
