"""`hallsym fit`: calibrate a model on a log."""

import shlex
import sys
from argparse import Namespace
from dataclasses import replace
from typing import Any

from hallsym.cli import INTERRUPTED, NOT_CONVERGED, NOT_DESCRIBED, NOT_DETERMINED, OK
from hallsym.cli.common import (
    command,
    log_options,
    model_options,
    open_log,
    own_effects,
    own_option,
    progress_of,
    reading_words,
    run_numbers,
    save_fit_pictures,
    say,
    seed,
)
from hallsym.diagnosis import model_on
from hallsym.estimation.calibration import Fit, added_effects
from hallsym.estimation.fit import fit
from hallsym.families import plain
from hallsym.families.machine_file import read_machine
from hallsym.log import Fault
from hallsym.model import Model
from hallsym.report.text.fit import fit_text


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "fit", run,
        "Calibrate a model on a log of Hall readings beside a reference. Prints errors before and after,\n"
        "parameters with standard uncertainties in parentheses (on the last two digits), and what the data\n"
        "determine instead of parameters they cannot tell apart. Where the model does not describe the log,\n"
        "the report begins with that, and the exit code is 3; the calibration is written all the same.",
        "examples:\n"
        "  hallsym fit campaign.parquet -o calib.json --plots pictures\n"
        "  hallsym fit log.csv --column hall_a_um=HallA --column x_ref_um=IFM_X ... --holdout 2,7,12\n"
        "  hallsym fit log.mat --machine mystage.toml --json > calib.json\n"
        "  hallsym fit campaign.parquet --effect hysteresis    what 'hallsym diagnose' found",
    )  # fmt: skip
    parser.add_argument(
        "log", metavar="LOG", help="Parquet, CSV, MATLAB or HDF5 file, or a folder with log and meta.json"
    )
    parser.add_argument("-o", "--output", metavar="JSON", help="save the calibration")
    parser.add_argument("--plots", metavar="FOLDER", help="save pictures")
    model_options(parser, "the log's base_model, else by its columns")
    own_option(parser)
    group = parser.add_argument_group("fit")
    group.add_argument(
        "--holdout", metavar="RUNS", help="runs to judge on and not to fit, such as 2,7,12 or 40-45"
    )
    group.add_argument(
        "--solver",
        metavar="SOLVER",
        default="hybrid",
        help="hybrid (SHTLBO + closed form + IPOPT), direct (closed form + IPOPT), "
        "or the global search: shtlbo, tlbo, gbtlbo, pso, mpso, screening",
    )
    group.add_argument(
        "--loss",
        metavar="LOSS",
        default="auto",
        help="auto (take out isolated spikes if there are any), none, reject, tukey",
    )
    group.add_argument(
        "--resolve-wiring",
        action="store_true",
        help="find channel order and signs instead of refusing wrong ones",
    )
    group.add_argument("--seed", type=seed, default=0, help="of the global search (default 0)")
    log_options(parser)


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine = read_machine(options.machine)
    log = open_log(options, machine)
    holdout = None if options.holdout is None else run_numbers(options.holdout)
    model: Model | str | None = options.model
    if options.effect:
        model = model_on(
            log,
            options.model,
            options.effect,
            parameters=machine.parameters,
            own=own_effects(options),
            holdout=holdout,
            drop_bad=options.drop_bad,
            on_progress=progress_of(options),
        )
    result = fit(
        log,
        model,
        solver=options.solver,
        holdout=holdout,
        loss=options.loss,
        parameters=None if options.effect else machine.parameters,
        resolve_wiring=options.resolve_wiring,
        drop_bad=options.drop_bad,
        seed=options.seed,
        on_progress=progress_of(options),
    )
    if result.goodness:
        goodness = replace(result.goodness, next_command=_diagnose(options, result))
        result = replace(result, goodness=goodness)
    if options.output:
        result.save(options.output)
    pictures = save_fit_pictures(log, result, options.plots)
    wrote = [*([options.output] if options.output else []), *pictures]
    say(options, result.to_dict(), lambda: fit_text(result), wrote=wrote, then=_next(options, result))
    return exit_code(result, said=not options.json)


def _diagnose(options: Namespace, result: Fit) -> str:
    """Return the command that finds what the model leaves, with the options that were given."""
    words = ["hallsym", "diagnose", options.log, "--model", plain(result.model).name]
    words += [word for effect in added_effects(result.model) for word in ("--effect", effect)]
    words += ["--holdout", options.holdout] if options.holdout else []
    return shlex.join([*words, *reading_words(options)])


def _next(options: Namespace, result: Fit) -> list[str]:
    """Return the words of the command that follows a fit, where its first line does not say one."""
    if (result.goodness and result.goodness.sentence) or result.status != "converged":
        return []
    if not options.output:
        return [*options.typed, "-o", "calib.json"]
    if result.undetermined_by_log:
        return ["hallsym", "sensitivity", options.output, options.log]
    return ["hallsym", "report", options.output, options.log, "-o", "report.html"]


def exit_code(result: Fit, *, said: bool = True) -> int:
    """0, or 3 and 4 with one sentence on stderr that says what is missing, or wrong with the recording.

    `said`: the text that was printed begins with the sentence on a model that does not describe its log.
    """
    faults = [note for note in result.notes if isinstance(note, Fault)]
    for fault in faults:
        print(f"hallsym: {fault}", file=sys.stderr)
    if result.status != "converged":
        print(f"hallsym: the solver did not converge ({result.status}): {result.message}.", file=sys.stderr)
        return INTERRUPTED if result.status == "interrupted" else NOT_CONVERGED
    if result.undetermined_by_log:
        what = ", ".join(result.undetermined_by_log)
        print(
            f"hallsym: this log does not determine {what} of {result.model.name}: "
            "they are fixed or combined as the table says; record runs that move what they belong to.",
            file=sys.stderr,
        )
        return NOT_DETERMINED
    amiss = result.goodness and result.goodness.sentence
    if amiss and not said:
        print(f"hallsym: {amiss}", file=sys.stderr)
    if amiss:
        return NOT_DESCRIBED
    return NOT_DETERMINED if faults else OK
