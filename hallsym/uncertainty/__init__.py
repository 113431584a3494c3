"""Uncertainty budgets: stand-alone by the GUM, and of a decoded position, confirmed by Monte Carlo.

`gum` is the arithmetic and a budget's file, `inputs` lists the inputs of a position, `position` propagates
them linearly, `monte_carlo` as distributions. `along` is the error of known causes along a coordinate,
`tolerances` the sensitivity to each tolerance of a machine.
"""

from hallsym.uncertainty.along import ErrorModel, error_model, errors_along
from hallsym.uncertainty.gum import Budget, Source, read_budget, with_curve
from hallsym.uncertainty.inputs import Settings, read_model_error, read_settings
from hallsym.uncertainty.monte_carlo import Comparison, budget_monte_carlo, position_monte_carlo
from hallsym.uncertainty.position import (
    Recorded,
    UncertaintyMap,
    map_axes,
    notes,
    over_log,
    position_budget,
    uncertainty_map,
)

__all__ = [
    "Budget", "Comparison", "ErrorModel", "Recorded", "Settings", "Source", "UncertaintyMap",
    "budget_monte_carlo", "error_model", "errors_along", "map_axes", "notes", "over_log", "position_budget",
    "position_monte_carlo", "read_budget", "read_model_error", "read_settings", "uncertainty_map",
    "with_curve",
]  # fmt: skip
