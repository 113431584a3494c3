"""What effects of the stage share: labels, and the motion of each probe along and across its sensing axis."""

import casadi as ca

from hallsym.families.parts import P
from hallsym.families.stage import models as stage
from hallsym.model import Model, Signals

UNIT = 0.5e-3
"""Displacement [m] at which relative non-linearities are stated."""
AXES = stage.REFERENCES


def labels(model: Model) -> list[str]:
    """Return the letter of each probe."""
    return [probe.label for probe in model.layout]


def along(model: Model, p: P, x: ca.SX, y: ca.SX, rz: ca.SX) -> ca.SX:
    """Return what each probe feels of a small planar motion, Eq. (11)."""
    rows = []
    for k, probe in enumerate(model.layout):
        (px, py), (nx, ny) = stage.position(k, probe, p), stage.direction(probe, p)
        rows.append(nx * x + ny * y + (px * ny - py * nx) * rz)
    return ca.vertcat(*rows)


def across(model: Model, s: Signals, p: P) -> ca.SX:
    """Return the motion of each probe across its sensing axis."""
    rows = []
    for k, probe in enumerate(model.layout):
        (px, py), (nx, ny) = stage.position(k, probe, p), stage.direction(probe, p)
        rows.append(-ny * (s["x_m"] - py * s["rz_rad"]) + nx * (s["y_m"] + px * s["rz_rad"]))
    return ca.vertcat(*rows)
