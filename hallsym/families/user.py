"""The user's own effects: functions `Model -> Model` in a Python file."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from hallsym.errors import InputError
from hallsym.model import Effect
from hallsym.model.effect import as_effect


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Read `EFFECTS`, a tuple of functions `Model -> Model` or of `Effect`s, from a Python file.

    Raises `InputError` for a file that cannot be run or names no effects.
    """
    path = Path(path)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise InputError(f"Effects file {path} must be a Python file; it cannot be read.")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"Effects file {path} cannot be run: {type(error).__name__}: {error}.") from error
    listed = getattr(module, "EFFECTS", None)
    if not isinstance(listed, Sequence) or not listed or not all(map(callable, listed)):
        raise InputError(f"Effects file {path} must define EFFECTS, a tuple of functions Model -> Model.")
    return tuple(map(as_effect, listed))
