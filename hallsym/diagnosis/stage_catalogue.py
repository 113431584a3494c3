"""The catalogue of the stage: the field's names, each with the ways in which it may act."""

from collections.abc import Callable

import casadi as ca
import numpy as np

from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.survey import MAINS
from hallsym.families import stage_effects as se
from hallsym.model import Model, Signals

WIDTHS = (2e-6, 6e-6, 1.5e-5, 4e-5, 1e-4, 2.5e-4)
"""Half-widths of the play that are tried [m]; refined around the best."""


ARMS = ((0, "ry_rad"), (1, "rx_rad"))
ALL_ARMS = tuple((i, c) for i in (0, 1) for c in ("z_m", "rx_rad", "ry_rad"))


def _warm(facts: Facts) -> tuple[list[str], Callable[[Signals], list[ca.SX]]]:
    return se.temperature(facts.temperature or 0.0)


def _one(label: str, make: se.Make) -> list[Variant]:
    return [Variant(label, make)]


def _hysteresis(model: Model, facts: Facts) -> list[Variant]:
    return [
        Variant(f"half-width {1e6 * w:.3g} um", se.hysteresis(w, facts.gains), 1, w, len(WIDTHS))
        for w in WIDTHS
    ]


def _finer_hysteresis(model: Model, facts: Facts, width: float) -> list[Variant]:
    tried = [width * 1.22**k for k in (-3, -2, -1, 1, 2, 3)]
    return [Variant(f"half-width {1e6 * w:.3g} um", se.hysteresis(w, facts.gains), 1, w) for w in tried]


def _gain_time(model: Model, facts: Facts) -> list[Variant]:
    T, out = facts.duration_s, []
    for degree in (1, 2, 3):
        columns, read = se.powers_of_time(T, degree)
        out.append(Variant(f"polynomial of degree {degree}", se.gain_drift("gain_time_drift", columns, read)))
    for tau in (T / 16, T / 5):
        columns, read = se.settling(tau)
        out.append(Variant(f"settling, {tau:.3g} s", se.gain_drift("gain_time_drift", columns, read), 1, tau))
    return out


def _offset_time(model: Model, facts: Facts) -> list[Variant]:
    T, out = facts.duration_s, []
    for degree in (1, 2, 3):
        columns, read = se.powers_of_time(T, degree)
        out.append(
            Variant(f"polynomial of degree {degree}", se.offset_drift("offset_time_drift", columns, read))
        )
    for tau in (T / 16, T / 5):
        columns, read = se.settling(tau)
        out.append(
            Variant(f"settling, {tau:.3g} s", se.offset_drift("offset_time_drift", columns, read), 1, tau)
        )
    return out


def _slips(model: Model, facts: Facts) -> list[Variant]:
    labels = [probe.label for probe in model.layout]
    return [
        Variant(f"probe {labels[k]} at {t:.6g} s", se.mount_slip(k, t), 1, t, facts.instants_tried)
        for k, t in facts.instants
    ]


def _hums(model: Model, facts: Facts) -> list[Variant]:
    tried = max(1, round(sum(b - a for a, b in MAINS) * facts.duration_s))  # independent frequencies
    out = [Variant(f"{f:.5g} Hz", se.mains_hum(f), 1, f, tried) for f in facts.lines_hz]
    return out + [
        Variant(f"{f:.5g} Hz and harmonics", se.mains_hum(f, (1, 2, 3)), 1, f, tried) for f in facts.lines_hz
    ]


def _clipping(model: Model, facts: Facts) -> list[Variant]:
    out = []
    if np.isfinite(facts.rails).any():
        low, high = np.array(facts.rails).T.tolist()
        out.append(Variant("where readings repeat", se.clipping(low, high), 1))
    for k, (high, low) in enumerate(zip(facts.extremes[0::2], facts.extremes[1::2], strict=True)):
        levels = [max(h, -v) for h, v in zip(high, low, strict=True)]
        out.append(Variant(f"rails, try {k + 1}", se.clipping([-v for v in levels], levels), 1, None, 4))
    return out


CATALOGUE: tuple[Effect, ...] = (
    Effect("vertical_gain_coupling", "transducer", "gain follows height and tilts (a, b, c of Model (31))",
           lambda m, f: [] if "vertical_coupling" in m.effects or "tied_vertical_coupling" in m.effects
           else _one("a, b, c", se.vertical_gain_coupling),
           "runs at several heights and tilts"),
    Effect("height_quadratic", "transducer", "the gain bends with height",
           lambda m, f: [Variant("height of each probe", se.height_quadratic_tied),
                         Variant("all second-order terms", se.height_quadratic)],
           "more than three heights, spread wide"),
    Effect("odd_nonlinearity", "field", "cubic deviation of the reading from a line",
           lambda m, f: [Variant("cubic", se.nonlinearity("odd_nonlinearity", (3,))),
                         Variant("cubic and quintic", se.nonlinearity("odd_nonlinearity", (3, 5)))],
           "strokes of several lengths"),
    Effect("even_nonlinearity", "field", "square deviation of the reading from a line",
           lambda m, f: [Variant("square", se.nonlinearity("even_nonlinearity", (2,))),
                         Variant("square and fourth power", se.nonlinearity("even_nonlinearity", (2, 4)))],
           "strokes of several lengths on both sides of zero"),
    Effect("cross_axis_sensitivity", "field", "leakage of the motion across the sensing axis",
           lambda m, f: [Variant("second order", se.cross_axis_sensitivity(("uv", "vv"))),
                         Variant("up to third order", se.cross_axis_sensitivity(tuple(se.CROSS)))],
           "x and y moved together, and each alone"),
    Effect("second_order_rotation", "mechanics", "finite rotation that the small-angle model drops",
           lambda m, f: [] if "exact_rotation" in m.effects else
           [Variant("rigid stage", se.second_order_rotation),
            Variant("term by term", se.second_order_rotation_body)],
           "large Rz while x and y are off centre"),
    Effect("vertical_offset_coupling", "mechanics", "reading follows Z, Rx, Ry whatever the stroke",
           lambda m, f: _one("nine lever arms", se.vertical_offset_coupling),
           "Z, Rx, Ry moved within a run while x, y, Rz stand still"),
    Effect("time_skew", "clock", "constant delay between readings and reference",
           lambda m, f: [Variant("one delay", se.delayed("time_skew", True)),
                         Variant("a delay per probe", se.delayed("time_skew", False))],
           "the same motion at several frequencies: a lag turns into phase that bends, a delay does not"),
    Effect("first_order_lag", "transducer", "low-pass in the path of the readings",
           lambda m, f: [Variant("one time constant", se.delayed("first_order_lag", True)),
                         Variant("a time constant per probe", se.delayed("first_order_lag", False))],
           "the same motion at higher frequencies: a lag lowers the amplitude, a delay does not"),
    Effect("hysteresis", "field", "memory of the direction of motion", _hysteresis,
           "the same stroke at several speeds: a loop keeps its width, a delay does not",
           refine=_finer_hysteresis),
    Effect("gain_temperature_drift", "transducer", "gain follows the logged temperature",
           lambda m, f: _one("linear", se.gain_drift("gain_temperature_drift", *_warm(f))),
           "warm up and cool down, so that temperature is not a function of time",
           needs=("temperature_degc",)),
    Effect("offset_temperature_drift", "transducer", "offset follows the logged temperature",
           lambda m, f: _one("linear", se.offset_drift("offset_temperature_drift", *_warm(f))),
           "long runs over which the temperature changes", needs=("temperature_degc",)),
    Effect("gain_time_drift", "transducer", "gain drifts smoothly over the campaign", _gain_time,
           "the first setting again at the end; log the temperature"),
    Effect("offset_time_drift", "transducer", "offset drifts smoothly over the campaign", _offset_time,
           "long runs at rest; log the temperature"),
    Effect("mount_slip", "mechanics", "one probe or magnet moved at an instant", _slips,
           "the first setting again at the end and in between"),
    Effect("motor_stray_field", "transducer", "field of the motor currents, in proportion to acceleration",
           lambda m, f: [Variant("by acceleration", se.motor_stray_field()),
                         Variant("by acceleration and position", se.motor_stray_field(m.pose))],
           "the same stroke at several frequencies; log the currents"),
    Effect("saturation", "electronics", "readings stop at a rail", _clipping, "strokes of several lengths"),
    Effect("mains_hum", "electronics", "50 or 60 Hz pick-up", _hums, "a run at rest on the full clock"),
    Effect("reference_scale_error", "reference", "scale factor of a reference axis",
           lambda m, f: _one("three factors", se.reference_scale_error()),
           "a known length beside the reference"),
    Effect("reference_abbe_error", "reference", "the reference reads tilt times an Abbe arm",
           lambda m, f: [Variant("x with Ry, y with Rx", se.reference_abbe_error(ARMS)),
                         Variant("x and y with Z, Rx, Ry", se.reference_abbe_error(ALL_ARMS))],
           "Rx and Ry moved within a run while the rest stands still, beside a second reference"),
    Effect("reference_drift", "reference", "the reference creeps within a run",
           lambda m, f: [Variant("one rate per axis", se.reference_drift()),
                         Variant("a cubic of each run's time per axis", se.reference_drift(3))],
           "a long run at rest"),
)  # fmt: skip
