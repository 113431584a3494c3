"""What a fit is worth: what the data determine, parameter by parameter, in null directions and in the pose.

`evidence` is where the numbers come from: a fit with its log, or a plan. `null_directions` names what cannot
be told apart, `further` what other recordings would determine. `profiles` (with `profile_tangent`,
`profile_walk`) and `bootstrap` give intervals where a normal one is not good enough, which `intervals` says.
`verdict` judges each parameter; `workspace` says what a change of it does to the decoded pose.
`identifiability` puts this together, `comparison` sets models side by side and `parameter_changes` two
recordings of one sensor; `belonging` tests whether a log still belongs to a calibration.
"""

from hallsym.inference.belonging import FALSE_ALARM, Belonging, belonging
from hallsym.inference.bootstrap import Bootstrap, bootstrap
from hallsym.inference.comparison import comparison
from hallsym.inference.further import FurtherReport, Gained
from hallsym.inference.identifiability import (
    CombinationReport,
    Identifiability,
    Offsets,
    Output,
    ParameterReport,
    identify,
)
from hallsym.inference.intervals import Interval
from hallsym.inference.null_directions import NullDirection, NullSpace
from hallsym.inference.parameter_changes import Estimate, Freedom, ParameterChange, changes, welch
from hallsym.inference.profile_tangent import Tangent, skewness, tangent
from hallsym.inference.profile_walk import Side
from hallsym.inference.profiles import Profile, profile
from hallsym.inference.verdict import VERDICTS, Verdict
from hallsym.inference.workspace import Change

__all__ = [
    "FALSE_ALARM",
    "VERDICTS",
    "Belonging",
    "Bootstrap",
    "Change",
    "CombinationReport",
    "Estimate",
    "Freedom",
    "FurtherReport",
    "Gained",
    "Identifiability",
    "Interval",
    "NullDirection",
    "NullSpace",
    "Offsets",
    "Output",
    "ParameterChange",
    "ParameterReport",
    "Profile",
    "Side",
    "Tangent",
    "Verdict",
    "belonging",
    "bootstrap",
    "changes",
    "comparison",
    "identify",
    "profile",
    "skewness",
    "tangent",
    "welch",
]
