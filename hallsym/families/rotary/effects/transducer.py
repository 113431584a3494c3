"""Effects of an encoder at the transducer: offsets, gains, axes and bends of the two plates."""

from collections.abc import Sequence

from hallsym.families.parts import Make, P, add, free
from hallsym.families.rotary.effects.parts import PLATES, amplitude, per_plate, volt
from hallsym.families.rotary.waves import Wave
from hallsym.model import Model, Signals


def offset(effect: str, link: str = "transducer") -> Make:
    """A constant in each voltage."""

    def make(model: Model) -> Model:
        names = [f"{effect}_{plate}" for plate in PLATES]

        def step(s: Signals, p: P) -> None:
            for plate, name in zip(PLATES, names, strict=True):
                s[f"v_{plate}"] = s[f"v_{plate}"] + p[name]

        return add(model, "transducer", effect, free(names, 10.0, volt(model), "offset"), step)

    return make


def gain_mismatch(model: Model) -> Model:
    """The gains of sine and cosine differ by a share."""

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] * (1 + p["mismatch"] / 2)
        s["v_cos"] = s["v_cos"] * (1 - p["mismatch"] / 2)

    return add(
        model, "transducer", "gain_mismatch", free(["mismatch"], 1.0, "1", "difference of gains"), step
    )


def orthogonality_error(model: Model) -> Model:
    """The sine plate sees a share of the cosine: the axes are not perpendicular."""

    def step(s: Signals, p: P) -> None:
        s["v_sin"] = s["v_sin"] + s["v_cos"] * p["skewed"]

    return add(
        model, "transducer", "orthogonality_error", free(["skewed"], 1.0, "rad", "angle off 90 deg"), step
    )


def nonlinearity(effect: str, powers: Sequence[int]) -> Make:
    """Voltage v becomes v + sum of c v^n / A^(n - 1), c per plate, A the nominal amplitude."""

    def make(model: Model) -> Model:
        size = amplitude(model)

        def read(s: Signals, v: Wave, j: int) -> Wave:
            out = v
            for _ in range(powers[j] - 1):
                out = out * v * (1 / size)
            return out

        return per_plate(effect, len(powers), read)(model)

    return make
