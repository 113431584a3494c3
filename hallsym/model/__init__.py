"""What a sensor is: the chain of links from pose to reading, its parameters, and what follows from them."""

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
    "Example",
    "Family",
    "Inspection",
    "Model",
    "Parameter",
    "PoseMetric",
    "Signals",
    "Step",
    "Symbols",
]
