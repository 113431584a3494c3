"""Effects of an encoder that its models leave out: physics only, one function each.

u is the electrical angle (angle + zero). The field at the chip, cosine + i sine, is exp(i u) for a
perfect magnet; its harmonic n is q exp(i n u) with q complex: n = 2 (and 0) is one wave of angle error
per turn, n = -1 and 3 are two, n = -3 is four. Voltages in V, times in s. One file per link of the chain;
mechanisms that other families share are in `hallsym.families.mechanisms`; `direct` is a model without the
series of waves.
"""

from hallsym.families.rotary import models as rotary
from hallsym.families.rotary.effects.direct import direct
from hallsym.families.rotary.effects.electronics import (
    mains_hum,
    reference_voltage_fluctuation,
    saturation,
)
from hallsym.families.rotary.effects.field import (
    field_harmonics,
    field_saturation,
    third_harmonic_distortion,
    uniform_stray_field,
)
from hallsym.families.rotary.effects.mechanics import (
    direction,
    eccentricity,
    hysteresis,
    magnet_tilt,
    off_axis,
    time_skew,
)
from hallsym.families.rotary.effects.reference import (
    reference_eccentricity,
    reference_pole_pairs,
    reference_scale_error,
)
from hallsym.families.rotary.effects.transducer import (
    even_nonlinearity,
    first_order_lag,
    gain_mismatch,
    gain_temperature_drift,
    gain_time_drift,
    odd_nonlinearity,
    offset_error,
    offset_temperature_drift,
    offset_time_drift,
    orthogonality_error,
)

EFFECTS = (
    *rotary.EFFECTS,
    offset_error,
    uniform_stray_field,
    gain_mismatch,
    orthogonality_error,
    third_harmonic_distortion,
    field_saturation,
    odd_nonlinearity,
    even_nonlinearity,
    eccentricity,
    magnet_tilt,
    time_skew,
    first_order_lag,
    hysteresis,
    gain_temperature_drift,
    offset_temperature_drift,
    gain_time_drift,
    offset_time_drift,
    saturation,
    mains_hum,
    reference_voltage_fluctuation,
    reference_eccentricity,
    reference_scale_error,
    reference_pole_pairs,
)
"""All effects of an encoder; a diagnosis prefers those that stand first where a log cannot tell two apart."""

__all__ = ["EFFECTS", "direct", "direction", "field_harmonics", "off_axis"]
