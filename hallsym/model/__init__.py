"""What a sensor is: the chain of links from pose to reading, its parameters, and what follows from them."""

from hallsym.model.arguments import Facts
from hallsym.model.effect import Effect, Variant, Way, effect, ways_text
from hallsym.model.family import Example, Family, PoseMetric
from hallsym.model.model import (
    LINKS,
    Combination,
    Inspection,
    Model,
    Parameter,
    Signals,
    Step,
    Symbols,
)

__all__ = [
    "LINKS",
    "Combination",
    "Effect",
    "Example",
    "Facts",
    "Family",
    "Inspection",
    "Model",
    "Parameter",
    "PoseMetric",
    "Signals",
    "Step",
    "Symbols",
    "Variant",
    "Way",
    "effect",
    "ways_text",
]
