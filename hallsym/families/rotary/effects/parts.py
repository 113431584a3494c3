"""Shared parts of the effects of an encoder: its ports, and the harmonics of its field."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca

from hallsym.families.mechanisms import P, Port, port
from hallsym.families.rotary import models as rotary
from hallsym.families.rotary import rings
from hallsym.families.rotary.waveforms import Waveform, waveform
from hallsym.families.rotary.waves import Wave, cosine, sine
from hallsym.model import Model, Parameter, Signals, Step
from hallsym.model.derived import Computed

(REFERENCE,) = rotary.REFERENCES
SPEED = f"d1_{REFERENCE}"
PLATES = ("sin", "cos")
MAGNET = "a turn at each of several known angles of the stator (or the chip) against the magnet"
LATE = "speeds so high that a low-pass lowers the amplitude, which a delay does not"
RECOUPLED = "a turn with the reference coupled at each of several other angles"


def plates(model: Model) -> tuple[str, ...]:
    """Return the labels of the plates, or of the Halls over a ring, that a model has."""
    return tuple(h.label for h in model.layout) if isinstance(model.layout[0], rings.Head) else PLATES


def _voltages(s: Signals) -> list[str]:
    """The signals of the plates, in the order in which the transducer made them."""
    return [name for name, value in s.items() if name[:2] == "v_" and isinstance(value, Wave | Waveform)]


def _write(s: Signals, values: Sequence[Wave]) -> None:
    s.update(zip(_voltages(s), values, strict=True))


VOLTAGES = Port(plates, lambda s: [s[name] for name in _voltages(s)], _write)
"""Voltages of the plates as waves of the angle of the magnet."""
READINGS = port("reading", plates)
"""All voltages as they are read."""


def decodes(model: Model) -> bool:
    """Return whether a model reads the decoded angle instead of two voltages."""
    return model.channels == rotary.ANGLE


def short(model: Model) -> Model:
    """Return the model with atan2 itself where it has no run statistics: the series would be long."""
    return direct(model) if decodes(model) and model.computed else model


def free_ellipse(model: Model) -> bool:
    """Return whether the model has offsets, amplitudes and phase of its own: an ellipse."""
    return "Vx" in model.names


def amplitude(model: Model) -> float:
    """Return the nominal amplitude of the voltages [V], 1 where only the angle is read."""
    return next(p.nominal for p in model.parameters if p.name in ("A", "Ax", "A1"))


def ahead(s: Signals, angle: ca.SX) -> None:
    """Replace the field by that at another angle of the magnet."""
    s["cosine"], s["sine"] = s["cosine"].ahead(angle), s["sine"].ahead(angle)


def add_ahead(
    model: Model,
    effect: str,
    link: str,
    parameters: tuple[Parameter, ...],
    angle: Callable[[Signals, P], ca.SX],
    *columns: Computed,
) -> Model:
    """Return the model whose field is that at another angle of the magnet, `angle` ahead."""

    def step(s: Signals, p: P) -> None:
        ahead(s, angle(s, p))

    return model.with_columns(*columns).with_step(link, step, effect=effect, parameters=parameters)


def harmonic(s: Signals, n: int, re: ca.SX, im: ca.SX) -> None:
    """Add (re + i im) exp(i n u) to the field, n waves per period of it."""
    n *= s.get("pairs", 1)
    sign = 1.0 if n >= 0 else -1.0
    s["cosine"] = s["cosine"] + Wave({abs(n): (re, -sign * im if n else ca.SX(0))})
    s["sine"] = s["sine"] + Wave({abs(n): (im, sign * re if n else ca.SX(0))})


def direct(model: Model) -> Model:
    """Return the model evaluated at each sample's own angle: atan2 itself, no series, no features.

    A fit from run statistics needs readings that are linear in features; a diagnosis, which goes over the
    samples, does not, and the series of many effects are long.
    """
    plain: dict[Step, Step] = {
        rotary.rotated: _direct_field,
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
