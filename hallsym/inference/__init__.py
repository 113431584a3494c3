"""What a fit is worth: what the data determine, parameter by parameter, in null directions and in the pose.

`evidence` is where the numbers come from: a fit with its log, or a plan. `profiles` and `bootstrap` give
intervals where a normal one is not good enough, which `intervals` says. `identifiability` names what cannot
be told apart, judges each parameter, and says what other recordings would determine; `parameter_changes`
compares two recordings of one sensor, `belonging` tests whether a log still belongs to a calibration.
"""

from hallsym.inference.belonging import FALSE_ALARM, Belonging, belonging, check_false_alarm
from hallsym.inference.evidence import Change
from hallsym.inference.identifiability import (
    VERDICTS,
    CombinationReport,
    FurtherReport,
    Identifiability,
    NullDirection,
    NullSpace,
    Offsets,
    ParameterReport,
    Verdict,
    identify,
)
from hallsym.inference.intervals import Interval
from hallsym.inference.parameter_changes import Estimate, Freedom, ParameterChange, changes, welch
from hallsym.inference.profiles import Profile, Side, profile, skewness, tangent

__all__ = [
    "FALSE_ALARM",
    "VERDICTS",
    "Belonging",
    "Change",
    "CombinationReport",
    "Estimate",
    "Freedom",
    "FurtherReport",
    "Identifiability",
    "Interval",
    "NullDirection",
    "NullSpace",
    "Offsets",
    "ParameterChange",
    "ParameterReport",
    "Profile",
    "Side",
    "Verdict",
    "belonging",
    "changes",
    "check_false_alarm",
    "identify",
    "profile",
    "skewness",
    "tangent",
    "welch",
]
