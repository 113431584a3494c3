"""What effects of an encoder share: its plates, harmonics of its field, and terms of each voltage."""

from collections.abc import Callable

import casadi as ca

from hallsym.families.data_functions import Columns
from hallsym.families.parts import Make, P, add, free
from hallsym.families.rotary import models as rotary
from hallsym.families.rotary.waves import Wave
from hallsym.model import Model, Signals

(REFERENCE,) = rotary.REFERENCES
SPEED = f"d1_{REFERENCE}"
PLATES = ("sin", "cos")


def decodes(model: Model) -> bool:
    """Return whether a model reads the decoded angle instead of two voltages."""
    return model.channels == rotary.ANGLE


def amplitude(model: Model) -> float:
    """Return the nominal amplitude of the voltages [V], 1 where only the angle is read."""
    return next(p.nominal for p in model.parameters if p.name in ("A", "Ax"))


def volt(model: Model) -> str:
    """Return the unit of the readings."""
    return "1" if decodes(model) else "V"


def ahead(s: Signals, angle: ca.SX) -> None:
    """Replace the field by that at another angle of the magnet."""
    s["cosine"], s["sine"] = s["cosine"].ahead(angle), s["sine"].ahead(angle)


def harmonic(s: Signals, n: int, re: ca.SX, im: ca.SX) -> None:
    """Add (re + i im) exp(i n u) to the field."""
    sign = 1.0 if n >= 0 else -1.0
    s["cosine"] = s["cosine"] + Wave({abs(n): (re, -sign * im if n else ca.SX(0))})
    s["sine"] = s["sine"] + Wave({abs(n): (im, sign * re if n else ca.SX(0))})


def per_plate(
    effect: str, terms: int, read: Callable[[Signals, Wave, int], Wave], columns: Columns = ()
) -> Make:
    """Each voltage v becomes v + sum of c_j read(s, v, j), c per plate."""

    def make(model: Model) -> Model:
        names = {plate: [f"{effect}{j}_{plate}" for j in range(terms)] for plate in PLATES}

        def step(s: Signals, p: P) -> None:
            for plate in PLATES:
                v = s[f"v_{plate}"]
                for j, name in enumerate(names[plate]):
                    s[f"v_{plate}"] = s[f"v_{plate}"] + read(s, v, j) * p[name]

        new = free([n for row in names.values() for n in row], 100.0, "1", "strength")
        return add(model, "transducer", effect, new, step, *columns)

    return make
