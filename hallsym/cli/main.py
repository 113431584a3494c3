"""The command line: `hallsym fit LOG --model stage31 -o calib.json`, and what belongs to it."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

import hallsym
from hallsym.cli import BAD_INPUT, COMMANDS, NOT_CONVERGED, OK
from hallsym.errors import InputError

EPILOG = """\
exit codes: 0 done; 2 bad input (one sentence says what to do); 3 done, but this log leaves parameters of
the model undetermined, or its recording is at fault (both are named); 4 the solver did not converge or was
interrupted (the best so far is written).

examples:
  hallsym demo                                    the paper's calibration on the bundled campaign
  hallsym fit LOG --model stage31 -o calib.json   calibrate a stage from your own log
  hallsym evaluate calib.json OTHER_LOG           errors of that calibration on another log
  hallsym diagnose LOG --model stage31            where the gap lies, why, and how far it shrinks
  hallsym report calib.json LOG -o report.html    one HTML page of a calibration
  hallsym info LOG                                what a log holds, and what is wrong with it
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code. Bad input gives one sentence on stderr and 2."""
    words = sys.argv[1:] if arguments is None else arguments
    parser = _parser(next((word for word in words if not word.startswith("-")), None))
    options = parser.parse_args(arguments)
    if options.version:
        print(f"hallsym {hallsym.__version__}")
        return OK
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


def _parser(called: str | None) -> argparse.ArgumentParser:
    """Return the parser with the options of the command that is called; the others are only listed."""
    parser = argparse.ArgumentParser(
        prog="hallsym",
        description="From a log of Hall readings beside a reference to a calibrated position sensor.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    for name, what in COMMANDS.items():
        if name == called:
            import_module(f"hallsym.cli.{name}").add(sub)
        else:
            sub.add_parser(name, help=what)
    return parser
