"""What a diagnosis of a log can find: known effects injected into its own motion, diagnosed blind.

It asks diagnoses and is no part of them: `simulated_machine` makes logs like the one at hand, `injection`
puts effects of a known size into them, `detection` diagnoses these logs and counts.
"""

from hallsym.power.detection import REPEATS, CurvePoint, DetectionPower, Findable, Trial, detection_power

__all__ = ["REPEATS", "CurvePoint", "DetectionPower", "Findable", "Trial", "detection_power"]
