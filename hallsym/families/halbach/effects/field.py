"""Effects of Halbach arrays in the field at the sensors: a field from outside, and soft compression."""

from hallsym.families.halbach.effects.transducer import BEND, constant
from hallsym.families.halbach.links import FIELD
from hallsym.families.mechanisms import following, in_runs, nonlinearity, switched
from hallsym.model import Model, Way, effect
from hallsym.model.arguments import found, one_of


@effect(link="field", waves=(1,), separate=Way("a run without the mover", "the field from outside stays"))
def uniform_stray_field(
    model: Model,
    source: str = one_of({"static": "static"}, "what the field follows"),
    runs: tuple[int, ...] | None = found(switched, "run numbers in which the field is on", instead=True),
) -> Model:
    """External field, the same at all sensors: static, or switched between runs."""
    name = "uniform_stray_field"
    if runs is None:
        return constant(model, name, shared=True)
    return following(model, name, "transducer", FIELD, in_runs(runs), 10.0, "V", shared=True)


@effect(
    link="field", label="cubic, all alike", waves=(2, 4),
    separate=Way("sweeps at a smaller gap", "compression follows the field"),
)  # fmt: skip
def field_saturation(model: Model) -> Model:
    """Sensors compress softly at a high field, all alike.

    Reading v becomes v - c v^3 / (1 V)^2.
    """
    names = {"compression_{k}": 3}
    return nonlinearity(model, "field_saturation", "field", FIELD, names, 10.0, BEND, shared=True)
