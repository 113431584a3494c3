"""Effects of an encoder that its models leave out: physics only, one function each.

u is the electrical angle (angle + zero). The field at the chip, cosine + i sine, is exp(i u) for a
perfect magnet; its harmonic n is q exp(i n u) with q complex: n = 2 (and 0) is one wave of angle error
per turn, n = -1 and 3 are two, n = -3 is four. Voltages in V, times in s. One file per part of the chain;
mechanisms that other families share are in `hallsym.families.mechanisms`; `direct` is a model without the
series of waves.
"""

from hallsym.families.rotary import models, rings
from hallsym.families.rotary.effects import electronics, field, mechanics, transducer
from hallsym.families.rotary.effects.field import field_harmonics
from hallsym.families.rotary.effects.mechanics import direction, off_axis
from hallsym.families.rotary.effects.parts import direct, short

EFFECTS = (
    models.harmonics, models.zero_deviation, transducer.offset_error, field.uniform_stray_field,
    transducer.gain_mismatch, transducer.orthogonality_error, field.third_harmonic_distortion,
    field.field_saturation, transducer.odd_nonlinearity, transducer.even_nonlinearity,
    mechanics.eccentricity, mechanics.magnet_tilt, mechanics.time_skew, transducer.first_order_lag,
    mechanics.hysteresis, transducer.gain_temperature_drift, transducer.offset_temperature_drift,
    transducer.gain_time_drift, transducer.offset_time_drift, electronics.saturation,
    electronics.mains_hum, electronics.reference_voltage_fluctuation, mechanics.reference_eccentricity,
    mechanics.reference_scale_error, mechanics.reference_pole_pairs,
)  # fmt: skip

RING_EFFECTS = (
    rings.turn_waves, models.zero_deviation, field.third_harmonic_distortion, field.field_saturation,
    transducer.odd_nonlinearity, transducer.even_nonlinearity, rings.eccentricity, mechanics.time_skew,
    transducer.first_order_lag, mechanics.hysteresis, transducer.gain_temperature_drift,
    transducer.offset_temperature_drift, transducer.gain_time_drift, transducer.offset_time_drift,
    electronics.mains_hum, electronics.reference_voltage_fluctuation, mechanics.reference_scale_error,
)  # fmt: skip
"""Those of a ring read by several Halls, whose offsets, gains and places are in its model."""

__all__ = ["EFFECTS", "RING_EFFECTS", "direct", "direction", "field_harmonics", "off_axis", "short"]
