"""`hallsym diagnose`: its options, and what it does."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from hallsym import cli, commands
from hallsym.calibration import load_fit
from hallsym.diagnosis import diagnose, diagnosis_text, load_effects
from hallsym.families import build
from hallsym.machine import read_machine

OK = 0


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = cli._command(
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
    cli._model_options(parser, "the log's base_model, else stage31")
    cli._log_options(parser)


def run(options: Namespace) -> int:
    """`hallsym diagnose`."""
    machine = read_machine(options.machine)
    log = commands._open(options, machine)
    name = options.model or log.meta.base_model or "stage31"
    if str(name).endswith(".json"):
        model: Any = load_fit(name)
    else:
        model = build(name, meta=log.meta, added=tuple(options.effect), parameters=machine.parameters)
    found = diagnose(
        log,
        model,
        holdout=None if options.holdout is None else commands._runs(options.holdout),
        effects=load_effects(options.effects) if options.effects else (),
        threshold=options.threshold,
        drop_bad=options.drop_bad,
        on_progress=commands._progress(options),
    )
    if options.output:
        import json

        Path(options.output).write_text(json.dumps(found.to_dict(), indent=1) + "\n", encoding="utf-8")
    commands._say(options, found.to_dict(), lambda: diagnosis_text(found))
    return OK
