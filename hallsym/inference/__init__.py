"""What a fit is worth: what the data determine, parameter by parameter, in null directions and in the pose.

`evidence` is where the numbers come from: a fit with its log, or a plan. `profiles` gives intervals where a
normal one is not good enough, which `intervals` says. `identifiability` names what cannot
be told apart, judges each parameter, and says what other recordings would determine; `belonging` compares
two recordings of one sensor and tests whether a log still belongs to a calibration.
"""

from hallsym.inference.belonging import (
    FALSE_ALARM,
    Belonging,
    ParameterChange,
    belonging,
    check_false_alarm,
)
from hallsym.inference.identifiability import (
    VERDICTS,
    Change,
    CombinationReport,
    Identifiability,
    NullDirection,
    NullSpace,
    Offsets,
    ParameterReport,
    Verdict,
    identify,
)

__all__ = [
    "FALSE_ALARM",
    "VERDICTS",
    "Belonging",
    "Change",
    "CombinationReport",
    "Identifiability",
    "NullDirection",
    "NullSpace",
    "Offsets",
    "ParameterChange",
    "ParameterReport",
    "Verdict",
    "belonging",
    "check_false_alarm",
    "identify",
]
