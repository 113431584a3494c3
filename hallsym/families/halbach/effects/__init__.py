"""Effects of Halbach arrays that their models leave out: physics only, one function each.

One file per part of the chain; mechanisms that other families share are in `hallsym.families.mechanisms`.
The same effects serve the model of x and z and that of six coordinates: they act on what `links` passes on.
"""

from hallsym.families.halbach.effects import electronics, ends, field, magnets, mechanics, transducer

COMMON = (
    transducer.offset_error, transducer.gain_mismatch, mechanics.sensor_position_error,
    mechanics.sensor_tilt, field.uniform_stray_field, field.field_saturation, transducer.odd_nonlinearity,
    transducer.even_nonlinearity, mechanics.time_skew, transducer.first_order_lag,
    transducer.gain_temperature_drift, transducer.offset_temperature_drift, transducer.gain_time_drift,
    transducer.offset_time_drift, electronics.motor_stray_field, electronics.saturation,
    electronics.mains_hum, mechanics.reference_scale_error, mechanics.reference_abbe_error,
)  # fmt: skip
"""Effects of both models."""
EFFECTS = (
    *COMMON, magnets.lost_magnet, magnets.remanence_spread, magnets.magnetisation_angle_error,
    magnets.magnet_map, magnets.forbidden_harmonics, magnets.wavelength_error,
    magnets.finite_width, ends.array_edges,
)  # fmt: skip
"""Effects of the model of x and z."""
PLANAR_EFFECTS = (
    *COMMON, mechanics.array_geometry_error, magnets.remanence_spread, magnets.magnetisation_angle_error,
    magnets.magnet_map, magnets.forbidden_harmonics, magnets.wavelength_error,
    magnets.finite_width, ends.planar_array_edges,
)  # fmt: skip
"""Effects of the model of six coordinates."""
