"""Uncertainty budgets: stand-alone by the GUM, and of a decoded position, confirmed by Monte Carlo.

`gum` is the arithmetic, `files` and `settings` read TOML, `inputs` lists what a position is computed from,
`position` propagates it linearly, `monte_carlo` as distributions, `show` is the text.
"""

from hallsym.uncertainty.files import read_budget
from hallsym.uncertainty.gum import Budget, Source
from hallsym.uncertainty.monte_carlo import (
    Comparison,
    Linear,
    budget_monte_carlo,
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
    "Budget",
    "Comparison",
    "Linear",
    "Recorded",
    "Settings",
    "Source",
    "UncertaintyMap",
    "budget_monte_carlo",
    "map_axes",
    "notes",
    "over_log",
    "position_budget",
    "position_monte_carlo",
    "propagate",
    "read_budget",
    "read_settings",
    "tolerance",
    "uncertainty_map",
]
