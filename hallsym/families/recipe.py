"""What a model is built again from, in a file or in another process: names and numbers, no expressions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hallsym.errors import InputError
from hallsym.families import build, known_effect, plain
from hallsym.log import Meta
from hallsym.model import Family, Model


@dataclass(frozen=True, eq=False)
class Recipe:
    """Name of a model, effects added to it, entries of its layout, nominal values and bounds that it has."""

    model: str
    added: tuple[str, ...]
    layout: tuple[Mapping[str, Any], ...]
    parameters: Mapping[str, Mapping[str, float]]


def added_effects(model: Model) -> Sequence[str]:
    """Return the effects that `model` has beyond those its name stands for, with their numbers."""
    new = [model.texts.get(effect, effect) for effect in model.effects[len(plain(model).effects) :]]
    return list(dict.fromkeys(new))


def layout_of(model: Model) -> list[dict[str, Any]]:
    """Return the layout of a model as a file states it."""
    return [dict(part.entry) for part in model.layout]


def recipe_of(model: Model) -> Recipe:
    """Return what `model` is built again from. Raises `InputError` where that takes somebody's own code."""
    added = tuple(added_effects(model))
    foreign = [effect for effect in added if not known_effect(effect, model.family)]
    changes = {p.name: {"nominal": p.nominal, "lower": p.lower, "upper": p.upper}
               for p in (*model.parameters, *model.zeros)}  # fmt: skip
    recipe = Recipe(model.name, added, tuple(layout_of(model)), changes)
    if foreign or model.family.maker(model.name) is None or _chain(made(recipe)) != _chain(model):
        what = f"Effect {foreign[0]}" if foreign else f"Model {model.name}"
        raise InputError(
            f"{what} holds code that is not hallsym's own, which workers do not have; leave workers out, and "
            "the log is read in one process."
        )
    return recipe


def _chain(model: Model) -> tuple[Any, ...]:
    return tuple(link for link, _ in model.steps), model.names, model.channels, model.references, model.state


def made(
    recipe: Recipe,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    families: Sequence[Family] = (),
) -> Model:
    """Return the model; `own`, `families` as for `build`."""
    meta = Meta(probes=[dict(entry) for entry in recipe.layout])
    model = build(recipe.model, meta=meta, added=recipe.added, own=own, families=families)
    return model.with_parameters(recipe.parameters)
