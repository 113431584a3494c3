"""The user's own effects: functions `Model -> Model` in a Python file."""

import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path

from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.errors import InputError
from hallsym.model import Model


def user_effect(make: Callable[[Model], Model]) -> Effect:
    """Return a plain function `Model -> Model` as an effect; its docstring is its meaning."""
    meaning = (make.__doc__ or "").strip().split("\n")[0]

    def variants(model: Model, facts: Facts) -> list[Variant]:
        return [Variant("as given", make, text=make.__name__)]

    return Effect(make.__name__, "user", meaning, variants, "a recording that moves what it depends on")


def makes(effects: Sequence[Effect]) -> dict[str, Callable[[Model], Model]]:
    """Return effects as functions `Model -> Model` by name; one with several forms acts in its first."""

    def first(effect: Effect) -> Callable[[Model], Model]:
        def make(model: Model) -> Model:
            tried = effect.variants(model, Facts(1.0, 1.0, ()))
            wide = tried[0].make(model) if tried else None
            if not isinstance(wide, Model):
                raise InputError(
                    f"Effect {effect.name} must return a Model; instead it returned {type(wide).__name__}."
                )
            return wide

        return make

    return {effect.name: first(effect) for effect in effects}


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Read `EFFECTS`, a tuple of functions `Model -> Model` (or `Effect`s), from a Python file.

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
    if (
        not isinstance(listed, Sequence)
        or not listed
        or not all(isinstance(e, Effect) or callable(e) for e in listed)
    ):
        raise InputError(f"Effects file {path} must define EFFECTS, a tuple of functions Model -> Model.")
    return tuple(e if isinstance(e, Effect) else user_effect(e) for e in listed)
