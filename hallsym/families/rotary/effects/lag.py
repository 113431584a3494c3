"""Effects of an encoder in time: the readings are of the past, by a delay or a low-pass."""

import casadi as ca

from hallsym.families.parts import P, add
from hallsym.families.rotary.effects.parts import PLATES, REFERENCE, SPEED, ahead
from hallsym.model import Model, Parameter, Signals
from hallsym.model.derived import rate


def time_skew(model: Model) -> Model:
    """The readings are older than the reference by a delay: latency."""

    def step(s: Signals, p: P) -> None:
        ahead(s, -p["delay"] * s[SPEED])

    new = (Parameter("delay", 0.0, -1.0, 1.0, "s", "delay of the readings"),)
    return add(model, "reference", "time_skew", new, step, rate(REFERENCE))


def time_skew_per_plate(model: Model) -> Model:
    """Each plate has a delay of its own: a multiplexed converter."""
    new = tuple(Parameter(f"delay_{k}", 0.0, -1.0, 1.0, "s", "delay of a plate") for k in PLATES)

    def step(s: Signals, p: P) -> None:
        for plate in PLATES:
            s[f"v_{plate}"] = s[f"v_{plate}"].ahead(-p[f"delay_{plate}"] * s[SPEED])

    return add(model, "transducer", "time_skew", new, step, rate(REFERENCE))


def first_order_lag(model: Model) -> Model:
    """A low-pass in the path of both voltages, at the speed of the moment: every harmonic loses its share."""

    def step(s: Signals, p: P) -> None:
        def share(n: int) -> tuple[ca.SX, ca.SX]:
            x = n * p["lag"] * s[SPEED]
            return 1 / (1 + x**2), -x / (1 + x**2)  # 1 / (1 + i x)

        for plate in PLATES:
            s[f"v_{plate}"] = s[f"v_{plate}"].filtered(share)

    new = (Parameter("lag", 0.0, 0.0, 1.0, "s", "time constant"),)
    return add(model, "transducer", "first_order_lag", new, step, rate(REFERENCE))
