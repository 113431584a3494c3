"""Effects of an encoder at the reference: waves of its turn and its scale."""

from collections.abc import Sequence

import casadi as ca

from hallsym.families.mechanisms import P, free
from hallsym.families.rotary.effects.parts import TURNED, add_ahead
from hallsym.model import Model, Signals, effect
from hallsym.model.arguments import Valid, searched

STEEPEST = 0.3
"""Slope of the error of a reference, at most: with more it would stand still or run backwards."""
FULL_STEPS = 50
"""Periods per turn of what a stepper of 1.8 deg per full step leaves: one for each pole pair of its rotor."""


def reference_harmonics(model: Model, effect: str, orders: Sequence[int]) -> Model:
    """The reference is off by waves of the turn: logged angle = angle + sum of c cos(n a) + s sin(n a)."""
    names = [(f"{effect}_{n}_cos", f"{effect}_{n}_sin") for n in orders]

    def error(s: Signals, p: P) -> ca.SX:
        a, waves = s[model.pose[0]], zip(orders, names, strict=True)
        return -sum(p[c] * ca.cos(n * a) + p[d] * ca.sin(n * a) for n, (c, d) in waves)

    new = tuple(
        q
        for n, row in zip(orders, names, strict=True)
        for q in free(dict.fromkeys(row, f"error of the reference, {n} per turn"), STEEPEST / n, "rad")
    )
    return add_ahead(model, effect, "reference", new, error)


@effect(link="reference", label="once per turn", separate=TURNED, waves=(1,))
def reference_eccentricity(model: Model) -> Model:
    """The reference has an error once per turn."""
    return reference_harmonics(model, "reference_eccentricity", (1,))


@effect(link="reference", label="one share", separate="several turns in one direction")
def reference_scale_error(model: Model) -> Model:
    """A turn of the reference is short or long."""
    new = free({"scale": "share by which a turn of the reference is long"}, 0.05, "1")
    return add_ahead(
        model, "reference_scale_error", "reference", new, lambda s, p: -p["scale"] * s[model.pose[0]]
    )


@effect(
    link="reference",
    separate=("micro-steps or another reference", TURNED),
    waves=(FULL_STEPS, 2 * FULL_STEPS),
)
def reference_pole_pairs(
    model: Model,
    periods: tuple[int, ...] = searched(
        ((FULL_STEPS,), (FULL_STEPS, 2 * FULL_STEPS), (2 * FULL_STEPS,)),
        "periods per turn of the pattern",
        label=lambda periods: f"{' and '.join(map(str, periods))} per turn",
        default=(FULL_STEPS,),
        valid=Valid(lambda n: 1 <= n <= 1000, "periods per turn, 1 to 1000, such as 50/100"),
        tried=lambda facts: 1,
    ),
) -> Model:
    """Pattern of the pole pairs of a stepper used as reference."""
    return reference_harmonics(model, "reference_pole_pairs", periods)
