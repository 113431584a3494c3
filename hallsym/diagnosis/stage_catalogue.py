"""The catalogue of the stage: the field's names, each with the ways in which it may act."""

from collections.abc import Callable
from functools import partial

import numpy as np

from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.survey import MAINS
from hallsym.families import recipes
from hallsym.families.recipes import make_of
from hallsym.model import Model

write = partial(recipes.write, "stage")
WIDTHS = (2e-6, 6e-6, 1.5e-5, 4e-5, 1e-4, 2.5e-4)
"""Half-widths of the play that are tried [m]; refined around the best."""


def _one(label: str, name: str, **numbers: object) -> list[Variant]:
    return [_variant(label, write(name, **numbers))]


def _variant(
    label: str, text: str, *, shapes: int = 0, shape: float | None = None, tried: int = 1
) -> Variant:
    """The variant that `--effect` builds again from its text."""
    return Variant(label, make_of(text), shapes, shape, tried, text)


def _forms(name: str, key: str, *forms: tuple[str, object]) -> Callable[[Model, Facts], list[Variant]]:
    """Variants that differ in one choice: labels and values."""
    return lambda model, facts: [_variant(label, write(name, **{key: value})) for label, value in forms]


def _hysteresis(model: Model, facts: Facts) -> list[Variant]:
    return [_play(w, len(WIDTHS)) for w in WIDTHS]


def _finer_hysteresis(model: Model, facts: Facts, width: float) -> list[Variant]:
    return [_play(width * 1.22**k, 1) for k in (-3, -2, -1, 1, 2, 3)]


def _play(width: float, tried: int) -> Variant:
    text = write("hysteresis", half_width_m=width)
    return _variant(f"half-width {1e6 * width:.3g} um", text, shape=width, tried=tried)


def _over_time(name: str) -> Callable[[Model, Facts], list[Variant]]:
    def variants(model: Model, facts: Facts) -> list[Variant]:
        T = facts.duration_s
        out = [_variant(f"polynomial of degree {n}", write(name, duration_s=T, degree=n)) for n in (1, 2, 3)]
        return out + [
            _variant(f"settling, {tau:.3g} s", write(name, settling_s=tau), shapes=1, shape=tau)
            for tau in (T / 16, T / 5)
        ]

    return variants


def _warm(name: str) -> Callable[[Model, Facts], list[Variant]]:
    return lambda model, facts: _one("linear", name, mean_degc=facts.temperature or 0.0)


def _slips(model: Model, facts: Facts) -> list[Variant]:
    labels = [probe.label for probe in model.layout]
    return [
        _variant(
            f"probe {labels[k]} at {t:.6g} s", write("mount_slip", probe=labels[k], instant_s=t),
            shapes=1, shape=t, tried=facts.instants_tried,
        )
        for k, t in facts.instants
    ]  # fmt: skip


def _hums(model: Model, facts: Facts) -> list[Variant]:
    tried = max(1, round(sum(b - a for a, b in MAINS) * facts.duration_s))  # independent frequencies
    return [
        _variant(label, write("mains_hum", frequency_hz=f, harmonics=n), shapes=1, shape=f, tried=tried)
        for n, more in ((1, ""), (3, " and harmonics"))
        for f in facts.lines_hz
        for label in (f"{f:.5g} Hz{more}",)
    ]


def _clipping(model: Model, facts: Facts) -> list[Variant]:
    out = []
    if np.isfinite(facts.rails).any():
        low, high = np.array(facts.rails).T.tolist()
        out.append(_variant("where readings repeat", write("saturation", low_m=low, high_m=high), shapes=1))
    for k, (high, low) in enumerate(zip(facts.extremes[0::2], facts.extremes[1::2], strict=True)):
        levels = [float(max(h, -v)) for h, v in zip(high, low, strict=True)]
        text = write("saturation", low_m=[-v for v in levels], high_m=levels)
        out.append(_variant(f"rails, try {k + 1}", text, shapes=1, tried=4))
    return out


CATALOGUE: tuple[Effect, ...] = (
    Effect("vertical_gain_coupling", "transducer", "gain follows height and tilts (a, b, c of Model (31))",
           lambda m, f: [] if "vertical_coupling" in m.effects or "tied_vertical_coupling" in m.effects
           else _one("a, b, c", "vertical_gain_coupling"),
           "runs at several heights and tilts"),
    Effect("height_quadratic", "transducer", "the gain bends with height",
           _forms("height_quadratic", "form", ("height of each probe", "tied"),
                  ("all second-order terms", "full")),
           "more than three heights, spread wide"),
    Effect("odd_nonlinearity", "field", "cubic deviation of the reading from a line",
           _forms("odd_nonlinearity", "order", ("cubic", 3), ("cubic and quintic", 5)),
           "strokes of several lengths"),
    Effect("even_nonlinearity", "field", "square deviation of the reading from a line",
           _forms("even_nonlinearity", "order", ("square", 2), ("square and fourth power", 4)),
           "strokes of several lengths on both sides of zero"),
    Effect("cross_axis_sensitivity", "field", "leakage of the motion across the sensing axis",
           _forms("cross_axis_sensitivity", "order", ("second order", 2), ("up to third order", 3)),
           "x and y moved together, and each alone"),
    Effect("second_order_rotation", "mechanics", "finite rotation that the small-angle model drops",
           lambda m, f: [] if "exact_rotation" in m.effects else
           _forms("second_order_rotation", "form", ("rigid stage", "rigid"), ("term by term", "terms"))(m, f),
           "large Rz while x and y are off centre"),
    Effect("vertical_offset_coupling", "mechanics", "reading follows Z, Rx, Ry whatever the stroke",
           lambda m, f: _one("nine lever arms", "vertical_offset_coupling"),
           "Z, Rx, Ry moved within a run while x, y, Rz stand still"),
    Effect("time_skew", "clock", "constant delay between readings and reference",
           _forms("time_skew", "per", ("one delay", "log"), ("a delay per probe", "probe")),
           "the same motion at several frequencies: a lag turns into phase that bends, a delay does not"),
    Effect("first_order_lag", "transducer", "low-pass in the path of the readings",
           _forms("first_order_lag", "per", ("one time constant", "log"),
                  ("a time constant per probe", "probe")),
           "the same motion at higher frequencies: a lag lowers the amplitude, a delay does not"),
    Effect("hysteresis", "field", "memory of the direction of motion", _hysteresis,
           "the same stroke at several speeds: a loop keeps its width, a delay does not",
           refine=_finer_hysteresis),
    Effect("gain_temperature_drift", "transducer", "gain follows the logged temperature",
           _warm("gain_temperature_drift"),
           "warm up and cool down, so that temperature is not a function of time",
           needs=("temperature_degc",)),
    Effect("offset_temperature_drift", "transducer", "offset follows the logged temperature",
           _warm("offset_temperature_drift"),
           "long runs over which the temperature changes", needs=("temperature_degc",)),
    Effect("gain_time_drift", "transducer", "gain drifts smoothly over the campaign",
           _over_time("gain_time_drift"),
           "the first setting again at the end; log the temperature"),
    Effect("offset_time_drift", "transducer", "offset drifts smoothly over the campaign",
           _over_time("offset_time_drift"),
           "long runs at rest; log the temperature"),
    Effect("mount_slip", "mechanics", "one probe or magnet moved at an instant", _slips,
           "the first setting again at the end and in between"),
    Effect("motor_stray_field", "transducer", "field of the motor currents, in proportion to acceleration",
           _forms("motor_stray_field", "terms", ("by acceleration", "acceleration"),
                  ("by acceleration and position", "position")),
           "the same stroke at several frequencies; log the currents"),
    Effect("saturation", "electronics", "readings stop at a rail", _clipping, "strokes of several lengths"),
    Effect("mains_hum", "electronics", "50 or 60 Hz pick-up", _hums, "a run at rest on the full clock"),
    Effect("reference_scale_error", "reference", "scale factor of a reference axis",
           lambda m, f: _one("three factors", "reference_scale_error"),
           "a known length beside the reference"),
    Effect("reference_abbe_error", "reference", "the reference reads tilt times an Abbe arm",
           _forms("reference_abbe_error", "arms", ("x with Ry, y with Rx", "tilt"),
                  ("x and y with Z, Rx, Ry", "all")),
           "Rx and Ry moved within a run while the rest stands still, beside a second reference"),
    Effect("reference_drift", "reference", "the reference creeps within a run",
           _forms("reference_drift", "degree", ("one rate per axis", 1),
                  ("a cubic of each run's time per axis", 3)), "a long run at rest"),
)  # fmt: skip
