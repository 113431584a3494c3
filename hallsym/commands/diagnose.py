"""`hallsym diagnose`: where the gap lies, which effect makes it, how far it shrinks."""

import json
from argparse import Namespace
from typing import Any

from hallsym.calibration import load_fit
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
from hallsym.diagnosis import diagnose, diagnosis_text, load_effects
from hallsym.families import build
from hallsym.files import atomic_write
from hallsym.machine import read_machine


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "diagnose", run, "where the gap lies, which effect makes it, how far it shrinks",
        "Fit a model on a log, find what it leaves above the noise, which effect explains it, and how\n"
        "far the gap shrinks once that effect is added, judged on held-out runs.",
        "examples:\n"
        "  hallsym diagnose LOG --model stage31\n"
        "  hallsym diagnose LOG --model calib.json --holdout 2,7,12 --json\n"
        "  hallsym diagnose LOG --effects my_effects.py",
    )  # fmt: skip
    parser.add_argument("log", metavar="LOG", help="log, or a folder with log and meta.json")
    parser.add_argument(
        "--holdout", metavar="RUNS", help="runs to judge on (default: the log's own, else every fifth)"
    )
    parser.add_argument("--effects", metavar="PY", help="your own effects: a file that defines EFFECTS")
    parser.add_argument(
        "--threshold", type=float, help="relative decrease of the gap that counts (default 0.05)"
    )
    parser.add_argument("-o", "--output", metavar="JSON", help="save the diagnosis")
    model_options(parser, "the log's base_model, else stage31")
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine = read_machine(options.machine)
    log = open_log(options, machine)
    name = options.model or log.meta.base_model or "stage31"
    if str(name).endswith(".json"):
        model: Any = load_fit(name)
    else:
        model = build(name, meta=log.meta, added=tuple(options.effect), parameters=machine.parameters)
    found = diagnose(
        log,
        model,
        holdout=None if options.holdout is None else run_numbers(options.holdout),
        effects=load_effects(options.effects) if options.effects else (),
        threshold=options.threshold,
        drop_bad=options.drop_bad,
        on_progress=progress_of(options),
    )
    if options.output:
        atomic_write(options.output, json.dumps(found.to_dict(), indent=1, allow_nan=False) + "\n")
    say(options, found.to_dict(), lambda: diagnosis_text(found))
    return OK
