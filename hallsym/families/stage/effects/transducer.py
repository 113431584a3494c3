"""Effects of the stage at the transducer: the gain of a probe with height, temperature, time; its lag."""

from collections.abc import Callable

import casadi as ca

from hallsym.families.mechanisms import (
    LOW_PASS,
    Functions,
    P,
    add_terms,
    drifts,
    following,
    late,
)
from hallsym.families.stage import models as stage
from hallsym.families.stage.effects.mechanics import rates_along
from hallsym.families.stage.effects.parts import GAIN, READING, SENSED
from hallsym.model import Model, Signals, Way, effect
from hallsym.model.arguments import one_of


@effect(
    link="transducer",
    label="a, b, c",
    separate="runs at several heights and tilts",
    unless=("vertical_coupling", "tied_vertical_coupling"),
)
def vertical_gain_coupling(model: Model) -> Model:
    """Gain follows height and tilts (a, b, c of Model (31))."""
    return stage.vertical_coupling(model)


@effect(link="transducer", separate="more than three heights, spread wide")
def height_quadratic(
    model: Model,
    form: str = one_of(
        {"tied": "height of each probe", "full": "all second-order terms"},
        "square of the height of each probe (tied), or all squares and products of Z, Rx, Ry (full)",
        default="full",
    ),
) -> Model:
    """The gain bends with height.

    Gain gains e h^2 per probe, h the height of its place on a rigid stage, or six terms per probe.
    """
    state, pairs = stage.STATE, [(i, j) for i in range(3) for j in range(i, 3)]
    bends = {f"bend_{{k}}_{i}{j}": f"term of the gain of probe {{k}} with {state[i]} {state[j]}"
             for i, j in pairs}  # fmt: skip
    if form == "tied":
        bends = {"bend_{k}": "square term of the gain of probe {k} with its height"}

    def terms(s: Signals, p: P) -> Callable[[ca.SX, int], list[ca.SX]]:
        if form == "tied":
            return lambda gain, k: [_height(model, s, p, k) ** 2]
        return lambda gain, k: [s[state[i]] * s[state[j]] for i, j in pairs]

    return add_terms(model, "height_quadratic", "transducer", GAIN, bends, terms, 1e6, "1/m2")


LEAST_SLOPE = 1e-3
"""Slope of a gain with height [1/m] far below any probe's (the paper's are about 190): below it tilts have no
effect, so that the model is defined at its nominal values, where every slope is 0."""


def _height(model: Model, s: Signals, p: P, k: int) -> ca.SX:
    """Height of probe k by the motion of a rigid stage."""
    probe = model.layout[k]
    if "vertical_coupling" in model.effects:
        a, b, c = (p[f"{q}_{probe.label}"] for q in "abc")
        return s["z_m"] + (b * s["rx_rad"] + c * s["ry_rad"]) * a / (a**2 + LEAST_SLOPE**2)
    px, py = stage.position(k, probe, p)
    return s["z_m"] + py * s["rx_rad"] - px * s["ry_rad"]


@effect(
    link="transducer",
    separate=Way("the same motion at higher frequencies", "a lag lowers the amplitude, a delay does not"),
)
def first_order_lag(
    model: Model,
    per: str = one_of(
        {"log": "one time constant", "probe": "a time constant per probe"},
        "one value for the log or for each probe",
    ),
) -> Model:
    """Low-pass in the path of the readings."""
    shared, rates = per == "log", rates_along(model)
    return late(model, "first_order_lag", "transducer", SENSED, LOW_PASS, rates, shared=shared, least=0.0)


def gain_follows(model: Model, effect: str, functions: Functions) -> Model:
    """Gain times 1 + sum of g f, g per probe."""
    return following(model, effect, "transducer", GAIN, functions, 1.0, "1", gain=True, by_channel=False)


def offset_follows(model: Model, effect: str, functions: Functions) -> Model:
    """Reading plus sum of o f, o per probe."""
    return following(model, effect, "electronics", READING, functions, 1e-3, "m", by_channel=False)


gain_temperature_drift, offset_temperature_drift, gain_time_drift, offset_time_drift = drifts(
    gain_follows,
    offset_follows,
    ("Gain follows", "Offset follows", "Gain drifts", "Offset drifts"),
    (16, 5),
    separate={
        "offset_temperature_drift": "long runs over which the temperature changes",
        "gain_time_drift": "the first setting again at the end; log the temperature",
        "offset_time_drift": "long runs at rest; log the temperature",
    },
)
