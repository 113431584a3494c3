"""Effects of an encoder by their texts: each a function of the numbers that its text holds (`recipes`)."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import radians

import casadi as ca

from hallsym.errors import InputError
from hallsym.families.data_functions import Columns, Followed, Read
from hallsym.families.parts import Make
from hallsym.families.recipe_numbers import among, positive
from hallsym.families.rotary import effects as re
from hallsym.model import Model, Step


def short(model: Model) -> Model:
    """Return the model with atan2 itself where it has no run statistics anyway: the series would be long."""
    return re.direct(model) if re.decodes(model) and model.computed else model


# -- mechanics and field -----------------------------------------------------------------------------------


def eccentricity(*, form: str = "both") -> Make:
    """Chip and magnet off the axis (both), the field's curvature too (curved), or the chip alone (chip)."""
    orders = {"both": (2,), "curved": (2, 3), "chip": (-1,)}[among("form", form, "both curved chip")]
    return re.field_harmonics("eccentricity", "mechanics", orders)


def eccentricity_towards(*, direction_deg: float) -> Make:
    """Chip and magnet off the axis, the chip in a known direction."""
    return re.off_axis("eccentricity", radians(direction_deg))


def magnet_tilt(*, form: str = "both") -> Make:
    """Magnet tilted and chip off the axis (both), or the chip tilted alone (chip)."""
    orders = {"both": (2,), "chip": (-1,)}[among("form", form, "both chip")]
    return re.field_harmonics("magnet_tilt", "mechanics", orders)


def magnet_tilt_towards(*, direction_deg: float) -> Make:
    """Magnet tilted and chip off the axis in a known direction."""
    return re.off_axis("magnet_tilt", radians(direction_deg), tilted=True)


def third_harmonic_distortion(*, phase: str = "fixed") -> Make:
    """Third harmonic of the magnet's field, in phase with the first, or in any phase."""
    free = among("phase", phase, "fixed free") == "free"
    return re.field_harmonics("third_harmonic_distortion", "field", (-3,), free)


def field_saturation() -> Make:
    """Both plates compress softly, alike."""
    return re.field_saturation


def uniform_stray_field(*, source: str = "static") -> Make:
    """External field: static, in proportion to the speed, or with runs=1/3 in some runs only."""
    if among("source", source, "static speed") == "static":
        return re.offset("uniform_stray_field")
    return re.offset_drift("uniform_stray_field", *re.speed())


def switched_stray_field(*, runs: tuple) -> Make:
    """External field that is on in some runs."""
    if any(r != int(r) for r in runs):
        raise InputError("Numbers runs of uniform_stray_field must be run numbers such as 1/3.")
    return re.offset_drift("uniform_stray_field", *re.during([int(r) for r in runs]))


# -- transducer --------------------------------------------------------------------------------------------


def offset_error() -> Make:
    """Constant offset of sine and cosine."""
    return re.offset("offset_error")


def gain_mismatch() -> Make:
    """Sine and cosine have different gains."""
    return re.gain_mismatch


def orthogonality_error() -> Make:
    """The axes of sine and cosine are not perpendicular."""
    return re.orthogonality_error


def odd_nonlinearity(*, order: int = 3) -> Make:
    """Cubic deviation of each voltage from a line; with order 5 quintic too."""
    among("order", str(order), "3 5")
    return re.nonlinearity("odd_nonlinearity", (3, 5)[: order // 2])


def even_nonlinearity(*, order: int = 2) -> Make:
    """Square deviation of each voltage from a line; with order 4 the fourth power too."""
    among("order", str(order), "2 4")
    return re.nonlinearity("even_nonlinearity", (2, 4)[: order // 2])


def gain_temperature_drift(*, mean_degc: float) -> Make:
    """Gains follow the logged temperature above a mean."""
    return _gains("gain_temperature_drift", *re.temperature(mean_degc))


def offset_temperature_drift(*, mean_degc: float) -> Make:
    """Offsets follow the logged temperature above a mean."""
    return re.offset_drift("offset_temperature_drift", *re.temperature(mean_degc))


def gain_time_drift(*, duration_s: float, degree: int = 1) -> Make:
    """Gains drift over the campaign: a polynomial of time, or with settling_s an exponential."""
    return _gains("gain_time_drift", *_polynomial(duration_s, degree))


def offset_time_drift(*, duration_s: float, degree: int = 1) -> Make:
    """Offsets drift over the campaign: a polynomial of time, or with settling_s an exponential."""
    return re.offset_drift("offset_time_drift", *_polynomial(duration_s, degree))


def gain_settling(*, settling_s: float) -> Make:
    """Gains settle exponentially over the campaign."""
    return _gains("gain_time_drift", *re.settling(positive("settling_s", settling_s)))


def offset_settling(*, settling_s: float) -> Make:
    """Offsets settle exponentially over the campaign."""
    return re.offset_drift("offset_time_drift", *re.settling(positive("settling_s", settling_s)))


# -- clock, lag, memory ------------------------------------------------------------------------------------


def time_skew(*, per: str = "log") -> Make:
    """Latency: one delay for the log, or one per plate."""
    if among("per", per, "log plate") == "log":
        return re.time_skew
    return _on_voltages("a delay per plate", re.time_skew_per_plate)


def first_order_lag() -> Make:
    """Low-pass in the path of both voltages."""
    return re.first_order_lag


def hysteresis(*, half_width_rad: float) -> Make:
    """Play: the angle lags in the direction of motion, which turns over within twice this angle."""
    return re.hysteresis(positive("half_width_rad", half_width_rad))


# -- electronics -------------------------------------------------------------------------------------------


def saturation(*, low_v: tuple, high_v: tuple) -> Make:
    """Voltages stop at a rail: lowest and highest of sine and cosine; or level, axes_deg of a bare angle."""
    if not len(low_v) == len(high_v) == 2:
        raise InputError("Rails of saturation must be 2 numbers each, as low_v=-1.2/-1.2.")
    return _on_voltages("low_v and high_v", re.clipping(low_v, high_v))


def clipped_angle(*, level: float, axes_deg: float = 0.0) -> Make:
    """Both voltages stop at a share of their amplitude before the angle is taken from them."""
    if not 0 < level < 1:
        raise InputError(f"Number level of saturation must lie between 0 and 1; it is {level:g}.")
    make = re.clipped_angle(level, radians(axes_deg))

    def checked(model: Model) -> Model:
        if not re.decodes(model):
            raise InputError(
                "Effect saturation takes level where only the angle is read; give low_v, high_v."
            )
        return make(model)

    return checked


def mains_hum(*, frequency_hz: float) -> Make:
    """Pick-up at a mains frequency."""
    return re.offset_drift("mains_hum", *re.wave_of_time(positive("frequency_hz", frequency_hz)))


def reference_voltage_fluctuation(*, frequency_hz: float) -> Make:
    """The gain of the converter swings with the mains."""
    wave = re.wave_of_time(positive("frequency_hz", frequency_hz))
    return _gains("reference_voltage_fluctuation", *wave)


# -- reference ---------------------------------------------------------------------------------------------


def reference_eccentricity() -> Make:
    """The reference has an error once per turn."""
    return re.reference_harmonics("reference_eccentricity", (1,))


def reference_scale_error() -> Make:
    """A turn of the reference is short or long by a share."""
    return re.reference_scale_error


def reference_pole_pairs(*, periods: tuple = (float(re.FULL_STEPS),)) -> Make:
    """Pattern of the pole pairs of a stepper used as reference: its periods per turn."""
    if not all(n == int(n) and 1 <= n <= 1000 for n in periods):
        raise InputError("Numbers periods of reference_pole_pairs must be periods per turn such as 50/100.")
    return re.reference_harmonics("reference_pole_pairs", [int(n) for n in periods])


RECIPES: dict[str, tuple[Callable[..., Make], ...]] = {
    f.__name__: (f,)
    for f in (
        offset_error, gain_mismatch, orthogonality_error, third_harmonic_distortion, field_saturation,
        odd_nonlinearity, even_nonlinearity, magnet_tilt, time_skew, first_order_lag, hysteresis,
        gain_temperature_drift, offset_temperature_drift, mains_hum, reference_voltage_fluctuation,
        reference_eccentricity, reference_scale_error, reference_pole_pairs,
    )
} | {"eccentricity": (eccentricity, eccentricity_towards),
     "magnet_tilt": (magnet_tilt, magnet_tilt_towards),
     "uniform_stray_field": (uniform_stray_field, switched_stray_field),
     "gain_time_drift": (gain_time_drift, gain_settling),
     "offset_time_drift": (offset_time_drift, offset_settling),
     "saturation": (saturation, clipped_angle)}  # fmt: skip
"""By name; where an effect has several forms the numbers that are given tell them apart."""


def _gains(effect: str, columns: Columns, read: Read) -> Make:
    """Drift of the gains of both plates; of the angle alone only that of the sine against the cosine."""
    both = re.gain_drift(effect, columns, read)

    def make(model: Model) -> Model:
        wide = both(model)
        if not re.decodes(model):
            return wide
        new = [p for p in wide.parameters if p.name not in model.names]
        none = {p.name: ca.SX(0) for p in new if p.name.endswith("_cos")}
        steps = tuple(pair if pair in model.steps else (pair[0], _with(pair[1], none)) for pair in wide.steps)
        kept = tuple(p for p in wide.parameters if p.name not in none)
        return replace(wide, steps=steps, parameters=kept)

    return make


def _polynomial(duration_s: float, degree: int) -> Followed:
    among("degree", str(degree), "1 2 3")
    return re.powers_of_time(positive("duration_s", duration_s), degree)


def _with(step: Step, values: Mapping[str, ca.SX]) -> Step:
    return lambda s, p: step(s, {**p, **values})


def _on_voltages(what: str, make: Make) -> Make:
    """The effect, refused where a model reads the angle alone."""

    def checked(model: Model) -> Model:
        if re.decodes(model):
            raise InputError(f"Model {model.name} reads the angle alone here; {what} needs both voltages.")
        return make(model)

    return checked
