"""Effects of Halbach arrays at the transducer: offset, gain, bend, drift and lag of each sensor."""

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.families.halbach import links
from hallsym.families.halbach.layout import arrays, sensors
from hallsym.families.halbach.links import FIELD, FILTER, LATER
from hallsym.families.mechanisms import Functions, P, bends, drifts, following
from hallsym.model import Facts, Model, Parameter, Signals, Way, effect
from hallsym.model.arguments import Try, found, one_of
from hallsym.model.derived import rate

BEND = 1.0
"""Reading [V] at which relative non-linearities are stated."""
HEIGHTS = Way("the same sweep at several gaps", "an offset stays, a gain follows the field")


def constant(model: Model, effect: str, shared: bool = False) -> Model:
    """A constant in the reading of each channel, or the same in all."""
    one = Functions(["at rest"], lambda s, p: [ca.SX(1)])
    return following(
        model, effect, "transducer", FIELD, one, 10.0, "V", names=[f"{effect}_{{k}}"], shared=shared
    )


@effect(link="transducer", label="each channel", separate=HEIGHTS, waves=(1,))
def offset_error(model: Model) -> Model:
    """Constant offset of each channel."""
    return constant(model, "offset_error")


FREE_FACTOR = (
    "field amplitudes and gains have one common factor that no recording shows: the mean gain stays 1 "
    "(or as stated); an a1 or a gain with fixed = true in the machine file sets the factor instead"
)
"""Said where a fit leaves the mean of the gains at 1."""
EACH = "each"
"""Channels of which every one is off by itself."""


def each_patch(model: Model, facts: Facts) -> list[Try]:
    """Return each channel by itself, then all channels under one of several arrays."""
    known = list(arrays(model.layout))
    patches = known if len(known) > 1 else []  # a gain that all channels share is the amplitude
    common = [Try({"of": name}, f"all under array {name}", tried=len(known)) for name in patches]
    return [Try({"of": EACH}, "each channel"), *common]


@effect(link="transducer", separate=HEIGHTS, waves=(2,))
def gain_mismatch(
    model: Model,
    of: str = found(each_patch, "each, or the array whose channels share one gain", default=EACH),
) -> Model:
    """Channels have different gains: each its own, or those under one array, which share a supply, one."""
    only, name, beside = None, "gain_{k}", "beside the others"
    if of != EACH:
        known = list(arrays(model.layout))
        if of not in known:
            raise InputError(
                f"Channels of gain_mismatch must be {EACH} or those under array {', '.join(known)}; "
                f"instead received {of!r}."
            )
        labels = zip(links.labels(model), sensors(model.layout), strict=True)
        only, name, beside = [k for k, s in labels if s.array == of], f"gain_{of}", f"under array {of}"
    one = Functions([beside], lambda s, p: [ca.SX(1)])
    wide = following(
        model, "gain_mismatch", "transducer", FIELD, one, 1.0, "1", gain=True, names=[name], only=only,
        shared=of != EACH,
    )  # fmt: skip
    gains = [p.name for p in wide.parameters if p not in model.parameters]
    return wide.with_gauge(gains, FREE_FACTOR)


odd_nonlinearity, even_nonlinearity = bends(
    "each reading", "transducer", FIELD, 100.0, lambda model: BEND,
    {"waves": (2, 4), "separate": "the same sweep at a smaller gap"},
    {"waves": (1, 3), "separate": "the same sweep at a smaller gap"},
)  # fmt: skip


@effect(
    link="transducer",
    needs=("t_s",),
    separate=Way("the same motion at higher speeds", "a lag lowers the amplitude, a delay does not"),
)
def first_order_lag(
    model: Model,
    per: str = one_of(
        {"log": "one time constant", "channel": "a time constant per channel"},
        "one value for the log or for each channel",
    ),
) -> Model:
    """Low-pass in the path of the readings, or eddy currents.

    The motion to second order in the time constant, and of that the mean over the past, weighed by
    exp(-age / tau), to fifth order: Gauss-Laguerre quadrature.
    """
    names = [f"tau_{k}" for k in links.labels(model)] if per == "channel" else ["tau_lag"]
    new = tuple(Parameter(n, 0.0, 0.0, 0.05, "s", "time constant of the low-pass") for n in names)
    columns = [rate(c, n) for n in (1, 2) for c in model.references]
    ages = np.transpose(np.polynomial.laguerre.laggauss(3)).tolist()

    def step(s: Signals, p: P) -> None:
        later = s[LATER] = ca.SX.sym(LATER, len(names))
        for coordinate, column in zip(model.pose, model.references, strict=True):
            by = [s[f"d1_{column}"] * t + s[f"d2_{column}"] * t**2 / 2 for t in ca.vertsplit(later)]
            links.move(s, coordinate, by * (len(model.channels) // len(names)))

        def low_passed(s: Signals, field: ca.SX) -> ca.SX:
            tau = ca.vertcat(*(p[n] for n in names))
            seen = (weight * ca.substitute(field, later, -age * tau) for age, weight in ages)
            return sum(seen, ca.SX(0))

        s.functions[FILTER] = low_passed

    return model.with_columns(*columns).with_step("clock", step, effect="first_order_lag", parameters=new)


def gains_follow(model: Model, effect: str, functions: Functions, shared: bool) -> Model:
    """Each reading times 1 + sum of g f: g of each sensor, or of the magnets and so of all."""
    return following(model, effect, "transducer", FIELD, functions, 100.0, "1", gain=True, shared=shared)


def offsets_follow(model: Model, effect: str, functions: Functions, shared: bool) -> Model:
    """Each reading plus sum of o f."""
    return following(model, effect, "transducer", FIELD, functions, 100.0, "V", shared=shared)


gain_temperature_drift, offset_temperature_drift, gain_time_drift, offset_time_drift = drifts(
    gains_follow,
    offsets_follow,
    ("Gains, or magnets, follow", "Offsets follow", "Gains, or magnets, drift", "Offsets drift"),
    (16, 5),
    per=True,
    needs=("t_s",),
)
