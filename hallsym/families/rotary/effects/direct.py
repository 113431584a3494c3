"""The chain of an encoder evaluated at each sample's own angle: atan2 itself, no series, no features."""

from dataclasses import replace

import casadi as ca

from hallsym.families.mechanisms import P
from hallsym.families.rotary import models as rotary
from hallsym.families.rotary.waveforms import waveform
from hallsym.families.rotary.waves import cosine, sine
from hallsym.model import Model, Signals, Step


def direct(model: Model) -> Model:
    """Return the model evaluated at each sample's own angle: atan2 itself, no series, no features.

    A fit from run statistics needs readings that are linear in features; a diagnosis, which goes over the
    samples, does not, and the series of many effects are long.
    """
    plain: dict[Step, Step] = {
        rotary.turned: _direct_field,
        rotary.voltages: _direct_voltages,
        rotary.arctangent: _direct_angle,
    }
    steps = tuple((link, plain.get(step, step)) for link, step in model.steps)
    return model.remember("direct", lambda: replace(model, steps=steps))


def _direct_field(s: Signals, p: P) -> None:
    s["cosine"], s["sine"] = waveform(cosine()), waveform(sine())


def _plates(s: Signals, p: P) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Angle of the magnet and both voltages there."""
    u = s[rotary.POSE[0]] + p["zero"]
    return u, s["v_sin"].at(u), s["v_cos"].at(u)


def _direct_voltages(s: Signals, p: P) -> None:
    _, y, x = _plates(s, p)
    s["reading"] = ca.vertcat(y, x)


def _direct_angle(s: Signals, p: P) -> None:
    """The angle on the branch of the magnet's."""
    u, y, x = _plates(s, p)
    cos, sin = ca.cos(u), ca.sin(u)
    s["reading"], s["gain"] = u + ca.atan2(y * cos - x * sin, x * cos + y * sin), ca.SX(1)
