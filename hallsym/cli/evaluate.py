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
    open_log,
    own_effects,
    own_option,
    plots_options,
    plots_place,
    reading_words,
    say,
)
from hallsym.estimation import evaluate, load_fit
from hallsym.log import Fault
from hallsym.report.data.periodic import periodic_of
from hallsym.report.text.fit import evaluation_text


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
    plots_options(parser)
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    known = load_fit(options.calibration, own_effects(options))
    log = open_log(options, known=known)
    found = evaluate(known, log, own_zero=options.own_zero, drop_bad=options.drop_bad)
    words = ["hallsym", "diagnose", options.log, "--model", options.calibration, *reading_words(options)]
    goodness = replace(found.goodness, next_command=shlex.join(words), what="The calibration")
    found = replace(found, goodness=goodness)
    record = {**found.to_dict(), "calibration": str(options.calibration), "log": str(options.log)}
    amiss = goodness.sentence
    faults = [note for note in found.notes if isinstance(note, Fault)]
    then = [] if amiss or faults else ["hallsym", "codegen", options.calibration, "-o", "decoupler"]
    if options.json:
        periodic = periodic_of(found.calibration, found.log)
        record["periodic_error"] = periodic.to_dict() if periodic else None
    wrote = []
    if options.plots:
        from hallsym.report.figures.campaign import save_evaluation

        wrote = save_evaluation(found, plots_place(options, options.log, options.calibration))
    say(
        options, record, lambda: evaluation_text(found, by_run=options.by_run), notes=found.notes,
        wrote=wrote, then=then,
    )  # fmt: skip
    for said in (*faults, *([amiss] if amiss and options.json else [])):
        print(f"hallsym: {said}", file=sys.stderr)
    return NOT_DESCRIBED if amiss or faults else OK
