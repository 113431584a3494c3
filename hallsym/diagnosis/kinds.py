"""How each family of sensors is diagnosed: its catalogue, and where on it a residual may live."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from hallsym.diagnosis.effect import Effect
from hallsym.errors import InputError
from hallsym.families.rotary import effects as rotary_effects
from hallsym.families.stage import effects as stage_effects
from hallsym.model import Model


@dataclass(frozen=True, eq=False)
class Kind:
    """What a family gives to the diagnosis: the effects it may have.

    `direct`: the model as it is cheapest to evaluate. `pairs`: whether a flexible effect is held against
    pairs of plain ones (`plainer.plain_pairs`). `most`: effects that are added at most. `waves`: of a pose
    that turns, waves of error per turn -> effects that make them.
    """

    catalogue: tuple[Effect, ...]
    direct: Callable[[Model], Model] = lambda model: model
    pairs: bool = False
    most: int = 3
    waves: Mapping[int, tuple[str, ...]] = field(default_factory=dict)


KINDS = {
    "stage": Kind(tuple(e for e in stage_effects.EFFECTS if e.diagnosed)),
    "rotary": Kind(
        tuple(e for e in rotary_effects.EFFECTS if e.diagnosed),
        rotary_effects.direct,
        True,
        6,
        rotary_effects.WAVES,
    ),
}


def kind_of(model: Model) -> Kind:
    """Return how `model` is diagnosed; raises `InputError` for a family that cannot be yet."""
    if model.family not in KINDS:
        known = " and ".join(KINDS)
        raise InputError(f"Model {model.name} has no catalogue of effects yet; only {known} models have.")
    return KINDS[model.family]
