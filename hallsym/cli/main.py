"""The command line: `hallsym fit LOG --model stage31 -o calib.json`, and what belongs to it."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, TextIO

import hallsym
from hallsym.cli import BAD_INPUT, BUG, COMMANDS, NOT_CONVERGED, OK
from hallsym.errors import InputError, one_line, quoted, summary
from hallsym.files import reason
from hallsym.guard import announce, task

DEBUG = "HALLSYM_DEBUG"
"""Environment variable that shows the traceback behind each sentence."""
OUTPUTS = ("output", "plots")
"""Options of all commands that name what is written."""

EPILOG = """\
exit codes: 0 done; 1 'watch' found a log that does not belong to its calibration; 2 bad input (one
sentence says what to do); 3 done and written, but the log leaves
parameters of the model undetermined or its recording is at fault (both are named), or the model does not
describe the log (the report of 'fit' or 'evaluate' begins with that); 4 the solver did not converge or was
interrupted (the best so far is written); 70 a mistake in hallsym itself (HALLSYM_DEBUG=1 shows where).

examples:
  hallsym demo                                    the paper's calibration on the bundled campaign
  hallsym fit LOG --model stage31 -o calib.json   calibrate a stage from your own log
  hallsym evaluate calib.json OTHER_LOG           errors of that calibration on another log
  hallsym watch calib.json NEW_LOG                does a new log still belong to that calibration
  hallsym diagnose LOG --model stage31            where the gap lies, why, and how far it shrinks
  hallsym report calib.json LOG -o report.html    one HTML page of a calibration
  hallsym info LOG                                what a log holds, and what is wrong with it
"""


def main(arguments: Sequence[str] | None = None, interrupted: Callable[[], bool] = lambda: False) -> int:
    """Run one command; returns its exit code. Bad input gives one sentence on stderr and 2.

    `interrupted`: whether Ctrl-C was pressed; a library may turn it into another exception.
    """
    try:
        with task():
            try:
                return _run(arguments)
            finally:
                sys.stdout.flush()
    except InputError as error:
        return _said(str(error), BAD_INPUT, error)
    except BrokenPipeError:
        _silence(sys.stdout)
        return OK
    except OSError as error:
        _silence(sys.stdout)
        what = f"read or write {quoted(error.filename)}" if error.filename else "write to standard output"
        return _said(f"Cannot {what}: {reason(error)}.", BAD_INPUT, error)
    except KeyboardInterrupt:
        return _said("interrupted; nothing was written.", NOT_CONVERGED)
    except MemoryError as error:
        return _said("There is not enough memory; use fewer samples or a larger machine.", BAD_INPUT, error)
    except Exception as error:
        if interrupted():
            return _said("interrupted; nothing was written.", NOT_CONVERGED)
        if type(error).__name__ == "LinAlgError":  # by name, because a command without numbers has no numpy
            return _said(
                f"The numbers of the inputs cannot be computed with ({summary(error)}): a value is far "
                "from what the model expects; look at the units and values of each file with 'hallsym info'.",
                BAD_INPUT,
                error,
            )
        return _said(_bug(error), BUG, error)


def _run(arguments: Sequence[str] | None) -> int:
    words = sys.argv[1:] if arguments is None else arguments
    parser = _parser(next((word for word in words if not word.startswith("-")), None))
    options = parser.parse_args(arguments)
    if options.version:
        print(f"hallsym {hallsym.__version__}")
        return OK
    if options.command is None:
        parser.print_help()
        return OK
    _check(options)
    return options.run(options)


def _check(options: argparse.Namespace) -> None:
    """Refuse empty words, which would be taken for no option, and outputs that are inputs."""
    for name, value in vars(options).items():
        if value == "" or (isinstance(value, list) and "" in value):
            raise InputError(f"'{name.replace('_', '-')}' must not be empty; give a value or leave it out.")
    for name in OUTPUTS:
        given = getattr(options, name, None) or []
        for path in [given] if isinstance(given, str) else given:
            announce(path)


def _said(sentence: str, code: int, error: BaseException | None = None) -> int:
    """Print one sentence on stderr; with the environment variable `HALLSYM_DEBUG` after the traceback."""
    if error is not None and os.environ.get(DEBUG):
        import traceback

        traceback.print_exception(error)
    try:
        print(f"hallsym: {one_line(sentence)}", file=sys.stderr)
    except OSError:
        _silence(sys.stderr)
    return code


def _bug(error: Exception) -> str:
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    place = f" at {Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno}" if frame else ""
    return (
        f"This is a mistake in hallsym, not in your input: {type(error).__name__} ({summary(error)}){place}; "
        f"please report it with the command and what it prints with {DEBUG}=1."
    )


def _silence(stream: TextIO) -> None:
    """Let the rest of what is printed go nowhere, so that nothing is raised when the interpreter ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one line, and that does not hide that a text could not be written."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong and end with 2."""
        self.exit(BAD_INPUT, f"{one_line(f'{self.prog}: {message}; see {self.prog} --help')}\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        (file or sys.stderr).write(message or "")


def _parser(called: str | None) -> argparse.ArgumentParser:
    """Return the parser with the options of the command that is called; the others are only listed."""
    parser = _Parser(
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
