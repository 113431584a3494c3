"""The model of a sensor: the chain of links from pose to reading, parameters, and derived quantities."""

from hallsym.model.arguments import Facts, one_of
from hallsym.model.arrays import on_arrays
from hallsym.model.derived import rate
from hallsym.model.effect import Effect, Variant, Way, effect, ways_text
from hallsym.model.family import Example, Family, Further, PoseMetric
from hallsym.model.features import find_features
from hallsym.model.model import LINKS, Combination, Gauge, Inspection, Model, Parameter, Signals, Step

__all__ = [
    "LINKS", "Combination", "Effect", "Example", "Facts", "Family", "Further", "Gauge", "Inspection", "Model",
    "Parameter", "PoseMetric", "Signals", "Step", "Variant", "Way", "effect", "find_features", "on_arrays",
    "one_of", "rate", "ways_text",
]  # fmt: skip
