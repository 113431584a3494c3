"""`hallsym completion`: what a shell needs to complete commands, options, models, effects and files."""

from argparse import Action, ArgumentParser, Namespace, _SubParsersAction
from collections.abc import Iterator
from typing import Any

import shtab

from hallsym.cli import COMMANDS, OK
from hallsym.cli.common import command
from hallsym.cli.parser import parser_of
from hallsym.estimation import LOSSES, SOLVERS
from hallsym.families import effects, models
from hallsym.log.formats import FORMATS

SHELLS = ("bash", "zsh", "fish")


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "completion", run,
        "Print the script with which a shell completes commands, options, models, effects and files.",
        "examples:\n"
        "  hallsym completion bash > ~/.local/share/bash-completion/completions/hallsym\n"
        "  hallsym completion zsh > ~/.zfunc/_hallsym    with 'fpath+=~/.zfunc' before compinit in ~/.zshrc\n"
        "  hallsym completion fish > ~/.config/fish/completions/hallsym.fish",
        json=False,
    )  # fmt: skip
    parser.add_argument("shell", choices=SHELLS, help="the shell that is to complete")


def run(options: Namespace) -> int:
    """Carry the command out."""
    print(script(options.shell))
    return OK


def script(shell: str) -> str:
    """Return the completion script for a shell, one of `SHELLS`."""
    parser = parser_of(tuple(COMMANDS))
    kinds = completed()
    for action in _actions(parser):
        name = action.metavar if isinstance(action.metavar, str) else ""
        if action.choices is None and name in kinds:
            action.complete = kinds[name]  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell))


def completed() -> dict[str, Any]:
    """Return what is completed where an argument is called so in the help: names, files or folders."""
    known = sorted(models())
    names = {
        "MODEL": _words("models", known, files=True),
        "EFFECT": _words("effects", sorted(effects())),
        "SOLVER": _words("solvers", list(SOLVERS)),
        "LOSS": _words("losses", ["auto", *LOSSES]),
        "FORMAT": _words("formats", [entry.name for entry in FORMATS]),
        "FILE_OR_NAME": _words("subjects", sorted({*known, *effects()}), files=True),
    }
    files = dict.fromkeys(("LOG", "CALIB", "FILE", "JSON", "TOML", "HTML", "PY", "POINTS"), shtab.FILE)
    return {**names, **files, "FOLDER": shtab.DIRECTORY}


def _words(kind: str, words: list[str], *, files: bool = False) -> dict[str, Any]:
    """Return how each shell completes one of some words, or a file."""
    function, listed = f"_hallsym_{kind}", " ".join(words)
    path = {
        "bash": "compgen -f -- $1; ",
        "zsh": "_files; ",
        "fish": "__fish_complete_path (commandline -ct); ",
    }
    path = path if files else dict.fromkeys(path, "")
    return {
        "bash": function,
        "zsh": f"{{{path['zsh']}compadd {listed}}}",
        "fish": f"({function})",
        "preamble": {
            "bash": f"{function}() {{ {path['bash']}compgen -W '{listed}' -- $1; }}",
            "fish": f"function {function}; {path['fish']}printf '%s\\n' {listed}; end",
        },
    }


def _actions(parser: ArgumentParser) -> Iterator[Action]:
    """Yield the arguments of a parser and of its commands."""
    for action in parser._actions:
        yield action
        if isinstance(action, _SubParsersAction):
            action.help = "command"  # what is suppressed is not completed
            for name, below in action.choices.items():
                below.description = COMMANDS[name]  # shells show it in one line
                yield from _actions(below)
