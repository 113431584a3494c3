"""The effects that a diagnosis searches in a family."""

from hallsym.diagnosis import rotary_catalogue, stage_catalogue
from hallsym.diagnosis.effect import Effect
from hallsym.model import Model

_CATALOGUES = {"stage": stage_catalogue.CATALOGUE, "rotary": rotary_catalogue.CATALOGUE}


def catalogue_of(model: Model) -> tuple[Effect, ...]:
    """Return the effects that may explain what `model` leaves; none for a family that states none."""
    own = model.family.catalogue
    return _CATALOGUES.get(model.family.name, ()) if own is None else own
