"""`hallsym selftest`: which effects a diagnosis of this log would find, and from which size on."""

import json
from argparse import ArgumentTypeError, Namespace
from pathlib import Path
from typing import Any

from hallsym.cli import INTERRUPTED, OK
from hallsym.cli.common import (
    command,
    log_options,
    model_options,
    open_log,
    plots_options,
    plots_place,
    progress_of,
    run_numbers,
    say,
    seed,
)
from hallsym.diagnosis import RATIOS, REPEATS, ROWS, load_effects, selftest
from hallsym.estimation.calibration import load_fit
from hallsym.families import build, default_model
from hallsym.families.machine_file import read_machine
from hallsym.files import atomic_write
from hallsym.report.text.selftest import selftest_text

FIRST_LOOK_S = 100.0
"""Seconds of trials of `--quick`: with the fit before them, two minutes."""


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "selftest", run,
        "Fit a model and simulate it on the recorded motion. Inject each effect of the catalogue at several\n"
        "sizes, with noise like that of the log, and diagnose each simulated log blind. Print which effects\n"
        "would be found, from which size on, and which would be taken for another. Takes an hour or two for\n"
        "all effects, minutes for a few; --quick ends after two minutes. Ctrl-C keeps what was done.",
        "examples:\n"
        "  hallsym selftest LOG --model stage31 --quick\n"
        "  hallsym selftest LOG --effects hysteresis,time_skew --sizes 1.1,1.2\n"
        "  hallsym selftest LOG --user-effects my_effects.py --effects speed_gain",
    )  # fmt: skip
    parser.add_argument("log", metavar="LOG", help="log, or a folder with log and meta.json")
    parser.add_argument("--effects", metavar="NAMES", help="try only these, such as hysteresis,time_skew")
    parser.add_argument("--user-effects", metavar="PY", help="your own effects: a file that defines EFFECTS")
    parser.add_argument(
        "--sizes", type=numbers, default=RATIOS, metavar="RATIOS",
        help="gap over noise floor, such as 1.07,1.3,2 (the default)",
    )  # fmt: skip
    parser.add_argument(
        "--repeats", type=int, default=REPEATS, help=f"trials of each size (default {REPEATS})"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a first look of two minutes: one trial of each size, the largest of each effect first, without "
        "bounds; what is not reached is listed",
    )
    parser.add_argument("--seed", type=seed, default=0, help="of signs, instants and noise (default 0)")
    parser.add_argument(
        "--rows", type=int, default=ROWS, metavar="N",
        help=f"decimate the log to about N samples, motion and mains resolved (default {ROWS})",
    )  # fmt: skip
    parser.add_argument(
        "--holdout", metavar="RUNS", help="runs to judge on (default: the log's own, else every fifth)"
    )
    parser.add_argument(
        "--threshold", type=float, help="relative decrease of the gap that counts (default 0.05)"
    )
    parser.add_argument("-o", "--output", metavar="JSON", help="save the result")
    plots_options(parser, "save a picture of detection against size")
    model_options(parser, "the log's base_model, else by its columns")
    log_options(parser)


def numbers(text: str) -> tuple[float, ...]:
    """Type of a list of numbers on the command line."""
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise ArgumentTypeError(
            f"numbers such as 1.07,1.3,2 are expected; instead received {text!r}"
        ) from None


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine = read_machine(options.machine)
    known = load_fit(options.model) if str(options.model).endswith(".json") else None
    log = open_log(options, machine, known)
    name = options.model or default_model(log.meta)
    model: Any = known
    if known is None:
        model = build(name, meta=log.meta, added=tuple(options.effect), parameters=machine.parameters)
    found = selftest(
        log,
        model,
        names=None
        if options.effects is None
        else [n.strip() for n in options.effects.split(",") if n.strip()],
        holdout=None if options.holdout is None else run_numbers(options.holdout),
        effects=load_effects(options.user_effects) if options.user_effects else (),
        threshold=options.threshold,
        ratios=options.sizes,
        repeats=options.repeats,
        seconds=FIRST_LOOK_S if options.quick else None,
        seed=options.seed,
        rows=options.rows,
        drop_bad=options.drop_bad,
        on_progress=progress_of(options),
    )
    wrote = []
    if options.output:
        atomic_write(options.output, json.dumps(found.to_dict(), indent=1, allow_nan=False) + "\n")
        wrote.append(Path(options.output))
    if options.plots:
        from hallsym.report.figures.detection import save_detection

        wrote += save_detection(found, plots_place(options, options.log, found.model))
    say(options, found.to_dict(), lambda: selftest_text(found), wrote=wrote)
    return OK if found.complete else INTERRUPTED
