"""Effects of the stage by what is typed and saved: `hysteresis:half_width_m=6e-05`, a name and its numbers.

A diagnosis names an effect and prints the text that `--effect` takes; a calibration holds the same text, so
the model can be built again. Numbers that a log must tell first (a width, an instant, a frequency) have no
default: `hallsym.diagnosis.choose` finds them when only the name is given.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from hallsym.errors import InputError, nearest
from hallsym.families import stage_effects as se
from hallsym.model import Model

Make = Callable[[Model], Model]

ARMS = ((0, "ry_rad"), (1, "rx_rad"))
ALL_ARMS = tuple((i, c) for i in (0, 1) for c in ("z_m", "rx_rad", "ry_rad"))
REPAIR = "is a fault of the recording, which no model holds"
FAULTS = {
    "outliers": f"{REPAIR}: fit with --loss auto or tukey, which leave spikes out or weigh them down.",
    "dropped_samples": f"{REPAIR}: repair the acquisition, or leave the samples out (--loss tukey).",
    "clock_jitter": f"{REPAIR}: take readings and reference on one clock, and record again.",
    "adc_quantisation": f"{REPAIR}: use a finer range or converter; the fit counts step / sqrt(12) as noise.",
    "channel_swap": f"{REPAIR}: put the wiring right, or fit with --resolve-wiring.",
    "sign_inversion": f"{REPAIR}: put the wiring right, or fit with --resolve-wiring.",
}
"""Names that a diagnosis may give and no fit can add, with what to do instead."""


def height_quadratic(*, form: str = "full") -> Make:
    """Gain bends with Z, Rx, Ry: all second-order terms (full), or each probe's height squared (tied)."""
    return {"full": se.height_quadratic, "tied": se.height_quadratic_tied}[_among("form", form, "full tied")]


def odd_nonlinearity(*, order: int = 3) -> Make:
    """Cubic deviation of the reading from a line; with order 5 quintic too."""
    _among("order", str(order), "3 5")
    return se.nonlinearity("odd_nonlinearity", (3, 5)[: order // 2])


def even_nonlinearity(*, order: int = 2) -> Make:
    """Square deviation of the reading from a line; with order 4 the fourth power too."""
    _among("order", str(order), "2 4")
    return se.nonlinearity("even_nonlinearity", (2, 4)[: order // 2])


def cross_axis_sensitivity(*, order: int = 2) -> Make:
    """Leakage of the motion across the sensing axis, to second or third order."""
    _among("order", str(order), "2 3")
    return se.cross_axis_sensitivity(("uv", "vv") if order == 2 else tuple(se.CROSS))


def second_order_rotation(*, form: str = "rigid") -> Make:
    """Finite rotation that the small-angle model drops: of a rigid stage, or term by term."""
    known = {"rigid": se.second_order_rotation, "terms": se.second_order_rotation_body}
    return known[_among("form", form, "rigid terms")]


def time_skew(*, per: str = "log") -> Make:
    """Constant delay between readings and reference: one for the log, or one per probe."""
    return se.delayed("time_skew", _among("per", per, "log probe") == "log")


def first_order_lag(*, per: str = "log") -> Make:
    """Low-pass in the path of the readings: one time constant for the log, or one per probe."""
    return se.delayed("first_order_lag", _among("per", per, "log probe") == "log")


def hysteresis(*, half_width_m: float) -> Make:
    """Memory of the direction of motion: a play of about this half-width of reading."""
    _positive("half_width_m", half_width_m)
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
    return se.gain_drift("gain_time_drift", *se.settling(_positive("settling_s", settling_s)))


def offset_settling(*, settling_s: float) -> Make:
    """Offset settles exponentially over the campaign."""
    return se.offset_drift("offset_time_drift", *se.settling(_positive("settling_s", settling_s)))


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
    _among("terms", terms, "acceleration position")
    return lambda model: se.motor_stray_field(() if terms == "acceleration" else model.pose)(model)


def mains_hum(*, frequency_hz: float, harmonics: int = 1) -> Make:
    """Pick-up at a mains frequency and its harmonics."""
    if not 1 <= harmonics <= 9:
        raise InputError(f"Number harmonics of mains_hum must be 1 to 9; instead received {harmonics}.")
    waves = tuple(range(1, harmonics + 1))
    return se.mains_hum(_positive("frequency_hz", frequency_hz), waves)


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
    return se.reference_abbe_error(ARMS if _among("arms", arms, "tilt all") == "tilt" else ALL_ARMS)


def reference_drift(*, degree: int = 1) -> Make:
    """The reference creeps within a run, one rate per axis, or with degree 3 along a cubic."""
    _among("degree", str(degree), "1 3")
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


def write(name: str, **numbers: object) -> str:
    """Return the text of an effect: `write("mains_hum", frequency_hz=50.02)`; numbers to 9 digits.

    What the name alone already means is left out.
    """
    usual = {k: v.default for make in RECIPES[name] for k, v in _arguments(make).items()}
    said = ",".join(f"{k}={_written(v)}" for k, v in numbers.items() if v != usual[k])
    return f"{name}:{said}" if said else name


def _written(value: object) -> str:
    if isinstance(value, list | tuple):
        return "/".join(_written(v) for v in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def read(text: str) -> tuple[str, dict[str, str]]:
    """Return name and numbers of an effect's text. Raises `InputError` for another form."""
    name, colon, rest = text.partition(":")
    pairs = [part.partition("=") for part in rest.split(",")] if colon else []
    if not name or any(not key or not value for key, _, value in pairs):
        raise InputError(
            f"Effect {text!r} must be a name, or a name with its numbers: hysteresis:half_width_m=6e-05."
        )
    return name, {key.strip(): value.strip() for key, _, value in pairs}


def lacking(text: str) -> tuple[str, ...]:
    """Return the numbers that a known effect's text leaves open and that a log must tell."""
    name, given = read(text)
    forms = RECIPES.get(name, ())
    if not forms:
        return ()
    open_ = [[k for k, v in _arguments(f).items() if v.default is v.empty and k not in given] for f in forms]
    return tuple(sorted(open_, key=lambda names: len(names))[0])


def make_of(text: str) -> Make:
    """Return the effect that a text names: a function `Model -> Model` that notes the text in the model.

    Raises `InputError` for numbers that are unknown, missing or no numbers.
    """
    name, given = read(text)
    make = _form(name, given)(**_numbers(name, given))
    return lambda model: noted(model, make(model), text)


def noted(model: Model, wide: Model, text: str) -> Model:
    """Return `wide` with `text` as what its effects beyond those of `model` are saved as."""
    new = [effect for effect in wide.effects if effect not in model.effects]
    return replace(wide, texts={**wide.texts, **dict.fromkeys(new, text)})


def _arguments(make: Callable[..., Make]) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(make).parameters


def _form(name: str, given: Mapping[str, Any]) -> Callable[..., Make]:
    """Return the form of an effect that takes the numbers given."""
    forms = RECIPES[name]
    known = list(dict.fromkeys(k for f in forms for k in _arguments(f)))
    for key in given:
        if key not in known:
            listed = f"; it has {', '.join(known)}" if known else "; it has none"
            raise InputError(f"Effect {name} has no number {key!r}{listed}{nearest(key, known)}.")
    fitting = [f for f in forms if set(given) <= set(_arguments(f))]
    if not fitting:
        raise InputError(f"Numbers {', '.join(given)} of effect {name} exclude each other; give one form.")
    whole = [f for f in fitting if all(k in given for k, v in _arguments(f).items() if v.default is v.empty)]
    if not whole:
        missing = [k for k, v in _arguments(fitting[0]).items() if v.default is v.empty and k not in given]
        raise InputError(
            f"Effect {name} needs {' and '.join(missing)}: {name}:{missing[0]}=..., as 'hallsym diagnose' "
            "prints it; with a log to fit, the name alone is enough."
        )
    return whole[0]


def _numbers(name: str, given: Mapping[str, str]) -> dict[str, Any]:
    kinds = _arguments(_form(name, given))
    out: dict[str, Any] = {}
    for key, text in given.items():
        kind = kinds[key].annotation
        try:
            out[key] = tuple(float(v) for v in text.split("/")) if kind is tuple else kind(text)
        except ValueError:
            wanted = {float: "a number", int: "a whole number", tuple: "numbers such as 1/2/3"}[kind]
            raise InputError(f"Number {key} of effect {name} must be {wanted}; it is {text!r}.") from None
    return out


def _among(key: str, value: str, known: str) -> str:
    names: Sequence[str] = known.split()
    if value not in names:
        raise InputError(f"An effect's {key} must be one of {', '.join(names)}; it is {value!r}.")
    return value


def _positive(key: str, value: float) -> float:
    if not 0 < value < float("inf"):
        raise InputError(f"An effect's {key} must be a positive number; it is {value:g}.")
    return value


def _polynomial(duration_s: float, degree: int) -> tuple[Any, Any]:
    _among("degree", str(degree), "1 2 3")
    return se.powers_of_time(_positive("duration_s", duration_s), degree)
