"""Effects of the stage by their texts: each a function of the numbers that its text holds (`recipes`)."""

from collections.abc import Callable

from hallsym.errors import InputError
from hallsym.families.data_functions import Followed
from hallsym.families.parts import Make
from hallsym.families.recipe_numbers import among, positive
from hallsym.families.stage import effects as se
from hallsym.model import Model

ARMS = ((0, "ry_rad"), (1, "rx_rad"))
ALL_ARMS = tuple((i, c) for i in (0, 1) for c in ("z_m", "rx_rad", "ry_rad"))


def height_quadratic(*, form: str = "full") -> Make:
    """Gain bends with Z, Rx, Ry: all second-order terms (full), or each probe's height squared (tied)."""
    return {"full": se.height_quadratic, "tied": se.height_quadratic_tied}[among("form", form, "full tied")]


def odd_nonlinearity(*, order: int = 3) -> Make:
    """Cubic deviation of the reading from a line; with order 5 quintic too."""
    among("order", str(order), "3 5")
    return se.nonlinearity("odd_nonlinearity", (3, 5)[: order // 2])


def even_nonlinearity(*, order: int = 2) -> Make:
    """Square deviation of the reading from a line; with order 4 the fourth power too."""
    among("order", str(order), "2 4")
    return se.nonlinearity("even_nonlinearity", (2, 4)[: order // 2])


def cross_axis_sensitivity(*, order: int = 2) -> Make:
    """Leakage of the motion across the sensing axis, to second or third order."""
    among("order", str(order), "2 3")
    return se.cross_axis_sensitivity(("uv", "vv") if order == 2 else tuple(se.CROSS))


def second_order_rotation(*, form: str = "rigid") -> Make:
    """Finite rotation that the small-angle model drops: of a rigid stage, or term by term."""
    known = {"rigid": se.second_order_rotation, "terms": se.second_order_rotation_body}
    return known[among("form", form, "rigid terms")]


def time_skew(*, per: str = "log") -> Make:
    """Constant delay between readings and reference: one for the log, or one per probe."""
    return se.delayed("time_skew", among("per", per, "log probe") == "log")


def first_order_lag(*, per: str = "log") -> Make:
    """Low-pass in the path of the readings: one time constant for the log, or one per probe."""
    return se.delayed("first_order_lag", among("per", per, "log probe") == "log")


def hysteresis(*, half_width_m: float) -> Make:
    """Memory of the direction of motion: a play of about this half-width of reading."""
    positive("half_width_m", half_width_m)
    return se.hysteresis(half_width_m)


def gain_temperature_drift(*, mean_degc: float) -> Make:
    """Gain follows the logged temperature above a mean."""
    return se.gain_drift("gain_temperature_drift", *se.temperature(mean_degc))


def offset_temperature_drift(*, mean_degc: float) -> Make:
    """Offset follows the logged temperature above a mean."""
    return se.offset_drift("offset_temperature_drift", *se.temperature(mean_degc))


def gain_time_drift(*, duration_s: float, degree: int = 1) -> Make:
    """Gain drifts over the campaign: a polynomial of time, or with settling_s an exponential."""
    return se.gain_drift("gain_time_drift", *_polynomial(duration_s, degree))


def offset_time_drift(*, duration_s: float, degree: int = 1) -> Make:
    """Offset drifts over the campaign: a polynomial of time, or with settling_s an exponential."""
    return se.offset_drift("offset_time_drift", *_polynomial(duration_s, degree))


def gain_settling(*, settling_s: float) -> Make:
    """Gain settles exponentially over the campaign."""
    return se.gain_drift("gain_time_drift", *se.settling(positive("settling_s", settling_s)))


def offset_settling(*, settling_s: float) -> Make:
    """Offset settles exponentially over the campaign."""
    return se.offset_drift("offset_time_drift", *se.settling(positive("settling_s", settling_s)))


def mount_slip(*, probe: str, instant_s: float) -> Make:
    """One probe moves at an instant since the log began."""

    def make(model: Model) -> Model:
        labels = [p.label for p in model.layout]
        if probe not in labels:
            raise InputError(f"Probe of mount_slip must be one of {', '.join(labels)}; it is {probe!r}.")
        return se.mount_slip(labels.index(probe), instant_s)(model)

    return make


def motor_stray_field(*, terms: str = "acceleration") -> Make:
    """Field of the motor currents: by acceleration, or also by position."""
    among("terms", terms, "acceleration position")
    return lambda model: se.motor_stray_field(() if terms == "acceleration" else model.pose)(model)


def mains_hum(*, frequency_hz: float, harmonics: int = 1) -> Make:
    """Pick-up at a mains frequency and its harmonics."""
    if not 1 <= harmonics <= 9:
        raise InputError(f"Number harmonics of mains_hum must be 1 to 9; instead received {harmonics}.")
    waves = tuple(range(1, harmonics + 1))
    return se.mains_hum(positive("frequency_hz", frequency_hz), waves)


def saturation(*, low_m: tuple, high_m: tuple) -> Make:
    """Readings stop at a rail: lowest and highest value of each probe."""

    def make(model: Model) -> Model:
        if not len(low_m) == len(high_m) == len(model.layout):
            raise InputError(f"Rails of saturation must be {len(model.layout)} numbers each, as -2e-4/-2e-4.")
        return se.clipping(low_m, high_m)(model)

    return make


def reference_scale_error() -> Make:
    """Scale factor of each reference axis."""
    return se.reference_scale_error()


def reference_abbe_error(*, arms: str = "tilt") -> Make:
    """The reference reads tilt times an Abbe arm: x with Ry and y with Rx, or with Z, Rx, Ry."""
    return se.reference_abbe_error(ARMS if among("arms", arms, "tilt all") == "tilt" else ALL_ARMS)


def reference_drift(*, degree: int = 1) -> Make:
    """The reference creeps within a run, one rate per axis, or with degree 3 along a cubic."""
    among("degree", str(degree), "1 3")
    return se.reference_drift(degree)


def vertical_offset_coupling() -> Make:
    """Reading follows Z, Rx, Ry whatever the stroke."""
    return se.vertical_offset_coupling


def vertical_gain_coupling() -> Make:
    """Gain follows height and tilts: a, b, c of Model (31)."""
    return se.vertical_gain_coupling


RECIPES: dict[str, tuple[Callable[..., Make], ...]] = {
    f.__name__: (f,)
    for f in (
        vertical_gain_coupling, height_quadratic, odd_nonlinearity, even_nonlinearity, cross_axis_sensitivity,
        second_order_rotation, vertical_offset_coupling, time_skew, first_order_lag, hysteresis,
        gain_temperature_drift, offset_temperature_drift, mount_slip, motor_stray_field, saturation,
        mains_hum, reference_scale_error, reference_abbe_error, reference_drift,
    )
} | {"gain_time_drift": (gain_time_drift, gain_settling),
     "offset_time_drift": (offset_time_drift, offset_settling)}  # fmt: skip
"""By name; where an effect has two forms the numbers that are given tell them apart."""


def _polynomial(duration_s: float, degree: int) -> Followed:
    among("degree", str(degree), "1 2 3")
    return se.powers_of_time(positive("duration_s", duration_s), degree)
