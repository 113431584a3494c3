"""`hallsym report`: one self-contained HTML page of a fit.

Write one self-contained HTML page of a calibration and a log: verdict, errors against the noise
floor, maps of the error, series to zoom, parameters. It opens from disk without a network.
The log is the one that was fitted, or another one of the same machine.
"""

import shlex
from argparse import Namespace
from dataclasses import replace

from hallsym.cli import OK
from hallsym.cli.common import open_log, own_effects, reading_words, say
from hallsym.estimation import load_fit
from hallsym.estimation.decoding import logged_columns
from hallsym.families.recording import as_read
from hallsym.files import atomic_write
from hallsym.log import check_log
from hallsym.log.phase import at_rest
from hallsym.report.content import document
from hallsym.report.results.fit import page_content

EPILOG = """\
example:
  hallsym report calib.json campaign.parquet -o report.html
"""
OPTIONS = """
calibration CALIB               a calibration saved by 'hallsym fit -o'
log LOG                         the log that was fitted, or another one
@own
-o, --output HTML <=report.html>  default: report.html
@correct
@log
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    known = load_fit(options.calibration, own_effects(options))
    log = at_rest(open_log(options, known=known, correct=options.correct), known.model)
    if not options.drop_bad:
        columns, read = logged_columns(known.model), as_read(log, known.model, known.corrections)
        log = replace(log, notes=tuple(check_log(read, columns)))
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
