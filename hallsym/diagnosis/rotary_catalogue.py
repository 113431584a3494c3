"""The catalogue of the encoder: the field's names, each with the ways in which it may act."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.survey import MAINS
from hallsym.families import recipes
from hallsym.families.recipes import make_of
from hallsym.families.rotary import effects as re
from hallsym.model import Model

write = partial(recipes.write, "rotary")
PLAYS = (1e-3, 1e-2, 0.1)
"""Angles [rad] within which the direction of motion turns over after a reversal: tried values."""
DIRECTIONS = tuple(np.pi * k / 6 for k in range(6))
"""Directions in which the chip may lie off the axis: tried values."""
LEVELS = (0.95, 0.8, 0.65, 0.5)
WHOLE = 0.3
"""How far the share of clipping in a decoded angle may be from 1: a rail clips altogether or not at all."""
AXES = tuple(np.pi * k / 12 for k in (0, 1, -1, 2, -2, 3))
"""Rails, in amplitudes, and axes of the plates [rad] to start from where only the angle is read.

Every 15 deg, of the 90 deg after which they repeat: within a quarter of a wave of the four per turn."""
THIRD = "third_harmonic_distortion"
MAGNET = "a turn at each of several known angles of the stator (or the chip) against the magnet"
REFERENCE = "a turn with the reference coupled at each of several other angles"


def _one(label: str, name: str, **numbers: object) -> list[Variant]:
    return [_variant(label, write(name, **numbers))]


def _variant(label: str, text: str, shapes: int = 0, shape: float | None = None, tried: int = 1) -> Variant:
    """The variant that `--effect` builds again from its text."""
    return Variant(label, make_of(text), shapes, shape, tried, text)


def _towards(effect: str, directions: Sequence[float], tried: int = 1) -> list[Variant]:
    texts = [(d, write(effect, direction_deg=float(np.degrees(d)))) for d in directions]
    return [_variant(f"chip towards {np.degrees(d):.0f} deg", t, 1, d, tried) for d, t in texts]


def _free_offset(model: Model) -> bool:
    """Whether the model has offsets, amplitudes and phase of its own: an ellipse."""
    return "Vx" in model.names


def _off_axis(model: Model, facts: Facts) -> list[Variant]:
    first = _variant("chip and magnet off the axis", write("eccentricity"))
    both = _variant("and the field's curvature", write("eccentricity", form="curved"))
    if _free_offset(model):
        return [first, both]
    chip = _variant("chip off the axis", write("eccentricity", form="chip"))
    return [chip, first, *_towards("eccentricity", DIRECTIONS, len(DIRECTIONS))]


def _finer_direction(effect: str) -> Callable[[Model, Facts, float], list[Variant]]:
    def refine(model: Model, facts: Facts, direction: float) -> list[Variant]:
        return _towards(effect, [direction + np.pi / 6 * k / 8 for k in (-4, -2, -1, 1, 2, 4)])

    return refine


def _tilted(model: Model, facts: Facts) -> list[Variant]:
    off = _variant("magnet tilted, chip off the axis", write("magnet_tilt"))
    if _free_offset(model):
        return [off]
    chip = _variant("chip tilted", write("magnet_tilt", form="chip"))
    return [chip, off, *_towards("magnet_tilt", DIRECTIONS, len(DIRECTIONS))]


def _hysteresis(model: Model, facts: Facts) -> list[Variant]:
    return [
        _variant(f"within {w:g} rad", write("hysteresis", half_width_rad=w), 0, None, len(PLAYS))
        for w in PLAYS
    ]


def _over_time(name: str, facts: Facts) -> list[Variant]:
    T, out = facts.duration_s, []
    for degree in (1, 2, 3):
        out.append(_variant(f"polynomial of degree {degree}", write(name, duration_s=T, degree=degree)))
    for tau in (T / 16, T / 8, T / 4, T / 2):
        out.append(_variant(f"settling, {tau:.3g} s", write(name, settling_s=tau), 1, tau))
    return out


def _finer_settling(name: str) -> Callable[[Model, Facts, float], list[Variant]]:
    def refine(model: Model, facts: Facts, tau: float) -> list[Variant]:
        tried = [tau * 1.35**k for k in (-2, -1, 1, 2)]
        return [_variant(f"settling, {t:.3g} s", write(name, settling_s=t), 1, t) for t in tried]

    return refine


def _by_temperature(name: str, facts: Facts) -> list[Variant]:
    return _one("linear", name, mean_degc=facts.temperature or 0.0)


def _stray(model: Model, facts: Facts) -> list[Variant]:
    out = [_variant("static", write("uniform_stray_field"))]
    if "t_s" in facts.columns:
        out.append(_variant("in proportion to speed", write("uniform_stray_field", source="speed")))
    if facts.on_runs:
        listed = ", ".join(map(str, facts.on_runs))
        text = write("uniform_stray_field", runs=facts.on_runs)
        out.append(_variant(f"on in runs {listed}", text, 1))
    return out


def _hums(name: str, facts: Facts) -> list[Variant]:
    tried = max(1, round(sum(b - a for a, b in MAINS) * facts.duration_s))  # independent frequencies
    return [_variant(f"{f:.5g} Hz", write(name, frequency_hz=f), 1, f, tried) for f in facts.lines_hz]


def _clipped_angle(level: float, axes: float) -> Variant:
    text = write("saturation", level=level, axes_deg=float(np.degrees(axes)))
    label = f"from a rail at {level:g} of the amplitude, axes at {np.degrees(axes):.0f} deg"
    # the share clipped must come out as 1 (`_clips_whole`): it is no number that is free
    return _variant(label, text, -1, None, len(LEVELS) * len(AXES))


def _clipping(model: Model, facts: Facts) -> list[Variant]:
    if re.decodes(model):
        return [_clipped_angle(x, a) for x in LEVELS for a in AXES]
    out = []
    if np.isfinite(facts.rails).any():
        low, high = np.array(facts.rails).T
        big = 1e3 * re.amplitude(model)
        low, high = np.where(np.isfinite(low), low, -big), np.where(np.isfinite(high), high, big)
        out.append(
            _variant(
                "where readings repeat", write("saturation", low_v=low.tolist(), high_v=high.tolist()), 1
            )
        )
    for k, (high, low) in enumerate(zip(facts.extremes[0::2], facts.extremes[1::2], strict=True)):
        text = write("saturation", low_v=low.tolist(), high_v=high.tolist())
        out.append(_variant(f"rails, try {k + 1}", text, 1, None, 4))
    return out


def _clips_whole(values: Mapping[str, float]) -> bool:
    return abs(values.get("clipped", 1.0) - 1) <= WHOLE


def _pole_pattern(model: Model, facts: Facts) -> list[Variant]:
    n, name = float(re.FULL_STEPS), "reference_pole_pairs"
    return [
        _variant(f"{n:g} per turn", write(name, periods=(n,))),
        _variant(f"{n:g} and {2 * n:g} per turn", write(name, periods=(n, 2 * n))),
        _variant(f"{2 * n:g} per turn", write(name, periods=(2 * n,))),
    ]


CATALOGUE: tuple[Effect, ...] = (
    Effect("offset_error", "transducer", "constant offset of sine or cosine",
           lambda m, f: _one("both plates", "offset_error"), MAGNET),
    Effect("uniform_stray_field", "field", "external field: static, switched, or with the speed", _stray,
           MAGNET),
    Effect("gain_mismatch", "transducer", "sine and cosine have different gains",
           lambda m, f: _one("one ratio", "gain_mismatch"), MAGNET),
    Effect("orthogonality_error", "transducer", "the axes of sine and cosine are not perpendicular",
           lambda m, f: _one("one angle", "orthogonality_error"), MAGNET),
    Effect(THIRD, "field", "third harmonic of the magnet's field: four waves per turn",
           lambda m, f: _one("in phase", THIRD) + _one("any phase", THIRD, phase="free"),
           f"another air gap; or {MAGNET}"),
    Effect("field_saturation", "field", "both plates compress softly at a high field",
           lambda m, f: _one("cubic", "field_saturation"), "another air gap: compression follows the field"),
    Effect("odd_nonlinearity", "transducer", "cubic deviation of each voltage from a line",
           lambda m, f: [_variant("cubic", write("odd_nonlinearity")),
                         _variant("cubic and quintic", write("odd_nonlinearity", order=5))],
           "another air gap: the field's own harmonics do not follow the amplitude"),
    Effect("even_nonlinearity", "transducer", "square deviation of each voltage from a line",
           lambda m, f: [_variant("square", write("even_nonlinearity")),
                         _variant("square and fourth power", write("even_nonlinearity", order=4))],
           "another air gap"),
    Effect("eccentricity", "mechanics", "chip or magnet off the axis of rotation", _off_axis,
           f"{MAGNET}; or {REFERENCE}", refine=_finer_direction("eccentricity")),
    Effect("magnet_tilt", "mechanics", "the axis of the magnet or the chip is tilted", _tilted,
           f"{MAGNET}; or {REFERENCE}", refine=_finer_direction("magnet_tilt")),
    Effect("time_skew", "clock", "constant delay between readings and reference: latency",
           lambda m, f: _one("one delay", "time_skew") + (
               [] if re.decodes(m) else _one("a delay per plate", "time_skew", per="plate")),
           "speeds so high that a low-pass lowers the amplitude, which a delay does not", needs=("t_s",)),
    Effect("first_order_lag", "transducer", "low-pass in the path of the readings",
           lambda m, f: _one("one time constant", "first_order_lag"),
           "speeds so high that a low-pass lowers the amplitude, which a delay does not", needs=("t_s",)),
    Effect("hysteresis", "mechanics", "the angle depends on the direction, not on the speed", _hysteresis,
           "both directions at several speeds: play does not grow with the speed, a delay does",
           needs=("t_s",)),
    Effect("gain_temperature_drift", "transducer", "gains follow the logged temperature",
           lambda m, f: _by_temperature("gain_temperature_drift", f),
           "warm up and cool down, so that temperature is not a function of time",
           needs=("temperature_degc",)),
    Effect("offset_temperature_drift", "transducer", "offsets follow the logged temperature",
           lambda m, f: _by_temperature("offset_temperature_drift", f),
           "warm up and cool down, so that temperature is not a function of time",
           needs=("temperature_degc",)),
    Effect("gain_time_drift", "transducer", "gains drift smoothly over the campaign",
           lambda m, f: _over_time("gain_time_drift", f),
           "the first run again at the end; log the temperature", needs=("t_s",),
           refine=_finer_settling("gain_time_drift")),
    Effect("offset_time_drift", "transducer", "offsets drift smoothly over the campaign",
           lambda m, f: _over_time("offset_time_drift", f),
           "the first run again at the end; log the temperature", needs=("t_s",),
           refine=_finer_settling("offset_time_drift")),
    Effect("saturation", "electronics", "voltages stop at a rail", _clipping,
           "a lower gain or a wider air gap", possible=_clips_whole),
    Effect("mains_hum", "electronics", "50 or 60 Hz pick-up",
           lambda m, f: _hums("mains_hum", f), "a run at rest on the full clock",
           needs=("t_s",)),
    Effect("reference_voltage_fluctuation", "electronics", "the gain of the converter swings with the mains",
           lambda m, f: _hums("reference_voltage_fluctuation", f),
           "a run at rest on the full clock", needs=("t_s",)),
    Effect("reference_eccentricity", "reference", "the reference has an error once per turn",
           lambda m, f: _one("once per turn", "reference_eccentricity"),
           REFERENCE),
    Effect("reference_scale_error", "reference", "a turn of the reference is short or long",
           lambda m, f: _one("one share", "reference_scale_error"), "several turns in one direction"),
    Effect("reference_pole_pairs", "reference", "pattern of the pole pairs of a stepper used as reference",
           _pole_pattern, f"micro-steps or another reference; or {REFERENCE}"),
)  # fmt: skip
