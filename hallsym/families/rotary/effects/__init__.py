"""Effects of an encoder that its models leave out: physics only, each a function `Model -> Model`.

New parameters are 0 where the effect is absent. u is the electrical angle (angle + zero). The field at the
chip, cosine + i sine, is exp(i u) for a perfect magnet; its harmonic n is q exp(i n u) with q complex: n = 2
(and 0) is one wave of angle error per turn, n = -1 and 3 are two, n = -3 is four. Voltages in V, times in s.
One file per link of the chain (mechanics, reference, field, transducer, electronics); `lag` and `drift` hold
mechanisms in time, `direct` a model without the series of waves.
"""

from hallsym.families.data_functions import during, powers_of_time, settling, temperature, wave_of_time
from hallsym.families.rotary.effects.direct import direct
from hallsym.families.rotary.effects.drift import gain_drift, offset_drift, speed
from hallsym.families.rotary.effects.electronics import clipped_angle, clipping
from hallsym.families.rotary.effects.field import field_harmonics, field_saturation
from hallsym.families.rotary.effects.lag import first_order_lag, time_skew, time_skew_per_plate
from hallsym.families.rotary.effects.mechanics import direction, hysteresis, off_axis
from hallsym.families.rotary.effects.parts import amplitude, decodes
from hallsym.families.rotary.effects.reference import FULL_STEPS, reference_harmonics, reference_scale_error
from hallsym.families.rotary.effects.transducer import (
    gain_mismatch,
    nonlinearity,
    offset,
    orthogonality_error,
)

__all__ = [
    "FULL_STEPS",
    "amplitude",
    "clipped_angle",
    "clipping",
    "decodes",
    "direct",
    "direction",
    "during",
    "field_harmonics",
    "field_saturation",
    "first_order_lag",
    "gain_drift",
    "gain_mismatch",
    "hysteresis",
    "nonlinearity",
    "off_axis",
    "offset",
    "offset_drift",
    "orthogonality_error",
    "powers_of_time",
    "reference_harmonics",
    "reference_scale_error",
    "settling",
    "speed",
    "temperature",
    "time_skew",
    "time_skew_per_plate",
    "wave_of_time",
]
