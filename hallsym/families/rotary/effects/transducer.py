"""Effects of an encoder at the transducer: offsets, gains, axes, bends, drifts and lag of the two plates."""

import casadi as ca

from hallsym.families.mechanisms import (
    DEGREE,
    DURATION,
    MEAN_TEMPERATURE,
    Functions,
    P,
    following,
    free,
    nonlinearity,
    over_time,
    settling_time,
    with_temperature,
)
from hallsym.families.rotary.effects.parts import (
    MAGNET,
    PLATES,
    REFERENCE,
    SPEED,
    VOLTAGES,
    amplitude,
    decodes,
    effect,
)
from hallsym.model import Model, Parameter, Signals
from hallsym.model.arguments import one_of
from hallsym.model.derived import rate

WARM = "warm up and cool down, so that temperature is not a function of time"
AGAIN = "the first run again at the end; log the temperature"
FINER = tuple(1.35**k for k in (-2, -1, 1, 2))


def offset(model: Model, effect: str) -> Model:
    """A constant in each voltage."""
    unit, constant = "1" if decodes(model) else "V", Functions(["plate"], lambda s: [ca.SX(1)])
    names = [f"{effect}_{{k}}"]
    return following(model, effect, "transducer", VOLTAGES, constant, 10.0, unit, names=names)


@effect(link="transducer", label="both plates", separate=MAGNET, waves=(1,))
def offset_error(model: Model) -> Model:
    """Constant offset of sine or cosine."""
    return offset(model, "offset_error")


@effect(link="transducer", label="one ratio", separate=MAGNET, waves=(2,))
def gain_mismatch(model: Model) -> Model:
    """Sine and cosine have different gains.

    The gains of sine and cosine differ by a share.
    """

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] * (1 + p["mismatch"] / 2)
        s["v_cos"] = s["v_cos"] * (1 - p["mismatch"] / 2)

    new = free(["mismatch"], 1.0, "1", "relative difference of the gains of sine and cosine")
    return model.with_step("transducer", step, effect="gain_mismatch", parameters=new)


@effect(link="transducer", label="one angle", separate=MAGNET, waves=(2,))
def orthogonality_error(model: Model) -> Model:
    """The axes of sine and cosine are not perpendicular.

    The sine plate sees a share of the cosine: the axes are not perpendicular.
    """

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] + s["v_cos"] * p["skewed"]

    new = free(["skewed"], 1.0, "rad", "angle by which the axes of the plates are off 90 deg")
    return model.with_step("transducer", step, effect="orthogonality_error", parameters=new)


def _bent(model: Model, effect: str, powers: tuple[int, ...]) -> Model:
    names = {f"{effect}{j}_{{k}}": n for j, n in enumerate(powers)}
    return nonlinearity(model, effect, "transducer", VOLTAGES, names, 100.0, amplitude(model))


@effect(
    link="transducer",
    waves=(4,),
    separate="another air gap: the field's own harmonics do not follow the amplitude",
)
def odd_nonlinearity(
    model: Model, order: int = one_of({3: "cubic", 5: "cubic and quintic"}, "highest power")
) -> Model:
    """Cubic deviation of each voltage from a line.

    Voltage v becomes v + sum of c v^n / A^(n - 1), c per plate, A the nominal amplitude.
    """
    return _bent(model, "odd_nonlinearity", (3, 5)[: order // 2])


@effect(link="transducer", separate="another air gap", waves=(3,))
def even_nonlinearity(
    model: Model, order: int = one_of({2: "square", 4: "square and fourth power"}, "highest power")
) -> Model:
    """Square deviation of each voltage from a line.

    Voltage v becomes v + sum of c v^n / A^(n - 1), c per plate, A the nominal amplitude.
    """
    return _bent(model, "even_nonlinearity", (2, 4)[: order // 2])


@effect(
    link="transducer",
    label="one time constant",
    needs=("t_s",),
    separate="speeds so high that a low-pass lowers the amplitude, which a delay does not",
)
def first_order_lag(model: Model) -> Model:
    """Low-pass in the path of the readings.

    A low-pass in the path of both voltages, at the speed of the moment: every harmonic loses its share.
    """

    def step(s: Signals, p: P) -> None:
        def share(n: int) -> tuple[ca.SX, ca.SX]:
            x = n * p["lag"] * s[SPEED]
            return 1 / (1 + x**2), -x / (1 + x**2)  # 1 / (1 + i x)

        for plate in PLATES:
            s[f"v_{plate}"] = s[f"v_{plate}"].filtered(share)

    lag = Parameter("lag", 0.0, 0.0, 1.0, "s", "time constant of the low-pass")
    wide = model.with_columns(rate(REFERENCE))
    return wide.with_step("transducer", step, effect="first_order_lag", parameters=(lag,))


def gains_follow(model: Model, effect: str, functions: Functions) -> Model:
    """Each voltage times 1 + sum of g f, g per plate; an angle shows only that of the sine over the
    cosine."""
    only = ("sin",) if decodes(model) else None
    return following(model, effect, "transducer", VOLTAGES, functions, 100.0, "1", gain=True, only=only)


def offsets_follow(model: Model, effect: str, functions: Functions) -> Model:
    """Each voltage plus sum of o f, o per plate."""
    return following(model, effect, "transducer", VOLTAGES, functions, 100.0, "1")


@effect(link="transducer", label="linear", separate=WARM, needs=("temperature_degc",))
def gain_temperature_drift(model: Model, mean_degc: float = MEAN_TEMPERATURE) -> Model:
    """Gains follow the logged temperature."""
    return gains_follow(model, "gain_temperature_drift", with_temperature(mean_degc))


@effect(link="transducer", label="linear", separate=WARM, needs=("temperature_degc",))
def offset_temperature_drift(model: Model, mean_degc: float = MEAN_TEMPERATURE) -> Model:
    """Offsets follow the logged temperature."""
    return offsets_follow(model, "offset_temperature_drift", with_temperature(mean_degc))


@effect(link="transducer", separate=AGAIN, needs=("t_s",))
def gain_time_drift(
    model: Model,
    duration_s: float = DURATION,
    degree: int = DEGREE,
    settling_s: float | None = settling_time((16, 8, 4, 2), FINER),
) -> Model:
    """Gains drift smoothly over the campaign.

    Gains drift over the campaign: along a polynomial of time, or an exponential.
    """
    return gains_follow(model, "gain_time_drift", over_time(duration_s, degree, settling_s))


@effect(link="transducer", separate=AGAIN, needs=("t_s",))
def offset_time_drift(
    model: Model,
    duration_s: float = DURATION,
    degree: int = DEGREE,
    settling_s: float | None = settling_time((16, 8, 4, 2), FINER),
) -> Model:
    """Offsets drift smoothly over the campaign.

    Offsets drift over the campaign: along a polynomial of time, or an exponential.
    """
    return offsets_follow(model, "offset_time_drift", over_time(duration_s, degree, settling_s))
