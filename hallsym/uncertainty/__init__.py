"""Uncertainty budgets: stand-alone by the GUM, and of a decoded position, confirmed by Monte Carlo.

`gum` is the arithmetic, `files` and `settings` read TOML, `inputs` lists what a position is computed from,
`position` propagates it linearly, `following` does so along a curve, `monte_carlo` as distributions. `along`
is the error of known causes along a coordinate.
"""

from hallsym.uncertainty.along import ErrorModel, error_model, errors_along
from hallsym.uncertainty.files import read_budget
from hallsym.uncertainty.following import AlongCurve, along_curve, curve_error, with_curve
from hallsym.uncertainty.gum import DIVISORS, Budget, Source
from hallsym.uncertainty.inputs import Input, Slopes, independent_inputs, slopes
from hallsym.uncertainty.model_error import Candidate, ModelError, Shape, read_model_error
from hallsym.uncertainty.monte_carlo import (
    Comparison,
    Linear,
    budget_monte_carlo,
    decoded_at_random,
    position_monte_carlo,
    propagate,
    tolerance,
)
from hallsym.uncertainty.position import (
    Recorded,
    UncertaintyMap,
    map_axes,
    notes,
    over_log,
    position_budget,
    uncertainty_map,
)
from hallsym.uncertainty.settings import Settings, read_settings

__all__ = [
    "DIVISORS",
    "AlongCurve",
    "Budget",
    "Candidate",
    "Comparison",
    "ErrorModel",
    "Input",
    "Linear",
    "ModelError",
    "Recorded",
    "Settings",
    "Shape",
    "Slopes",
    "Source",
    "UncertaintyMap",
    "along_curve",
    "budget_monte_carlo",
    "curve_error",
    "decoded_at_random",
    "error_model",
    "errors_along",
    "independent_inputs",
    "map_axes",
    "notes",
    "over_log",
    "position_budget",
    "position_monte_carlo",
    "propagate",
    "read_budget",
    "read_model_error",
    "read_settings",
    "slopes",
    "tolerance",
    "uncertainty_map",
    "with_curve",
]
