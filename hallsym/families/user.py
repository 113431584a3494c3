"""The user's own effects: functions `Model -> Model` in a Python file."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from hallsym.errors import InputError, quoted, summary
from hallsym.files import regular
from hallsym.model import Effect
from hallsym.model.effect import as_effect


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Read `EFFECTS`, a tuple of functions `Model -> Model` or of `Effect`s, from a Python file.

    Raises `InputError` for a file that cannot be run or names no effects.
    """
    path = regular(path, "Effects file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"Effects file {path} must be a Python file; it cannot be read.")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        what = f"{type(error).__name__}: {summary(error)}"
        raise InputError(f"Effects file {quoted(path)} cannot be run ({what}); correct it.") from error
    listed = getattr(module, "EFFECTS", None)
    if not isinstance(listed, Sequence) or not listed or not all(map(callable, listed)):
        raise InputError(f"Effects file {path} must define EFFECTS, a tuple of functions Model -> Model.")
    return tuple(map(as_effect, listed))
