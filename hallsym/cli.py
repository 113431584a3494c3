"""The command line: `hallsym fit LOG --model stage31 -o calib.json`, and what belongs to it."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from hallsym import commands
from hallsym.errors import InputError

OK, BAD_INPUT, NOT_DETERMINED, NOT_CONVERGED = 0, 2, 3, 4

EPILOG = """\
exit codes: 0 done; 2 bad input (one sentence says what to do); 3 done, but this log leaves parameters of
the model undetermined (they are named); 4 the solver did not converge or was interrupted (the best so far is
written).

examples:
  hallsym demo                                    the paper's calibration on the bundled campaign
  hallsym fit LOG --model stage31 -o calib.json   calibrate a stage from your own log
  hallsym evaluate calib.json OTHER_LOG           errors of that calibration on another log
  hallsym diagnose LOG --model stage31            where the gap lies, why, and how far it shrinks
  hallsym info LOG                                what a log holds, and what is wrong with it
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code. Bad input gives one sentence on stderr and 2."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.command is None:
        parser.print_help()
        return OK
    try:
        return options.run(options)
    except InputError as error:
        print(f"hallsym: {error}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:
        sys.stderr.close()
        return OK
    except KeyboardInterrupt:
        print("hallsym: interrupted; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED


def _parser() -> argparse.ArgumentParser:
    from hallsym import diagnose_command  # it uses this module's options

    parser = argparse.ArgumentParser(
        prog="hallsym",
        description="From a log of Hall readings beside a reference to a calibrated position sensor.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=commands.version())
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    _demo(sub)
    _fit(sub)
    _evaluate(sub)
    _info(sub)
    _simulate(sub)
    diagnose_command.add(sub)
    return parser


def _command(
    sub: Any, name: str, run: Any, help: str, description: str, epilog: str = ""
) -> argparse.ArgumentParser:
    parser = sub.add_parser(
        name, help=help, description=description, epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.set_defaults(run=run)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    return parser


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"a seed is a whole number, 0 or more; instead received {text!r}")
    return int(text)


def _log_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("reading the log")
    group.add_argument(
        "--column", action="append", default=[], metavar="OURS=THEIRS",
        help="our name, ending with the unit their column is in: --column hall_a_um=HallA (repeat)",
    )  # fmt: skip
    group.add_argument(
        "--column-file", metavar="TOML", help='the same as a file: [columns] hall_a_um = "HallA"'
    )
    group.add_argument("--format", help="parquet, csv, mat or hdf5, when the suffix does not tell")
    group.add_argument("--delimiter", help="of a CSV file, when it is not a comma")
    group.add_argument(
        "--drop-bad", action="store_true", help="leave out bad samples and runs and go on; they are counted"
    )
    group.add_argument(
        "--noise", action="append", default=[], metavar="COLUMN=SIGMA",
        help="1 sigma in SI: --noise hall_m=5e-7 (repeat); estimated from the log where not given",
    )  # fmt: skip


def _model_options(parser: argparse.ArgumentParser, default: str) -> None:
    group = parser.add_argument_group("model")
    group.add_argument("--model", help=f"stage15, stage30, stage31, stage31_tied (default: {default})")
    group.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME",
        help="add an effect, such as exact_rotation (repeat)",
    )
    group.add_argument(
        "--machine", metavar="TOML",
        help="your machine: [[probes]] with channel, position_m, senses; [parameters.H1x] with nominal, "
        "lower, upper, fixed",
    )  # fmt: skip


def _demo(sub: Any) -> None:
    parser = _command(
        sub, "demo", commands.demo, "the paper's calibration on the bundled campaign",
        "Calibrate the bundled 6-DOF stage campaign as Chen et al. (Sensors 2016, 16, 872) do: designed\n"
        "parameters, Model (30), Model (31), each beside the paper's own error table.",
    )  # fmt: skip
    parser.add_argument(
        "-o",
        "--output",
        default="demo",
        metavar="FOLDER",
        help="where calib.json and pictures go (default: demo)",
    )


def _fit(sub: Any) -> None:
    parser = _command(
        sub, "fit", commands.fit_log, "calibrate a model on a log",
        "Calibrate a model on a log of Hall readings beside a reference. Prints errors before and after,\n"
        "parameters with standard uncertainties in parentheses (on the last two digits), and what the data\n"
        "determine instead of parameters they cannot tell apart.",
        "examples:\n"
        "  hallsym fit campaign.parquet -o calib.json --plots pictures\n"
        "  hallsym fit log.csv --column hall_a_um=HallA --column x_ref_um=IFM_X ... --holdout 2,7,12\n"
        "  hallsym fit log.mat --machine mystage.toml --json > calib.json",
    )  # fmt: skip
    parser.add_argument(
        "log", metavar="LOG", help="Parquet, CSV, MATLAB or HDF5 file, or a folder with log and meta.json"
    )
    parser.add_argument("-o", "--output", metavar="JSON", help="save the calibration")
    parser.add_argument("--plots", metavar="FOLDER", help="save pictures")
    _model_options(parser, "the log's base_model, else stage31")
    group = parser.add_argument_group("fit")
    group.add_argument(
        "--holdout", metavar="RUNS", help="runs to judge on and not to fit, such as 2,7,12 or 40-45"
    )
    group.add_argument(
        "--solver",
        default="hybrid",
        help="hybrid (SHTLBO + closed form + IPOPT), direct (closed form + IPOPT), "
        "or the global stage: shtlbo, tlbo, gbtlbo, pso, screening",
    )
    group.add_argument(
        "--loss", default="auto", help="auto (take out isolated spikes if there are any), none, reject, tukey"
    )
    group.add_argument(
        "--resolve-wiring",
        action="store_true",
        help="find channel order and signs instead of refusing wrong ones",
    )
    group.add_argument("--seed", type=_seed, default=0, help="of the global stage (default 0)")
    _log_options(parser)


def _evaluate(sub: Any) -> None:
    parser = _command(
        sub, "evaluate", commands.evaluate, "errors of a saved calibration on another log",
        "Decode a log with a saved calibration and tabulate the errors against its reference. The zero\n"
        "deviations of each run are estimated from that run: a reset is a reset.",
    )  # fmt: skip
    parser.add_argument("calibration", metavar="CALIB", help="a calibration saved by 'hallsym fit -o'")
    parser.add_argument("log", metavar="LOG", help="log to judge on")
    parser.add_argument("--by-run", action="store_true", help="one line per run")
    _log_options(parser)


def _info(sub: Any) -> None:
    parser = _command(
        sub, "info", commands.info, "what a log, calibration or campaign file holds; or what hallsym knows",
        "Describe a log (columns, runs, motion, noise, what is wrong with it), a saved calibration or a\n"
        "campaign file. Without a file: the models, effects and solvers there are.",
    )  # fmt: skip
    parser.add_argument(
        "file", metavar="FILE", nargs="?", help="log, calibration (.json) or campaign (.toml)"
    )
    _log_options(parser)


def _simulate(sub: Any) -> None:
    parser = _command(
        sub, "simulate", commands.simulate, "write the log a known machine would record",
        "Simulate a campaign of a machine with known parameters: the paper's by default (Table 6 settings,\n"
        "sines at 1 Hz, 2 ms clock, Table A1 deviations, noise that reproduces Table 8), or any from TOML.",
    )  # fmt: skip
    parser.add_argument(
        "campaign", metavar="TOML", nargs="?", help="campaign file (default: the paper's campaign)"
    )
    parser.add_argument(
        "-o", "--output", required=True, metavar="LOG", help="log to write: .parquet, .csv, .h5 or .mat"
    )
    parser.add_argument("--seed", type=_seed, required=True, help="of noise and random zero deviations")
    parser.add_argument(
        "--values", metavar="JSON", help="calibration whose values are the truth (default: Table 7)"
    )
    parser.add_argument(
        "--noise-scale", type=float, default=1.0, help="factor on every noise level; 0 for a noise-free log"
    )
    parser.add_argument(
        "--correlation", type=float, default=0.0, metavar="S", help="correlation time of the noise [s]"
    )
    parser.add_argument(
        "--outliers",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="share of samples that are off by up to 1 mm or 1 mrad",
    )
    parser.add_argument(
        "--adc-step", type=float, default=0.0, metavar="M", help="round readings to this step [m]"
    )
    parser.add_argument(
        "--step", type=float, metavar="S", help="clock of the paper's campaign [s] (default 0.002)"
    )
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="length of each run of the paper's campaign [s] (default 1)",
    )
    _model_options(parser, "stage31")
