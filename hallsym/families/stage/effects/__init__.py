"""Effects of the stage that the paper's models leave out: physics only, one function each.

Displacements in m, times in s; u is what a probe senses along its sensing axis, v the motion across it.
One file per part of the chain; mechanisms that other families share are in `hallsym.families.mechanisms`.
"""

from hallsym.families.stage import models
from hallsym.families.stage.effects import electronics, field, mechanics, transducer

EFFECTS = (
    models.zero_deviation, models.vertical_coupling, models.tied_vertical_coupling, models.exact_rotation,
    transducer.vertical_gain_coupling, transducer.height_quadratic, field.odd_nonlinearity,
    field.even_nonlinearity, field.cross_axis_sensitivity, mechanics.second_order_rotation,
    mechanics.vertical_offset_coupling, mechanics.time_skew, transducer.first_order_lag, field.hysteresis,
    transducer.gain_temperature_drift, transducer.offset_temperature_drift, transducer.gain_time_drift,
    transducer.offset_time_drift, mechanics.mount_slip, electronics.motor_stray_field,
    electronics.saturation, electronics.mains_hum, mechanics.reference_scale_error,
    mechanics.reference_abbe_error, mechanics.reference_drift,
)  # fmt: skip
