"""The one exception that a user's input can cause, and the words of its message."""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from hallsym.output import printable

LONGEST = 300
"""Characters of a message: three or four lines of a terminal."""
_LONGEST_WORD = 120
"""Characters of one word (a path, say) of a message that would be too long with all of it."""


class InputError(ValueError):
    """Bad input: its message is one sentence with fault, place, expectation and remedy.

    The message is one line of at most `LONGEST` characters, as `printable` shows them. It advises options
    where a command is carried out (`commanded`), else the arguments of Python that they stand for.
    The command line prints it and exits with status 2; a script catches it as `ValueError`.
    """

    def __init__(self, message: object = "", claims: Sequence[Any] = ()) -> None:
        """Take the sentence; `claims`: on the recording of a fit that failed."""
        text = str(message)
        super().__init__(one_line(text if os.environ.get(_COMMANDED) else in_python(text)))
        self.claims = tuple(claims)


_COMMANDED = "HALLSYM_COMMANDED"
"""Environment variable of a process that carries out a command, and of those that it starts."""


@contextmanager
def commanded() -> Iterator[None]:
    """Let errors advise the options of the command line meanwhile."""
    before = os.environ.get(_COMMANDED)
    os.environ[_COMMANDED] = "1"
    try:
        yield
    finally:
        os.environ.pop(_COMMANDED) if before is None else os.environ.update({_COMMANDED: before})


def uncomputable(error: BaseException) -> InputError:
    """Return the refusal of numbers that end linear algebra with `error`."""
    return InputError(
        f"The numbers of the inputs cannot be computed with ({summary(error)}): a value is far from "
        "what the model expects; look at the units and values of each file with 'hallsym info'."
    )


_ARGUMENTS = {"column": "columns", "correct": "corrections", "effect": "effects", "effects": "own",
              "range": "ranges", "join": "a list of files", "reference": "fit_without_reference",
              "bin": "width"}  # fmt: skip
"""Arguments of Python that have another name than the option."""
_PAIRS, _LISTS = ("column", "noise", "range", "value"), ("correct", "accept", "effect")
"""Options that stand for a dict, and for a list."""
_FLAGS = {"drop-bad", "force", "params-only", "jacobian", "allow-undetermined", "own-zero", "like-paper"}
_WORD = re.compile(r"[a-z]+|-+.*")
"""What follows an option in a sentence and is no value of it, unless it is one of these."""
_VALUES = {"hybrid", "direct", "float", "series", "table", "coasting", "none", "auto", "all"}


def in_python(text: str) -> str:
    """Return a sentence with the arguments of Python in place of the options of the command line.

    >>> in_python("Map it with --column hall_a_um=HallA, or leave it out with --drop-bad.")
    "Map it with columns={'hall_a_um': 'HallA'}, or leave it out with drop_bad=True."
    """
    return re.sub(r"'hallsym [^']*'|(?<![\w'-])--([a-z]+(?:-[a-z]+)*)(?: ('[^']*'|\S+))?", _argument, text)


def _argument(option: re.Match[str]) -> str:
    if option[1] is None:  # a command to copy
        return option[0]
    name, after = option[1], option[2] or ""
    value = after if after in (",", ".") else re.sub(r"(?<!\.)[.,;:)]$|(?<=\.\.\.)[,;:)]$", "", after)
    rest = after[len(value) :]
    python = _ARGUMENTS.get(name, name.replace("-", "_"))
    if name in _FLAGS:
        return f"{python}=True" + (f" {after}" if after else "")
    if not value or (_WORD.fullmatch(value) and value not in _VALUES) or name in ("join", "reference"):
        return python + (f" {after}" if after else "")
    if name in _PAIRS and "=" in value:
        key, _, given = value.partition("=")
        if name == "range" and key.endswith("_um"):  # a range of Python is in SI
            key, given = f"{key[:-3]}_m", ":".join(f"{end}e-6" for end in given.split(":"))
        given = f"({given.replace(':', ', ')})" if ":" in given else given
        shown = repr(given) if name == "column" else given
        return f"{python}={{{key!r}: {shown}}}{rest}"
    shown = value if re.fullmatch(r"[\d.]+|'.*'", value) and value != "." else repr(value)
    return f"{python}={f'[{shown}]' if name in _LISTS else shown}{rest}"


def require(good: object, what: str, wanted: str, received: object, known: Sequence[str] = ()) -> None:
    """Raise an `InputError` unless `good`; it names the nearest of the `known` words.

    >>> require(2 > 1, "Seed", "above 1", 2)
    """
    if not good:
        near = nearest(str(received), list(known)) if known else ""
        raise InputError(f"{what} must be {wanted}; instead received {received!r}{near}.")


def one_line(text: str) -> str:
    r"""Return `text` on one line of at most `LONGEST` characters, its middle left out where it is longer.

    >>> one_line("Log a\nb.csv does not exist.")
    'Log a\\nb.csv does not exist.'
    """
    text = printable(text[: 20 * LONGEST])
    if len(text) <= LONGEST:
        return text
    text = re.sub(rf"\S{{{_LONGEST_WORD + 1},}}", lambda m: _shortened(m[0], _LONGEST_WORD, "..."), text)
    return _shortened(text, LONGEST, " ... ")


def _shortened(text: str, length: int, gap: str) -> str:
    """Return both ends of a text; the longer one is that with the remedy, or the name of the file."""
    if len(text) <= length:
        return text
    last = (length - len(gap)) // 2
    return f"{text[: length - len(gap) - last].rstrip()}{gap}{text[-last:].lstrip()}"


def quoted(name: object) -> str:
    """Return a name for a message: as it is where it is one plain word, else in quotes.

    >>> quoted("log.csv"), quoted("my log.csv")
    ('log.csv', "'my log.csv'")
    """
    text = printable(name)
    return text if re.fullmatch(r"[\w./\\:~+=@%-]+", text) else f"'{text}'"


def summary(error: BaseException, most: int = 100) -> str:
    """Return the message of an exception of a library, on one line of at most `most` characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return (text if len(text) <= most else f"{text[: most - 3]}...").rstrip(".")


def nearest(name: str, known: list[str]) -> str:
    """Return `" (did you mean 'x'?)"` for the closest known name, or an empty string.

    A name that is known, but not in its place, is not offered again.
    """
    from difflib import get_close_matches

    folded = {k.lower(): k for k in reversed(known[:_COMPARED]) if k != name}
    hit = get_close_matches(name.lower()[:_LONGEST_WORD], list(folded), n=1, cutoff=0.5)
    return f" (did you mean '{folded[hit[0]]}'?)" if hit else ""


_COMPARED = 2000
"""Known names that a misspelt one is compared with: a folder may hold many more files."""


def listed(names: Sequence[str]) -> str:
    """Return names with commas and an and.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def few(names: Sequence[str], most: int = 6) -> str:
    """Return the first names, and how many more there are: no wall of names."""
    more = f" and {len(names) - most} more" if len(names) > most + 1 else ""
    return ", ".join(names[:most] if more else names) + more


def counted(number: int, thing: str) -> str:
    """Return a count with its noun.

    >>> counted(1, "run"), counted(22, "holdout run")
    ('1 run', '22 holdout runs')
    """
    plural = "es" if thing.endswith("ch") else "s"
    return f"{number} {thing}{'' if number == 1 else plural}"
