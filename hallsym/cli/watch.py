"""`hallsym watch`: whether new logs still belong to a saved calibration."""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from hallsym.cli import BAD_INPUT, CHANGED, OK
from hallsym.cli.common import (
    command,
    log_options,
    open_log,
    own_effects,
    own_option,
    plots_options,
    plots_place,
    progress_of,
    reading_words,
    say,
)
from hallsym.estimation import load_fit
from hallsym.log import Log
from hallsym.report.text.watch import watch_text
from hallsym.watching import FALSE_ALARM, watch


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "watch", run,
        "Say of each log whether it still belongs to a calibration: its residual error against what the\n"
        "calibration left, and the drift of each parameter that the log identifies, from a fit of its own.\n"
        "The limits share one probability of a false alarm over all tests of a log.",
        "exit codes: 0 every log belongs; 1 one does not; 2 bad input, or a log could not be judged\n\n"
        "examples:\n"
        "  hallsym watch calib.json monday.csv\n"
        "  hallsym watch calib.json week_*.tdms --plots charts -o watch.json\n"
        "  hallsym watch calib.json today.mf4 --clock Hall:linear || mail -s 'calibrate again' lab",
    )  # fmt: skip
    parser.add_argument("calibration", metavar="CALIB", help="a calibration saved by 'hallsym fit -o'")
    parser.add_argument("logs", metavar="LOG", nargs="+", help="logs in the order of time")
    parser.add_argument(
        "--false-alarm", type=float, default=FALSE_ALARM, metavar="P",
        help=f"probability that a log which belongs is called changed (default {FALSE_ALARM:g})",
    )  # fmt: skip
    parser.add_argument("-o", "--output", metavar="JSON", help="save the record")
    plots_options(parser, "save a picture of the control chart")
    own_option(parser)
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    known = load_fit(options.calibration, own_effects(options))

    def read(path: Any) -> Log:
        options.log = path
        return open_log(options, known=known)

    found = watch(
        known,
        options.logs,
        false_alarm=options.false_alarm,
        drop_bad=options.drop_bad,
        read=read,
        name=options.calibration,
        on_progress=progress_of(options),
    )
    wrote: list[str | Path] = []
    if options.output:
        found.save(options.output)
        wrote.append(options.output)
    if options.plots:
        from hallsym.report.figures.watch import save_watch

        wrote += save_watch(found, plots_place(options, options.calibration, found.model))
    say(options, found.to_dict(), lambda: watch_text(found, reading_words(options)), wrote=wrote)
    for log in found.not_judged:
        print(f"hallsym: {log.reason}", file=sys.stderr)
    if found.changed:
        return CHANGED
    return BAD_INPUT if found.not_judged else OK
