"""Effects of the stage that the paper's models leave out: physics only, one function each.

Displacements in m, times in s; u is what a probe senses along its sensing axis, v the motion across it.
One file per link of the chain; mechanisms that other families share are in `hallsym.families.mechanisms`.
"""

from hallsym.families.stage import models as stage
from hallsym.families.stage.effects.electronics import mains_hum, motor_stray_field, saturation
from hallsym.families.stage.effects.field import (
    cross_axis_sensitivity,
    even_nonlinearity,
    hysteresis,
    odd_nonlinearity,
)
from hallsym.families.stage.effects.mechanics import (
    mount_slip,
    second_order_rotation,
    time_skew,
    vertical_offset_coupling,
)
from hallsym.families.stage.effects.reference import (
    reference_abbe_error,
    reference_drift,
    reference_scale_error,
)
from hallsym.families.stage.effects.transducer import (
    first_order_lag,
    gain_temperature_drift,
    gain_time_drift,
    height_quadratic,
    offset_temperature_drift,
    offset_time_drift,
    vertical_gain_coupling,
)

EFFECTS = (
    *stage.EFFECTS,
    vertical_gain_coupling,
    height_quadratic,
    odd_nonlinearity,
    even_nonlinearity,
    cross_axis_sensitivity,
    second_order_rotation,
    vertical_offset_coupling,
    time_skew,
    first_order_lag,
    hysteresis,
    gain_temperature_drift,
    offset_temperature_drift,
    gain_time_drift,
    offset_time_drift,
    mount_slip,
    motor_stray_field,
    saturation,
    mains_hum,
    reference_scale_error,
    reference_abbe_error,
    reference_drift,
)
"""All effects of the stage; a diagnosis prefers those that stand first where a log cannot tell two apart."""
