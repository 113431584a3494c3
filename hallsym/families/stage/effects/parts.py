"""Shared parts of the stage's effects: its ports, and the motion of each probe along and across its axis."""

import casadi as ca

from hallsym.families.mechanisms import P, port
from hallsym.families.stage import models as stage
from hallsym.model import Model, Signals

UNIT = 0.5e-3
"""Displacement [m] at which relative non-linearities are stated."""
AXES = stage.REFERENCES


def labels(model: Model) -> list[str]:
    """Return the letter of each probe."""
    return [probe.label for probe in model.layout]


SENSED, GAIN, READING = (port(name, labels) for name in ("displacement", "gain", "reading"))
"""Displacement [m] that each probe senses, its gain [1], and its reading [m]."""


def across(model: Model, s: Signals, p: P, k: int) -> ca.SX:
    """Return the motion of probe k across its sensing axis."""
    probe = model.layout[k]
    (px, py), (nx, ny) = stage.position(k, probe, p), stage.direction(probe, p)
    return -ny * (s["x_m"] - py * s["rz_rad"]) + nx * (s["y_m"] + px * s["rz_rad"])
