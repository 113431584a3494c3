"""Effects of the stage at the electronics: signals added to a reading, and its rails."""

from collections.abc import Callable

import casadi as ca

from hallsym.families import mechanisms
from hallsym.families.mechanisms import LINE, P, add_terms, at_frequency, following
from hallsym.families.stage.effects.parts import AXES, READING, UNIT
from hallsym.model import Model, Signals, effect
from hallsym.model.arguments import Valid, one_of
from hallsym.model.derived import rate


@effect(link="transducer", separate="the same stroke at several frequencies; log the currents")
def motor_stray_field(
    model: Model,
    terms: str = one_of(
        {"acceleration": "by acceleration", "position": "by acceleration and position"},
        "whether the field also changes with the position",
    ),
) -> Model:
    """Field of the motor currents, in proportion to acceleration.

    Reading plus C times acceleration, C per probe and axis; also times position over 0.5 mm.
    """
    columns = [rate(c, 2) for c in AXES]
    places = ["", *(model.pose if terms == "position" else ())]
    pushes = {
        f"stray_{{k}}_{axis}{q and '_' + q}": f"reading of probe {{k}} per acceleration of {axis}"
        + (f", per {UNIT:g} of {q}" if q else "")
        for q in places
        for axis in model.pose
    }

    def pushed(s: Signals, p: P) -> Callable[[ca.SX, int], list[ca.SX]]:
        values = [s[c.name] * (s[q] / UNIT if q else 1) for q in places for c in columns]
        return lambda reading, k: values

    return add_terms(
        model, "motor_stray_field", "electronics", READING, pushes, pushed, 1e-2, "m s2/m", *columns
    )


saturation = mechanisms.saturation("m", "probe", READING, "strokes of several lengths")


@effect(link="electronics", separate="a run at rest on the full clock")
def mains_hum(
    model: Model,
    frequency_hz: float = LINE,
    harmonics: int = one_of(
        {1: "", 3: " and harmonics"},
        "how many multiples of the frequency",
        valid=Valid(lambda n: 1 <= n <= 9, "1 to 9"),
    ),
) -> Model:
    """50 or 60 Hz pick-up.

    Reading plus a sine at the mains frequency (and harmonics), amplitude and phase per probe.
    """
    waves = at_frequency("mains_hum", frequency_hz, harmonics, ("sin", "cos"))
    names = [
        f"hum_{wave}_{n * frequency_hz:.9g}_{{k}}" for n in range(1, harmonics + 1) for wave in ("sin", "cos")
    ]
    return following(model, "mains_hum", "electronics", READING, waves, 1e-4, "m", names=names)
