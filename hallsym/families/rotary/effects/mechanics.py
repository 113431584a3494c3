"""Effects of an encoder at the mechanics, the clock and the reference: eccentricity, tilt, delay, play."""

from collections.abc import Sequence
from math import cos, radians, sin

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.families.mechanisms import P, free, stop_state, travel
from hallsym.families.rotary.effects.field import field_harmonics
from hallsym.families.rotary.effects.parts import (
    LATE,
    MAGNET,
    RECOUPLED,
    REFERENCE,
    add_ahead,
    decodes,
    free_ellipse,
    harmonic,
    plates,
)
from hallsym.model import Facts, Model, Parameter, Signals, Way, effect
from hallsym.model.arguments import ANY, Valid, one_of, searched
from hallsym.model.derived import Computed, Stretch, rate

STEP_DEG = 30.0
"""Distance of the directions in which the chip may lie off the axis."""


def _tried(form: str, model: Model, facts: Facts) -> bool:
    """An ellipse already includes the effect of a chip off the axis, without its direction."""
    return form != "chip" if free_ellipse(model) else form != "curved"


DIRECTION = searched(
    [STEP_DEG * k for k in range(6)],
    "direction in which the chip is off the axis, if it is known",
    label="chip towards {:.0f} deg",
    valid=ANY,
    instead=True,
    shapes=1,
    grid=True,
    when=lambda value, model, facts: not free_ellipse(model),
)


@effect(link="mechanics", separate=(MAGNET, RECOUPLED), waves=(1, 2))
def eccentricity(
    model: Model,
    form: str = one_of(
        {
            "chip": "chip off the axis",
            "both": "chip and magnet off the axis",
            "curved": "and the field's curvature",
        },
        "what is off the axis: chip, both, or both in a curved field",
        default="both",
        when=_tried,
    ),
    direction_deg: float | None = DIRECTION,
) -> Model:
    """Chip or magnet off the axis of rotation.

    Harmonics of the field of a chip and a magnet off the axis, or both with the chip in a known
    direction.
    """
    if direction_deg is not None:
        return off_axis(model, "eccentricity", radians(direction_deg))
    orders = {"both": (2,), "curved": (2, 3), "chip": (-1,)}[form]
    return field_harmonics(model, "eccentricity", "mechanics", orders)


@effect(link="mechanics", separate=(MAGNET, RECOUPLED), waves=(1, 2))
def magnet_tilt(
    model: Model,
    form: str = one_of(
        {"chip": "chip tilted", "both": "magnet tilted, chip off the axis"},
        "what is tilted: the chip, or the magnet with the chip off the axis",
        default="both",
        when=_tried,
    ),
    direction_deg: float | None = DIRECTION,
) -> Model:
    """The axis of the magnet or the chip is tilted.

    Harmonics of the field of a tilted magnet and a chip off the axis, or of a tilted chip.
    """
    if direction_deg is not None:
        return off_axis(model, "magnet_tilt", radians(direction_deg), tilted=True)
    return field_harmonics(model, "magnet_tilt", "mechanics", {"both": (2,), "chip": (-1,)}[form])


def off_axis(model: Model, effect: str, direction_rad: float, tilted: bool = False) -> Model:
    """Chip and magnet both off the axis of rotation, to second order in their offsets.

    Near the axis the field in the frame of the magnet is 1 + a |w|^2 + (a/2) w^2 for a displacement w of the
    chip from the magnet's axis: curl B = 0 leaves one curvature a, and the last one, c conj(w)^2, vanishes
    for a dipole. A chip at S exp(i direction) and a magnet at M make w = S exp(i (direction - u)) - M, which
    gives harmonics 2 and 0 by their product and -1 by the chip alone. A `tilted` magnet gives the same with
    other shares of both parts of harmonic 0, free within bounds: without harmonic 2 there is none.
    """
    names = [f"{effect}_{part}" for part in ("both_re", "both_im", "chip")]
    c, d = cos(2 * direction_rad), sin(2 * direction_rad)

    def step(s: Signals, p: P) -> None:
        re, im, chip = (p[n] for n in names)
        a, b = (p["mirrored"], p["turned"]) if tilted else (ca.SX(1), ca.SX(1))
        harmonic(s, 2, re, im)
        harmonic(s, 0, a * re + b * (re * c - im * d), -a * im + b * (re * d + im * c))
        harmonic(s, -1, chip * c, chip * d)

    parts = ("chip and magnet, real part", "chip and magnet, imaginary part", "the chip alone")
    meanings = [f"change of the field off the axis by {part}" for part in parts]
    new = free(dict(zip(names, meanings, strict=True)), 0.5, "1")
    if tilted:
        what = "part of harmonic 2 of the field that is also in harmonic 0"
        new += tuple(Parameter(n, 0.5, -2.0, 3.0, "1", f"{n} {what}") for n in ("mirrored", "turned"))
    return model.with_step("mechanics", step, effect=effect, parameters=new)


@effect(link="clock", separate=LATE, needs=("t_s",))
def time_skew(
    model: Model,
    per: str = one_of(
        {"log": "one delay", "plate": "a delay per plate"},
        "one delay for the log or for each plate",
        when=lambda per, model, facts: per == "log" or not decodes(model),
    ),
) -> Model:
    """Constant delay between readings and reference: latency.

    A multiplexed converter has one per plate.
    """
    speed, own = rate(REFERENCE), per == "plate"
    if own and decodes(model):
        raise InputError(
            f"Model {model.name} reads the angle alone here; a delay per plate needs both voltages."
        )
    names = {k: f"delay_{k}" if own else "delay" for k in plates(model)}
    meanings = {n: f"delay of the {k} plate" if own else "delay of the readings" for k, n in names.items()}
    new = free(meanings, 1.0, "s")

    def step(s: Signals, p: P) -> None:
        for plate, name in names.items():
            s[f"v_{plate}"] = s[f"v_{plate}"].ahead(-p[name] * s[speed.name])

    return model.with_columns(speed).with_step("transducer", step, effect="time_skew", parameters=new)


@effect(
    link="mechanics",
    needs=("t_s",),
    separate=Way("both directions at several speeds", "play does not grow with the speed, a delay does"),
)
def hysteresis(
    model: Model,
    half_width_rad: float = searched(
        (1e-3, 1e-2, 0.1),
        "half the angle within which the direction turns over after a reversal",
        label="within {:g} rad",
    ),
) -> Model:
    """The angle depends on the direction, not on the speed.

    It lags by a constant in the direction of motion: play, magnetic memory.
    """
    column, new = direction(half_width_rad), free({"play": "half the play"}, 0.5, "rad")
    return add_ahead(model, "hysteresis", "mechanics", new, lambda s, p: -p["play"] * s[column.name], column)


def direction(width_rad: float) -> Computed:
    """Return the direction of motion, -1 to 1, which reverses within `2 width_rad`; 0 where a run begins."""

    def rule(s: Stretch) -> np.ndarray:
        return np.asarray(stop_state(travel(s.rate(REFERENCE, 0), s.edges), width_rad)[0])

    return Computed(f"direction_{width_rad:.6g}", (REFERENCE,), rule)


# -- at the reference --------------------------------------------------------------------------------------

STEEPEST = 0.3
"""Largest slope of the error of a reference: with more it would stand still or run backwards."""
FULL_STEPS = 50
"""Periods per turn of the error of a stepper of 1.8 deg per full step: one for each pole pair of its
rotor."""


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


@effect(link="reference", label="once per turn", separate=RECOUPLED, waves=(1,))
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
    separate=("micro-steps or another reference", RECOUPLED),
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
