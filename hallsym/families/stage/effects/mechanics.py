"""Effects of the stage at the mechanics: vertical motion and finite rotation that displace a probe."""

import casadi as ca

from hallsym.families.parts import P, add, free
from hallsym.families.stage import models as stage
from hallsym.families.stage.effects.parts import labels
from hallsym.model import Model, Signals


def vertical_offset_coupling(model: Model) -> Model:
    """Displacement plus c . (Z, Rx, Ry), c per probe: probe lever arm, tilt of probe or magnet."""
    names = [[f"tilt_{k}_{c}" for c in stage.STATE] for k in labels(model)]

    def step(s: Signals, p: P) -> None:
        rows = [sum(p[n] * s[c] for n, c in zip(row, stage.STATE, strict=True)) for row in names]
        s["displacement"] = s["displacement"] + ca.vertcat(*rows)

    new = free([n for row in names for n in row], 1.0, "1", "displacement per vertical motion")
    return add(model, "mechanics", "vertical_offset_coupling", new, step)


def second_order_rotation(model: Model) -> Model:
    """Share of the finite-rotation terms x Rz, y Rz, Rz^2 that Eq. (8) drops: 1 for a rigid stage."""
    new = free(["finite_rotation"], 3.0, "1", "share of the finite rotation")

    def step(s: Signals, p: P) -> None:
        x, y, rz = s["x_m"], s["y_m"], s["rz_rad"]
        rows = []
        for k, probe in enumerate(model.layout):
            (px, py), (nx, ny) = stage.position(k, probe, p), stage.direction(probe, p)
            rows.append(nx * (-y * rz - px * rz**2 / 2) + ny * (x * rz - py * rz**2 / 2))
        s["displacement"] = s["displacement"] + p["finite_rotation"] * ca.vertcat(*rows)

    return add(model, "mechanics", "second_order_rotation", new, step)


def second_order_rotation_body(model: Model) -> Model:
    """The same with the translation stated in the turned frame: only the terms with Rz^2 remain free."""
    names = ["rotation_x", "rotation_y", "rotation_rz"]

    def step(s: Signals, p: P) -> None:
        x, y, rz = s["x_m"], s["y_m"], s["rz_rad"]
        rows = []
        for k, probe in enumerate(model.layout):
            (px, py), (nx, ny) = stage.position(k, probe, p), stage.direction(probe, p)
            rows.append(
                -p[names[0]] * nx * y * rz
                + p[names[1]] * ny * x * rz
                - p[names[2]] * (nx * px + ny * py) * rz**2 / 2
            )
        s["displacement"] = s["displacement"] + ca.vertcat(*rows)

    return add(model, "mechanics", "second_order_rotation", free(names, 3.0, "1", "share"), step)
