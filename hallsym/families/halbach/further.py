"""Recordings that planar machines can make beside a log: another gap, and the mover turned half round."""

from collections.abc import Mapping

import numpy as np

from hallsym.families.halbach import links
from hallsym.families.halbach.effects.magnets import HALF_TURN, HEIGHT
from hallsym.families.halbach.layout import arrays, opposite
from hallsym.families.mechanisms import P
from hallsym.model import Further, Model, Parameter, Signals

GAP_M = 1e-3
"""Between the gaps of the thesis's sweeps, 4.2 and 5.2 mm."""
ANEW = ("x_m", "y_m", "rz_rad")
"""What a reference has a new zero of when the mover has been turned: its place and its yaw."""
MOST = 0.05
"""Bounds of these offsets [m, rad]."""


def wider(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the gap of the same motion a millimetre farther from the sensors."""
    return {"z_ref_m": columns["z_ref_m"] + GAP_M}


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
    offsets = {f"turned_{c}": c for c in ANEW if c in model.pose}

    def step(s: Signals, p: P) -> None:
        s["turn"] = -1
        for name, coordinate in offsets.items():
            links.move(s, coordinate, p[name])

    new = tuple(
        Parameter(n, 0.0, -MOST, MOST, c.rpartition("_")[2], f"zero of {c} with the mover turned")
        for n, c in offsets.items()
    )
    return model.with_step("clock", step, effect="half_turned", parameters=new)


FURTHER = (
    Further(f"{HEIGHT.what}, {1e3 * GAP_M:g} mm wider", wider),
    Further(f"{HALF_TURN.what}, the reference zeroed anew in the plane", read=half_turned),
)
