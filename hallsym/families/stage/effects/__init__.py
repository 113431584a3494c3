"""Effects of the stage that the paper's models leave out: physics only, each a function `Model -> Model`.

New parameters are 0 where the effect is absent. Displacements in m, times in s; u is what a probe feels along
its sensing axis, v the motion across it. One file per link of the chain (mechanics, reference, field,
transducer, electronics); `lag` and `drift` hold the mechanisms that stand on two links.
"""

from hallsym.families.data_functions import powers_of_time, settling, temperature
from hallsym.families.stage.effects.drift import gain_drift, offset_drift
from hallsym.families.stage.effects.electronics import clipping, mains_hum, motor_stray_field
from hallsym.families.stage.effects.field import (
    CROSS,
    cross_axis_sensitivity,
    hysteresis,
    mount_slip,
    nonlinearity,
)
from hallsym.families.stage.effects.lag import delayed
from hallsym.families.stage.effects.mechanics import (
    second_order_rotation,
    second_order_rotation_body,
    vertical_offset_coupling,
)
from hallsym.families.stage.effects.reference import (
    reference_abbe_error,
    reference_drift,
    reference_scale_error,
)
from hallsym.families.stage.effects.transducer import (
    height_quadratic,
    height_quadratic_tied,
    vertical_gain_coupling,
)

__all__ = [
    "CROSS",
    "clipping",
    "cross_axis_sensitivity",
    "delayed",
    "gain_drift",
    "height_quadratic",
    "height_quadratic_tied",
    "hysteresis",
    "mains_hum",
    "motor_stray_field",
    "mount_slip",
    "nonlinearity",
    "offset_drift",
    "powers_of_time",
    "reference_abbe_error",
    "reference_drift",
    "reference_scale_error",
    "second_order_rotation",
    "second_order_rotation_body",
    "settling",
    "temperature",
    "vertical_gain_coupling",
    "vertical_offset_coupling",
]
