"""Effects of an encoder at the electronics: rails at which voltages stop."""

from collections.abc import Sequence
from math import pi

import casadi as ca

from hallsym.families.parts import Make, P, add, free
from hallsym.families.rotary.effects.parts import PLATES
from hallsym.model import Model, Parameter, Signals


def clipping(low: Sequence[float], high: Sequence[float]) -> Make:
    """Each voltage stops at rails of its own [V]; the parameters say how much of what is beyond is cut."""

    def make(model: Model) -> Model:
        names = [f"clipped_{plate}" for plate in PLATES]

        def step(s: Signals, p: P) -> None:
            v = s["reading"]
            rows = [
                v[k] - p[name] * (ca.fmax(v[k] - high[k], 0) - ca.fmax(low[k] - v[k], 0))
                for k, name in enumerate(names)
            ]
            s["reading"] = ca.vertcat(*rows)

        return add(model, "electronics", "saturation", free(names, 1.5, "1", "share clipped"), step)

    return make


def clipped_angle(level: float, axes_rad: float) -> Make:
    """Both voltages stop at a rail, as a part of their amplitude, before the angle is taken from them.

    The zero of the reading may have been set apart from the plates' axes: `level` and `axes_rad` are starts.
    """

    def make(model: Model) -> Model:
        def step(s: Signals, p: P) -> None:
            r = s["reading"]
            y, x = ca.sin(r - p["axes"]), ca.cos(r - p["axes"])
            v, u = (ca.fmin(ca.fmax(q, -p["rail"]), p["rail"]) for q in (y, x))
            s["reading"] = r + p["clipped"] * ca.atan2(v * x - u * y, u * x + v * y)

        new = (
            Parameter("clipped", 0.0, 0.0, 1.5, "1", "share of what clipping does"),
            Parameter("rail", level, 0.1, 1.0, "1", "rail over amplitude"),
            Parameter(
                "axes", axes_rad, -pi, pi, "rad", "angle at which the reading's plates have their axes"
            ),
        )
        return add(model, "electronics", "saturation", new, step)

    return make
