"""Effects of an encoder at the electronics: rails of the voltages, and hum."""

from collections.abc import Mapping
from math import pi, radians

import casadi as ca

from hallsym.errors import InputError
from hallsym.families.faults import inject_rails
from hallsym.families.mechanisms import LINE, P, at_frequency, clipping, rails
from hallsym.families.rotary.effects.parts import READINGS, decodes
from hallsym.families.rotary.effects.transducer import gains_follow, offsets_follow
from hallsym.model import Facts, Model, Parameter, Signals, effect
from hallsym.model.arguments import SHARE, Try, beside, found

LEVELS = (0.95, 0.8, 0.65, 0.5)
AXES_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0)
"""Rails, in amplitudes, and axes of the plates to start from where only the angle is read.

Every 15 deg, of the 90 deg after which they repeat: within a quarter of a wave of the four per turn."""
WHOLE = 0.3
"""Largest distance of the clipped share of a decoded angle from 1: a rail clips fully or not at all."""


def voltage_rails(model: Model, facts: Facts) -> list[Try]:
    """Return the rails that the voltages of a log may show."""
    return [] if decodes(model) else rails("low_v", "high_v", symmetric=False)(model, facts)


def angle_rails(model: Model, facts: Facts) -> list[Try]:
    """Return the rails to start from where only the angle is read.

    The clipped share must result as 1 (`clips_whole`).
    """
    return [
        Try(
            {"level": level, "axes_deg": axes},
            f"from a rail at {level:g} of the amplitude, axes at {axes:.0f} deg",
            shapes=-1,
            tried=len(LEVELS) * len(AXES_DEG),
        )
        for level in LEVELS
        if decodes(model)
        for axes in AXES_DEG
    ]


def clips_whole(values: Mapping[str, float]) -> bool:
    """Return whether a decoded angle is fully clipped, as by a rail."""
    return abs(values.get("clipped", 1.0) - 1) <= WHOLE


@effect(
    link="electronics",
    separate="a lower gain or a wider air gap",
    waves=(4, 8, 12),
    possible=clips_whole,
    inject=inject_rails,
)
def saturation(
    model: Model,
    low_v: tuple[float, ...] | None = beside("lowest voltage of sine and cosine"),
    high_v: tuple[float, ...] | None = found(voltage_rails, "highest voltage of sine and cosine"),
    level: float | None = found(
        angle_rails, "rail over amplitude, of an angle alone", valid=SHARE, instead=True
    ),
    axes_deg: float | None = beside("angle of the plates' axes there", default=0.0, instead=True),
) -> Model:
    """Voltages stop at a rail."""
    if level is not None and axes_deg is not None:
        return clipped_angle(model, level, radians(axes_deg))
    if low_v is None or high_v is None or not len(low_v) == len(high_v) == 2:
        raise InputError("Rails of saturation must be 2 numbers each, as low_v=-1.2/-1.2.")
    if decodes(model):
        raise InputError(
            f"Model {model.name} reads the angle alone here; low_v and high_v needs both voltages."
        )
    return clipping(model, READINGS, low_v, high_v)


def clipped_angle(model: Model, level: float, axes_rad: float) -> Model:
    """Both voltages stop at a rail, as a part of their amplitude, before the angle is taken from them.

    The zero of the reading may differ from the plates' axes: `level` and `axes_rad` are starts.
    """
    if not decodes(model):
        raise InputError("Effect saturation takes level where only the angle is read; give low_v, high_v.")

    def step(s: Signals, p: P) -> None:
        r = s["reading"]
        y, x = ca.sin(r - p["axes"]), ca.cos(r - p["axes"])
        v, u = (ca.fmin(ca.fmax(q, -p["rail"]), p["rail"]) for q in (y, x))
        s["reading"] = r + p["clipped"] * ca.atan2(v * x - u * y, u * x + v * y)

    new = (
        Parameter("clipped", 0.0, 0.0, 1.5, "1", "share of the error of clipped voltages (1: hard)"),
        Parameter("rail", level, 0.1, 1.0, "1", "rail over amplitude"),
        Parameter("axes", axes_rad, -pi, pi, "rad", "angle at which the reading's plates have their axes"),
    )
    return model.with_step("electronics", step, effect="saturation", parameters=new)


@effect(link="electronics", separate="a run at rest on the full clock", needs=("t_s",))
def mains_hum(model: Model, frequency_hz: float = LINE) -> Model:
    """50 or 60 Hz pick-up."""
    return offsets_follow(model, "mains_hum", at_frequency("mains_hum", frequency_hz))


@effect(link="electronics", needs=("t_s",), separate="a run at rest on the full clock")
def reference_voltage_fluctuation(model: Model, frequency_hz: float = LINE) -> Model:
    """The gain of the converter swings with the mains."""
    return gains_follow(
        model, "reference_voltage_fluctuation", at_frequency("reference_voltage_fluctuation", frequency_hz)
    )
