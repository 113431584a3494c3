"""Detection power of a diagnosis: known effects injected into the motion of a log, diagnosed blind.

`simulated_machine` makes logs like the given one, `injection` adds effects of a known size, `detection`
diagnoses these logs and counts.
"""

from hallsym.power.detection import REPEATS, CurvePoint, DetectionPower, Findable, Trial, detection_power

__all__ = ["REPEATS", "CurvePoint", "DetectionPower", "Findable", "Trial", "detection_power"]
