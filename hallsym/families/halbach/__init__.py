"""Halbach arrays on a mover over a board of Hall sensors: x and z of one array, six coordinates of four."""

from collections.abc import Mapping
from typing import Any

from hallsym.families.halbach import links, models, planar
from hallsym.families.halbach.checks import implausible
from hallsym.families.halbach.effects import EFFECTS, PLANAR_EFFECTS
from hallsym.families.halbach.effects.magnets import HALF_TURN, HEIGHT
from hallsym.families.halbach.layout import arrays, opposite
from hallsym.families.mechanisms import P
from hallsym.model import Example, Family, Further, Model, Parameter, PoseMetric, Signals

SWEEPS = tuple(
    {
        "duration_s": 2.0,
        "x_m": {"kind": "sine", "amplitude": 0.02, "frequency_hz": f},
        "z_m": {"kind": "sine", "amplitude": depth, "frequency_hz": 2.3 * f, "about": gap},
    }
    for f, gap, depth in (
        (1.0, 4.2e-3, 0.0), (1.3, 5.2e-3, 0.0), (0.9, 6.2e-3, 0.0), (0.7, 5e-3, 8e-4), (1.1, 5e-3, 8e-4),
        (0.8, 5.5e-3, 8e-4),
    )
)  # fmt: skip
"""Sweeps of x at the gaps of the thesis and one more, then with the gap moving."""
MOTIONS = tuple(
    {
        "duration_s": 2.0,
        "z_m": {"kind": "sine", "amplitude": 1.5e-3, "frequency_hz": 2.3 * f, "about": 6e-3},
        **{
            c: {"kind": "sine", "amplitude": size, "frequency_hz": n * f}
            for n, (c, size) in zip(
                (1.0, 1.4, 1.9, 2.9, 3.1),
                (("x_m", 0.015), ("y_m", 0.015), ("rx_rad", 6e-3), ("ry_rad", 6e-3), ("rz_rad", 6e-3)),
                strict=True,
            )
        },
    }
    for f in (0.5, 0.6, 0.75, 0.9, 1.1)
)
"""All six coordinates at once, at frequencies that do not come back together."""

SENSORS: Mapping[str, Mapping[str, Any]] = {
    "gain_mismatch": {"gain_*_percent": 2.5},
    "offset_error": {"offset_error_*_mv": 10},
    "sensor_position_error": {"d?_*_um": 50},
    "sensor_tilt": {"tilt?_*_mrad": 10},
}
"""Typical of linear Hall sensors that are not sorted (an assumption, no standard): sensitivity, quiescent
voltage of 2.5 V +- .4 %, placed to .05 mm, and seated to 30 um over a package of 3 mm."""

GAP_M = 1e-3
"""Between the gaps of the thesis's sweeps, 4.2 and 5.2 mm."""
MOST_MOVED = 0.05
"""Bounds of the offsets that a reference has when the mover has been turned [m, rad]."""


def half_turned(model: Model) -> Model | None:
    """Return the model as it reads with the mover turned half round about z in its mount.

    The logged tilt is that of the mount; place and yaw have their own offsets. None where arrays do not come
    to stand where others stood.
    """
    known = arrays(model.layout)
    try:
        if len(known) > 1:
            for array in known.values():
                opposite(model.layout, array)
    except LookupError:
        return None
    offsets = {f"turned_{c}": c for c in ("x_m", "y_m", "rz_rad") if c in model.pose}

    def step(s: Signals, p: P) -> None:
        s["turn"] = -1
        for name, coordinate in offsets.items():
            links.move(s, coordinate, p[name])

    new = tuple(
        Parameter(n, 0.0, -MOST_MOVED, MOST_MOVED, c.rpartition("_")[2], f"zero of {c} with the mover turned")
        for n, c in offsets.items()
    )
    return model.with_step("clock", step, effect="half_turned", parameters=new)


FURTHER = (
    Further(f"{HEIGHT.what}, {1e3 * GAP_M:g} mm wider", lambda data: {"z_ref_m": data["z_ref_m"] + GAP_M}),
    Further(f"{HALF_TURN.what}, the reference zeroed anew in the plane", read=half_turned),
)

FAMILY = Family(
    name="halbach",
    noun="array",
    about="an array (col_0_v, ...; x_ref_m, z_ref_m)",
    readings=r"col_\d+_v",
    references=models.REFERENCES,
    moved=models.POSE,
    pose_metric=PoseMetric("m"),
    models=(models.halbach,),
    default="halbach",
    aliases={"halbach_h5": "halbach"},
    from_meta=models.from_meta,
    tables=("arrays",),
    decoder="wave",
    most_effects=6,
    implausible=implausible,
    further=FURTHER,
    effects=EFFECTS,
    assumed="columns a third of the wavelength apart, which is 30 mm",
    words={"x_ref_m": "x along the array", "z_ref_m": "gap z"},
    tolerances={"": {"a1_percent": 2, "b1_mv": 6, "a5_mv": 0.5, "b5": "exact"}, **SENSORS},
    example=Example(
        campaign={"step_s": 4e-3, "run": list(SWEEPS)},
        values={"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4},
        noise={"col_v": 1e-3, "x_ref_m": 1e-7, "z_ref_m": 1e-7},
    ),
)
models.FAMILY = FAMILY
PLANAR = Family(
    name="halbach_planar",
    noun="mover",
    about="a planar mover (hall_0_0_v, ... or x1_col_0_v, ...; x_ref_m ... rz_ref_rad)",
    readings=r"hall_\d+_\d+_v|[xy]\d+_(col|row)_\d+_v",
    references=planar.REFERENCES,
    moved=planar.POSE,
    pose_metric=PoseMetric("m", arm_m=0.1),
    models=(planar.halbach_planar,),
    default="halbach_planar",
    aliases={"planar_h5": "halbach_planar"},
    from_meta=planar.from_meta,
    tables=("arrays", "channels"),
    decoder="wave",
    most_effects=6,
    implausible=implausible,
    further=FURTHER,
    effects=PLANAR_EFFECTS,
    words={"z_ref_m": "gap z"},
    tolerances={
        "": {"a1_percent": 2, "a5_mv": 0.5, "[xy]0": "exact", "r[xyz]0": "exact"},
        "gain_mismatch": SENSORS["gain_mismatch"],
        "offset_error": SENSORS["offset_error"],
    },
    example=Example(
        campaign={"step_s": 8e-3, "run": list(MOTIONS)},
        values={"a1": 0.62, "a5": -2e-3, "x0": 1e-4, "y0": -5e-5, "rx0": 3e-4, "ry0": -2e-4, "rz0": 5e-4},
        noise={"x1_col_v": 1e-3, "x2_col_v": 1e-3, "y1_row_v": 1e-3, "y2_row_v": 1e-3}
        | {c: 1e-7 if c.endswith("_m") else 1e-6 for c in planar.REFERENCES},
    ),
)
planar.FAMILY = PLANAR
