"""Effects of an encoder at the transducer: offsets, gains, axes, bends, drifts and lag of the two plates."""

import casadi as ca

from hallsym.families.mechanisms import Functions, P, bends, drifts, following, free
from hallsym.families.rotary.effects.parts import (
    LATE,
    MAGNET,
    REFERENCE,
    SPEED,
    VOLTAGES,
    amplitude,
    decodes,
    plates,
)
from hallsym.model import Model, Parameter, Signals, Way, effect
from hallsym.model.derived import rate


def offset(model: Model, effect: str) -> Model:
    """A constant in each voltage."""
    unit, constant = "1" if decodes(model) else "V", Functions(["plate"], lambda s, p: [ca.SX(1)])
    names = [f"{effect}_{{k}}"]
    return following(model, effect, "transducer", VOLTAGES, constant, 10.0, unit, names=names)


@effect(link="transducer", label="both plates", separate=MAGNET, waves=(1,))
def offset_error(model: Model) -> Model:
    """Constant offset of sine or cosine."""
    return offset(model, "offset_error")


@effect(link="transducer", label="one ratio", separate=MAGNET, waves=(2,))
def gain_mismatch(model: Model) -> Model:
    """Sine and cosine have different gains."""

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] * (1 + p["mismatch"] / 2)
        s["v_cos"] = s["v_cos"] * (1 - p["mismatch"] / 2)

    new = free({"mismatch": "relative difference of the gains of sine and cosine"}, 1.0, "1")
    return model.with_step("transducer", step, effect="gain_mismatch", parameters=new)


@effect(link="transducer", label="one angle", separate=MAGNET, waves=(2,))
def orthogonality_error(model: Model) -> Model:
    """The axes of sine and cosine are not perpendicular."""

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] + s["v_cos"] * p["skewed"]

    new = free({"skewed": "angle by which the axes of the plates are off 90 deg"}, 1.0, "rad")
    return model.with_step("transducer", step, effect="orthogonality_error", parameters=new)


odd_nonlinearity, even_nonlinearity = bends(
    "each voltage", "transducer", VOLTAGES, 100.0, amplitude,
    {
        "waves": (4,),
        "separate": Way("another air gap", "the field's own harmonics do not follow the amplitude"),
    },
    {"waves": (3,), "separate": "another air gap"},
    by_place=True,
)  # fmt: skip


@effect(link="transducer", label="one time constant", needs=("t_s",), separate=LATE)
def first_order_lag(model: Model) -> Model:
    """Low-pass in the path of the readings.

    Of both voltages, at the speed of the moment: every harmonic loses its share.
    """

    def step(s: Signals, p: P) -> None:
        def share(n: int) -> tuple[ca.SX, ca.SX]:
            x = n * p["lag"] * s[SPEED]
            return 1 / (1 + x**2), -x / (1 + x**2)  # 1 / (1 + i x)

        for plate in plates(model):
            s[f"v_{plate}"] = s[f"v_{plate}"].filtered(share)

    lag = Parameter("lag", 0.0, 0.0, 1.0, "s", "time constant of the low-pass")
    wide = model.with_columns(rate(REFERENCE))
    return wide.with_step("transducer", step, effect="first_order_lag", parameters=(lag,))


def gains_follow(model: Model, effect: str, functions: Functions) -> Model:
    """Each voltage times 1 + sum of g f, g per plate; an angle shows only the ratio of both."""
    only = ("sin",) if decodes(model) else None
    return following(model, effect, "transducer", VOLTAGES, functions, 100.0, "1", gain=True, only=only)


def offsets_follow(model: Model, effect: str, functions: Functions) -> Model:
    """Each voltage plus sum of o f, o per plate."""
    return following(model, effect, "transducer", VOLTAGES, functions, 100.0, "1")


gain_temperature_drift, offset_temperature_drift, gain_time_drift, offset_time_drift = drifts(
    gains_follow,
    offsets_follow,
    ("Gains follow", "Offsets follow", "Gains drift", "Offsets drift"),
    (16, 8, 4, 2),
    grid=True,
    needs=("t_s",),
)
