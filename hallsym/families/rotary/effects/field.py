"""Effects of an encoder in the field at the chip: harmonics of the magnet, soft compression, stray field."""

from collections.abc import Sequence

import casadi as ca

from hallsym.families.mechanisms import P, column, following, free, in_runs, switched
from hallsym.families.rotary.effects.parts import MAGNET, REFERENCE, VOLTAGES, harmonic
from hallsym.families.rotary.effects.transducer import offset
from hallsym.model import Model, Signals, Way, effect
from hallsym.model.arguments import found, one_of
from hallsym.model.derived import rate


def field_harmonics(model: Model, effect: str, link: str, orders: Sequence[int], phase: bool = True) -> Model:
    """Harmonics of the field at the chip, each with a free amplitude and (if `phase`) a free phase."""
    parts = {"re": "in phase with it", "im": "across it"} if phase else {"re": "in phase with it"}
    meanings = {
        f"{effect}_{n}_{part}".replace("-", "m"): f"harmonic {n} of the field, {what}"
        for n in orders
        for part, what in parts.items()
    }

    def step(s: Signals, p: P) -> None:
        values = (p[name] for name in meanings)
        for n in orders:
            harmonic(s, n, next(values), next(values) if phase else ca.SX(0))

    return model.with_step(link, step, effect=effect, parameters=free(meanings, 0.5, "1"))


@effect(link="field", waves=(4,), separate=("another air gap", MAGNET))
def third_harmonic_distortion(
    model: Model,
    phase: str = one_of(
        {"fixed": "in phase", "free": "any phase"}, "phase of the harmonic to the fundamental"
    ),
) -> Model:
    """Third harmonic of the magnet's field: four waves per turn."""
    return field_harmonics(model, "third_harmonic_distortion", "field", (-3,), phase == "free")


@effect(
    link="field", label="cubic", waves=(4,), separate=Way("another air gap", "compression follows the field")
)
def field_saturation(model: Model) -> Model:
    """Both plates compress softly at a high field.

    b becomes b - k b^3 on both.
    """

    def step(s: Signals, p: P) -> None:
        for plate in ("cosine", "sine"):
            b = s[plate]
            s[plate] = b - b * b * b * p["compression"]

    new = free({"compression": "share of the field that compression takes at the peak"}, 0.5, "1")
    return model.with_step("field", step, effect="field_saturation", parameters=new)


@effect(link="field", separate=MAGNET, waves=(1,))
def uniform_stray_field(
    model: Model,
    source: str = one_of(
        {"static": "static", "speed": "in proportion to speed"},
        "what the field follows",
        when=lambda source, model, facts: source == "static" or "t_s" in facts.columns,
    ),
    runs: tuple[int, ...] | None = found(switched, "run numbers in which the field is on", instead=True),
) -> Model:
    """External field: static, switched, or with the speed."""
    name = "uniform_stray_field"
    if runs is not None:
        return following(model, name, "transducer", VOLTAGES, in_runs(runs), 100.0, "1")
    if source == "static":
        return offset(model, name)
    return following(model, name, "transducer", VOLTAGES, column(rate(REFERENCE), "per speed"), 100.0, "1")
