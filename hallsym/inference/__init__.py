"""What data determine: per parameter, in null directions, and in the decoded pose.

`workspace` holds what changes do to the decoded pose, `null` names null directions, `evidence` is where the
numbers come from, `intervals` and `verdict` judge them, `report` puts it together, `text` prints it.
"""

from hallsym.inference.report import CombinationReport, Identifiability, ParameterReport, identify

__all__ = ["CombinationReport", "Identifiability", "ParameterReport", "identify"]
