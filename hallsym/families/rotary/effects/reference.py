"""Effects of an encoder at the reference: waves of its turn and its scale."""

from collections.abc import Sequence

import casadi as ca

from hallsym.families.parts import Make, P, add, free
from hallsym.families.rotary.effects.parts import ahead
from hallsym.model import Model, Signals

STEEPEST = 0.3
"""Slope of the error of a reference, at most: with more it would stand still or run backwards."""
FULL_STEPS = 50
"""Periods per turn of what a stepper of 1.8 deg per full step leaves: one for each pole pair of its rotor."""


def reference_harmonics(effect: str, orders: Sequence[int]) -> Make:
    """The reference is off by waves of the turn: logged angle = angle + sum of c cos(n a) + s sin(n a)."""

    def make(model: Model) -> Model:
        names = [(f"{effect}_{n}_cos", f"{effect}_{n}_sin") for n in orders]

        def step(s: Signals, p: P) -> None:
            a = s[model.pose[0]]
            error = sum(
                p[c] * ca.cos(n * a) + p[d] * ca.sin(n * a) for n, (c, d) in zip(orders, names, strict=True)
            )
            ahead(s, -error)

        new = tuple(
            q
            for n, row in zip(orders, names, strict=True)
            for q in free(row, STEEPEST / n, "rad", "error of the reference")
        )
        return add(model, "reference", effect, new, step)

    return make


def reference_scale_error(model: Model) -> Model:
    """A turn of the reference is short or long by a share."""

    def step(s: Signals, p: P) -> None:
        ahead(s, -p["scale"] * s[model.pose[0]])

    return add(
        model, "reference", "reference_scale_error", free(["scale"], 0.05, "1", "share of a turn"), step
    )
