"""What a sensor is: the chain of links from pose to reading, its parameters, and what follows from them."""

from hallsym.model.arguments import Facts, example_facts, found, from_log, one_of, searched
from hallsym.model.arrays import on_arrays
from hallsym.model.derived import Computed, rate
from hallsym.model.effect import Effect, Variant, Way, as_effect, effect, ways_text
from hallsym.model.family import Example, Family, Further, PoseMetric
from hallsym.model.features import find_features
from hallsym.model.influence import influence
from hallsym.model.medians import median, medians
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
from hallsym.model.quantities import Quantity, combination, linear, parameter
from hallsym.model.sketch import Part

__all__ = [
    "LINKS",
    "Combination",
    "Computed",
    "Effect",
    "Example",
    "Facts",
    "Family",
    "Further",
    "Inspection",
    "Model",
    "Parameter",
    "Part",
    "PoseMetric",
    "Quantity",
    "Signals",
    "Step",
    "Symbols",
    "Variant",
    "Way",
    "as_effect",
    "combination",
    "effect",
    "example_facts",
    "find_features",
    "found",
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
