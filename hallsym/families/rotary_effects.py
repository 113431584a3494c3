"""Effects of an encoder that its models leave out: physics only, each a function `Model -> Model`.

New parameters are 0 where the effect is absent. u is the electrical angle (angle + zero). The field at the
chip, cosine + i sine, is exp(i u) for a perfect magnet; its harmonic n is q exp(i n u) with q complex: n = 2
(and 0) is one wave of angle error per turn, n = -1 and 3 are two, n = -3 is four. Voltages in V, times in s.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import pi

import casadi as ca
import numpy as np

from hallsym.computed import Computed, Stretch, campaign_time, rate
from hallsym.families import rotary
from hallsym.families.play import stop_operator
from hallsym.families.rotary import ANGLE, REFERENCES
from hallsym.families.rotary_waveforms import waveform
from hallsym.families.rotary_waves import Wave, cosine, sine
from hallsym.model import Model, Parameter, Signals, Step

(REFERENCE,) = REFERENCES
SPEED = f"d1_{REFERENCE}"
PLATES = ("sin", "cos")
STEEPEST = 0.3
"""Slope of the error of a reference, at most: with more it would stand still or run backwards."""
FULL_STEPS = 50
"""Periods per turn of what a stepper of 1.8 deg per full step leaves: one for each pole pair of its rotor."""

Make = Callable[[Model], Model]
P = Mapping[str, ca.SX]
Read = Callable[[Signals], list[ca.SX]]


def _free(names: Sequence[str], limit: float, unit: str, meaning: str) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, 0.0, -limit, limit, unit, meaning) for name in names)


def _add(
    model: Model,
    link: str,
    effect: str,
    parameters: tuple[Parameter, ...],
    step: Step,
    *columns: str | Computed,
) -> Model:
    return model.with_columns(*columns).with_step(link, step, effect=effect, parameters=parameters)


def decodes(model: Model) -> bool:
    """Return whether a model reads the decoded angle instead of two voltages."""
    return model.channels == ANGLE


def amplitude(model: Model) -> float:
    """Return the nominal amplitude of the voltages [V], 1 where only the angle is read."""
    return next(p.nominal for p in model.parameters if p.name in ("A", "Ax"))


def _volt(model: Model) -> str:
    return "1" if decodes(model) else "V"


def direct(model: Model) -> Model:
    """Return the model evaluated at each sample's own angle: atan2 itself, no series, no features.

    A fit from run summaries needs readings that are linear in features; a diagnosis, which goes over the
    samples, does not, and the series of many effects are long.
    """
    plain: dict[Step, Step] = {
        rotary._turned: _direct_field,
        rotary._voltages: _direct_voltages,
        rotary._arctangent: _direct_angle,
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


# -- mechanics and field -----------------------------------------------------------------------------------


def _harmonic(s: Signals, n: int, re: ca.SX, im: ca.SX) -> None:
    """Add (re + i im) exp(i n u) to the field."""
    sign = 1.0 if n >= 0 else -1.0
    s["cosine"] = s["cosine"] + Wave({abs(n): (re, -sign * im if n else ca.SX(0))})
    s["sine"] = s["sine"] + Wave({abs(n): (im, sign * re if n else ca.SX(0))})


def field_harmonics(effect: str, link: str, orders: Sequence[int], phase: bool = True) -> Make:
    """Harmonics of the field at the chip, each with a free amplitude and (if `phase`) a free phase."""

    def make(model: Model) -> Model:
        parts = ("re", "im") if phase else ("re",)
        names = [f"{effect}_{n}_{part}".replace("-", "m") for n in orders for part in parts]

        def step(s: Signals, p: P) -> None:
            values = iter(names)
            for n in orders:
                re = p[next(values)]
                _harmonic(s, n, re, p[next(values)] if phase else ca.SX(0))

        return _add(model, link, effect, _free(names, 0.5, "1", "harmonic of the field"), step)

    return make


def off_axis(effect: str, direction_rad: float, tilted: bool = False) -> Make:
    """Chip and magnet both off the axis of rotation, to second order in what they are off.

    Near the axis the field in the frame of the magnet is 1 + a |w|^2 + (a/2) w^2 for a displacement w of the
    chip from the magnet's axis: curl B = 0 leaves one curvature a, and the last one, c conj(w)^2, vanishes
    for a dipole. A chip at S exp(i direction) and a magnet at M make w = S exp(i (direction - u)) - M, which
    gives harmonics 2 and 0 by their product and -1 by the chip alone. A `tilted` magnet gives the same with
    other shares of both parts of harmonic 0, free within bounds: without harmonic 2 there is none.
    """

    def make(model: Model) -> Model:
        names = [f"{effect}_{part}" for part in ("both_re", "both_im", "chip")]
        cos, sin = float(np.cos(2 * direction_rad)), float(np.sin(2 * direction_rad))

        def step(s: Signals, p: P) -> None:
            re, im, chip = (p[n] for n in names)
            a, b = (p["mirrored"], p["turned"]) if tilted else (ca.SX(1), ca.SX(1))
            _harmonic(s, 2, re, im)
            _harmonic(s, 0, a * re + b * (re * cos - im * sin), -a * im + b * (re * sin + im * cos))
            _harmonic(s, -1, chip * cos, chip * sin)

        new = _free(names, 0.5, "1", "field off the axis")
        if tilted:
            shares = ("mirrored", "turned")
            new += tuple(
                Parameter(n, 0.5, -2.0, 3.0, "1", "part of harmonic 2 in harmonic 0") for n in shares
            )
        return _add(model, "mechanics", effect, new, step)

    return make


def field_saturation(model: Model) -> Model:
    """Each plate compresses softly, alike: b becomes b - k b^3."""
    name = "compression"

    def step(s: Signals, p: P) -> None:
        for plate in ("cosine", "sine"):
            b = s[plate]
            s[plate] = b - b * b * b * p[name]

    return _add(model, "field", "field_saturation", _free([name], 0.5, "1", "compression at the peak"), step)


# -- transducer --------------------------------------------------------------------------------------------


def _per_plate(
    effect: str, terms: int, read: Callable[[Signals, Wave, int], Wave], columns: Sequence = ()
) -> Make:
    """Each voltage v becomes v + sum of c_j read(s, v, j), c per plate."""

    def make(model: Model) -> Model:
        names = {plate: [f"{effect}{j}_{plate}" for j in range(terms)] for plate in PLATES}

        def step(s: Signals, p: P) -> None:
            for plate in PLATES:
                v = s[f"v_{plate}"]
                for j, name in enumerate(names[plate]):
                    s[f"v_{plate}"] = s[f"v_{plate}"] + read(s, v, j) * p[name]

        new = _free([n for row in names.values() for n in row], 100.0, "1", "strength")
        return _add(model, "transducer", effect, new, step, *columns)

    return make


def offset(effect: str, link: str = "transducer") -> Make:
    """A constant in each voltage."""

    def make(model: Model) -> Model:
        names = [f"{effect}_{plate}" for plate in PLATES]

        def step(s: Signals, p: P) -> None:
            for plate, name in zip(PLATES, names, strict=True):
                s[f"v_{plate}"] = s[f"v_{plate}"] + p[name]

        return _add(model, "transducer", effect, _free(names, 10.0, _volt(model), "offset"), step)

    return make


def gain_mismatch(model: Model) -> Model:
    """The gains of sine and cosine differ by a share."""

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] * (1 + p["mismatch"] / 2)
        s["v_cos"] = s["v_cos"] * (1 - p["mismatch"] / 2)

    return _add(
        model, "transducer", "gain_mismatch", _free(["mismatch"], 1.0, "1", "difference of gains"), step
    )


def orthogonality_error(model: Model) -> Model:
    """The sine plate sees a share of the cosine: the axes are not perpendicular."""

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] + s["v_cos"] * p["skewed"]

    return _add(
        model, "transducer", "orthogonality_error", _free(["skewed"], 1.0, "rad", "angle off 90 deg"), step
    )


def nonlinearity(effect: str, powers: Sequence[int]) -> Make:
    """Voltage v becomes v + sum of c v^n / A^(n - 1), c per plate, A the nominal amplitude."""

    def make(model: Model) -> Model:
        size = amplitude(model)

        def read(s: Signals, v: Wave, j: int) -> Wave:
            out = v
            for _ in range(powers[j] - 1):
                out = out * v * (1 / size)
            return out

        return _per_plate(effect, len(powers), read)(model)

    return make


def gain_drift(effect: str, columns: Sequence[str | Computed], functions: Read, count: int) -> Make:
    """Each voltage times 1 + sum of g f(t), g per plate; f are `count` data-only functions of columns."""
    return _per_plate(effect, count, lambda s, v, j: v * functions(s)[j], columns)


def offset_drift(effect: str, columns: Sequence[str | Computed], functions: Read, count: int) -> Make:
    """Each voltage plus sum of o f(t), o per plate."""
    return _per_plate(effect, count, lambda s, v, j: Wave({0: (functions(s)[j], ca.SX(0))}), columns)


def powers_of_time(duration_s: float, degree: int) -> tuple[list[Computed], Read, int]:
    """Return shifted Legendre polynomials of campaign time, degrees 1 to `degree`."""

    def read(s: Signals) -> list[ca.SX]:
        x = 2 * s["campaign_s"] / duration_s - 1
        return [x, (3 * x**2 - 1) / 2, (5 * x**3 - 3 * x) / 2][:degree]

    return [campaign_time()], read, degree


def settling(tau_s: float) -> tuple[list[Computed], Read, int]:
    """Return exp(-t / tau): the shape of a warm-up."""
    return [campaign_time()], lambda s: [ca.exp(-s["campaign_s"] / tau_s)], 1


def temperature(mean: float) -> tuple[list[str | Computed], Read, int]:
    """Return the logged temperature above its mean."""
    return ["temperature_degc"], lambda s: [s["temperature_degc"] - mean], 1


def speed() -> tuple[list[Computed], Read, int]:
    """Return the speed of the reference [rad/s]."""
    return [rate(REFERENCE)], lambda s: [s[SPEED]], 1


def during(runs: Sequence[int]) -> tuple[list[Computed], Read, int]:
    """Return 1 in some runs, 0 in the others."""
    name, on = f"on_in_{'_'.join(map(str, runs))}", frozenset(runs)

    def rule(s: Stretch) -> np.ndarray:
        return np.full(len(s.data["t_s"]), float(s.run in on))

    return [Computed(name, (), rule)], lambda s: [s[name]], 1


def wave_of_time(frequency_hz: float, harmonics: Sequence[int] = (1,)) -> tuple[list[Computed], Read, int]:
    """Return cosine and sine of a frequency and its harmonics over the campaign."""
    columns = []
    for k in harmonics:
        for name, function in (("cos", np.cos), ("sin", np.sin)):

            def rule(s: Stretch, f: float = k * frequency_hz, of: Callable = function) -> np.ndarray:
                return np.asarray(of(2 * pi * f * (s.data["t_s"] - s.origin_s)))

            columns.append(Computed(f"{name}_{k}x{frequency_hz:.9g}hz", (), rule))
    return columns, lambda s: [s[c.name] for c in columns], len(columns)


# -- clock, lag, memory, reference -------------------------------------------------------------------------


def _turned(s: Signals, angle: ca.SX) -> None:
    """The field as it is at another angle of the magnet."""
    s["cosine"], s["sine"] = s["cosine"].ahead(angle), s["sine"].ahead(angle)


def time_skew(model: Model) -> Model:
    """The readings are older than the reference by a delay: latency."""

    def step(s: Signals, p: P) -> None:
        _turned(s, -p["delay"] * s[SPEED])

    new = (Parameter("delay", 0.0, -1.0, 1.0, "s", "delay of the readings"),)
    return _add(model, "reference", "time_skew", new, step, rate(REFERENCE))


def time_skew_per_plate(model: Model) -> Model:
    """Each plate has a delay of its own: a multiplexed converter."""
    new = tuple(Parameter(f"delay_{k}", 0.0, -1.0, 1.0, "s", "delay of a plate") for k in PLATES)

    def step(s: Signals, p: P) -> None:
        for plate in PLATES:
            s[f"v_{plate}"] = s[f"v_{plate}"].ahead(-p[f"delay_{plate}"] * s[SPEED])

    return _add(model, "transducer", "time_skew", new, step, rate(REFERENCE))


def first_order_lag(model: Model) -> Model:
    """A low-pass in the path of both voltages, at the speed of the moment: every harmonic loses its share."""

    def step(s: Signals, p: P) -> None:
        def share(n: int) -> tuple[ca.SX, ca.SX]:
            x = n * p["lag"] * s[SPEED]
            return 1 / (1 + x**2), -x / (1 + x**2)  # 1 / (1 + i x)

        for plate in PLATES:
            s[f"v_{plate}"] = s[f"v_{plate}"].filtered(share)

    new = (Parameter("lag", 0.0, 0.0, 1.0, "s", "time constant"),)
    return _add(model, "transducer", "first_order_lag", new, step, rate(REFERENCE))


def direction(width_rad: float) -> Computed:
    """Return the direction of motion, -1 to 1, which turns over within `2 width_rad` after a reversal."""

    def rule(s: Stretch) -> np.ndarray:
        u = s.rate(REFERENCE, 0)
        z = stop_operator(u, width_rad)
        full = np.flatnonzero(np.abs(z) >= 1.0)
        if len(full):
            z[: full[0]] = z[full[0]]
        return z

    return Computed(f"direction_{width_rad:.6g}", (REFERENCE,), rule)


def hysteresis(width_rad: float) -> Make:
    """The angle lags in the direction of motion by a constant, whatever the speed: play, magnetic memory."""

    def make(model: Model) -> Model:
        column = direction(width_rad)

        def step(s: Signals, p: P) -> None:
            _turned(s, -p["play"] * s[column.name])

        return _add(
            model, "mechanics", "hysteresis", _free(["play"], 0.5, "rad", "half the play"), step, column
        )

    return make


def reference_harmonics(effect: str, orders: Sequence[int]) -> Make:
    """The reference is off by waves of the turn: logged angle = angle + sum of c cos(n a) + s sin(n a)."""

    def make(model: Model) -> Model:
        names = [(f"{effect}_{n}_cos", f"{effect}_{n}_sin") for n in orders]

        def step(s: Signals, p: P) -> None:
            a = s[model.pose[0]]
            error = sum(
                p[c] * ca.cos(n * a) + p[d] * ca.sin(n * a) for n, (c, d) in zip(orders, names, strict=True)
            )
            _turned(s, -error)

        new = tuple(
            q
            for n, row in zip(orders, names, strict=True)
            for q in _free(row, STEEPEST / n, "rad", "error of the reference")
        )
        return _add(model, "reference", effect, new, step)

    return make


def reference_scale_error(model: Model) -> Model:
    """A turn of the reference is short or long by a share."""

    def step(s: Signals, p: P) -> None:
        _turned(s, -p["scale"] * s[model.pose[0]])

    return _add(
        model, "reference", "reference_scale_error", _free(["scale"], 0.05, "1", "share of a turn"), step
    )


# -- electronics -------------------------------------------------------------------------------------------


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

        return _add(model, "electronics", "saturation", _free(names, 1.5, "1", "share clipped"), step)

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
        return _add(model, "electronics", "saturation", new, step)

    return make
