"""Gains and offsets of an encoder that follow data-only functions (`hallsym.families.data_functions`)."""

from collections.abc import Callable

import casadi as ca

from hallsym.families.data_functions import Columns, Followed, Read, count
from hallsym.families.parts import Make
from hallsym.families.rotary.effects.parts import REFERENCE, SPEED, per_plate
from hallsym.families.rotary.waves import Wave
from hallsym.model import Model
from hallsym.model.derived import rate


def gain_drift(effect: str, columns: Columns, read: Read) -> Make:
    """Each voltage times 1 + sum of g f(t), g per plate; f are data-only functions of the columns."""
    return _following(effect, columns, read, lambda v, f: v * f)


def offset_drift(effect: str, columns: Columns, read: Read) -> Make:
    """Each voltage plus sum of o f(t), o per plate."""
    return _following(effect, columns, read, lambda v, f: Wave({0: (f, ca.SX(0))}))


def _following(effect: str, columns: Columns, read: Read, part: Callable[[Wave, ca.SX], Wave]) -> Make:
    """Each voltage v becomes v + sum of c part(v, f), c per plate and function."""

    def make(model: Model) -> Model:
        terms = count(model.with_columns(*columns), read)
        return per_plate(effect, terms, lambda s, v, j: part(v, read(s)[j]), columns)(model)

    return make


def speed() -> Followed:
    """Return the speed of the reference [rad/s]."""
    return [rate(REFERENCE)], lambda s: [s[SPEED]]
