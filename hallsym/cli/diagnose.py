"""`hallsym diagnose`: where the gap lies, which effect makes it, how far it shrinks."""

import shlex
from argparse import Namespace
from typing import Any

from hallsym.cli import INTERRUPTED, OK
from hallsym.cli.common import (
    command,
    log_options,
    model_options,
    open_log,
    own_effects,
    own_option,
    progress_of,
    reading_words,
    say,
)
from hallsym.diagnosis import Examined, examine, model_on, prepare
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit, load_fit
from hallsym.families import default_model
from hallsym.families.machine_file import read_machine
from hallsym.files import atomic_write, write_json
from hallsym.log import Log
from hallsym.log.columns import read_runs
from hallsym.model import Effect, Model
from hallsym.power import REPEATS, detection_power
from hallsym.report.data.gather import gather, version_of
from hallsym.report.page.diagnosis_page import diagnosis_page
from hallsym.report.text.diagnosis import diagnosis_text
from hallsym.report.text.power import power_text

EVERY = "all"
"""Word for every effect of the catalogue."""


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "diagnose", run,
        "Fit a model on a log, find the error that it leaves above the noise, which effect causes it, and\n"
        "how far the error shrinks with that effect in the model, judged on holdout runs.",
        "examples:\n"
        "  hallsym diagnose LOG --model stage31\n"
        "  hallsym diagnose LOG --model calib.json --holdout 2,7,12 --json\n"
        "  hallsym diagnose LOG --effects my_effects.py -o report.html\n"
        "  hallsym diagnose LOG --power hysteresis,time_skew      from which size on these would be found",
    )  # fmt: skip
    parser.add_argument("log", metavar="LOG", help="log, or a folder with log and meta.json")
    parser.add_argument(
        "--power", nargs="?", const=EVERY, metavar="EFFECTS",
        help="instead: what 'no gap' is worth: inject effects (by name; all take an hour or two, "
        "Ctrl-C keeps what was done) into its motion and noise, and diagnose each simulated log blind",
    )  # fmt: skip
    parser.add_argument(
        "--repeats", type=int, default=REPEATS, help=f"trials of each size with --power (default {REPEATS})"
    )
    parser.add_argument(
        "--holdout", metavar="RUNS", help="runs to judge on (default: the log's own, else every fifth)"
    )
    own_option(parser)
    parser.add_argument(
        "--threshold", type=float, help="relative decrease of the gap that counts (default 0.05)"
    )
    parser.add_argument(
        "--budget", type=float, metavar="SECONDS",
        help="end the search after so long with what it knows, which a note says (default: no limit)",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", action="append", default=[], metavar="FILE",
        help="save the diagnosis: .html for one page to read and print, anything else for JSON (repeat)",
    )  # fmt: skip
    model_options(parser, "the log's base_model, else by its columns")
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine, own = read_machine(options.machine), own_effects(options)
    known = load_fit(options.model, own) if str(options.model).endswith(".json") else None
    log = open_log(options, machine, known)
    name = options.model or default_model(log.meta)
    holdout = None if options.holdout is None else read_runs(options.holdout, "--holdout")
    if known:
        model: Model | Fit = known
    else:
        model = model_on(
            log,
            name,
            options.effect,
            parameters=machine.parameters,
            own=own,
            holdout=holdout,
            drop_bad=options.drop_bad,
        )
    if options.power:
        if options.budget is not None:
            raise InputError("--budget ends one search; --power makes many: choose one of the two.")
        return _power(options, log, model, holdout, tuple(own.values()))
    setup = prepare(
        log,
        model,
        holdout=holdout,
        effects=tuple(own.values()),
        threshold=options.threshold,
        drop_bad=options.drop_bad,
        budget=options.budget,
        on_progress=progress_of(options),
    )
    seen = examine(setup)
    found = seen.diagnosis
    for path in options.output:
        if path.lower().endswith((".html", ".htm")):
            atomic_write(path, _page(options, seen))
        else:
            write_json(path, found.to_dict())
    words = reading_words(options, known)
    say(options, found.to_dict(), lambda: diagnosis_text(found, words), wrote=options.output)
    return OK


def _power(
    options: Namespace, log: Log, model: Model | Fit, holdout: tuple[int, ...] | None, own: tuple[Effect, ...]
) -> int:
    """Say which effects a diagnosis of this log would find, and from which size on."""
    found = detection_power(
        log,
        model,
        names=None if options.power == EVERY else [n.strip() for n in options.power.split(",") if n.strip()],
        holdout=holdout,
        effects=own,
        threshold=options.threshold,
        repeats=options.repeats,
        drop_bad=options.drop_bad,
        on_progress=progress_of(options),
    )
    for path in options.output:
        write_json(path, found.to_dict())
    say(options, found.to_dict(), lambda: power_text(found), wrote=options.output)
    return OK if found.complete else INTERRUPTED


def _page(options: Namespace, seen: Examined) -> str:
    """The page of a diagnosis, with maps and series of what the model leaves, before and after."""
    first = seen.fit
    after = None if seen.after is None else version_of(seen.after, "after")
    shown = gather(seen.before.log, first, label="before", keep=first.keep, after=after)
    return diagnosis_page(
        seen.diagnosis,
        maps=shown.maps,
        after=shown.after,
        series=shown.series,
        fit=first,
        command=_typed(options, first),
        reading=reading_words(options),
    )


def _typed(options: Namespace, first: Fit) -> str:
    """Return the command that writes the page again; the name of the page does not change the page."""
    words = ["hallsym", "diagnose", options.log, "--model", options.model or first.model.name]
    words += [word for effect in options.effect for word in ("--effect", effect)]
    words += ["--holdout", options.holdout] if options.holdout else []
    words += [] if options.threshold is None else ["--threshold", f"{options.threshold:g}"]
    words += [] if options.budget is None else ["--budget", f"{options.budget:g}"]
    return shlex.join([*words, *reading_words(options), "-o", "report.html"])
