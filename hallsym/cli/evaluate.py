"""`hallsym evaluate`: errors of a saved calibration on another log."""

from argparse import Namespace
from typing import Any

from hallsym.cli import OK
from hallsym.cli.common import command, log_options, noted, open_log, own_effects, own_option, say
from hallsym.errors import InputError
from hallsym.estimation import noise_of
from hallsym.estimation.calibration import Fit, load_fit
from hallsym.estimation.channel_assignment import as_read, rewired
from hallsym.estimation.decoding import logged_columns
from hallsym.estimation.gauss_newton import judge
from hallsym.log import Log, usable
from hallsym.report.tables import error_rows


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "evaluate", run,
        "Decode a log with a saved calibration and tabulate the errors against its reference. The zero\n"
        "deviations of each run are estimated from that run: a reset is a reset.",
    )  # fmt: skip
    parser.add_argument("calibration", metavar="CALIB", help="a calibration saved by 'hallsym fit -o'")
    parser.add_argument("log", metavar="LOG", help="log to judge on")
    own_option(parser)
    parser.add_argument("--by-run", action="store_true", help="one line per run")
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
    table = judge(log, known.model, known.values, noise.std)
    rows: dict[str, Any] = {"all runs": table.over()}
    if options.by_run:
        rows |= {f"run {run}": table.over([run]) for run in table.runs}
    record = {
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
            [error_rows(known.model.pose, rows, None, turning=known.model.period), *noted(notes)]
        ),
    )
    return OK


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
