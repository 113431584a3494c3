"""The catalogue of the encoder: the field's names, each with the ways in which it may act."""

from collections.abc import Callable, Sequence

import numpy as np

from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.survey import MAINS
from hallsym.families import rotary_effects as re
from hallsym.model import Model

PLAYS = (1e-3, 1e-2, 0.1)
"""Angles [rad] within which the direction of motion turns over after a reversal: tried values."""
DIRECTIONS = tuple(np.pi * k / 6 for k in range(6))
"""Directions in which the chip may lie off the axis: tried values."""
LEVELS = (0.95, 0.8, 0.65, 0.5)
AXES = (0.0, np.pi / 6, -np.pi / 6)
"""Rails, in amplitudes, and axes of the plates [rad] to start from where only the angle is read."""
THIRD = "third_harmonic_distortion"
MAGNET = "turn the stator (or the chip) by a known angle against the magnet, and record a turn at each"
REFERENCE = "couple the reference anew at another angle, and record a turn at each"


def _one(label: str, make: re.Make) -> list[Variant]:
    return [Variant(label, make)]


def _free_offset(model: Model) -> bool:
    """Whether the model has offsets, amplitudes and phase of its own: an ellipse."""
    return "Vx" in model.names


def _off_axis(model: Model, facts: Facts) -> list[Variant]:
    first = Variant("chip and magnet off the axis", re.field_harmonics("eccentricity", "mechanics", (2,)))
    both = Variant("and the field's curvature", re.field_harmonics("eccentricity", "mechanics", (2, 3)))
    if _free_offset(model):
        return [first, both]
    chip = Variant("chip off the axis", re.field_harmonics("eccentricity", "mechanics", (-1,)))
    return [chip, first, *_towards("eccentricity", DIRECTIONS, len(DIRECTIONS))]


def _towards(effect: str, directions: Sequence[float], tried: int = 1) -> list[Variant]:
    tilted = effect == "magnet_tilt"
    return [
        Variant(f"chip towards {np.degrees(d):.0f} deg", re.off_axis(effect, d, tilted), 1, d, tried)
        for d in directions
    ]


def _finer_direction(effect: str) -> Callable[[Model, Facts, float], list[Variant]]:
    def refine(model: Model, facts: Facts, direction: float) -> list[Variant]:
        return _towards(effect, [direction + np.pi / 6 * k / 8 for k in (-4, -2, -1, 1, 2, 4)])

    return refine


def _tilted(model: Model, facts: Facts) -> list[Variant]:
    off = Variant("magnet tilted, chip off the axis", re.field_harmonics("magnet_tilt", "mechanics", (2,)))
    if _free_offset(model):
        return [off]
    chip = Variant("chip tilted", re.field_harmonics("magnet_tilt", "mechanics", (-1,)))
    return [chip, off, *_towards("magnet_tilt", DIRECTIONS, len(DIRECTIONS))]


def _hysteresis(model: Model, facts: Facts) -> list[Variant]:
    return [Variant(f"within {w:g} rad", re.hysteresis(w), 0, None, len(PLAYS)) for w in PLAYS]


def _over_time(drift: Callable[..., re.Make], effect: str, facts: Facts) -> list[Variant]:
    T, out = facts.duration_s, []
    for degree in (1, 2, 3):
        out.append(Variant(f"polynomial of degree {degree}", drift(effect, *re.powers_of_time(T, degree))))
    for tau in (T / 16, T / 8, T / 4, T / 2):
        out.append(Variant(f"settling, {tau:.3g} s", drift(effect, *re.settling(tau)), 1, tau))
    return out


def _finer_settling(
    drift: Callable[..., re.Make], effect: str
) -> Callable[[Model, Facts, float], list[Variant]]:
    def refine(model: Model, facts: Facts, tau: float) -> list[Variant]:
        tried = [tau * 1.35**k for k in (-2, -1, 1, 2)]
        return [Variant(f"settling, {t:.3g} s", drift(effect, *re.settling(t)), 1, t) for t in tried]

    return refine


def _by_temperature(drift: Callable[..., re.Make], effect: str, facts: Facts) -> list[Variant]:
    return _one("linear", drift(effect, *re.temperature(facts.temperature or 0.0)))


def _stray(model: Model, facts: Facts) -> list[Variant]:
    out = [Variant("static", re.offset("uniform_stray_field"))]
    if "t_s" in facts.columns:
        out.append(Variant("in proportion to speed", re.offset_drift("uniform_stray_field", *re.speed())))
    if facts.on_runs:
        listed = ", ".join(map(str, facts.on_runs))
        make = re.offset_drift("uniform_stray_field", *re.during(facts.on_runs))
        out.append(Variant(f"on in runs {listed}", make, 1))
    return out


def _hums(drift: Callable[..., re.Make], effect: str, facts: Facts) -> list[Variant]:
    tried = max(1, round(sum(b - a for a, b in MAINS) * facts.duration_s))  # independent frequencies
    out = []
    for f in facts.lines_hz:
        out.append(Variant(f"{f:.5g} Hz", drift(effect, *re.wave_of_time(f)), 1, f, tried))
    return out


def _clipped_angle(level: float, axes: float) -> Variant:
    label = f"from a rail at {level:g} of the amplitude, axes at {np.degrees(axes):.0f} deg"
    return Variant(label, re.clipped_angle(level, axes), 0, None, len(LEVELS) * len(AXES))


def _clipping(model: Model, facts: Facts) -> list[Variant]:
    if re.decodes(model):
        return [_clipped_angle(x, a) for x in LEVELS for a in AXES]
    out = []
    if np.isfinite(facts.rails).any():
        low, high = np.array(facts.rails).T
        big = 1e3 * re.amplitude(model)
        low, high = np.where(np.isfinite(low), low, -big), np.where(np.isfinite(high), high, big)
        out.append(Variant("where readings repeat", re.clipping(low.tolist(), high.tolist()), 1))
    for k, (high, low) in enumerate(zip(facts.extremes[0::2], facts.extremes[1::2], strict=True)):
        out.append(Variant(f"rails, try {k + 1}", re.clipping(low.tolist(), high.tolist()), 1, None, 4))
    return out


def _pole_pattern(model: Model, facts: Facts) -> list[Variant]:
    n, name = re.FULL_STEPS, "reference_pole_pairs"
    return [
        Variant(f"{n} per turn", re.reference_harmonics(name, (n,))),
        Variant(f"{n} and {2 * n} per turn", re.reference_harmonics(name, (n, 2 * n))),
        Variant(f"{2 * n} per turn", re.reference_harmonics(name, (2 * n,))),
    ]


CATALOGUE: tuple[Effect, ...] = (
    Effect("offset_error", "transducer", "constant offset of sine or cosine",
           lambda m, f: _one("both plates", re.offset("offset_error")), MAGNET),
    Effect("uniform_stray_field", "field", "external field: static, switched, or with the speed", _stray,
           MAGNET),
    Effect("gain_mismatch", "transducer", "sine and cosine have different gains",
           lambda m, f: _one("one ratio", re.gain_mismatch), MAGNET),
    Effect("orthogonality_error", "transducer", "the axes of sine and cosine are not perpendicular",
           lambda m, f: _one("one angle", re.orthogonality_error), MAGNET),
    Effect(THIRD, "field", "third harmonic of the magnet's field: four waves per turn",
           lambda m, f: [Variant("in phase", re.field_harmonics(THIRD, "field", (-3,), False)),
                         Variant("any phase", re.field_harmonics(THIRD, "field", (-3,)))],
           f"another air gap; or {MAGNET}"),
    Effect("field_saturation", "field", "both plates compress softly at a high field",
           lambda m, f: _one("cubic", re.field_saturation), "another air gap: compression follows the field"),
    Effect("odd_nonlinearity", "transducer", "cubic deviation of each voltage from a line",
           lambda m, f: [Variant("cubic", re.nonlinearity("odd_nonlinearity", (3,))),
                         Variant("cubic and quintic", re.nonlinearity("odd_nonlinearity", (3, 5)))],
           "another air gap: the field's own harmonics do not follow the amplitude"),
    Effect("even_nonlinearity", "transducer", "square deviation of each voltage from a line",
           lambda m, f: [Variant("square", re.nonlinearity("even_nonlinearity", (2,))),
                         Variant("square and fourth power", re.nonlinearity("even_nonlinearity", (2, 4)))],
           "another air gap"),
    Effect("eccentricity", "mechanics", "chip or magnet off the axis of rotation", _off_axis,
           f"{MAGNET}; or {REFERENCE}", refine=_finer_direction("eccentricity")),
    Effect("magnet_tilt", "mechanics", "the axis of the magnet or the chip is tilted", _tilted,
           f"{MAGNET}; or {REFERENCE}", refine=_finer_direction("magnet_tilt")),
    Effect("time_skew", "clock", "constant delay between readings and reference: latency",
           lambda m, f: [Variant("one delay", re.time_skew)] if re.decodes(m) else
           [Variant("one delay", re.time_skew), Variant("a delay per plate", re.time_skew_per_plate)],
           "speeds so high that a low-pass lowers the amplitude, which a delay does not", needs=("t_s",)),
    Effect("first_order_lag", "transducer", "low-pass in the path of the readings",
           lambda m, f: _one("one time constant", re.first_order_lag),
           "speeds so high that a low-pass lowers the amplitude, which a delay does not", needs=("t_s",)),
    Effect("hysteresis", "mechanics", "the angle depends on the direction, not on the speed", _hysteresis,
           "both directions at several speeds: play does not grow with the speed, a delay does",
           needs=("t_s",)),
    Effect("gain_temperature_drift", "transducer", "gains follow the logged temperature",
           lambda m, f: _by_temperature(re.gain_drift, "gain_temperature_drift", f),
           "warm up and cool down, so that temperature is not a function of time",
           needs=("temperature_degc",)),
    Effect("offset_temperature_drift", "transducer", "offsets follow the logged temperature",
           lambda m, f: _by_temperature(re.offset_drift, "offset_temperature_drift", f),
           "warm up and cool down, so that temperature is not a function of time",
           needs=("temperature_degc",)),
    Effect("gain_time_drift", "transducer", "gains drift smoothly over the campaign",
           lambda m, f: _over_time(re.gain_drift, "gain_time_drift", f),
           "the first run again at the end; log the temperature", needs=("t_s",),
           refine=_finer_settling(re.gain_drift, "gain_time_drift")),
    Effect("offset_time_drift", "transducer", "offsets drift smoothly over the campaign",
           lambda m, f: _over_time(re.offset_drift, "offset_time_drift", f),
           "the first run again at the end; log the temperature", needs=("t_s",),
           refine=_finer_settling(re.offset_drift, "offset_time_drift")),
    Effect("saturation", "electronics", "voltages stop at a rail", _clipping,
           "a lower gain or a wider air gap"),
    Effect("mains_hum", "electronics", "50 or 60 Hz pick-up",
           lambda m, f: _hums(re.offset_drift, "mains_hum", f), "a run at rest on the full clock",
           needs=("t_s",)),
    Effect("reference_voltage_fluctuation", "electronics", "the gain of the converter swings with the mains",
           lambda m, f: _hums(re.gain_drift, "reference_voltage_fluctuation", f),
           "a run at rest on the full clock", needs=("t_s",)),
    Effect("reference_eccentricity", "reference", "the reference has an error once per turn",
           lambda m, f: _one("once per turn", re.reference_harmonics("reference_eccentricity", (1,))),
           REFERENCE),
    Effect("reference_scale_error", "reference", "a turn of the reference is short or long",
           lambda m, f: _one("one share", re.reference_scale_error), "several turns in one direction"),
    Effect("reference_pole_pairs", "reference", "pattern of the pole pairs of a stepper used as reference",
           _pole_pattern, f"micro-steps or another reference; or {REFERENCE}"),
)  # fmt: skip
