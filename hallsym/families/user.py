"""The user's own effects: functions `Model -> Model` in a Python file."""

from collections.abc import Sequence
from pathlib import Path
from runpy import run_path

from hallsym.errors import InputError, quoted, summary
from hallsym.files import regular
from hallsym.model import Effect
from hallsym.model.effect import as_effect


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Read `EFFECTS`, a tuple of functions `Model -> Model` or of `Effect`s, from a Python file.

    Raises `InputError` for a file that cannot be run or names no effects.
    """
    path = regular(path, "Effects file")
    try:
        listed = run_path(str(path)).get("EFFECTS")
    except (Exception, SystemExit) as error:
        what = f"{type(error).__name__}: {summary(error)}"
        raise InputError(f"Effects file {quoted(path)} cannot be run ({what}); correct it.") from error
    if not isinstance(listed, Sequence) or not listed or not all(map(callable, listed)):
        raise InputError(f"Effects file {path} must define EFFECTS, a tuple of functions Model -> Model.")
    return tuple(map(as_effect, listed))
