"""Effects of the ends of a Halbach array: its field fades near them, also where sensors are chosen anew."""

import casadi as ca

from hallsym.families.halbach.effects.magnets import HEIGHT, LONGER
from hallsym.families.halbach.ends import missing, nearest
from hallsym.families.halbach.layout import sensors
from hallsym.families.halbach.links import Seen
from hallsym.families.halbach.models import array_of
from hallsym.families.mechanisms import P
from hallsym.model import Model, Parameter, Signals, effect
from hallsym.model.arguments import one_of

WHOLE = 1.0
"""Value of `edges` for the array that the layout states."""
MOST = 20.0
"""Bounds: what an array of a third of the stated length takes from the field in the middle, and more."""


@effect(link="field", waves=(3, 1), separate=(HEIGHT, LONGER))
def array_edges(
    model: Model,
    reads: str = one_of(
        {"fixed": "fixed sensors", "nearest": "sensors chosen anew"},
        "whether a channel is one sensor, or the one of those a wavelength apart that is next to the middle",
    ),
) -> Model:
    """The array has ends, near which its field fades; sensors chosen anew as it travels see them in turn.

    `edges` is 1 for the array that the layout states, negative where it is half a wavelength longer.
    """
    array = array_of(model.layout)

    def of_element(s: Signals, k: int, seen: Seen, x: float) -> tuple[ca.SX, ca.SX]:
        """Vertical field; from the columns alone where nothing has moved the sensor."""
        moved, (dx, _, dz) = s["moved"][k], s["placed"][k]
        still = all(v.is_zero() for v in (dx, dz, moved["x_m"], moved["z_m"]))
        u, gap = (x - s["x_m"], s["z_m"]) if still else (seen.u, seen.height)
        if reads == "nearest":
            u = nearest(array, u)
        straight, quarter = missing(array, u, gap)
        if not still:
            return straight, quarter
        named = f"ends at {x:g} m ({reads})"
        return s.derive(f"{named}, cos", straight), s.derive(f"{named}, sin", quarter)

    def step(s: Signals, p: P) -> None:
        added = []
        for k, sensor in enumerate(sensors(model.layout)):
            places = [x for x, _ in sensor.positions]
            each = [of_element(s, k, e, x) for e, x in zip(s["seen"](k), places, strict=True)]
            added.append(sum(p["a1"] * c + p["b1"] * q for c, q in each) / len(each))
        s["field"] = s["field"] + p["edges"] * ca.vertcat(*added)

    new = Parameter("edges", 0.0, -MOST, MOST, "1", "share of what the ends of the stated array take")
    return model.with_step("field", step, effect="array_edges", parameters=(new,))
