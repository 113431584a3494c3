"""The Hall rotary encoder: two plates under a turning magnet, read as two voltages or as a decoded angle.

Meng, Wang, Sun, Yuan: A Novel Diagnosis Method for a Hall Plates-Based Rotary Encoder with a Magnetic
Concentrator, Sensors 2014, 14, 13980, doi:10.3390/s140813980; its signs are restored in docs/rotary.md:

    alpha' = atan2(Vy + Ay F(alpha - pi/2 + beta), Vx + Ax F(alpha)),  F(u) = K1 m^2 cos^2 u + K2 m cos u + K3

with alpha = angle + zero, the angle that the reference gives, whose zero is free. One family, two forms of
a log: the voltages `v_sin_v, v_cos_v` (numerator and denominator), or `angle_rad`, alpha' itself. The angle
determines only ratios: a common factor of Vx, Vy, Ax, Ay does not change it.

Voltages in V, angles in rad, flux density m in T. Valid for any number of turns; the angle form for
distortions (offset, mismatch, phase, harmonics together) up to about 20 %.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import pi, prod
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import require
from hallsym.families.mechanisms import free, started
from hallsym.families.rotary.checks import inspect
from hallsym.families.rotary.waves import Wave, angle, cosine, sine
from hallsym.log import Meta
from hallsym.model import Combination, Family, Model, Parameter, Signals, Step, effect

FAMILY = Family("rotary")
"""The family of these models, set by the package."""
POSE = ("angle_rad",)
REFERENCES = ("angle_ref_rad",)
VOLTAGES, ANGLE = ("v_sin_v", "v_cos_v"), ("angle_rad",)
TURN = 2 * pi
K1, K2, K3 = 0.1896, 10.0, 0.0
"""K2 m = 1 at 100 mT, and K1 m / K2 = 1.896e-3 there, which gives Table 1's 0.07682 deg; not printed."""


BETA = Parameter("beta", 0.0, -0.5, 0.5, "rad", "angle by which the sine plate is more than 90 deg ahead")
ZERO = Parameter("zero", 0.0, -TURN, TURN, "rad", "angle of the magnet at the zero of the reference")
"""Bounds two turns wide, so that no zero lies at a bound."""


@dataclass(frozen=True)
class Output:
    """A column in which the encoder is read: a voltage or the decoded angle."""

    channel: str

    @property
    def label(self) -> str:
        """Name in messages."""
        return self.channel

    @property
    def entry(self) -> dict[str, Any]:
        """The output as a saved calibration describes it."""
        return {"channel": self.channel}


def two_voltages() -> tuple[Output, ...]:
    """Return the layout of a log with the voltages of both plates."""
    return tuple(map(Output, VOLTAGES))


def angle_only() -> tuple[Output, ...]:
    """Return the layout of a log with the decoded angle alone."""
    return tuple(map(Output, ANGLE))


# -- models ----------------------------------------------------------------------------------------------


@cache
def rotary_ideal(layout: tuple[Output, ...] | None = None) -> Model:
    """Return the ideal encoder: v_sin = A sin(angle + zero), v_cos = A cos(angle + zero)."""

    def transducer(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["v_sin"], s["v_cos"] = s["sine"] * p["A"], s["cosine"] * p["A"]
        s["gain"] = ca.vertcat(p["A"], p["A"])

    def begin(v: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        return ca.atan2(v[0], v[1]) - p["zero"]

    both = _amplitude("A", layout, "amplitude of both voltages")
    if layout == angle_only():  # which has none
        both = Parameter("A", 1.0, 1.0, 1.0, "1", both.meaning)
    parameters = (both, ZERO)
    return _encoder("rotary_ideal", layout, parameters, transducer, begin)


@cache
def rotary(layout: tuple[Output, ...] | None = None) -> Model:
    """Return the ellipse: v_sin = Vy + Ay sin(angle + zero + beta), v_cos = Vx + Ax cos(angle + zero)."""
    return _ellipse("rotary", layout, (*_plates(layout), BETA, ZERO), _RATIOS)


@cache
def rotary_meng(layout: tuple[Output, ...] | None = None) -> Model:
    """Return the paper's model: the ellipse with F(u) = K1 m^2 cos^2 u + K2 m cos u + K3 on both plates."""

    def field(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["cosine"], s["sine"] = _transfer(s["cosine"], p), _transfer(s["sine"], p)

    parameters = (
        *_plates(layout),
        BETA,
        Parameter("m", 0.1, 0.02, 0.3, "T", "flux density at the plates"),
        ZERO,
        Parameter("K1", K1, K1, K1, "1/T2", "quadratic coefficient of F"),
        Parameter("K2", K2, K2, K2, "1/T", "linear coefficient of F"),
        Parameter("K3", K3, K3, K3, "1", "constant of F"),
    )
    model = _ellipse("rotary_meng", layout, parameters, _MENG_RATIOS)
    return model.with_step("field", field, effect="quadratic_transfer")


def _ellipse(
    name: str,
    layout: tuple[Output, ...] | None,
    parameters: tuple[Parameter, ...],
    combinations: tuple[Combination, ...],
) -> Model:
    """Return an encoder with an offset and an amplitude for each plate, the sine plate ahead by beta."""
    scaled = any(p.name == "m" for p in parameters)  # by F: K3, and K2 m of the field's cosine

    def transducer(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["v_sin"] = s["sine"].ahead(p["beta"]) * p["Ay"] + p["Vy"]
        s["v_cos"] = s["cosine"] * p["Ax"] + p["Vx"]
        s["gain"] = ca.vertcat(p["Ay"], p["Ax"]) * (p["K2"] * p["m"] if scaled else 1)

    def begin(v: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        y, x = ((v[k] - p[f"V{a}"]) / p[f"A{a}"] for k, a in enumerate("yx"))
        if scaled:
            y, x = ((u - p["K3"]) / (p["K2"] * p["m"]) for u in (y, x))
        return ca.atan2(y - x * ca.sin(p["beta"]), x * ca.cos(p["beta"])) - p["zero"]

    return _encoder(name, layout, parameters, transducer, begin, combinations)


def _encoder(
    name: str,
    layout: tuple[Output, ...] | None,
    parameters: tuple[Parameter, ...],
    transducer: Step,
    begin: Callable[[ca.SX, Mapping[str, ca.SX]], ca.SX],
    combinations: tuple[Combination, ...] = (),
) -> Model:
    """Return the chain that all encoders share, up to what stands on the transducer link."""
    outputs = two_voltages() if layout is None else tuple(layout)
    channels = tuple(o.channel for o in outputs)
    wanted = f"read as {' and '.join(VOLTAGES)} or as {ANGLE[0]}"
    require(channels in (VOLTAGES, ANGLE), "An encoder", wanted, channels)
    decoded = channels == ANGLE
    amplitudes = tuple(p.name for p in parameters if p.name in ("A", "Ax", "Ay"))
    return Model(
        name=name,
        family=FAMILY,
        pose=POSE,
        references=REFERENCES,
        state=(),
        channels=channels,
        parameters=parameters,
        steps=(
            ("mechanics", rotated),
            ("transducer", transducer),
            ("electronics", arctangent if decoded else voltages),
        ),
        combinations=combinations if decoded else (),
        layout=outputs,
        closed_form=closed_form,
        period=dict.fromkeys((*POSE, *REFERENCES, "zero"), TURN),
        amplitudes=() if decoded else amplitudes,
        begin=(lambda v, p: v[0] - p["zero"]) if decoded else begin,
        typical=tuple((k * TURN / 16,) for k in range(16)),
        inspect=inspect,
    )


# -- links -----------------------------------------------------------------------------------------------


def rotated(s: Signals, p: Mapping[str, ca.SX]) -> None:
    """Set the field at the plates, as waves of the angle from the encoder's own zero."""
    s["cosine"], s["sine"] = cosine(), sine()


def _transfer(u: Wave, p: Mapping[str, ca.SX]) -> Wave:
    """F of the paper for a plate that sees cos u."""
    return u * u * (p["K1"] * p["m"] ** 2) + u * (p["K2"] * p["m"]) + p["K3"]


def voltages(s: Signals, p: Mapping[str, ca.SX]) -> None:
    """Set the reading to both voltages."""
    s["reading"] = ca.vertcat(*(s[v].ahead(p["zero"]).of(s, POSE[0]) for v in ("v_sin", "v_cos")))


def arctangent(s: Signals, p: Mapping[str, ca.SX]) -> None:
    """Set the reading to the chip's own atan2, as a series in the angle (`rotary_waves.angle`)."""
    columns = [value for name, value in s.items() if name not in POSE and _is_column(name, value)]
    error = angle(s["v_sin"], s["v_cos"], ca.vertcat(*columns) if columns else ca.SX(0, 1))
    s["reading"] = s[POSE[0]] + p["zero"] + error.ahead(p["zero"]).of(s, POSE[0])
    s["gain"] = ca.SX(1)


def _is_column(name: str, value: Any) -> bool:
    """Whether a signal is a logged column: a symbol of that name."""
    return isinstance(value, ca.SX) and value.is_symbolic() and str(value) == name


# -- parameters ------------------------------------------------------------------------------------------


def _amplitude(name: str, layout: tuple[Output, ...] | None, meaning: str) -> Parameter:
    low, high, unit = (0.5, 2.0, "1") if layout == angle_only() else (1e-3, 20.0, "V")
    return Parameter(name, 1.0, low, high, unit, meaning)


def _plates(layout: tuple[Output, ...] | None) -> tuple[Parameter, ...]:
    """Offsets and amplitudes: volts, or numbers where only the angle is logged (only their ratios count)."""
    far, unit = (0.3, "1") if layout == angle_only() else (10.0, "V")
    return (
        Parameter("Vx", 0.0, -far, far, unit, "offset of the cosine plate"),
        Parameter("Vy", 0.0, -far, far, unit, "offset of the sine plate"),
        _amplitude("Ax", layout, "amplitude of the cosine plate"),
        _amplitude("Ay", layout, "amplitude of the sine plate"),
    )


def _ratio(a: str, *below: str) -> Combination:
    text = below[0] if len(below) == 1 else f"({'*'.join(below)})"
    return Combination(f"{a}/{text}", "1", (a, *below), lambda p: p[a] / prod(p[b] for b in below))


_RATIOS = (_ratio("Vx", "Ax"), _ratio("Vy", "Ay"), _ratio("Ay", "Ax"))
"""Combinations of offsets and amplitudes that an angle determines."""
_MENG_RATIOS = (_ratio("Vx", "Ax", "K2", "m"), _ratio("Vy", "Ay", "K2", "m"), _ratio("Ay", "Ax"))
"""The same where the flux density scales both plates."""


# -- effects ---------------------------------------------------------------------------------------------


@effect(link="transducer", diagnosed=False)
def harmonics(model: Model) -> Model:
    """3 to 8 waves of angle error per turn, whatever their cause.

    The content of a correction table; one and two waves belong to the ellipse. To first order: valid for
    errors up to about 10 mrad.
    """
    orders = range(3, 9)
    meanings = {f"h{n}{part}": f"{n} waves of angle error per turn" for n in orders for part in "cs"}
    added = free(meanings, 0.1, "rad")

    def error(p: Mapping[str, ca.SX]) -> Wave:
        return Wave({n: (p[f"h{n}c"], p[f"h{n}s"]) for n in orders})

    def on_voltages(s: Signals, p: Mapping[str, ca.SX]) -> None:
        for v in ("v_sin", "v_cos"):
            s[v] = s[v] + s[v].slope() * error(p)

    def on_angle(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["reading"] = s["reading"] + error(p).ahead(p["zero"]).of(s, POSE[0])

    if model.channels == ANGLE:
        return model.with_step("electronics", on_angle, effect="harmonics", parameters=added)
    return model.with_step("transducer", on_voltages, effect="harmonics", parameters=added)


@effect(link="reference", diagnosed=False)
def zero_deviation(model: Model) -> Model:
    """A zero of the reference in each run.

    The reference was homed or coupled anew between runs. Each run is first shifted to the encoder's own zero
    (`hallsym.log.phase.homes`); `delta` is the rest. `zero` is then a per-run offset and no parameter.
    """

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["cosine"], s["sine"] = s["cosine"].ahead(p["delta"]), s["sine"].ahead(p["delta"])

    delta = Parameter("delta", 0.0, -0.2, 0.2, "rad", "zero of a run's reference beside the encoder's")
    wide = model.with_step("reference", step, effect="zero_deviation", offsets=(delta,))
    wide = replace(wide, homes={"delta": POSE[0]})
    return wide.with_parameters({"zero": {"nominal": 0.0, "lower": 0.0, "upper": 0.0}})


# -- a start in closed form ------------------------------------------------------------------------------


def closed_form(model: Model, coefficients: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return parameters from the harmonics of the readings: exact for voltages, first order for an angle.

    `coefficients`: feature name -> (n_channels,), from linear least squares. Parameters it cannot see stay
    nominal.
    """
    p = model.named(model.nominal)
    start = _from_voltages if model.channels == VOLTAGES else _from_angle
    found = start(p, coefficients)
    return np.array([found.get(name, p[name]) for name in model.names])


def phasor(coefficients: Mapping[str, np.ndarray], n: int, k: int) -> complex:
    """c - i s of harmonic n in channel k: c cos + s sin is the real part of it times exp(i n a)."""
    c, s = (coefficients.get(f"{name} {n}a") for name in ("cos", "sin"))
    return complex(0.0 if c is None else c[k], 0.0 if s is None else -s[k])


def _from_voltages(p: Mapping[str, float], c: Mapping[str, np.ndarray]) -> dict[str, float]:
    sine, cosine = phasor(c, 1, 0) * 1j, phasor(c, 1, 1)  # i sin(u): both like exp(i zero) then
    if "A" in p:
        both = (sine + cosine) / 2
        return {"A": abs(both), "zero": float(np.angle(both))}
    zero, beta = float(np.angle(cosine)), float(np.angle(sine * np.conj(cosine)))
    found = {"zero": zero, "beta": beta, "Vy": float(c["1"][0]), "Vx": float(c["1"][1])}
    Ay, Ax = abs(sine), abs(cosine)
    if "m" in p:
        # harmonic 2 over harmonic 1 of Ax F is K1 m / (2 K2)
        second = -phasor(c, 2, 0) * np.exp(-2j * (zero + beta)) + phasor(c, 2, 1) * np.exp(-2j * zero)
        m = 2 * float(second.real) / (Ay + Ax) * p["K2"] / p["K1"] if p["K1"] else p["m"]
        m = m if 0 < m < 10 * p["m"] else p["m"]
        Ay, Ax = Ay / (p["K2"] * m), Ax / (p["K2"] * m)
        level = p["K1"] * m**2 / 2 + p["K3"]
        found |= {"m": m, "Vy": found["Vy"] - Ay * level, "Vx": found["Vx"] - Ax * level}
    return {**found, "Ay": Ay, "Ax": Ax}


def _from_angle(p: Mapping[str, float], c: Mapping[str, np.ndarray]) -> dict[str, float]:
    """First order: e = vy cos u - vx sin u + r/2 sin 2u + beta cos^2 u + eps sin u cos u (sin u - cos u)."""
    zero = float(np.angle(np.exp(1j * float(c["1"][0]))))
    if "A" in p:
        return {"zero": zero}
    first, second, third = (phasor(c, n, 0) * np.exp(-1j * n * zero) for n in (1, 2, 3))
    beta, ratio = 2 * second.real, 1 - 2 * second.imag
    eps = -2 * (third.real - third.imag) if "m" in p and p["K1"] else 0.0
    found = {"zero": zero - beta / 2, "beta": beta}
    if eps > 0:
        found["m"] = eps * p["K2"] / p["K1"]
    scale = p["K2"] * found.get("m", p.get("m", 0.0)) if "m" in p else 1.0
    Ax = p["Ax"]
    vy, vx = first.real - eps / 4, first.imag + eps / 4
    found |= {"Ay": Ax * ratio, "Vy": vy * Ax * scale, "Vx": vx * Ax * scale}
    return found


# -- machines described by a log -------------------------------------------------------------------------


def from_meta(make: Callable[..., Model], meta: Meta) -> Model:
    """Return the model for the columns, nominal values and outputs that a log states.

    Two voltages are taken where the log has them, the angle otherwise. `amplitude_v` of the nominal values is
    the start of every amplitude; texts among them (magnet, sensor) are facts for a reader.
    """
    model, nominal = make(_outputs(meta)), dict(meta.nominal)
    amplitude = nominal.pop("amplitude_v", None)
    if amplitude is not None and model.channels != ANGLE:
        nominal = {n: amplitude for n in model.names if n[0] == "A"} | nominal
    return started(model, nominal, rotary_meng(), rotary_ideal())


def _outputs(meta: Meta) -> tuple[Output, ...] | None:
    if meta.probes is not None:
        return tuple(Output(str(entry.get("channel"))) for entry in meta.probes)
    seen = set(meta.columns)
    return angle_only() if set(ANGLE) <= seen and not set(VOLTAGES) <= seen else None
