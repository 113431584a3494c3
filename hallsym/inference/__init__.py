"""Inference from a fit: identifiability and intervals of parameters, null directions and the pose.

`evidence` is the source of the numbers: a fit with its log, or a plan. `intervals` decides where a normal
interval is not good enough and takes one of `profiles`. `identifiability` names null directions, judges each
parameter, and states what other recordings would determine; `belonging` compares two recordings of one sensor
and tests whether a log still belongs to a calibration.
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
    "FALSE_ALARM", "VERDICTS", "Belonging", "Change", "CombinationReport", "Identifiability", "NullDirection",
    "NullSpace", "Offsets", "ParameterChange", "ParameterReport", "Verdict", "belonging", "check_false_alarm",
    "identify",
]  # fmt: skip
