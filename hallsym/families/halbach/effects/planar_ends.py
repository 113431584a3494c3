"""Ends of the four Halbach arrays of a mover: the field of each fades near them."""

import casadi as ca

from hallsym.families.halbach.effects.ends import MOST, stronger
from hallsym.families.halbach.effects.magnets import HALF_TURN, LONGER
from hallsym.families.halbach.finite import missing
from hallsym.families.halbach.links import Seen
from hallsym.families.halbach.planar import ended
from hallsym.families.mechanisms import P
from hallsym.model import Model, Parameter, Signals, effect


@effect(link="field", separate=(LONGER, HALF_TURN))
def array_edges(model: Model) -> Model:
    """The arrays have ends along their period, near which their field fades and reaches beyond.

    `edges` is 1 for arrays as long as the layout states, and wide; with it sensors may lie beyond the
    ends along the period, as long as two or more of each array are under it. Of a model that has the ends
    already it is the share by which they are stronger.
    """
    if ended(model.layout):
        return stronger(model)

    def step(s: Signals, p: P) -> None:
        each = [s.functions["seen"](s, k) for k in range(len(model.channels))]
        added = [sum(map(_taken, seen), ca.SX(0)) / len(seen) for seen in each]
        s["field"] = s["field"] + p["edges"] * p["a1"] * ca.vertcat(*added)

    new = Parameter("edges", 0.0, -MOST, MOST, "1", "share of what the ends of the stated arrays take")
    return model.with_step("field", step, effect="array_edges", parameters=(new,))


def _taken(e: Seen) -> ca.SX:
    """What the ends take along the axis of an element, of an amplitude of 1: a turned magnet's along it."""
    vertical, horizontal = missing(e.array)(e.u, e.height)
    return e.up * vertical + e.along * horizontal
