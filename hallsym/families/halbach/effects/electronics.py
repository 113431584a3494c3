"""Effects of Halbach arrays at the electronics: coils under the sensors, rails, and the mains."""

from collections.abc import Sequence

import casadi as ca

from hallsym.errors import InputError
from hallsym.families import mechanisms
from hallsym.families.halbach.links import READING
from hallsym.families.mechanisms import LINE, Functions, P, at_frequency, following
from hallsym.model import Facts, Model, Signals, effect
from hallsym.model.arguments import Try, found
from hallsym.model.derived import Computed, rate

CURRENT = "current"
ACCELERATION = "acceleration"


def currents_of(model: Model, facts: Facts) -> list[Try]:
    """Return the logged currents, else the acceleration that they make."""
    logged = tuple(c for c in facts.columns if c.split("_")[0] == CURRENT)
    if logged:
        return [Try({"currents": logged}, "by the logged current")]
    if "t_s" in facts.columns:
        return [Try({"currents": (ACCELERATION,)}, "by acceleration")]
    return []


@effect(link="electronics", separate="currents without motion, the mover held; log the currents")
def motor_stray_field(
    model: Model, currents: tuple[str, ...] = found(currents_of, "columns of the currents, or acceleration")
) -> Model:
    """Field of the stator's traces: in proportion to the logged currents, else to acceleration."""
    if currents == (ACCELERATION,):
        columns: list[str | Computed] = [rate(c, 2) for c in model.references if c.endswith("_m")]
    else:
        columns = list(currents)
    if any(isinstance(c, str) and c.split("_")[0] != CURRENT for c in columns):
        raise InputError(
            f"Currents of motor_stray_field must be columns such as current_a, or acceleration; instead "
            f"received {'/'.join(currents)}."
        )
    names = [c if isinstance(c, str) else c.name for c in columns]

    def values(s: Signals, p: P) -> Sequence[ca.SX]:
        return [s[n] for n in names]

    functions = Functions([f"per {n}" for n in names], values, columns)
    own = [f"stray_{n}_{{k}}" for n in names]
    return following(model, "motor_stray_field", "electronics", READING, functions, 10.0, "V/A", names=own)


saturation = mechanisms.saturation("v", "channel", READING, "a wider gap")


@effect(link="electronics", separate="a run at rest on the full clock", needs=("t_s",))
def mains_hum(model: Model, frequency_hz: float = LINE) -> Model:
    """50 or 60 Hz pick-up."""
    return following(
        model, "mains_hum", "electronics", READING, at_frequency("mains_hum", frequency_hz), 10.0, "V"
    )
