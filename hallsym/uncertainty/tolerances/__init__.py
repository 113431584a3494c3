"""Global sensitivity before data: Sobol indices of the nominal decoder's errors to a machine's tolerances.

`ranges` says what a tolerance is, `workspace` where errors count, `sobol` estimates the indices, `calibrated`
what a calibration takes away, `study` puts them together.
"""

from hallsym.uncertainty.tolerances.ranges import (
    Tolerance,
    default_tolerances,
    given_tolerances,
    read_tolerances,
    read_value,
)
from hallsym.uncertainty.tolerances.result import ENOUGH, Tolerances
from hallsym.uncertainty.tolerances.sobol import Indices
from hallsym.uncertainty.tolerances.study import MOST_SAMPLES, tolerances
from hallsym.uncertainty.tolerances.workspace import Workspace, workspace_of

__all__ = [
    "ENOUGH",
    "MOST_SAMPLES",
    "Indices",
    "Tolerance",
    "Tolerances",
    "Workspace",
    "default_tolerances",
    "given_tolerances",
    "read_tolerances",
    "read_value",
    "tolerances",
    "workspace_of",
]
