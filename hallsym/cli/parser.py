"""The parser of the command line, which suggests the nearest word for a misspelt one."""

import argparse
import re
import sys
from argparse import Action, ArgumentParser, Namespace
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from textwrap import fill
from typing import Any, NoReturn

from hallsym.cli import BAD_INPUT, COMMANDS, GROUPS
from hallsym.errors import nearest, one_line, quoted
from hallsym.output import prose_width

DESCRIPTION = "From a log of Hall readings beside a reference to a calibrated position sensor."
EPILOG = """\
exit codes: 0 done; 1 'evaluate' found a log that does not belong to its calibration; 2 bad input (one
sentence says what to do); 3 done and written, but the log leaves parameters of the model undetermined or its
recording is at fault (both are named), or the model does not describe the log (the report of 'fit' or
'evaluate' begins with that); 4 the solver did not converge (the best so far is written); 70 a mistake in
hallsym itself (HALLSYM_DEBUG=1 shows where); 130 interrupted by Ctrl-C (nothing is written).

examples:
  hallsym demo                                    the paper's calibration on the bundled campaign
  hallsym fit LOG --model stage31 -o calib.json   calibrate a stage from your own log
  hallsym evaluate calib.json OTHER_LOG           its errors on another log; does that log belong to it
  hallsym diagnose LOG --model stage31            where the gap lies, why, and how far it shrinks
  hallsym report calib.json LOG -o report.html    one HTML page of a calibration
  hallsym info LOG                                what a log holds, and what is wrong with it
"""


def parser_of(commands: Sequence[str]) -> ArgumentParser:
    """Return the parser with the options of `commands`; the other commands are only listed."""
    parser = Parser(
        prog="hallsym",
        usage="hallsym [-h] [--version] COMMAND ...",
        description=f"{DESCRIPTION}\n\n{_listed()}",
        epilog=EPILOG,
        formatter_class=HelpText,
    )
    add_options(parser, "--version  print the version and exit")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", prog="hallsym", help=argparse.SUPPRESS)
    for name, what in COMMANDS.items():
        if name not in commands:
            sub.add_parser(name, help=what)
            continue
        module = import_module(f"hallsym.cli.{name}")
        own = sub.add_parser(name, help=what, formatter_class=HelpText, epilog=getattr(module, "EPILOG", ""))
        own.description = (module.__doc__ or "").partition("\n\n")[2]
        own.set_defaults(run=module.run)
        add_options(own, f"--json  print one JSON object instead of tables{module.OPTIONS}")
    return parser


_OPTION = re.compile(r"((?:-\w, )?[\w-]+)(?: ([^\s<]+))?(?: <([^>]*)>)?(?:  +(.*))?")
_READING = """\
[reading the file]
--column OURS=THEIRS <repeat>   our name, ending with the unit their column is in, such as
    hall_a_um=HallA (repeat); of an angle in counts also those of a turn:
    angle_count=raw,counts_per_turn=16384; of a log also a column file, such as columns.toml:
    [columns] hall_a_um = "HallA"
--format FORMAT                 csv, parquet and others that are listed below; by the ending if not given
--delimiter DELIMITER           of a text file: ';', tab, blank; recognised where it is not given
--decimal SIGN                  of its numbers: . or , where both would be possible
--sheet SHEET                   of a workbook or a database that has several
"""
SHARED = {
    "plots": """
--plots FOLDER                  {}
""",
    "model": """
[model]
--model MODEL                   such as stage31 or rotary; 'hallsym info' lists them (default: {})
--effect EFFECT <repeat>        add an effect, such as exact_rotation or mains_hum:frequency_hz=50.02
    (repeat)
--machine TOML                  your machine: [[probes]] with channel, position_m, senses;
    [parameters.H1x] with nominal, lower, upper, fixed
""",
    "correct": """
--correct TEXT <repeat>         undo a mistake of the recording, in the words of the claim: 'sign
    x_ref_m' (repeat)
""",
    "own": """
--effects PY                    your own effects: a file that defines EFFECTS
""",
    "table": _READING,
    "log": _READING
    + """\
--join FILE <repeat>            another file of the same log (repeat): more runs where it has the same
    columns, else columns that are read at the times of the slower file
--clock GROUP                   of several files, or of groups of one (TDMS, MDF, MCAP, HDF5), with clocks
    of their own: whose samples become the rows (default: the slowest); others are read there linearly
--drop-bad                      leave out bad samples and runs and go on; they are counted
--noise COLUMN=SIGMA <repeat>   1 sigma in SI: --noise hall_m=5e-7 (repeat); estimated from the log where
    not given
""",
}
"""Options of several commands; those that say how a file is read are explained by 'hallsym info --help'."""


def add_options(parser: Any, table: str, *, hidden: bool = False) -> None:
    """Add options from a table: a line each with names, METAVAR, `<how>` where that is to be said, and help.

    A line that is indented goes on with the one before. Without a METAVAR an option is a switch.
    `how`, with commas: `int`, `float` or `seed`; `=default`; `required`; `repeat` (a list); `optional`,
    `several` or `any` number of words; `alone=value` of an optional one without a word; choices as `a|b`.
    `[title]` begins a group, `[]` ends it; `@name words` stands for a table of `SHARED` with its words.
    `hidden`: from the help page.
    """
    group = parser
    for text in re.sub(r"\n +", " ", table).strip().split("\n"):
        if text.startswith("["):
            named = ", ".join(re.findall(r"^(--[\w-]+)", table, re.M))
            said = f"{named}: see 'hallsym info --help'" if hidden else None
            group = parser.add_argument_group(text[1:-1], said) if text != "[]" else parser
            continue
        if text.startswith("@"):
            name, _, said = text[1:].partition(" ")
            unexplained = name in ("table", "log") and said != "explained"
            add_options(parser, SHARED[name].format(said), hidden=unexplained)
            continue
        found = _OPTION.fullmatch(text)
        if found is None:
            raise ValueError(f"not a line of options: {text!r}")
        names, metavar, how, said = found.groups()
        said = argparse.SUPPRESS if hidden else said
        made: dict[str, Any] = {"help": said, "metavar": metavar}
        for word in filter(None, (how or "").split(", ")):
            kind, _, value = word.partition("=")
            if kind in _TYPES:
                made["type"] = _TYPES[kind]
            if word in _COUNTS:
                made["nargs"] = _COUNTS[word]
            elif kind == "alone":
                made |= {"nargs": "?", "const": made.get("type", str)(value) if value else False}
            elif "=" in word:
                made["default"] = made.get("type", str)(value)
            elif word == "repeat":
                made |= {"action": "append", "default": []}
            elif word == "required":
                made["required"] = True
            elif "|" in word:
                made |= {"choices": word.split("|"), "metavar": None}
        if names.startswith("-") and metavar is None:
            made = {"help": said, "action": "store_true"}
        group.add_argument(*names.split(", "), **made)


def seed(text: str) -> int:
    """Type of a seed on the command line."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"a seed is a whole number, 0 or more; instead received {text!r}")
    return int(text)


_TYPES = {"int": int, "float": float, "seed": seed}
_COUNTS = {"optional": "?", "several": "+", "any": "*"}


def _listed() -> str:
    width, lines = prose_width() - 2, []
    for task, commands in GROUPS.items():
        lines += [f"{task}:"]
        for name, what in commands.items():
            lines += fill(what, width, initial_indent=f"  {name:<13}", subsequent_indent=" " * 15).split("\n")
    return "\n".join(lines)


class HelpText(argparse.HelpFormatter):
    """Help whose paragraphs fit the terminal; indented lines (examples) stay as they are."""

    def __init__(self, prog: str) -> None:
        """Be as wide as the terminal is."""
        super().__init__(prog, width=prose_width() - 2)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines: list[str] = []
        paragraph: list[str] = []
        for line in [*text.split("\n"), ""]:
            plain = bool(line) and not line.startswith(" ")
            if plain:
                paragraph.append(line)
                if not line.endswith(":"):
                    continue
            if paragraph:
                lines.append(fill(" ".join(paragraph), width, break_long_words=False, break_on_hyphens=False))
                paragraph = []
            if not plain:
                lines.append(line)
        return "\n".join(lines).rstrip() + "\n"


class Parser(ArgumentParser):
    """A parser whose complaint is one line, and that does not hide that a text could not be written."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong and end with 2."""
        self.exit(BAD_INPUT, f"{one_line(f'{self.prog}: {message}; see {self.prog} --help')}\n")

    def parse_known_args(  # type: ignore[override]
        self, args: Any = None, namespace: Any = None
    ) -> tuple[Namespace, list[str]]:
        """Parse as argparse does, but name an option that does not exist before anything that follows."""
        words = list(sys.argv[1:] if args is None else args)
        for word in words:
            if word == "--" or (self._subparsers and not word.startswith("-")):
                break
            name = word.partition("=")[0]
            known = list(self._option_string_actions)
            if name.startswith("--") and " " not in name and not any(o.startswith(name) for o in known):
                self.error(f"there is no option {quoted(name)}{nearest(name, known)}")
        return super().parse_known_args(words, namespace)

    def _check_value(self, action: Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        near = nearest(str(value), known)
        if action.dest != "command":
            what = f"must be one of {', '.join(known)}; instead received {str(value)!r}{near}"
            raise argparse.ArgumentError(action, what)
        if Path(str(value)).exists():
            near = f" (did you mean 'hallsym info {value}'?)"
        near = near or f"; there are {', '.join(known)}"
        self.error(f"there is no command {str(value)!r}{near}")

    def _print_message(self, message: str, file: Any = None) -> None:
        (file or sys.stderr).write(message or "")
