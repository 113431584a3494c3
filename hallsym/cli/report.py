"""`hallsym report`: one self-contained HTML page of a fit."""

import shlex
from argparse import Namespace
from dataclasses import replace
from typing import Any

from hallsym.cli import OK
from hallsym.cli.common import command, log_options, open_log, own_effects, own_option, reading_words, say
from hallsym.cli.parser import add_options
from hallsym.estimation import load_fit
from hallsym.estimation.decoding import logged_columns
from hallsym.families.recording import as_read
from hallsym.files import atomic_write
from hallsym.log import check_log
from hallsym.log.phase import at_rest
from hallsym.report.content import document
from hallsym.report.results.fit import page_content


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "report", run,
        "Write one self-contained HTML page of a calibration and a log: verdict, errors against the noise\n"
        "floor, maps of the error, series to zoom, parameters. It opens from disk without a network.\n"
        "The log is the one that was fitted, or another one of the same machine.",
        "example:\n  hallsym report calib.json campaign.parquet -o report.html",
    )  # fmt: skip
    add_options(parser, """
        calibration CALIB               a calibration saved by 'hallsym fit -o'
        log LOG                         the log that was fitted, or another one""")  # fmt: skip
    own_option(parser)
    add_options(parser, """
        -o, --output HTML <=report.html>  default: report.html""")  # fmt: skip
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    known = load_fit(options.calibration, own_effects(options))
    log = at_rest(open_log(options, known=known), known.model)
    if not options.drop_bad:
        columns, wired = logged_columns(known.model), as_read(log, known.model, known.corrections)
        log = replace(log, notes=tuple(check_log(wired, columns)))
    # the command without the name of the page, so that the name does not change the page
    typed = shlex.join(["hallsym", "report", options.calibration, options.log, *reading_words(options)])
    content = page_content(log, known, command=typed, calibration=str(options.calibration))
    page = document(content).encode()
    atomic_write(options.output, page)
    record = {
        "report": str(options.output),
        "bytes": len(page),
        "calibration": str(options.calibration),
        "log": str(options.log),
        "model": known.model.name,
    }
    say(options, record, lambda: content.answer, wrote=[options.output])
    return OK
