"""What a sensor is: the chain of links from pose to reading, its parameters, and what follows from them."""

from hallsym.model.arguments import Facts, example_facts, from_log, one_of, searched
from hallsym.model.arrays import median, medians, on_arrays
from hallsym.model.derived import rate
from hallsym.model.effect import Effect, Variant, Way, as_effect, effect, ways_text
from hallsym.model.family import Example, Family, Further, PoseMetric
from hallsym.model.features import find_features
from hallsym.model.influence import influence
from hallsym.model.model import (
    LINKS,
    Combination,
    Inspection,
    Model,
    Parameter,
    Signals,
    Step,
)
from hallsym.model.quantities import Quantity, combination, linear, parameter

__all__ = [
    "LINKS",
    "Combination",
    "Effect",
    "Example",
    "Facts",
    "Family",
    "Further",
    "Inspection",
    "Model",
    "Parameter",
    "PoseMetric",
    "Quantity",
    "Signals",
    "Step",
    "Variant",
    "Way",
    "as_effect",
    "combination",
    "effect",
    "example_facts",
    "find_features",
    "from_log",
    "influence",
    "linear",
    "median",
    "medians",
    "on_arrays",
    "one_of",
    "parameter",
    "rate",
    "searched",
    "ways_text",
]
