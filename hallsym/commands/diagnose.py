"""`hallsym diagnose`: where the gap lies, which effect makes it, how far it shrinks."""

import json
import shlex
from argparse import Namespace
from typing import Any

from hallsym.calibration import Fit, load_fit
from hallsym.commands.common import (
    OK,
    command,
    log_options,
    model_options,
    open_log,
    progress_of,
    run_numbers,
    say,
)
from hallsym.diagnosis import Diagnosis, diagnose, diagnosis_text, load_effects
from hallsym.diagnosis.compare import compare
from hallsym.diagnosis.compare_text import comparison_text
from hallsym.errors import InputError
from hallsym.families import build, default_model
from hallsym.files import atomic_write
from hallsym.fitting import fit
from hallsym.log import Log
from hallsym.machine import read_machine
from hallsym.model import Model
from hallsym.page import diagnosis_page, gather


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "diagnose", run, "where the gap lies, which effect makes it, how far it shrinks",
        "Fit a model on a log, find what it leaves above the noise, which effect explains it, and how\n"
        "far the gap shrinks once that effect is added, judged on held-out runs.",
        "examples:\n"
        "  hallsym diagnose LOG --model stage31\n"
        "  hallsym diagnose LOG --model calib.json --holdout 2,7,12 --json\n"
        "  hallsym diagnose LOG --effects my_effects.py -o report.html\n"
        "  hallsym diagnose --compare before.json after.json",
    )  # fmt: skip
    parser.add_argument("log", metavar="LOG", nargs="?", help="log, or a folder with log and meta.json")
    parser.add_argument(
        "--compare", nargs=2, metavar=("BEFORE", "AFTER"),
        help="instead: what changed between two saved diagnoses (or calibrations) of one machine",
    )  # fmt: skip
    parser.add_argument(
        "--holdout", metavar="RUNS", help="runs to judge on (default: the log's own, else every fifth)"
    )
    parser.add_argument("--effects", metavar="PY", help="your own effects: a file that defines EFFECTS")
    parser.add_argument(
        "--threshold", type=float, help="relative decrease of the gap that counts (default 0.05)"
    )
    parser.add_argument(
        "-o", "--output", action="append", default=[], metavar="FILE",
        help="save the diagnosis: .html for one page to read and print, anything else for JSON (repeat)",
    )  # fmt: skip
    model_options(parser, "the log's base_model, else by its columns")
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    if options.compare:
        return _compare(options)
    if options.log is None:
        raise InputError("A log to diagnose must be given, or --compare with two saved diagnoses.")
    machine = read_machine(options.machine)
    log = open_log(options, machine)
    name = options.model or default_model(log.meta)
    if str(name).endswith(".json"):
        model: Model | Fit = load_fit(name)
    else:
        model = build(name, meta=log.meta, added=tuple(options.effect), parameters=machine.parameters)
    holdout = None if options.holdout is None else run_numbers(options.holdout)
    found = diagnose(
        log,
        model,
        holdout=holdout,
        effects=load_effects(options.effects) if options.effects else (),
        threshold=options.threshold,
        drop_bad=options.drop_bad,
        on_progress=progress_of(options),
    )
    for path in options.output:
        if path.lower().endswith((".html", ".htm")):
            atomic_write(path, _page(options, log, model, found))
        else:
            _save(path, found.to_dict())
    written = [f"wrote {path}" for path in options.output]
    say(options, found.to_dict(), lambda: "\n".join([diagnosis_text(found), *written]))
    return OK


def _save(path: str, record: dict[str, Any]) -> None:
    atomic_write(path, json.dumps(record, indent=1, allow_nan=False) + "\n")


def _page(options: Namespace, log: Log, model: Model | Fit, found: Diagnosis) -> str:
    """The page of a diagnosis, with maps and series of what the model by itself leaves."""
    base = model.model if isinstance(model, Fit) else model
    first = fit(
        log,
        base,
        solver="direct",
        holdout=found.validation_runs,
        resolve_wiring=True,
        drop_bad=options.drop_bad,
    )
    source = first.source or log
    seen = gather(source, {"before": first}, keep=first.keep)
    command = shlex.join(["hallsym", "diagnose", options.log, "--model", options.model or base.name])
    return diagnosis_page(found.to_dict(), maps=seen.maps, series=seen.series, fit=first, command=command)


def _compare(options: Namespace) -> int:
    if options.log is not None:
        raise InputError(
            f"--compare reads saved diagnoses only; leave the log {options.log} out, or diagnose it first."
        )
    changed = compare(*options.compare)
    for path in options.output:
        _save(path, changed.to_dict())
    say(options, changed.to_dict(), lambda: comparison_text(changed))
    return OK
